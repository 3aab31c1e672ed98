"""A small model of the motion in all records, which is asked of each.

It is linear in its parameters: the accelerations of the coordinates, averaged over smooth windows
(`weak_form`), are regressed on sines and cosines of angles, positions, velocities, signs of
velocities, inputs, and products of these (an equation error model). It needs no physics of the
machine and is fitted at once; it is far from a good model, and need only be one that holds for
all records alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Channels
from tustinnet.check.view import RecordView
from tustinnet.check.weak_form import Windows
from tustinnet.signals.spectra import welch

_MOST_SAMPLES, _BLOCK = 16_000, 1000  # of a longer record some blocks are taken
_WINDOWS = 250  # of a record, about
_SHARE = 0.1  # half the width of a window, in periods of the fast part of the motion
_FAST_SHARE, _SEGMENT = 0.1, 1024  # of the power; samples of a spectrum
_NARROWEST, _WIDEST = 4, 60  # samples
_NOISE = 0.2  # share of the noise in averaged accelerations that windows are widened to
_WIDENED = 0.4  # periods, no wider
_SMALL_RANGE = 3.0  # rad; a spring may hold an angle that stays within
_FEW_COORDINATES = 2  # so many have products of velocities, too
_CREEP = 0.03  # of the usual speed: sign(v) is smooth within
_RIDGE = 1e-5  # of the mean square of a regressor
_MATTERS = 0.05  # of the accelerations: a force that matters
_STIFF = 1e-3  # the same, of groups of regressors that are scaled
_FEWEST_WINDOWS = 12

Samples = tuple[np.ndarray, np.ndarray]  # positions (n, n_q) and inputs (n, n_u)
Change = Callable[[np.ndarray, np.ndarray], Samples]


@dataclass(frozen=True)
class Equations:
    """Both sides of the equations of motion in every window of a record.

    Attributes:
        left: averaged accelerations, (m, n_q).
        right: averaged regressors, (m, p).
    """

    left: Float[np.ndarray, "m n_q"]
    right: Float[np.ndarray, "m p"]


@dataclass(frozen=True)
class Regressors:
    """The regressors of the model, which are the same for all records.

    Attributes:
        channels: coordinates and inputs.
        windows: the windows, but for the stride.
        creep: speed within which the sign of a velocity is smooth, (n_q,).
        held: mask of the coordinates of which a spring may depend.
        delays: delay of each input in all records, in samples, (n_u,).
        names: a name of each regressor.
        kinds: `constant`, `position`, `velocity`, `speed product` or `input` of each.
    """

    channels: Channels
    windows: Windows
    creep: Float[np.ndarray, " n_q"]
    held: Bool[np.ndarray, " n_q"]
    delays: Float[np.ndarray, " n_u"]
    names: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()

    def equations(
        self, blocks: Sequence[Samples], stride: int, time_scale: float = 1.0
    ) -> Equations:
        """The equations of a record, which is given as blocks of samples.

        Args:
            blocks: positions and inputs of each.
            stride: samples from window to window.
            time_scale: true sampling period over the declared one.
        """
        windows = Windows(self.windows.half, stride, self.windows.dt * time_scale)
        parts = [self._block(windows, q, self._delay(u)) for q, u in blocks]
        return Equations(*(np.concatenate(side) for side in zip(*parts, strict=True)))

    def _delay(self, u: np.ndarray) -> np.ndarray:
        if not self.delays.any():
            return u
        return np.stack([delay(c, d) for c, d in zip(u.T, self.delays, strict=True)], axis=1)

    def _block(self, windows: Windows, q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        columns = self._columns(q, u, windows)
        linear = windows.average_derivative(q)
        return (
            windows.average_second_derivative(q),
            np.concatenate([linear, windows.average(np.stack(columns, axis=1))], axis=1),
        )

    def _columns(self, q: np.ndarray, u: np.ndarray, windows: Windows) -> list[np.ndarray]:
        """The regressors at every sample, but for the velocities themselves."""
        return [column for _, _, column in self._list(q, u, windows)]

    def _list(
        self, q: np.ndarray, u: np.ndarray, windows: Windows
    ) -> list[tuple[str, str, np.ndarray]]:
        names = [c.name for c in self.channels.coordinates]
        v = np.gradient(q, windows.dt, axis=0)
        result = [("1", "constant", np.ones(len(q)))]
        trigonometric = []
        for j, c in enumerate(self.channels.coordinates):
            if c.kind == "angular":
                trigonometric += [
                    (f"sin {c.name}", np.sin(q[:, j])),
                    (f"cos {c.name}", np.cos(q[:, j])),
                ]
            if self.held[j]:
                result.append((c.name, "position", q[:, j]))
                result.append((f"{c.name}^3", "position", q[:, j] ** 3))
            result.append((f"sign {c.name}'", "velocity", np.tanh(v[:, j] / self.creep[j])))
            result.append((f"{c.name}'|{c.name}'|", "velocity", v[:, j] * np.abs(v[:, j])))
        result += [(name, "position", column) for name, column in trigonometric]
        few = self.channels.n_q <= _FEW_COORDINATES
        if few:
            for (a, x), (b, y) in combinations_with_replacement(trigonometric, 2):
                if a[4:] != b[4:] or (a[0] == "s" and b[0] == "c"):
                    result.append((f"{a} {b}", "position", x * y))
            for i, j in combinations_with_replacement(range(self.channels.n_q), 2):
                product = v[:, i] * v[:, j]
                result += [
                    (f"{names[i]}' {names[j]}' {name}", "speed product", product * column)
                    for name, column in trigonometric
                ]
        for k, i in enumerate(self.channels.inputs):
            result.append((i.name, "input", u[:, k]))
            if few:
                result += [
                    (f"{i.name} {name}", "input", u[:, k] * column)
                    for name, column in trigonometric
                ]
        return result

    def with_names(self, q: np.ndarray, u: np.ndarray) -> "Regressors":
        """These regressors with their names and kinds."""
        velocities = [(f"{c.name}'", "velocity") for c in self.channels.coordinates]
        others = [(name, kind) for name, kind, _ in self._list(q, u, self.windows)]
        names, kinds = zip(*velocities, *others, strict=True)
        return replace(self, names=names, kinds=kinds)

    def with_delay(self, k: int, samples: float) -> "Regressors":
        """These regressors with an input that acts later in all records."""
        delays = self.delays.copy()
        delays[k] += samples
        return replace(self, delays=delays)


def delay(column: Float[np.ndarray, " n"], samples: float) -> Float[np.ndarray, " n"]:
    """A signal that is later by some samples, its ends held."""
    k = np.arange(len(column))
    return np.interp(k - samples, k, column)


def split_into_blocks(q: np.ndarray, u: np.ndarray) -> list[Samples]:
    """The samples of a record, of a long one some blocks from everywhere."""
    if len(q) <= _MOST_SAMPLES:
        return [(q, u)]
    starts = np.linspace(0, len(q) - _BLOCK, _MOST_SAMPLES // _BLOCK).astype(int)
    return [(q[a : a + _BLOCK], u[a : a + _BLOCK]) for a in starts]


def make_regressors(views: Sequence[RecordView]) -> Regressors | None:
    """The regressors for some records, their windows as wide as noise and motion ask for.

    Returns None where nothing moves or the records are too short.
    """
    first = views[0].experiment
    q = [v.experiment.q for v in views]
    moving = [j for j in range(first.channels.n_q) if any(v.moving[j] for v in views)]
    long = [v for v in views if len(v.experiment) >= 8 * _NARROWEST]
    if not moving or not long:
        return None
    shortest = min(_fast_period(long, j) for j in moving)
    half = int(np.clip(round(_SHARE * shortest), _NARROWEST, _WIDEST))
    widest = int(np.clip(round(_WIDENED * shortest), _NARROWEST, _WIDEST))
    while half < widest and _noise_share(long, half, moving) > _NOISE:
        half += max(1, half // 4)
    speed = np.median([np.std(v.velocity, axis=0) for v in views], axis=0)
    speed = np.maximum(speed, 1e-12)
    span = np.max([x.max(axis=0) for x in q], axis=0) - np.min([x.min(axis=0) for x in q], axis=0)
    angular = first.channels.angular
    regressors = Regressors(
        first.channels,
        Windows(half, 1, first.dt),
        _CREEP * speed,
        ~angular | (span < _SMALL_RANGE),
        np.zeros(first.channels.n_u),
    )
    return regressors.with_names(first.q[:2], first.u[:2])


def _fast_period(views: Sequence[RecordView], j: int) -> float:
    """Period below which a tenth of the power of a coordinate's velocity lies, in samples."""
    segment = min(_SEGMENT, *(len(v.experiment) for v in views))
    spectra = [welch(v.velocity[:, j], 1.0, segment) for v in views]
    frequency, power = spectra[0][0], np.mean([p for _, p in spectra], axis=0)
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    at = int(np.searchsorted(share, 1 - _FAST_SHARE))  # beyond the end where the power underflows
    return 1 / float(frequency[np.clip(at, 1, len(frequency) - 1)])


def _noise_share(views: Sequence[RecordView], half: int, moving: Sequence[int]) -> float:
    """Largest share of noise in the averaged accelerations of a coordinate, in deviations."""
    windows = Windows(half, max(1, half // 2), views[0].experiment.dt)
    weights = windows._weights()[2]
    noise = np.median([v.noise for v in views], axis=0) * np.sqrt(weights @ weights)
    parts = [windows.average_second_derivative(v.experiment.q[: 4 * _BLOCK]) for v in views]
    signal = np.concatenate(parts).std(axis=0)
    return float(np.max((noise / np.maximum(signal, 1e-300))[moving]))


@dataclass(frozen=True)
class _Products:
    """Sums of products over the windows of a record."""

    right: Float[np.ndarray, "p p"]
    mixed: Float[np.ndarray, "p n_q"]
    left: Float[np.ndarray, " n_q"]
    windows: int


@dataclass(frozen=True)
class MotionModel:
    """The model, fitted to all records but one at a time.

    Attributes:
        regressors: its regressors.
        scale: root mean square of each regressor, (p,).
        noise: usual root mean square residual of each equation, (n_q,).
        others: for each record the parameters that fit the others, (p, n_q).
        own: for each record the parameters that fit it.
        equations: for each record its equations.
        weights: weight of each record in the fits to others, between 0 and 1.
    """

    regressors: Regressors
    scale: Float[np.ndarray, " p"]
    noise: Float[np.ndarray, " n_q"]
    others: list[Float[np.ndarray, "p n_q"]]
    own: list[Float[np.ndarray, "p n_q"]]
    equations: list[Equations]
    weights: Float[np.ndarray, " r"]

    def cost(self, equations: Equations, parameters: Float[np.ndarray, "p n_q"]) -> float:
        """Mean square residual of all equations, each in units of its usual one."""
        residual = equations.left - equations.right @ parameters
        return float(np.mean(np.mean(residual**2, axis=0) / self.noise**2))

    def explained(self, equations: Equations, parameters: Float[np.ndarray, "p n_q"]) -> float:
        """Share of the accelerations' mean square that the model explains, at most 1."""
        total = float(np.mean(np.mean(equations.left**2, axis=0) / self.noise**2))
        return 1 - self.cost(equations, parameters) / max(total, 1e-300)

    def novelty(self, equations: Equations, index: int) -> float:
        """How far the motion of a record is from that of the others: 1 where it is alike.

        It is the mean leverage of its windows under the regressors of all other records, in units
        of their own. Where it is large the model extrapolates, and its failure says nothing.

        Args:
            equations: equations of the record, as they are or changed.
            index: the record.
        """
        others = [
            e.right for r, e in enumerate(self.equations) if r != index and self.weights[r] > 0
        ]
        right, known = equations.right / self.scale, np.concatenate(others) / self.scale
        gram = known.T @ known / len(known) + _RIDGE * np.eye(len(self.scale))
        leverage = np.einsum("mp,pm->m", right, np.linalg.solve(gram, right.T))
        return float(np.mean(leverage)) / len(self.scale)

    def scale_groups(
        self, index: int, kinds: Sequence[str]
    ) -> tuple[Float[np.ndarray, "p n_q"], dict[str, Float[np.ndarray, " n_q"]]]:
        """Parameters of the others, those of some kinds scaled by factors that fit a record.

        Returns:
            The parameters, and the factors of each kind in each equation, 1 where it is a small
            part of the accelerations.
        """
        equations, parameters = self.equations[index], self.others[index].copy()
        masks = [np.array([k == kind for k in self.regressors.kinds]) for kind in kinds]
        factors = {kind: np.ones(parameters.shape[1]) for kind in kinds}
        for i in range(parameters.shape[1]):
            parts = np.stack([equations.right[:, m] @ parameters[m, i] for m in masks], axis=1)
            residual = equations.left[:, i] - equations.right @ parameters[:, i]
            size = np.sqrt(np.mean(parts**2, axis=0))
            size[size == 0] = 1.0
            unit = parts / size
            gram = unit.T @ unit + _STIFF * len(unit) * np.eye(len(kinds))
            change = np.linalg.solve(gram, unit.T @ residual) / size
            for mask, step in zip(masks, change, strict=True):
                parameters[mask, i] *= 1 + step
            matters = size > _MATTERS * np.sqrt(np.mean(equations.left[:, i] ** 2))
            for kind, step, counts in zip(kinds, change, matters, strict=True):
                if counts:
                    factors[kind][i] = 1 + step
        return parameters, factors


def fit_motion_model(
    regressors: Regressors, views: Sequence[RecordView], weights: Float[np.ndarray, " r"]
) -> MotionModel | None:
    """Fits the model to each set of all records but one.

    Args:
        regressors: its regressors.
        views: the records.
        weights: weights of the records; 0 for those that are known to be wrong.

    Returns:
        The model; None of a single record, or where too few windows fit into the records.
    """
    equations = record_equations(regressors, views)
    if len(views) < 2 or sum(len(e.left) for e in equations) < 3 * len(regressors.names):
        return None
    right = np.concatenate([e.right for e in equations])
    scale = np.sqrt(np.mean(right**2, axis=0))
    scale[scale == 0] = 1.0
    products = [
        _Products(
            (e.right / scale).T @ (e.right / scale),
            (e.right / scale).T @ e.left,
            np.sum(e.left**2, axis=0),
            len(e.left),
        )
        for e in equations
    ]
    share, others = weights.copy(), []
    n_q = regressors.channels.n_q
    noise = np.ones(n_q)
    for _ in range(3):
        others = [_solve(products, share, scale, without=r) for r in range(len(views))]
        squares = np.array(
            [
                np.mean((e.left - e.right @ p) ** 2, axis=0)
                if len(e.left)
                else np.full(n_q, np.nan)
                for e, p in zip(equations, others, strict=True)
            ]
        )
        known = np.isfinite(squares).all(axis=1)
        if not known.any():
            return None
        usual = np.median(squares[known], axis=0)
        largest = np.mean([np.mean(e.left**2, axis=0) for e in equations if len(e.left)], axis=0)
        noise = np.sqrt(np.maximum(usual, np.maximum(1e-12 * largest, 1e-300)))
        cost = np.where(known, np.mean(squares / noise**2, axis=1), 1.0)
        # records that the others do not explain count less for the others
        share = weights / (1 + (cost / (2 * np.median(cost[known]))) ** 2)
    own = [_solve([p], np.ones(1), scale, without=None) for p in products]
    return MotionModel(regressors, scale, noise, others, own, equations, weights)


def record_equations(regressors: Regressors, views: Sequence[RecordView]) -> list[Equations]:
    """The equations of each record."""
    equations = []
    for view in views:
        blocks = split_into_blocks(view.experiment.q, view.experiment.u)
        equations.append(regressors.equations(blocks, stride_for(blocks)))
    return equations


def stride_for(blocks: Sequence[Samples]) -> int:
    """Samples from window to window, for about `_WINDOWS` of them in a record."""
    return max(1, sum(len(q) for q, _ in blocks) // _WINDOWS)


def _solve(
    products: Sequence[_Products], weights: np.ndarray, scale: np.ndarray, without: int | None
) -> Float[np.ndarray, "p n_q"]:
    """Parameters of least squares over records, (p, n_q)."""
    kept = [(p, w) for r, (p, w) in enumerate(zip(products, weights, strict=True)) if r != without]
    gram = sum(w * p.right for p, w in kept)
    mixed = sum(w * p.mixed for p, w in kept)
    count = sum(w * p.windows for p, w in kept)
    gram = gram + _RIDGE * max(count, 1.0) * np.eye(len(scale))
    return np.linalg.solve(gram, mixed) / scale[:, None]


def has_windows(equations: Equations) -> bool:
    """Whether a record is long enough for the model to be asked of it."""
    return len(equations.left) >= _FEWEST_WINDOWS


def unexplained_share(
    regressors: Regressors, views: Sequence[RecordView], scales: Float[np.ndarray, " n_q"]
) -> float:
    """Share of the accelerations that the model leaves when it is fitted to all records at once.

    Args:
        regressors: its regressors.
        views: the records.
        scales: factors of the positions in all of them, (n_q,).
    """
    equations = []
    for view in views:
        e = view.experiment
        blocks = split_into_blocks(e.q * scales, e.u)
        equations.append(regressors.equations(blocks, stride_for(blocks)))
    left = np.concatenate([e.left for e in equations])
    right = np.concatenate([e.right for e in equations])
    if len(left) < 3 * right.shape[1]:
        return 1.0
    scale = np.sqrt(np.mean(right**2, axis=0))
    right = right / np.where(scale > 0, scale, 1.0)
    gram = right.T @ right + _RIDGE * len(right) * np.eye(right.shape[1])
    residual = left - right @ np.linalg.solve(gram, right.T @ left)
    total = np.mean(left**2, axis=0)
    moving = total > 0
    if not moving.any():  # squares of tiny accelerations underflow
        return 1.0
    return float(np.mean(np.mean(residual**2, axis=0)[moving] / total[moving]))
