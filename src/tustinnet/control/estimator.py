"""Estimators of states for controllers: an extended Kalman filter, its noise, and tests of both."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.control.input_history import InputHistory, causal_source
from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import smooth_velocities
from tustinnet.engine.engines import make_linearised_step
from tustinnet.errors import InputError
from tustinnet.export.source import Source, require_stepping
from tustinnet.models.contract import Model
from tustinnet.shown import Brief
from tustinnet.signals.causal_velocities import low_pass_velocities, polynomial_velocities
from tustinnet.signals.encoder import encoder_count
from tustinnet.simulate.filtering import (
    LOST_AFTER,
    FilterNoise,
    FilterResult,
    KalmanFilter,
    filter_records,
)
from tustinnet.simulate.range import Range
from tustinnet.simulate.simulation import initial_states
from tustinnet.wording import counted

Vector = Float[np.ndarray, " _"]

_SETTLING = 20  # samples at the beginning of a record that say more of the start than of the noise
_UNKNOWN = 1e-3  # of the travel: noise of a position whose resolution is not known, to begin with
_GUESS = 1e-2  # of the speed: what a step misses, to begin with
_LEAST_MISS = 3e-4  # of the speed: a filter that trusts its model wholly never learns that it errs
_DIVERGED_MISFIT = 1e12  # stands for a likelihood that is no number


class FilterCheck(NamedTuple):
    """Settings by which the innovations of a filter are checked.

    All are set by hand, not measured.

    Attributes:
        confidence: probability of the bounds of innovations that are as expected.
        lags: lags at which innovations are correlated [samples].
        outside: share of the lags that may be outside: of 20 more than two are in 8 % of
            all cases.
        little: correlation up to which innovations are nearly white.
        samples: samples of all records together, at most.
    """

    confidence: float = 0.95
    lags: int = 20
    outside: float = 0.1
    little: float = 0.2
    samples: int = 2500


CHECK = FilterCheck()
_SHORTEST = 2 * _SETTLING + CHECK.lags  # records that say something of the noise


@runtime_checkable
class Estimator(Protocol):
    """Estimates of the state from measured positions, sample by sample; NaN where it is lost."""

    def reset(self, y: Vector) -> Vector:
        """The estimate at the first sample, (n_x,), by the first measurement, (n_y,)."""
        ...

    def update(self, y: Vector, u: Vector) -> Vector:
        """The estimate at the next sample, (n_x,).

        Args:
            y: the new measurement, (n_y,).
            u: the inputs that were applied since the last one, (n_u,).
        """
        ...


class ExtendedKalmanFilter:
    """An extended Kalman filter over the steps of a model, from encoders to states.

    It also estimates internal states, wraps the innovations of angles, and knows the delays of the
    model's inputs. Wrong samples are not used, see `KalmanFilter`; an estimate that is lost is NaN.
    An update takes some tens of microseconds. `estimate.c` of an export to C computes the same.

    Args:
        model: the model, discretised if it is a continuous one.
        noise: standard deviations of the start, of the steps, of the measurement; `find_noise`
            finds them by records.
        lost_after: samples in a row that were not used, after which the estimate is lost, until as
            many were used.
        delay: samples by which inputs act later than the model says, as a computer needs.

    Attributes:
        model: the model.
        noise: the standard deviations.

    Raises:
        InputError: a continuous model, JAX in single precision, noise of other sizes than the
            model's, an estimate that is lost after fewer than one sample.
    """

    def __init__(
        self, model: Model, noise: FilterNoise, lost_after: int = LOST_AFTER, delay: int = 0
    ) -> None:
        require_stepping(model)
        channels = model.channels
        self.model = model
        self.noise = noise.checked(model.state_size, channels.n_q, "ExtendedKalmanFilter")
        if lost_after < 1:
            raise InputError("ExtendedKalmanFilter", f"lost_after {lost_after}", "1 or more")
        source = causal_source(model, delay)
        self._history = InputHistory(source.n_w)
        self._filter = make_filter(source, self.noise, lost_after)

    @property
    def unused(self) -> int:
        """The number of samples since the start that were not used."""
        return self._filter.unused

    @property
    def is_lost(self) -> bool:
        """Whether too many samples in a row were not used."""
        return self._filter.missed < 0

    @property
    def covariance(self) -> Float[np.ndarray, "n_x n_x"]:
        """The covariance of the last estimate, (n_x, n_x)."""
        return self._filter.p

    @property
    def normalised_innovations(self) -> Vector:
        """Excess of the last measurement over the expected one, in expected deviations, (n_q,)."""
        return self._filter.innovations / np.sqrt(self._filter.spreads)

    def reset(self, y: Vector) -> Vector:
        """The estimate at the first sample: the measured positions, at rest, (n_x,)."""
        y = np.asarray(y, np.float64)
        self._history.reset()
        self._filter.restart(rest_state(self.model, y))
        return self._corrected(y)

    def update(self, y: Vector, u: Vector) -> Vector:
        """The estimate at the next sample, (n_x,).

        Args:
            y: the new measurement, (n_q,).
            u: the inputs that were applied since the last one, (n_u,).
        """
        self._filter.predict(self._history.add(np.asarray(u, np.float64)))
        return self._corrected(np.asarray(y, np.float64))

    def _corrected(self, y: Vector) -> Vector:
        self._filter.correct(y)
        return np.full_like(self._filter.x, np.nan) if self.is_lost else self._filter.x


def make_filter(source: Source, noise: FilterNoise, lost_after: int = LOST_AFTER) -> KalmanFilter:
    """A filter over the steps of a model, which is given the input samples of its layout."""
    channels = source.channels
    return KalmanFilter(
        make_linearised_step(source.equations),
        noise,
        channels,
        partial(rest_state, source.model),
        channels.angular if channels.angular.any() else None,
        lost_after,
    )


@dataclass(frozen=True, repr=False)
class FilterConsistency(Brief):
    """Whether a filter's innovations are as large as it expects, and white.

    Attributes:
        channels: of the model.
        samples: how many innovations of each coordinate were examined.
        nis: mean of the normalised innovations squared (NIS), of each coordinate, (n_q,): 1 where
            the filter is right, more where it is too sure of itself, less where it is too careful.
        bounds: within which this mean is with a probability of 95 % where the filter is right,
            by the chi-square distribution.
        correlation: of innovations at lags of 1 to 20 samples, (20, n_q).
        correlation_bound: within which independent innovations are at 95 % of the lags.
        velocity_errors: root mean square of what velocities are off from those of the smoothed
            records: of the filter, of the best low-pass of differences, of the best parabola
            through the last samples, (3, n_q) [rad/s or m/s].

    References:
        Bar-Shalom, Li, Kirubarajan (2001), Estimation with Applications to Tracking and
        Navigation, section 5.4.
    """

    channels: Channels
    samples: int
    nis: Vector
    bounds: tuple[float, float]
    correlation: Float[np.ndarray, "lags n_q"]
    correlation_bound: float
    velocity_errors: Float[np.ndarray, "3 n_q"]

    @property
    def is_consistent(self) -> bool:
        """Whether the filter is not surer of itself than it may be."""
        return bool((self.nis <= self.bounds[1]).all())

    @property
    def is_white(self) -> bool:
        """Whether no more lags are outside than independent innovations would have."""
        return bool((self._outside <= CHECK.outside).all())

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict on each coordinate."""
        largest = np.abs(self.correlation).max(axis=0)
        low, high = self.bounds
        sentences = []
        for j, coordinate in enumerate(self.channels.coordinates):
            verdict = (
                "too sure of itself"
                if self.nis[j] > high
                else "careful"
                if self.nis[j] < low
                else "consistent"
            )
            correlated = f"correlated by up to {largest[j]:.2f}"
            white = (
                "white"
                if self._outside[j] <= CHECK.outside
                else f"nearly white ({correlated})"
                if largest[j] < CHECK.little
                else f"not white ({correlated}): the model lacks something that lasts longer than "
                "a sample"
            )
            sentences.append(
                f"{coordinate.name}: the filter is {verdict}, innovations are "
                f"{math.sqrt(self.nis[j]):.2f} times as large as it expects, and {white}"
            )
            own, low_pass, parabola = self.velocity_errors[:, j]
            better = "" if own <= min(low_pass, parabola) else ", so the model is of no use to it"
            sentences.append(
                f"{coordinate.name}: its velocity is off by {own:.3g} {coordinate.unit}/s, that of "
                f"the best low-pass by {low_pass:.3g}, of the best parabola through the last "
                f"samples by {parabola:.3g}{better}"
            )
        return tuple(sentences)

    @property
    def _outside(self) -> Vector:
        """The share of lags that are outside, (n_q,)."""
        return np.mean(np.abs(self.correlation) > self.correlation_bound, axis=0)


def find_noise(model: Model, records: Sequence[Experiment]) -> FilterNoise:
    """The noise with which a filter of a model explains records best.

    What encoders err by follows from their resolution, where it is known. What the model misses in
    a step is found by the likelihood of the innovations, as a standard deviation of each velocity:
    positions miss half a period times as much. Internal states have one factor for all.

    Args:
        model: the model.
        records: records of its system; parts of them, 1250 samples together, are used.

    Returns:
        The standard deviations. Those of the start are for a start at rest at the first measured
        positions, as `ExtendedKalmanFilter.reset` does it.

    Raises:
        InputError: no records, records of another system, or the model diverges along all of them.

    References:
        Mehra (1970), On the identification of variances and adaptive Kalman filtering, IEEE
        Transactions on Automatic Control 15(2).
    """
    import scipy.optimize

    # so many samples tell the noise to about 2 %
    parts = _parts(model, records, 1250)
    channels, n_z = model.channels, len(model.internal)
    # velocities that differ by counts are no motion: what never moves still has a unit
    speed = _spread([e.velocities() for e in parts])
    travel = _spread([e.q - e.q.mean(axis=0) for e in parts])
    resolution = _resolution(channels, parts)
    has_resolution = resolution > 0
    spread = np.asarray(model.internal_spread, np.float64)
    guess = np.concatenate(
        [np.log(_GUESS * speed), np.zeros(min(n_z, 1)), np.zeros(np.count_nonzero(~has_resolution))]
    )

    def noise(logarithms: Vector) -> FilterNoise:
        factors = np.exp(np.clip(logarithms, -40.0, 40.0))
        velocity, rest = np.split(factors, [channels.n_q])
        velocity = np.maximum(velocity, _LEAST_MISS * speed)
        internal = np.maximum(_GUESS * (rest[0] if n_z else 1.0), _LEAST_MISS) * spread
        measured = resolution / math.sqrt(12)  # rounding is uniform within a count
        measured[~has_resolution] = _UNKNOWN * travel[~has_resolution] * rest[min(n_z, 1) :]
        return FilterNoise(
            start=np.concatenate([measured, speed, spread]),
            process=np.concatenate([velocity * channels.dt / 2, velocity, internal]),
            measured=measured,
        )

    def misfit(logarithms: Vector) -> float:
        """Minus twice the logarithm of the likelihood, for each innovation."""
        total = []
        for result in _filtered(model, parts, noise(logarithms)):
            variances = result.innovation_deviations[_SETTLING:] ** 2
            squares = result.innovations[_SETTLING:] ** 2 / variances
            total.append(np.log(variances) + squares)
        value = float(np.mean(np.concatenate(total)))
        return value if math.isfinite(value) else _DIVERGED_MISFIT

    if misfit(guess) >= _DIVERGED_MISFIT:
        raise InputError(
            "find_noise", "a model that diverges along the records", "one that simulates them"
        )
    result = scipy.optimize.minimize(
        misfit,
        guess,
        method="Nelder-Mead",
        options={
            "maxfev": 50,
            "xatol": 0.05,
            "fatol": 1e-3,
            "initial_simplex": np.vstack([guess, guess + 1.5 * np.eye(len(guess))]),
        },
    )
    return noise(result.x)


def check_filter(
    model: Model, records: Sequence[Experiment], noise: FilterNoise
) -> FilterConsistency:
    """Tests whether a filter's innovations along records are white, and as large as it expects.

    Args:
        model: the model.
        records: records of its system, better others than those by which the noise was found.
        noise: the noise that the filter assumes.

    Raises:
        InputError: no records, or records of another system.
    """
    import scipy.stats

    parts = _parts(model, records, CHECK.samples)
    results = _filtered(model, parts, noise)
    series = [(one.innovations / one.innovation_deviations)[_SETTLING:] for one in results]
    pooled = np.concatenate(series)
    n = len(pooled)
    tails = ((1 - CHECK.confidence) / 2, (1 + CHECK.confidence) / 2)
    low, high = (float(scipy.stats.chi2.ppf(tail, n)) / n for tail in tails)
    power = np.sum(pooled**2, axis=0)
    correlations = np.stack(
        [
            sum(np.sum(e[:-lag] * e[lag:], axis=0) for e in series) / power
            for lag in range(1, CHECK.lags + 1)
        ]
    )
    return FilterConsistency(
        channels=model.channels,
        samples=n,
        nis=power / n,
        bounds=(low, high),
        correlation=correlations,
        correlation_bound=float(scipy.stats.norm.ppf(tails[1])) / math.sqrt(n),
        velocity_errors=_velocity_errors(parts, results),
    )


def _velocity_errors(
    parts: Sequence[Experiment], results: Sequence[FilterResult]
) -> Float[np.ndarray, "3 n_q"]:
    """Errors of the filter's velocities, and of what is computed without a model; see there."""
    channels = parts[0].channels
    smoothed = [smooth_velocities(e) for e in parts]

    def error(velocities: Sequence[np.ndarray]) -> np.ndarray:
        squares = [
            (v - expected)[_SETTLING:] ** 2
            for v, expected in zip(velocities, smoothed, strict=True)
        ]
        return np.sqrt(np.mean(np.concatenate(squares), axis=0))

    own = error([result.states[:, channels.velocity] for result in results])
    without_model = [
        np.min([error(v) for v in zip(*(compute(e.q, e.dt) for e in parts), strict=True)], axis=0)
        for compute in (low_pass_velocities, polynomial_velocities)
    ]
    return np.stack([own, *without_model])


def _parts(model: Model, records: Sequence[Experiment], most: int) -> list[Experiment]:
    """The first samples of records, so that all have a share."""
    # a filter's work grows with its states
    samples = int(most * min(1.0, 20 / model.state_size))
    length = min(500, max(_SHORTEST, samples // max(len(records), 1)))
    parts = [e[:length] for e in records if len(e) >= _SHORTEST]
    if not parts:
        raise InputError(
            "the filter's noise",
            counted(len(records), "record"),
            f"at least one of {_SHORTEST} samples or more",
        )
    return parts[: samples // _SHORTEST]


def _resolution(channels: Channels, parts: Sequence[Experiment]) -> Vector:
    """Counts of the encoders as the records declare them, or show them; 0 where unknown, (n_q,)."""
    resolution = np.array(parts[0].channels.resolution)
    for j, count in enumerate(resolution):
        if not count:
            resolution[j] = channels.resolution[j] or encoder_count(parts[0].q[:, j]) or 0.0
    return resolution


def _spread(rows: Sequence[np.ndarray]) -> Vector:
    """Root mean squares of columns, those that are 0 as small as the smallest of the others."""
    size = np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0))
    smallest = float(np.min(size, where=size > 0, initial=np.inf))
    return np.where(size > 0, size, smallest if math.isfinite(smallest) else 1.0)


def _filtered(model: Model, parts: Sequence[Experiment], noise: FilterNoise) -> list[FilterResult]:
    """Results along parts of records; those of one group side by side."""
    models = [model.for_record(e) for e in parts]
    results: dict[int, FilterResult] = {}
    for own in {id(one): one for one in models}.values():
        places = [i for i, one in enumerate(models) if one is own]
        some = [parts[i] for i in places]
        starts = [rest_state(own, e.q[0], e.u[0]) for e in some]
        results |= zip(places, filter_records(own, some, starts, noise), strict=True)
    return [results[i] for i in range(len(parts))]


def rest_state(model: Model, q: Vector, u: Vector | None = None) -> Float[np.ndarray, " n_x"]:
    """The state at rest at positions, internal states as the model expects; inputs 0 by default."""
    first = np.zeros((1, model.channels.n_u)) if u is None else u[None]
    return initial_states(model, np.concatenate([q, np.zeros(len(q))])[None], first)[0]


def usual_noise(model: Model, range: Range | None = None) -> FilterNoise:
    """The noise of a filter where there are no records to find it by.

    Encoders err by their rounding; what a step misses is taken to be a hundredth of the recorded
    speeds.

    Args:
        model: the model.
        range: the range of its training records; without it positions are taken to move by 1 rad
            or m, at 1 a second.
    """
    channels = model.channels
    half = np.ones(channels.measured.stop)
    if range is not None:
        recorded = np.ptp(range.states[channels.measured], axis=1) / 2
        half = np.where(recorded > 0, recorded, half)
    travel, speed = half[channels.position], half[channels.velocity]
    resolution = np.asarray(channels.resolution, np.float64)
    measured = np.where(resolution > 0, resolution / math.sqrt(12), _UNKNOWN * travel)
    spread = np.asarray(model.internal_spread, np.float64)
    velocity = _GUESS * speed
    return FilterNoise(
        start=np.concatenate([measured, speed, spread]),
        process=np.concatenate([velocity * channels.dt / 2, velocity, _GUESS * spread]),
        measured=measured,
    )
