"""Search for the map of a linear state-space model by the error of its free runs.

Free runs are first-order filters in the Schur form of the map, their derivatives sums of such over
its modes, so that no loop goes over samples.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.linalg import schur


@dataclass(frozen=True)
class LinearSearchOptions:
    """Constants of the search.

    Attributes:
        lengths: samples of the segments that are simulated, one stage after the other, before
            whole records: as long as the windows on which networks begin and end.
        iterations: most steps of a stage; few stages take more than ten.
        gain: part of the cost that a step has to save for another one to follow.
        damping: of Levenberg-Marquardt: at the beginning, and where the search gives up.
        derivatives: most derivatives of a position that are used, evenly thinned out: the many
            parameters of many coordinates would take minutes, and need no more.
    """

    lengths: tuple[int, ...] = (100, 200, 400)
    iterations: int = 20
    gain: float = 1e-3
    damping: tuple[float, float] = (1e-3, 1e6)
    derivatives: int = 500_000


@dataclass(frozen=True)
class LinearRecord:
    """A record in the units of a linear model.

    Attributes:
        states: positions and velocities, (n, 2 n_q).
        drive: inputs from each sample to the next, and a column of ones, (n, n_u + 1).
    """

    states: Float[np.ndarray, "*n n_measured"]
    drive: Float[np.ndarray, "*n n_drive"]

    def every(self, factor: int) -> "LinearRecord":
        """Every so manieth of several segments."""
        return LinearRecord(self.states[::factor], self.drive[::factor])


@dataclass(frozen=True)
class PositionResidual:
    """The error of simulated positions, of angles by the periodic distance.

    Attributes:
        unit: of each position [rad or m], (n_q,).
        angular: which are angles, (n_q,).
    """

    unit: Float[np.ndarray, " n_q"]
    angular: Bool[np.ndarray, " n_q"]

    def compute(self, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of scaled errors (..., n_q) in SI units, and their derivatives."""
        error = error * self.unit
        periodic = np.where(self.angular, 2 * np.sin(error / 2), error)
        return periodic, np.where(self.angular, np.cos(error / 2), 1.0) * self.unit


Change = Float[np.ndarray, "n_x n_x_and_drive"]
_BESIDE = 1e-9  # of a map, a difference that no derivative shows


class LinearSearch:
    """Searches for the change of the state in a period, `x[k+1] = x[k] + change [x[k]; drive[k]]`.

    Args:
        train: the records that it is fitted to.
        choosing: the records whose free runs choose among the stages.
        residual: how positions are compared.
        longest: most samples of a segment, None for whole records.
        options: the constants of the search.
    """

    def __init__(
        self,
        train: Sequence[LinearRecord],
        choosing: Sequence[LinearRecord],
        residual: PositionResidual,
        longest: int | None = None,
        options: LinearSearchOptions | None = None,
    ) -> None:
        self._train, self._residual = train, residual
        self._options = options or LinearSearchOptions()
        self._longest = max(len(r.states) for r in (*train, *choosing))
        self._longest = min(self._longest, longest or self._longest)
        self._choosing = choosing

    @np.errstate(all="ignore")  # of maps whose free runs diverge
    def run(self, initial: Change, should_stop: Callable[[], bool]) -> tuple[Change, bool]:
        """The best change after all stages, and whether there was time for all of them.

        Args:
            initial: where the search begins.
            should_stop: asked before every step.
        """
        stages, change, is_complete = [initial], initial, True
        for length in self._lengths:
            change, is_complete = self._descend(change, _cut(self._train, length), should_stop)
            stages.append(change)
            if not is_complete:
                break
        return self._choose(stages), is_complete

    @property
    def _lengths(self) -> list[int]:
        """Samples of the segments of every stage."""
        lengths = (*self._options.lengths, self._longest)
        return sorted({min(length, self._longest) for length in lengths})

    def _choose(self, stages: Sequence[Change]) -> Change:
        """The stage with the best free runs over the longest segments that one of them follows.

        That is: better than a position that stays at its mean. Whole records of a plant that a
        controller holds are followed by none. What over no length is better than standing still, as
        where columns hardly move, is replaced by that.
        """
        rest = np.zeros_like(stages[0])
        cuts = [_cut(self._choosing, length) for length in self._lengths]
        costs = np.array([[self._cost(c, cut) for c in (*stages, rest)] for cut in cuts])
        best = 0
        for k, (cut, row) in enumerate(zip(cuts, costs[:, :-1], strict=True)):
            still = sum(self._sum_of_squares(self._positions(s)) for s in cut)
            if k == 0 or row.min() < still / _count(cut):
                best = int(np.argmin(row))
        return stages[best] if (costs[:, best] < costs[:, -1]).any() else rest

    def _descend(
        self, change: Change, segments: Sequence[LinearRecord], should_stop: Callable[[], bool]
    ) -> tuple[Change, bool]:
        """The change after the Levenberg-Marquardt steps of a stage, and whether that was all."""
        damping, most = self._options.damping
        cost = self._cost(change, segments)
        for _ in range(self._options.iterations):
            if not np.isfinite(cost):  # no derivatives: what diverges is left as it was
                break
            if should_stop():
                return change, False
            normal, gradient = self._normal_equations(change, segments)
            diagonal, least = np.diag(normal), 1e-12 * np.trace(normal)
            following, new_cost = change, np.inf
            while damping < most:
                step = np.linalg.solve(normal + np.diag(damping * diagonal + least), gradient)
                following = change - step.reshape(change.shape)
                new_cost = self._cost(following, segments)
                if new_cost < cost:
                    break
                damping *= 10
            if not new_cost < (1 - self._options.gain) * cost:
                return (following if new_cost < cost else change), True
            change, cost, damping = following, new_cost, damping / 10
        return change, True

    def _cost(self, change: Change, segments: Sequence[LinearRecord]) -> float:
        """Mean squared residual of free runs; infinite where one diverges."""
        if not np.isfinite(change).all():
            return np.inf
        total = 0.0
        for segment in segments:
            states = _FreeRun(change, segment).states[..., : self._outputs]
            total += self._sum_of_squares(states - self._positions(segment))
        return total / _count(segments) if np.isfinite(total) else np.inf

    def _normal_equations(
        self, change: Change, segments: Sequence[LinearRecord]
    ) -> tuple[np.ndarray, np.ndarray]:
        """`J'J` and `J'r` of free runs."""
        factor = max(1, _count(segments) * change.size // self._options.derivatives)
        normal, gradient = np.zeros((change.size, change.size)), np.zeros(change.size)
        for all_of_length in segments:
            # some of many segments, or of few some of their samples
            segment, thin = all_of_length, factor
            if len(segment.states) >= factor:
                segment, thin = segment.every(factor), 1
            run = _FreeRun(change, segment)
            error = run.states[..., : self._outputs] - self._positions(segment)
            residual, slope = self._residual.compute(error[:, ::thin])
            jacobian = run.derivatives(self._outputs, thin) * slope[..., None, None]
            jacobian = jacobian.reshape(-1, change.size)
            normal += jacobian.T @ jacobian
            gradient += jacobian.T @ residual.ravel()
        return normal, gradient

    def _sum_of_squares(self, error: np.ndarray) -> float:
        return float(np.sum(self._residual.compute(error)[0] ** 2))

    @property
    def _outputs(self) -> int:
        return len(self._residual.unit)

    def _positions(self, segment: LinearRecord) -> np.ndarray:
        return segment.states[..., : self._outputs]


class _FreeRun:
    """Free runs of segments from their measured states; internal states begin at 0.

    Args:
        change: of the state in a period.
        segment: segments of one length, (segments, samples, ...).

    Attributes:
        states: the simulated states, (segments, samples, n_x).
    """

    def __init__(self, change: Change, segment: LinearRecord) -> None:
        n_x, self._drive = len(change), segment.drive
        self._map = np.eye(n_x) + change[:, :n_x]
        triangular, basis, *_ = schur(self._map, output="complex")
        forcing = np.empty((*segment.states.shape[:2], n_x))
        forcing[:, 0] = 0.0
        forcing[:, 0, : segment.states.shape[-1]] = segment.states[:, 0]
        forcing[:, 1:] = segment.drive[:, :-1] @ change[:, n_x:].T
        rotated = _filter_triangular(triangular, forcing @ basis.conj())
        self.states = np.real(rotated @ basis.T)

    def derivatives(
        self, outputs: int, thin: int
    ) -> Float[np.ndarray, "segments rows n_y n_x n_z"]:
        """Derivatives of positions by the change, of every so manieth sample.

        Each is a sum over the modes of the map, of what a first-order filter makes of a signal.
        """
        # a map that lacks a mode, as of two integrators in a row, is one beside it that has all
        beside = _BESIDE * np.random.default_rng(0).normal(size=self._map.shape)
        values, modes = np.linalg.eig(self._map + beside)
        signals = np.concatenate([self.states, self._drive], axis=-1)
        delayed = np.zeros(signals.shape, complex)
        delayed[:, 1:] = signals[:, :-1]
        responses = np.stack([_filter(value, delayed)[:, ::thin] for value in values], axis=-1)
        weights = modes[:outputs].T[:, :, None] * np.linalg.inv(modes)[:, None, :]
        of_modes = responses @ weights.reshape(len(values), -1)
        return np.moveaxis(np.real(of_modes), -2, -1).reshape(
            *of_modes.shape[:2], outputs, len(values), signals.shape[-1]
        )


def _filter_triangular(
    triangular: Complex[np.ndarray, "n n"], forcing: np.ndarray
) -> Complex[np.ndarray, "segments samples n"]:
    """`w[k] = T w[k-1] + forcing[k]` of an upper triangular `T`, from `w[-1] = 0` on."""
    result = np.zeros(forcing.shape, complex)
    for i in reversed(range(len(triangular))):
        driven = forcing[..., i].astype(complex)
        driven[:, 1:] += result[:, :-1, i + 1 :] @ triangular[i, i + 1 :]
        result[..., i] = _filter(triangular[i, i], driven)
    return result


def _filter(
    pole: complex | float, forcing: np.ndarray
) -> Complex[np.ndarray, "segments samples *n"]:
    """`w[k] = pole w[k-1] + forcing[k]`, from `w[-1] = 0` on."""
    from scipy.signal import lfilter  # takes a second, and most fits are of other families

    return np.asarray(lfilter([1.0], [1.0, -pole], forcing, axis=1))


def _cut(records: Sequence[LinearRecord], length: int) -> list[LinearRecord]:
    """Segments of records, each begins in the middle of the one before.

    Those of one length are together, (segments, samples, ...).
    """
    by_length: dict[int, list[LinearRecord]] = {}
    for r in records:
        samples = min(length, len(r.states))
        for begin in range(0, len(r.states) - samples + 1, max(1, samples // 2)):
            part = slice(begin, begin + samples)
            piece = LinearRecord(r.states[part], r.drive[part])
            by_length.setdefault(samples, []).append(piece)
    return [
        LinearRecord(np.stack([p.states for p in pieces]), np.stack([p.drive for p in pieces]))
        for pieces in by_length.values()
    ]


def _count(segments: Sequence[LinearRecord]) -> int:
    """The number of samples of segments."""
    return sum(s.states.shape[0] * s.states.shape[1] for s in segments)
