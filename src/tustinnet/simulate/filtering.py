"""Estimates of a model's states by an extended Kalman filter that sees positions only."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Bool, Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import LinearisedStep, make_linearised_step
from tustinnet.errors import InputError
from tustinnet.models.contract import Model, require_fit
from tustinnet.simulate.input_signal import input_signal
from tustinnet.simulate.simulation import step_equations

Deviations = Float[Array | np.ndarray, " _"]
Rows = Float[Array | np.ndarray, "..."]
Vector = Float[np.ndarray, " _"]

# deviations beyond which an innovation is impossible: with noise by likelihood, loops of models
# that are off by 20 %, or by a sample of delay, reach 6.6 (docs/explanation/control.md)
GATE = 8.0
LOST_AFTER = 10  # samples in a row without use after which an estimate is lost: 0.1 s at 100 Hz
# an estimate may diverge, as of a plant that has fallen over: whoever uses it sees that
_DIVERGES = np.errstate(over="ignore", invalid="ignore")
_RECENT = 4  # models whose steps are at hand


@dataclass(frozen=True)
class FilterNoise:
    """Standard deviations of the errors that a filter assumes.

    Attributes:
        start: of the first state, (n_x,), in units of the state.
        process: of what a step of the model misses, (n_x,), in units of the state.
        measured: of the measured positions, (n_q,) [rad or m].
    """

    start: Deviations
    process: Deviations
    measured: Deviations

    def checked(self, n_x: int, n_q: int, where: str) -> "FilterNoise":
        """The deviations as arrays, of the sizes that a model has.

        Raises:
            InputError: another size, a deviation that is negative or not finite, no noise at a
                position that is measured.
        """
        arrays = {}
        for name, size in (("start", n_x), ("process", n_x), ("measured", n_q)):
            value = getattr(self, name)
            array = arrays[name] = checked_vector(name, value, size, where)
            if (array < 0).any() or (name == "measured" and not array.all()):
                raise InputError(
                    where, f"{name} {value}", "standard deviations, those measured above 0"
                )
        return FilterNoise(**arrays)


@dataclass(frozen=True)
class FilterResult:
    """Estimates of a filter along a record.

    Attributes:
        states: estimates after the positions of the same sample are known, (n, n_x).
        deviations: the standard deviation of each of them, (n, n_x).
        innovations: positions minus what the filter expected, (n, n_q) [rad or m]. A coordinate's
            is what remains once the coordinates before it are known, so that all are independent
            of one another where the model is right.
        innovation_deviations: the standard deviations that the filter expected of them, (n, n_q).
    """

    states: Float[np.ndarray, "n n_x"]
    deviations: Float[np.ndarray, "n n_x"]
    innovations: Float[np.ndarray, "n n_q"]
    innovation_deviations: Float[np.ndarray, "n n_q"]


class KalmanFilter:
    """An extended Kalman filter, sample by sample: `correct` by positions, `predict` by inputs.

    With `at_rest` it survives wrong samples. A position that is not finite, or whose innovation is
    beyond eight of its expected deviations, is not used. Either the encoder errs then, or something
    pushed the device in the last period: the covariance becomes that of a device at the start which
    got its speed a period ago, so that the next sample decides. After `lost_after` samples in a row
    that were not used the estimate is lost. From then on each sample that is not used is a new
    start at rest, until as many samples in a row were used.

    Attributes:
        x: the estimated state, (n_x,).
        p: its covariance, (n_x, n_x).
        innovations: of the last correction, (n_q,), see `FilterResult`; NaN of what is no position.
        spreads: the variances that were expected of them, (n_q,).
        missed: samples in a row that were not used. Below 0 the estimate is lost, and minus so many
            samples have to be used until it is found; -1 before the first sample.
        unused: samples that were not used since the start.

    Args:
        step: the step of the model with its derivatives, see `make_linearised_step`.
        noise: standard deviations, as `FilterNoise.checked` returns them.
        channels: of the model.
        angular: coordinates whose innovations are wrapped to within half a turn, (n_q,); None
            for none.
        at_rest: the state at rest at positions; None where all samples are used.
        lost_after: samples in a row after which an estimate is lost.
    """

    def __init__(
        self,
        step: LinearisedStep,
        noise: FilterNoise,
        channels: Channels,
        angular: Bool[np.ndarray, " n_q"] | None = None,
        at_rest: Callable[[Vector], Vector] | None = None,
        lost_after: int = LOST_AFTER,
    ) -> None:
        self._step, self._angular = step, angular
        self._at_rest, self._lost_after = at_rest, lost_after
        self._process = np.diag(np.asarray(noise.process) ** 2)
        self._measured = np.asarray(noise.measured)
        self._variances = (self._measured**2).tolist()
        self._start = np.diag(np.asarray(noise.start) ** 2)
        motion = np.eye(len(self._start))
        motion[channels.position, channels.velocity] = channels.dt * np.eye(channels.n_q)
        self._pushed = motion @ self._start @ motion.T
        self.restart(np.zeros(len(self._start)))

    def restart(self, x: Vector) -> None:
        """Begins anew at a state whose errors are those of the start."""
        self.x, self.p = x, self._start
        self.innovations = self.spreads = np.zeros(len(self._variances))
        self.missed, self.unused = -1, 0

    @_DIVERGES
    def correct(self, q: Vector) -> None:
        """Takes measured positions into account, (n_q,).

        They come one after the other, in the form of Joseph, which keeps the covariance symmetric.
        """
        x, p, at_rest = self.x, self.p, self._at_rest
        innovations, spreads = np.full((2, len(q)), np.nan)
        # a number too large for differences as small as the gate is no position
        readable = np.isfinite(q) & (q + GATE * self._measured != q)
        is_used = True
        for i, variance in enumerate(self._variances):
            if at_rest is not None and not readable[i]:
                is_used = False
                continue
            row = p[i]
            spread = row[i] + variance
            innovation = q[i] - x[i]
            if self._angular is not None and self._angular[i]:
                innovation = (innovation + np.pi) % (2 * np.pi) - np.pi
            innovations[i], spreads[i] = innovation, spread
            if at_rest is not None and not abs(innovation) <= GATE * math.sqrt(max(spread, 0.0)):
                is_used, p = False, self._pushed
                continue
            gain = row / spread
            x = x + gain * innovation
            across = gain[:, None] * row
            p = p - across - across.T + spread * gain[:, None] * gain
        self.x, self.p, self.innovations, self.spreads = x, p, innovations, spreads
        is_finite = math.isfinite(x.sum() + p.sum())
        if (is_used and is_finite) or at_rest is None:
            self.missed = min(self.missed, -1) + 1
            return
        self.unused += 1
        if is_finite and 0 <= self.missed < self._lost_after - 1:
            self.missed += 1
        else:
            self.missed = -self._lost_after
            self.x, self.p = at_rest(np.where(readable, q, 0.0)), self._start

    @_DIVERGES
    def predict(self, inputs: Vector) -> None:
        """Steps to the next sample, with the inputs of a step, flattened.

        At an unstable equilibrium what rounding adds to one half of the covariance only would grow
        without end, as no measurement corrects it: both halves are made the same.
        """
        self.x, a, _ = self._step(self.x, inputs)
        p = a @ self.p @ a.T
        self.p = (p + p.T) / 2 + self._process


def kalman_filter(
    model: Model, experiment: Experiment, x0: Float[Array | np.ndarray, " n_x"], noise: FilterNoise
) -> FilterResult:
    """Estimates states along a record by an extended Kalman filter over the steps of a model.

    It sees the positions up to each sample, never later ones: what a controller can do, and what
    `estimate.c` of an export to C computes. Positions are not wrapped.

    Args:
        model: the model; what it sees of the inputs after a sample is taken from the record.
        experiment: the record, of which positions and inputs are used.
        x0: the state at the first sample before its positions are known, (n_x,).
        noise: standard deviations of the start, of the steps, of the measurement.

    Returns:
        The estimated states and their standard deviations, after each sample's positions are known,
        and the innovations.

    Raises:
        InputError: another system's record; shapes that the model does not have; a standard
            deviation that is negative or not finite; no noise at a position that is measured.
    """
    require_fit(model, experiment)
    where = "kalman_filter"
    x = checked_vector("x0", x0, model.state_size, where)
    noise = noise.checked(model.state_size, model.channels.n_q, where)
    u = np.asarray(input_signal(model, experiment).u, np.float64)
    kalman = KalmanFilter(_linearised_step(model, u.shape[1:]), noise, model.channels)
    kalman.restart(x)
    rows = u.reshape(len(u), -1)
    results: list[tuple[np.ndarray, ...]] = []
    for k, q in enumerate(experiment.q):
        kalman.correct(q)
        results.append((kalman.x, np.diag(kalman.p), kalman.innovations, kalman.spreads))
        if k < len(rows):
            kalman.predict(rows[k])
    states, variances, innovations, spreads = map(np.stack, zip(*results, strict=True))
    return FilterResult(states, np.sqrt(variances), innovations, np.sqrt(spreads))


def checked_vector(name: str, value: Rows, size: int, where: str) -> Vector:
    """A vector of finite numbers in double precision.

    Raises:
        InputError: another size, or a number that is not finite.
    """
    array = np.asarray(value, np.float64)
    if array.shape != (size,) or not np.isfinite(array).all():
        raise InputError(where, f"{name} {value}", f"{size} finite numbers")
    return array


def _linearised_step(model: Model, shape: tuple[int, ...]) -> LinearisedStep:
    """The step of a model with its derivatives, compiled once while the model is in use."""
    for known, known_shape, step in _recent:
        if known is model and known_shape == shape:
            return step
    step = make_linearised_step(step_equations(model.simplify(), shape))
    _recent.insert(0, (model, shape, step))
    del _recent[_RECENT:]
    return step


_recent: list[tuple[Model, tuple[int, ...], LinearisedStep]] = []
