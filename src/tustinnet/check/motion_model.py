"""A small model of the motion in all records, which is asked of each.

It is linear in its parameters: the accelerations of the coordinates, averaged over smooth windows
(`weak_form`), are regressed on sines and cosines of angles, positions, velocities, signs of
velocities, inputs, and products of these (an equation error model). It needs no physics of the
machine and is fitted at once; it is far from a good model, and need only be one that holds for
all records alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Channels
from tustinnet.check.levels import LEVELS
from tustinnet.check.view import RecordView
from tustinnet.check.weak_form import Windows
from tustinnet.signals.spectra import welch

Samples = Float[np.ndarray, "_ c"]  # of coordinates and inputs side by side


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
        half: half the width of a window, in samples.
        dt: sampling period [s].
        creep: speed within which the sign of a velocity is smooth, (n_q,).
        held: mask of the coordinates of which a spring may depend.
    """

    channels: Channels
    half: int
    dt: float
    creep: Float[np.ndarray, " n_q"]
    held: Bool[np.ndarray, " n_q"]

    def equations(self, blocks: Sequence[Samples], coarse: int = 1, slow: float = 1.0) -> Equations:
        """The equations of a record, which is given as blocks of samples.

        Args:
            blocks: coordinates and inputs of each.
            coarse: how many times farther apart windows are than in a fit.
            slow: true sampling period over the declared one.
        """
        stride = coarse * max(1, sum(map(len, blocks)) // LEVELS.windows)
        windows = Windows(self.half, stride, self.dt * slow)
        left, right = [], []
        for block in blocks:
            q, u = np.split(block, [self.channels.n_q], axis=1)
            columns = np.stack(self._columns(q, u, windows.dt), axis=1)
            left.append(windows.average(q, derivative=2))
            right.append(np.hstack([windows.average(q, derivative=1), windows.average(columns)]))
        return Equations(np.concatenate(left), np.concatenate(right))

    def _columns(self, q: np.ndarray, u: np.ndarray, dt: float) -> list[np.ndarray]:
        """The regressors at every sample, but for the velocities themselves."""
        v = np.gradient(q, dt, axis=0)
        columns, circular = [np.ones(len(q))], []
        for j, c in enumerate(self.channels.coordinates):
            if c.kind == "angular":
                circular.append((np.sin(q[:, j]), np.cos(q[:, j])))
            if self.held[j]:
                columns += [q[:, j], q[:, j] ** 3]
            columns += [np.tanh(v[:, j] / self.creep[j]), v[:, j] * np.abs(v[:, j])]
        waves = [wave for pair in circular for wave in pair]
        columns += [*waves, *u.T]
        if self.channels.n_q <= LEVELS.few_coordinates:
            products = combinations_with_replacement(range(self.channels.n_q), 2)
            speeds = [v[:, i] * v[:, j] for i, j in products]
            columns += [x * y for x in (*speeds, *u.T) for y in waves]
            columns += [sine * cosine for sine, cosine in circular]
            if len(circular) > 1:
                columns += [x * y for x in circular[0] for y in circular[1]]
        return columns


def split_into_blocks(samples: Samples) -> list[Samples]:
    """The samples of a record, of a long one some blocks from everywhere."""
    if len(samples) <= LEVELS.most_samples:
        return [samples]
    count = LEVELS.most_samples // LEVELS.block
    starts = np.linspace(0, len(samples) - LEVELS.block, count).astype(int)
    return [samples[a : a + LEVELS.block] for a in starts]


def make_regressors(views: Sequence[RecordView]) -> Regressors | None:
    """The regressors for some records, their windows as wide as noise and motion ask for.

    Returns None where nothing moves or the records are too short.
    """
    first = views[0].experiment
    moving = np.any([v.moving for v in views], axis=0)
    long = [v for v in views if len(v.experiment) >= 8 * LEVELS.narrowest]
    if not moving.any() or not long:
        return None
    shortest = min(_fast_period(long, int(j)) for j in np.flatnonzero(moving))
    half, widest = (
        int(np.clip(round(share * shortest), LEVELS.narrowest, LEVELS.widest))
        for share in (LEVELS.share, LEVELS.widened)
    )
    while half < widest and np.any(_noise_share(long, half)[moving] > LEVELS.noise):
        half += max(1, half // 4)
    speed = np.median([np.std(v.velocity, axis=0) for v in views], axis=0)
    span = np.ptp([f(v.experiment.q, axis=0) for v in views for f in (np.min, np.max)], axis=0)
    return Regressors(
        first.channels,
        half,
        first.dt,
        LEVELS.creep * np.maximum(speed, 1e-12),
        ~first.channels.angular | (span < LEVELS.small_range),
    )


def _fast_period(views: Sequence[RecordView], j: int) -> float:
    """Period below which a tenth of the power of a coordinate's velocity lies, in samples."""
    segment = min(LEVELS.segment, *(len(v.experiment) for v in views))
    spectra = [welch(v.velocity[:, j], 1.0, segment) for v in views]
    frequency, power = spectra[0][0], np.mean([p for _, p in spectra], axis=0)
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    at = int(np.searchsorted(share, 0.9))  # beyond the end where the power underflows
    return 1 / float(frequency[np.clip(at, 1, len(frequency) - 1)])


def _noise_share(views: Sequence[RecordView], half: int) -> Float[np.ndarray, " n_q"]:
    """Share of noise in the averaged accelerations of each coordinate, in deviations."""
    windows = Windows(half, max(1, half // 2), views[0].experiment.dt)
    noise = np.median([v.noise for v in views], axis=0) * np.linalg.norm(windows.weights(2))
    parts = [windows.average(v.experiment.q[: 4 * LEVELS.block], 2) for v in views]
    return noise / np.maximum(np.concatenate(parts).std(axis=0), 1e-300)


@dataclass(frozen=True)
class MotionModel:
    """The model, fitted to all sets of samples but one at a time.

    Attributes:
        noise: usual root mean square residual of each equation, (n_q,).
        others: for each set the parameters that fit the others, (p, n_q).
        own: for each set the parameters that fit it.
        equations: for each set its equations.
        weights: weight of each set in the fits to others, between 0 and 1.
    """

    noise: Float[np.ndarray, " n_q"]
    others: list[Float[np.ndarray, "p n_q"]]
    own: list[Float[np.ndarray, "p n_q"]]
    equations: Sequence[Equations]
    weights: Float[np.ndarray, " r"]

    def size(self, equations: Equations) -> float:
        """Mean square acceleration of all equations, each in units of its usual residual."""
        return float(np.mean((equations.left / self.noise) ** 2))

    def cost(self, equations: Equations, parameters: Float[np.ndarray, "p n_q"]) -> float:
        """Mean square residual in the same units."""
        return float(np.mean(((equations.left - equations.right @ parameters) / self.noise) ** 2))

    @cached_property
    def costs(self) -> Float[np.ndarray, " r"]:
        """Mean square residual of each set under the parameters of the others."""
        return np.array([self.cost(e, p) for e, p in zip(self.equations, self.others, strict=True)])

    def usual_cost(self, index: int) -> float:
        """The median residual of all sets but one, and but those that are known to be wrong."""
        others = self.weights > 0
        others[index] = False
        return float(np.median(self.costs[others])) if others.any() else np.inf

    def novelty(self, equations: Equations, index: int) -> float:
        """Distance of the motion of a set from that of the others: 1 where it is alike.

        It is the mean leverage of its windows under the regressors of all others, in units of
        their own, each by what the others leave of it. Where it is large the model fails where it
        extrapolates, as where a servo saturates that no other record drives so far: that says
        nothing of the machine.

        Args:
            equations: equations of the set, as they are or changed.
            index: the set.
        """
        others = [
            e.right for r, e in enumerate(self.equations) if r != index and self.weights[r] > 0
        ]
        reference = np.concatenate(others)
        scale = _scale(reference)
        right, reference = equations.right / scale, reference / scale
        gram = reference.T @ reference / len(reference) + LEVELS.ridge * np.eye(len(scale))
        leverage = np.einsum("mp,pm->m", right, np.linalg.solve(gram, right.T))
        misfit = (equations.left - equations.right @ self.others[index]) / self.noise
        weights = np.sum(misfit**2, axis=1) + 1e-300
        return float(np.average(leverage, weights=weights)) / len(scale)


def fit_motion_model(
    equations: Sequence[Equations], weights: Float[np.ndarray, " r"]
) -> MotionModel:
    """Fits the model to all sets of equations but one, without each in turn.

    Args:
        equations: the equations of each set of samples, of some windows each.
        weights: weights of the sets; 0 for those that are known to be wrong.
    """
    scale = _scale(np.concatenate([e.right for e in equations]))
    largest = np.mean([np.mean(e.left**2, axis=0) for e in equations], axis=0)
    others, share, usual = [], weights, largest
    for _ in range(3):
        others = _solve(equations, share * (1 - np.eye(len(equations))), scale)
        squares = np.array(
            [
                np.mean((e.left - e.right @ p) ** 2, axis=0)
                for e, p in zip(equations, others, strict=True)
            ]
        )
        usual = np.maximum(np.median(squares, axis=0), np.maximum(1e-12 * largest, 1e-300))
        cost = np.mean(squares / usual, axis=1)
        # records that the others do not explain count less for the others
        share = weights / (1 + (cost / (2 * np.median(cost))) ** 2)
    own = _solve(equations, np.eye(len(equations)), scale)
    return MotionModel(np.sqrt(usual), others, own, equations, weights.copy())


def _scale(right: Float[np.ndarray, "m p"]) -> Float[np.ndarray, " p"]:
    """Root mean square of each regressor, 1 of one that is zero."""
    scale = np.sqrt(np.mean(right**2, axis=0))
    return np.where(scale > 0, scale, 1.0)


def _solve(
    equations: Sequence[Equations],
    weights: Float[np.ndarray, "k r"],
    scale: Float[np.ndarray, " p"],
) -> list[Float[np.ndarray, "p n_q"]]:
    """Parameters of least squares over sets of equations, for each choice of their weights."""
    scaled = [e.right / scale for e in equations]
    gram = np.tensordot(weights, np.array([x.T @ x for x in scaled]), 1)
    lefts = [x.T @ e.left for x, e in zip(scaled, equations, strict=True)]
    count = np.maximum(weights @ [len(x) for x in scaled], 1.0)
    gram += LEVELS.ridge * count[:, None, None] * np.eye(len(scale))
    return [*(np.linalg.solve(gram, np.tensordot(weights, np.array(lefts), 1)) / scale[:, None])]


def unexplained_share(
    regressors: Regressors, views: Sequence[RecordView], scales: Float[np.ndarray, " n_q"]
) -> float:
    """Share of the accelerations that the model leaves when it is fitted to all records at once.

    Args:
        regressors: its regressors.
        views: the records.
        scales: factors of the positions in all of them, (n_q,).
    """
    factors = np.append(scales, np.ones(views[0].samples.shape[1] - len(scales)))
    equations = [
        regressors.equations([block * factors for block in split_into_blocks(v.samples)])
        for v in views
    ]
    left, right = (
        np.concatenate(side) for side in zip(*((e.left, e.right) for e in equations), strict=True)
    )
    if len(left) < 3 * right.shape[1]:
        return 1.0
    (parameters,) = _solve(equations, np.ones((1, len(views))), _scale(right))
    residual, total = np.mean((left - right @ parameters) ** 2, axis=0), np.mean(left**2, axis=0)
    moving = total > 0  # squares of tiny accelerations underflow
    return float(np.mean(residual[moving] / total[moving])) if moving.any() else 1.0
