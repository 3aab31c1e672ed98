"""When inputs act: holds, delays and lags from records alone, without a model of the system.

The second difference of a position is its acceleration, averaged exactly by a triangle that spans
two periods. What an input adds to it is therefore declared in closed form for every hold, delay and
first-order lag: a weight for each sample before (`Response`). Records are then a regression,

    (q[k+1] - 2 q[k] + q[k-1]) / dt^2
        = static(q[k], v[k]) + gain(q[k]) sum_l weight[l] u[k-l] + noise,

with flexible functions in the place of equations of motion. The noise is white measurement noise,
which second differences amplify, beside an autoregressive part for all that the functions miss;
both whiten the regression. Its Gram matrices by blocks of rows are computed once: a hypothesis
mixes their columns, so that hundreds of them cost little. Blocks that are left out give errors
(jackknife) and the likelihoods by which hypotheses are compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import factorial
from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import block_diag, solve_toeplitz

from tustinnet.errors import InputError
from tustinnet.signals.encoder import encoder_count
from tustinnet.signals.excitation import DeclaredHold
from tustinnet.signals.outliers import TO_DEVIATION

Verdict = Literal["none", "delay", "lag", "delay and lag", "delay or lag", "early", "unclear"]
Array = Float[np.ndarray, "..."]


@dataclass(frozen=True)
class TimingLevels:
    """Levels that decide between hypotheses; set on simulated systems, then tried on others.

    Attributes:
        rows: of all records, at most; more say little that is new.
        fewest_rows: in motion, below which nothing is told.
        coupled: coordinates, at most, whose functions have products of theirs.
        most: coordinates or inputs, at most; more take minutes.
        blocks: of rows, for errors and likelihoods.
        earliest: smallest delay that is tried [periods]; one below 0 is none, but shows a defect.
        latest: largest delay [periods].
        slowest: largest time constant of a lag [periods].
        outlier: robust standard deviations of a residual that is one: a collision, a lost sample.
        clear: standard errors of a delay that is one, of a likelihood that is clearly better.
        gain: log-likelihood a row that matters; less is nothing, however significant.
        hold_gain: the same of another hold than `zero-order`, a coordinate.
        hold_share: the same, of all that the input explains.
        none: shortest delay that matters [periods].
        vague: standard error of a delay [periods], of a lag relative to it, that tells nothing.
        floor: smallest standard error [periods]: damping between two samples makes as much.
        power: log-likelihood a row that an input explains, below which functions that miss some of
            the motion look like its delay: of arms under stiff control it is 0.004 to 0.2.
        both: smallest delay and lag [periods] of an input that has both.
        both_share: of all that the input explains, what both explain beyond one of them.
        feedback: log-likelihood a row that later inputs add in a closed loop.
        behind: share of it that no hypothesis without later inputs reaches in a closed loop.
        misfit: share of what free weights explain that a true hypothesis may miss.
        misfit_closed: the same in a closed loop, where a wrong one looks better than it is.
    """

    rows: int = 8_000
    fewest_rows: int = 200
    coupled: int = 6
    most: int = 12
    blocks: int = 10
    earliest: float = -2.0
    latest: float = 8.0
    slowest: float = 20.0
    outlier: float = 6.0
    clear: float = 3.0
    gain: float = 0.01
    hold_gain: float = 0.05
    hold_share: float = 0.1
    none: float = 0.1
    vague: float = 0.2
    floor: float = 0.05
    power: float = 0.25
    both: float = 0.4
    both_share: float = 0.05
    feedback: float = 0.04
    behind: float = 0.15
    misfit: float = 0.4
    misfit_closed: float = 0.03


TIMING = TimingLevels()


class Measured(NamedTuple):
    """A value and its standard error."""

    value: float
    error: float

    @property
    def is_vague(self) -> bool:
        """Whether a delay or lag [periods] tells nothing."""
        return self.error > TIMING.vague * max(1.0, self.value)


@dataclass(frozen=True)
class InputTiming:
    """The time at which an input acts: hold, delay and lag.

    Attributes:
        verdict: what it has: a delay, a first-order lag, both, one of them of which records do not
            say which, or none; `early` where it acts before it is logged, which is a defect of the
            log; `unclear` where records do not tell.
        hold: the hold; `zero-order` unless another one is clearly better.
        delay: the delay beside a lag where there are both, else the delay without a lag [s].
        lag: the time constant beside a delay where there are both, else without one [s].
        rivals: other holds that explain the records as well, each with a delay of its own.
        is_hidden: of an unclear verdict, whether it is because a controller makes the inputs: later
            ones tell the motion.
    """

    verdict: Verdict
    hold: DeclaredHold
    delay: Measured
    lag: Measured
    rivals: tuple[DeclaredHold, ...]
    is_hidden: bool


# of a step that is integrated two or three times, the differences that make what the samples of an
# input add to a second difference of positions: offsets [periods] and factors
_STENCILS: Mapping[str, tuple[int, tuple[int, ...], tuple[int, ...]]] = {
    "zero-order": (2, (1, 0, -1, -2), (1, -3, 3, -1)),
    "first-order": (3, (2, 1, 0, -1, -2), (1, -4, 6, -4, 1)),
}
_FREQUENCIES = (np.arange(256) + 0.5) / 512  # of the sampling rate


class Response(NamedTuple):
    """The response to an input.

    Attributes:
        hold: its course between samples.
        delay: its delay [periods].
        lag: time constant of its lag [periods].
    """

    hold: DeclaredHold = "zero-order"
    delay: float = 0.0
    lag: float = 0.0

    def weights(self, lags: Int[np.ndarray, " lags"]) -> Float[np.ndarray, " lags"]:
        """The weights of inputs some periods before in a second difference, for a gain of 1.

        Args:
            lags: the periods; negative ones are later inputs.
        """
        if self.hold == "band-limited":
            f = _FREQUENCIES
            spectrum = np.sinc(f) ** 2 * np.exp(-2j * np.pi * f * self.delay)
            spectrum /= 1 + 2j * np.pi * f * self.lag
            return np.real(np.exp(2j * np.pi * np.outer(lags, f)) @ spectrum) / len(f)
        order, offsets, factors = _STENCILS[self.hold]
        t = np.maximum(lags[:, None] - self.delay + np.array(offsets), 0.0)
        step = -np.expm1(-t / self.lag) if self.lag > 1e-6 else np.sign(t)
        for n in range(1, order + 1):  # integrated once more
            step = t**n / factorial(n) - self.lag * step
        return step @ np.array(factors)


class DeclaredTiming(NamedTuple):
    """The hold and the delay that records declare of an input.

    Attributes:
        hold: its hold, None where it is not declared.
        delay: its delay [s], None where it is not declared.
    """

    hold: DeclaredHold | None = None
    delay: float | None = None


def estimate_input_timing(
    positions: Sequence[Float[np.ndarray, "_ n_q"]],
    inputs: Sequence[Float[np.ndarray, "_ n_u"]],
    dt: float,
    angular: Bool[np.ndarray, " n_q"],
    declared: Sequence[DeclaredTiming],
) -> list[InputTiming]:
    """The time at which each input acts.

    Args:
        positions: of each record, (n, n_q) [rad or m]; angles are not wrapped.
        inputs: of each record, (n, n_u).
        dt: sampling period of all records [s].
        angular: which coordinates are angles.
        declared: what is declared of each input. A declared delay leaves no hypothesis, and no lag.

    Raises:
        InputError: too few samples, too many coordinates or inputs, or nothing moves.
    """
    regression = _Regression(positions, inputs, dt, angular)
    usual = [Response(k.hold or "zero-order", (k.delay or 0.0) / dt) for k in declared]
    searched = [j for j, k in enumerate(declared) if k.delay is None]
    for j in searched * min(len(declared), 2):  # twice, as each depends on the others
        one, hold = regression.of_input(j, usual), usual[j].hold
        usual[j] = min((Response(hold, d) for d in _delays(TIMING.earliest, 0.5)), key=one.loss)
    ones = [regression.of_input(j, usual) for j in range(len(declared))]
    tried = [_try_all(one, k, dt) for one, k in zip(ones, declared, strict=True)]
    is_closed = any(map(_shows_feedback, ones, tried))
    if is_closed:
        tried = [
            hypotheses if k.hold or k.delay is not None else _try_causal(one)
            for one, k, hypotheses in zip(ones, declared, tried, strict=True)
        ]
    return [
        _decide(one, hypotheses, k, dt, is_closed)
        for one, hypotheses, k in zip(ones, tried, declared, strict=True)
    ]


_HOLDS: tuple[DeclaredHold, ...] = get_args(DeclaredHold)
Kind = Literal["none", "delay", "lag", "delay and lag"]
_KINDS: tuple[Kind, ...] = get_args(Kind)  # the simpler first


def _delays(earliest: float, step: float) -> Array:
    return np.arange(earliest, TIMING.latest + step / 2, step)


class _Regression:
    """The whitened regression of records, as Gram matrices by coordinate and block of rows.

    Columns are the inputs, each times each gain at each lag, then the second difference; what the
    static functions explain is taken out of all of them.
    """

    def __init__(
        self,
        positions: Sequence[Array],
        inputs: Sequence[Array],
        dt: float,
        angular: Bool[np.ndarray, " n_q"],
    ) -> None:
        every, n_u = np.concatenate(positions), inputs[0].shape[1]
        n_q, is_small = every.shape[1], n_u <= 2
        if max(n_q, n_u) > TIMING.most:
            raise InputError(
                "records", f"{n_q} coordinates, {n_u} inputs", f"at most {TIMING.most} of each"
            )
        # one coordinate leaves room for slow lags; many coordinates have many inputs
        self.lags = (
            np.arange(-6, 61) if n_q == 1 else np.arange(*((-5, 25) if is_small else (-3, 17)))
        )
        motion = _MotionScale.of_records(positions, dt, angular)
        spread, middle = np.std(np.concatenate(inputs), 0), np.mean(np.concatenate(inputs), 0)
        parts, records, end = [], [], 0
        for q, u in zip(positions, inputs, strict=True):
            rows = np.arange(self.lags[-1], len(q) + self.lags[0])
            rows = rows[: max(int(len(rows) * min(1.0, TIMING.rows / len(every))), 100)]
            if len(rows) < len(self.lags):
                continue
            scaled = (u - middle) / (spread + 1e-12)
            static, gains = motion.functions(q)
            moved = np.stack([scaled[rows - lag] for lag in self.lags], 2)[:, :, None]
            if is_small:  # inputs may act by gains that depend on positions, and by their squares
                moved = np.concatenate(
                    [moved * gains[rows][:, None, :, None], moved * np.abs(moved)], 2
                )
            second = (q[rows + 1] - 2 * q[rows] + q[rows - 1]) / dt**2
            span = np.ptp([q[rows + k] for k in range(-4, 4)], axis=0)
            changes = np.sum(np.diff(scaled, axis=0)[rows - 1] ** 2, axis=1)
            is_moving = span > 1.01 * motion.counts  # at rest nothing says when an input acts
            parts.append((static[rows], moved.reshape(len(rows), -1), second, is_moving, changes))
            records.append(slice(end, end + len(rows)))
            end += len(rows)
        if end < TIMING.fewest_rows:
            raise InputError(
                "records", f"{end} samples to judge by", f"at least {TIMING.fewest_rows}"
            )
        static, lagged, second, moving, changes = (
            np.concatenate(x) for x in zip(*parts, strict=True)
        )
        self.gains = lagged.shape[1] // (n_u * len(self.lags))
        size = np.sqrt(np.mean(lagged**2, 0)).reshape(-1, len(self.lags)).mean(1)
        lagged /= np.repeat(size, len(self.lags)) + 1e-12
        # blocks of as much change of the inputs, not of as many rows: falls would say nothing
        information = np.cumsum(changes / (changes.mean() + 1e-300) + 0.05)
        cuts = [
            0,
            *np.searchsorted(information, np.linspace(0, information[-1], TIMING.blocks + 1)[1:-1]),
            end,
        ]
        blocks = [slice(a, b) for a, b in pairwise(cuts)]
        # of all coordinates, as filters take most of the time
        near = np.column_stack([static, lagged[:, self._near(n_u)]])
        filtered = [_filter(near, records, [1.0], _measurement_noise(r)) for r in _RATIOS]
        grams, counts = [], []
        for i in range(n_q):
            weight = moving[:, i].astype(float)
            if weight.sum() < TIMING.fewest_rows or np.ptp(every[:, i]) <= 3 * motion.counts[i]:
                continue
            noise = _Noise.of_regression(filtered, second[:, i], weight, records)
            weight *= np.abs(noise.residual) < TIMING.outlier * noise.deviation
            columns = noise.whiten(np.column_stack([static, lagged, second[:, i]]), records)
            columns *= (weight / noise.deviation)[:, None]
            rest = _without(columns[:, : static.shape[1]], columns[:, static.shape[1] :])
            grams.append([rest[b].T @ rest[b] for b in blocks])
            counts.append([weight[b].sum() + 1e-3 for b in blocks])
        if not grams:
            raise InputError("records", "nothing that moves for long enough", "motion")
        self.grams, self.counts = np.array(grams), np.array(counts)

    def _near(self, n_u: int) -> Bool[np.ndarray, " columns"]:
        """The lagged columns that are enough to tell what noise there is."""
        first = np.arange(self.gains)[:, None] == 0
        within = np.where(
            first, (self.lags >= -1) & (self.lags <= 9), (self.lags >= 0) & (self.lags <= 3)
        )
        return np.tile(within.ravel(), n_u)

    def of_input(self, j: int, responses: Sequence[Response]) -> "_OneInput":
        """The regression on one input, where the others act by their responses."""
        count = self.gains * len(self.lags)
        parts = [
            np.eye(count)
            if i == j
            else np.kron(np.eye(self.gains), response.weights(self.lags)[:, None])
            for i, response in enumerate(responses)
        ]
        mixing = np.asarray(block_diag(*parts, np.ones((1, 1))))
        begin = j * self.gains  # the others have a column a gain
        mixing[:, : begin + count] = np.roll(mixing[:, : begin + count], count, axis=1)
        return _OneInput(mixing.T @ self.grams @ mixing, self.counts, self.lags, self.gains)


@dataclass(frozen=True)
class _MotionScale:
    """Units of positions and velocities, in which functions of them are of size 1.

    Attributes:
        dt: sampling period [s].
        angular: which coordinates are angles.
        counts: of encoders, 0 where none shows [rad or m].
        size: of positions; 1 rad of angles.
        speed: of velocities.
    """

    dt: float
    angular: Bool[np.ndarray, " n_q"]
    counts: Array
    size: Array
    speed: Array

    @classmethod
    def of_records(
        cls, positions: Sequence[Array], dt: float, angular: Bool[np.ndarray, " n_q"]
    ) -> "_MotionScale":
        every = np.concatenate(positions)
        counts = np.array([encoder_count(x) or 0.0 for x in every.T])
        size = np.where(angular, 1.0, np.std(every, 0) + 1e-12)
        scale = cls(dt, angular, counts, size, np.ones(len(counts)))
        speeds = np.concatenate([scale.velocities(q) for q in positions])
        return cls(dt, angular, counts, size, np.sqrt(np.mean(speeds**2, 0)) + 1e-12)

    def velocities(self, q: Array) -> Array:
        """Velocities by a parabola through the last samples, as few as encoders allow.

        Never by a later one: a controller says what the velocity was, and the difference from it
        would say the acceleration.
        """
        columns = []
        for x, count in zip(q.T, self.counts, strict=True):
            fast, taps = np.sqrt(np.mean(np.diff(x) ** 2)) / self.dt, np.zeros(0)
            for n in range(3, 12):
                taps = np.linalg.pinv(np.vander(-np.arange(n) * self.dt, 3))[1]
                if count / np.sqrt(12) * np.linalg.norm(taps) <= 0.1 * fast:
                    break
            columns.append(np.convolve(taps, x - x[0])[: len(x)])
        return np.stack(columns, 1)

    def functions(self, q: Array) -> tuple[Array, Array]:
        """Static functions of positions and velocities, and the gains by which inputs may act."""
        v, q = self.velocities(q) / self.speed, q / self.size
        n, n_q = q.shape
        waves = [  # two for each coordinate
            f(x)
            for x, turns in zip(q.T, self.angular, strict=True)
            for f in ((np.sin, np.cos) if turns else (np.positive, np.square))
        ]
        double = [f(2 * x) for x in q.T[self.angular] for f in (np.sin, np.cos)]
        others = [x if turns else x**3 for x, turns in zip(q.T, self.angular, strict=True)]
        dry = [f for w in v.T for f in (np.tanh(w / 0.03), np.tanh(w / 0.3), w * np.abs(w))]
        squares = [v[:, i] ** 2 for i in range(n_q)]
        pairs = list[Array]()
        if n_q <= TIMING.coupled:
            squares += [v[:, i] * v[:, j] for i in range(n_q) for j in range(i + 1, n_q)]
            pairs = [a * b for i, a in enumerate(waves) for b in waves[2 * (i // 2) + 2 :]]
        static = [np.ones(n), *waves, *double, *others, *v.T, *dry, *squares, *pairs]
        gains = [np.ones(n)]
        if n_q <= 2:
            static += [a * b for a in (*waves, *pairs) for b in (*v.T, *squares)]
            static += [a * np.tanh(w / 0.1) for a in waves for w in v.T]
            gains += waves + (double[1::2] if n_q == 2 else [])
        return np.stack(static, 1), np.stack(gains, 1)


_AUTOREGRESSION = 8  # order of the noise that functions miss
_RATIOS = (0.0, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4)  # of measurement noise to white forces


@dataclass(frozen=True)
class _Noise:
    """The noise of a regression, as filters that make it white.

    Attributes:
        denominator: of the filter for measurement noise beside white forces.
        autoregression: the filter for what is left.
        residual: what the regression leaves, white.
        deviation: robust standard deviation of that.
    """

    denominator: Array
    autoregression: Array
    residual: Array
    deviation: float

    @classmethod
    def of_regression(
        cls, filtered: Sequence[Array], y: Array, weight: Array, records: Sequence[slice]
    ) -> "_Noise":
        """The noise with the smallest innovations of a regression of y.

        Args:
            filtered: the columns, filtered for each of `_RATIOS`.
            y: what is regressed.
            weight: of its rows.
            records: the rows of each record.
        """
        best: tuple[float, Array, Array, Array] | None = None
        for ratio, columns in zip(_RATIOS, filtered, strict=True):
            denominator = _measurement_noise(ratio)
            residual = _without(columns, _filter(y, records, [1.0], denominator), weight)
            bound = TIMING.outlier * _robust_deviation(residual[weight > 0])
            residual = np.clip(residual, -bound, bound) * weight
            parts = [residual[r] for r in records]
            covariance = np.array(
                [sum(x[k:] @ x[: len(x) - k] for x in parts) for k in range(_AUTOREGRESSION + 1)]
            )
            ridge = 1e-9 * covariance[0] * (np.arange(_AUTOREGRESSION) == 0)
            past = solve_toeplitz(covariance[:-1] + ridge, covariance[1:])
            variance = float(covariance[0] - past @ covariance[1:])
            if best is None or variance < 0.995 * best[0]:
                best = variance, denominator, np.concatenate([[1.0], -past]), residual
        assert best is not None
        _, denominator, autoregression, residual = best
        residual = _filter(residual, records, autoregression, [1.0])
        deviation = _robust_deviation(residual[weight > 0])
        return cls(denominator, autoregression, residual, deviation)

    def whiten(self, columns: Array, records: Sequence[slice]) -> Array:
        """Columns through both filters, record by record."""
        return _filter(columns, records, self.autoregression, self.denominator)


def _measurement_noise(ratio: float) -> Array:
    """Denominator of the filter that whitens noise of the spectrum `ratio |1 - z|^4 + 1`."""
    if ratio == 0:
        return np.ones(1)
    roots = np.roots([1, 1j / np.sqrt(ratio) - 2, 1])
    root = roots[np.argmin(np.abs(roots))]
    return np.array([1.0, -2 * root.real, np.abs(root) ** 2])


def _filter(
    columns: Array, records: Sequence[slice], b: Array | list[float], a: Array | list[float]
) -> Array:
    from scipy.signal import lfilter  # takes a second, and few records need it

    return np.concatenate([lfilter(b, a, columns[rows], axis=0) for rows in records])


def _robust_deviation(x: Array) -> float:
    return TO_DEVIATION * float(np.median(np.abs(x))) + 1e-300


def _without(columns: Array, y: Array, weight: Array | None = None) -> Array:
    """The residual of y after a weighted regression on columns, with a slight ridge."""
    z = columns / (np.sqrt(np.mean(columns**2, 0)) + 1e-12)
    weighted = z if weight is None else z * weight[:, None]
    ridge = 1e-6 * len(z) * np.eye(z.shape[1])
    return y - z @ np.linalg.solve(weighted.T @ z + ridge, weighted.T @ y)


class _OneInput:
    """Losses (minus twice log-likelihoods) of hypotheses on how one input acts."""

    def __init__(
        self, grams: Array, counts: Array, lags: Int[np.ndarray, " lags"], gains: int
    ) -> None:
        self.grams, self.counts, self.lags, self.gains = grams, counts, lags, gains
        total, rows = grams.sum(1, keepdims=True), counts.sum(1, keepdims=True)
        self._all, self._others = (total, rows), (total - grams, rows - counts)
        self.rows = counts.mean(0) + 1.0  # by block

    def _mix(self, weights: Array, grams: Array) -> Array:
        """Gram matrices whose columns of lags are mixed by weights, (lags, m)."""
        n = self.gains * len(self.lags)
        for _ in range(2):  # rows, then columns: the matrices are symmetric
            lead, size = grams.shape[:-2], grams.shape[-1]
            own = grams[..., :n, :].reshape(*lead, self.gains, len(self.lags), size)
            mixed = (weights.T @ own).reshape(*lead, -1, size)
            grams = np.swapaxes(np.concatenate([mixed, grams[..., n:, :]], -2), -1, -2)
        return grams

    def _solve(self, weights: Array, grams: Array, rows: Array) -> tuple[Array, Array]:
        """Coefficients and variances by coordinate and block."""
        gram = self._mix(weights, grams)
        xx, xy = gram[..., :-1, :-1], gram[..., :-1, -1]
        on_diagonal = np.arange(xx.shape[-1])
        xx[..., on_diagonal, on_diagonal] = xx[..., on_diagonal, on_diagonal] * (1 + 1e-4) + 1e-9
        coefficients = np.linalg.solve(xx, xy[..., None])[..., 0]
        return coefficients, (gram[..., -1, -1] - np.sum(coefficients * xy, -1)) / rows

    def loss(self, response: Response) -> float:
        """Over all rows."""
        _, variance = self._solve(response.weights(self.lags)[:, None], *self._all)
        return float((self._all[1] * np.log(variance)).sum())

    def losses_without(self, response: Response) -> Array:
        """Over all rows but those of each block."""
        _, variance = self._solve(response.weights(self.lags)[:, None], *self._others)
        return (self._others[1] * np.log(variance)).sum(0)

    def held_out(self, acts: Response | range, block: int | None = None) -> Array:
        """Of each block, or of one, by a fit to the others; a range is of lags with a gain each."""
        if isinstance(acts, range):
            weights = np.eye(len(self.lags))[:, np.isin(self.lags, acts)]
        else:
            weights = acts.weights(self.lags)[:, None]
        at = slice(None) if block is None else slice(block, block + 1)
        coefficients, variance = self._solve(weights, *(x[:, at] for x in self._others))
        ends = np.concatenate([-coefficients, np.ones((*variance.shape, 1))], -1)[..., None]
        missed = np.swapaxes(ends, 2, 3) @ self._mix(weights, self.grams[:, at]) @ ends
        return (self.counts[:, at] * np.log(variance) + missed[..., 0, 0] / variance).sum(0)


class _Hypothesis(NamedTuple):
    """A hold with or without a delay and a lag.

    Attributes:
        point: the best delay and lag [periods].
        error: their standard errors.
        losses: of held-out blocks.
    """

    point: Array
    error: Array
    losses: Array

    @property
    def measured(self) -> tuple[Measured, Measured]:
        """Delay and lag [periods]."""
        (delay, lag), (delay_error, lag_error) = self.point.tolist(), self.error.tolist()
        return Measured(delay, delay_error), Measured(lag, lag_error)


_TIMING_STEP = 0.05  # of differences in delay and lag [periods]


def _search(
    one: _OneInput, hold: DeclaredHold, kind: Kind, earliest: float = TIMING.earliest
) -> _Hypothesis:
    """The best delay and lag of a hypothesis; no lag has a delay before 0."""
    free = [name in kind for name in ("delay", "lag")]
    if kind == "none":
        return _Hypothesis(np.zeros(2), np.zeros(2), one.held_out(Response(hold)))
    low = np.array([earliest if kind == "delay" else max(earliest, 0.0), 0.0])
    high = np.array([TIMING.latest, TIMING.slowest])
    place = np.eye(2)[:, free]

    def response(values: Array) -> Response:
        delay, lag = np.clip(place @ values, low, high)
        return Response(hold, float(delay), float(lag))

    delays = _delays(low[0], 0.5 if kind == "delay" else 1.0) if free[0] else (0.0,)
    lags = (0.3, 0.7, 1.5, 3.0, 6.0, 10.0) if free[1] else (0.0,)  # [periods]
    starts = [np.array(p)[free] for p in product(delays, lags)]
    start = min(starts, key=lambda p: one.loss(response(p)))
    unit = np.eye(len(start))
    options = {
        "initial_simplex": start + np.vstack([np.zeros(len(start)), 0.3 * unit]),
        "xatol": 2e-3,
        "fatol": 1e-3,
        "maxiter": 80,
    }
    from scipy.optimize import minimize  # takes half a second, and few records need it

    result = minimize(lambda p: one.loss(response(p)), start, method="Nelder-Mead", options=options)
    best = np.array(response(result.x)[1:])[free]
    steps, curvature = _jackknife_steps(one, hold, place @ best, place)
    spread = (TIMING.blocks - 1) / TIMING.blocks * np.sum((steps - steps.mean(0)) ** 2, 0)
    formal = 2 * np.abs(np.diag(np.linalg.inv(curvature)))
    error = np.sqrt(np.maximum(spread, formal) + TIMING.floor**2)
    losses = [one.held_out(response(best + step), b) for b, step in enumerate(steps)]
    return _Hypothesis(place @ best, place @ error, np.concatenate(losses))


def _jackknife_steps(
    one: _OneInput, hold: DeclaredHold, at: Array, place: Array
) -> tuple[Array, Array]:
    """A Newton step for each block that is left out, (blocks, m), and the mean curvature."""
    m = place.shape[1]
    near = {
        move: one.losses_without(Response(hold, *(at + _TIMING_STEP * place @ np.array(move))))
        for move in product((-1, 0, 1), repeat=m)
    }
    unit = np.eye(m, dtype=int)
    slope, curvature = np.empty((TIMING.blocks, m)), np.empty((TIMING.blocks, m, m))
    for i in range(m):
        up, down = near[tuple(unit[i])], near[tuple(-unit[i])]
        slope[:, i] = (up - down) / (2 * _TIMING_STEP)
        curvature[:, i, i] = np.maximum((up - 2 * near[(0,) * m] + down) / _TIMING_STEP**2, 1e-9)
    if m == 2:
        mixed = near[1, 1] - near[1, -1] - near[-1, 1] + near[-1, -1]
        curvature[:, 0, 1] = curvature[:, 1, 0] = mixed / (4 * _TIMING_STEP**2)
    curvature += 1e-9 * unit
    steps = -np.linalg.solve(curvature, slope[..., None])[..., 0]
    return np.clip(steps, -2, 2), curvature.mean(0)


def _try_all(one: _OneInput, declared: DeclaredTiming, dt: float) -> "_Hypotheses":
    """All hypotheses that what is declared of an input leaves."""
    holds = (declared.hold,) if declared.hold else _HOLDS
    if declared.delay is None:
        return {key: _search(one, *key) for key in product(holds, _KINDS)}
    point, none = np.array([declared.delay / dt, 0.0]), np.zeros(2)
    return {
        (hold, "none"): _Hypothesis(point, none, one.held_out(Response(hold, *point)))
        for hold in holds
    }


def _try_causal(one: _OneInput) -> "_Hypotheses":
    """The hypotheses in which an input acts when a controller has made it.

    An input that is interpolated is known when the next sample is, so that it acts a period late.
    """
    tried: dict[tuple[DeclaredHold, Kind], _Hypothesis] = {}
    for kind in _KINDS:
        tried["zero-order", kind] = _search(one, "zero-order", kind, 0.0)
    for kind in ("delay", "delay and lag"):
        tried["first-order", kind] = _search(one, "first-order", kind, 1.0)
    return tried


_PAST, _PAST_AND_LATER, _ABSENT = range(9), range(-3, 9), range(0)  # lags with weights of their own
_Hypotheses = Mapping[tuple[DeclaredHold, Kind], _Hypothesis]


def _shows_feedback(one: _OneInput, tried: _Hypotheses) -> bool:
    """Whether later inputs explain the motion, and no hypothesis does: a controller makes them."""
    free = one.held_out(_PAST_AND_LATER).sum()
    later = one.held_out(_PAST).sum() - free
    behind = min(h.losses.sum() for h in tried.values()) - free
    explained = one.held_out(_ABSENT).sum() - free
    return bool(later > TIMING.feedback * one.rows.sum() and behind > TIMING.behind * explained)


def _is_better(losses: Array, others: Array, rows: Array, least: float = TIMING.gain) -> bool:
    """Whether held-out losses are clearly smaller than others; no single block decides."""
    gain = (others - losses) / rows / 2
    bound = 3 * np.median(np.abs(gain))
    gain = np.clip(gain, -bound, bound)
    return bool(gain.mean() > max(TIMING.clear * gain.std(ddof=1) / np.sqrt(len(gain)), least))


def _decide(
    one: _OneInput, tried: _Hypotheses, declared: DeclaredTiming, dt: float, is_closed: bool
) -> InputTiming:
    """The simplest hypothesis that is not clearly worse than the best, or that none can be told."""
    rows, best = one.rows, _best_by_hold(tried)
    top = min(best.values(), key=lambda h: h.losses.sum())
    power = (one.held_out(_ABSENT) - top.losses).sum() / rows.sum() / 2
    misfit = (top.losses - one.held_out(_PAST)).sum() / rows.sum() / 2
    least = max(TIMING.hold_gain * len(one.grams), TIMING.hold_share * power)
    hold = _choose_hold(tried, best, rows, least)
    top = best[hold]
    rivals: tuple[DeclaredHold, ...] = tuple(
        h
        for h, other in best.items()
        if h != hold
        and tried.get((h, "delay"), other).point[0] > -TIMING.none
        and not _is_better(top.losses, other.losses, rows, least)
    )
    if declared.delay is not None:
        delay, lag = Measured(declared.delay, 0.0), Measured(0.0, np.inf)
        return InputTiming("none", hold, delay, lag, rivals, False)
    kinds = _simplest_kinds(tried, hold, top, rows, power)
    lagging = tried.get((hold, "lag")) or tried["zero-order", "lag"]
    delay, lag = tried[hold, "delay"].measured[0], lagging.measured[1]
    is_hidden = is_closed and bool(misfit > TIMING.misfit_closed * (power + misfit))
    is_missed = misfit > TIMING.misfit * (power + misfit)
    if is_hidden or is_missed or (lag if top is lagging else delay).is_vague:
        verdict = "unclear"
    else:
        verdict = _judge(kinds, delay)
    if power < TIMING.power and verdict != "none":
        verdict = "unclear"
    if is_closed and verdict == "none":  # the hypothesis that it was logged late is not tried there
        verdict, is_hidden = "unclear", True
    if verdict == "delay and lag":
        delay, lag = tried[hold, verdict].measured
    if verdict == "unclear":  # of its course between samples they tell as little
        hold, rivals = declared.hold or "zero-order", ()
    delay, lag = (Measured(dt * x.value, dt * x.error) for x in (delay, lag))
    return InputTiming(verdict, hold, delay, lag, rivals, is_hidden)


def _simplest_kinds(
    tried: _Hypotheses, hold: DeclaredHold, top: _Hypothesis, rows: Array, power: float
) -> list[Kind]:
    """The kinds of hypotheses that are not clearly worse than the best, the simplest first."""
    of_hold: dict[Kind, _Hypothesis] = {
        kind: tried[hold, kind] for kind in _KINDS if (hold, kind) in tried
    }
    good: list[Kind] = [k for k, h in of_hold.items() if not _is_better(top.losses, h.losses, rows)]
    if good != ["delay and lag"]:
        return good
    singles: list[Kind] = [k for k in ("delay", "lag") if k in of_hold]
    single = min(singles, key=lambda k: of_hold[k].losses.sum())
    gain = (of_hold[single].losses - top.losses).sum() / rows.sum() / 2
    is_detail = of_hold["delay and lag"].point.min() < TIMING.both
    return [single] if is_detail or gain < TIMING.both_share * power else good


def _judge(kinds: Sequence[Kind], delay: Measured) -> Verdict:
    """The verdict by the kinds that explain the records, and by the delay without a lag."""
    is_clear = abs(delay.value) > TIMING.clear * delay.error
    if abs(delay.value) <= TIMING.none or ("none" in kinds and not is_clear):
        return "none"
    if "none" in kinds or not is_clear:
        return "unclear"
    if delay.value < 0:
        return "early"
    return "delay or lag" if {"delay", "lag"} <= set(kinds) else kinds[0]


def _best_by_hold(tried: _Hypotheses) -> dict[DeclaredHold, _Hypothesis]:
    """The hypothesis with the smallest losses of each hold."""
    best: dict[DeclaredHold, _Hypothesis] = {}
    for (hold, _), hypothesis in tried.items():
        if hold not in best or hypothesis.losses.sum() < best[hold].losses.sum():
            best[hold] = hypothesis
    return best


def _choose_hold(
    tried: _Hypotheses, best: Mapping[DeclaredHold, _Hypothesis], rows: Array, least: float
) -> DeclaredHold:
    """`zero-order`, unless another hold is clearly better, or the input would act early by it."""
    if len(best) == 1:
        return next(iter(best))
    point, error, _ = tried.get(("zero-order", "delay"), best["zero-order"])
    if point[0] >= -max(TIMING.clear * error[0], TIMING.none):
        return _simplest_hold({h: hypothesis.losses for h, hypothesis in best.items()}, rows, least)
    # no input acts early: it is interpolated between samples, or logged late
    simple: list[DeclaredHold] = [
        hold
        for hold in best
        if hold != "zero-order"
        and (hold, "none") in tried
        and not _is_better(best["zero-order"].losses, tried[hold, "none"].losses, rows)
    ]
    if not simple:
        return min(best, key=lambda hold: best[hold].losses.sum())
    return _simplest_hold({h: tried[h, "none"].losses for h in simple}, rows, least)


def _simplest_hold(losses: Mapping[DeclaredHold, Array], rows: Array, least: float) -> DeclaredHold:
    """The first of the holds, the plainest first, that is not clearly worse than the best."""
    plain: tuple[DeclaredHold, ...] = ("zero-order", "first-order", "band-limited")
    holds: list[DeclaredHold] = [hold for hold in plain if hold in losses]
    top = min(holds, key=lambda hold: losses[hold].sum())
    return next(h for h in holds if not _is_better(losses[top], losses[h], rows, least))
