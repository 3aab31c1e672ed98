"""Estimates of a model's states by an extended Kalman filter that sees positions only."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import LinearisedStep, evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.models.contract import Model, require_fit
from tustinnet.shown import Brief
from tustinnet.simulate.input_signal import input_signal
from tustinnet.simulate.recent import keep_latest
from tustinnet.simulate.simulation import step_equations

Deviations = Float[Array | np.ndarray, " _"]
Vector = Float[np.ndarray, " _"]

# deviations beyond which an innovation is impossible: with noise by likelihood, loops of models
# that are off by 20 %, or by a sample of delay, reach 6.6 (docs/explanation/control.md)
GATE = 8.0
LOST_AFTER = 10  # samples in a row without use after which an estimate is lost: 0.1 s at 100 Hz
# an estimate may diverge, as of a plant that has fallen over: whoever uses it sees that
_DIVERGES = np.errstate(over="ignore", invalid="ignore")


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


@dataclass(frozen=True, repr=False)
class FilterResult(Brief):
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

    It survives wrong samples. A position that is not finite, or whose innovation is
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
        at_rest: the state at rest at positions.
        angular: coordinates whose innovations are wrapped to within half a turn, (n_q,); None
            for none.
        lost_after: samples in a row after which an estimate is lost.
    """

    def __init__(
        self,
        step: LinearisedStep,
        noise: FilterNoise,
        channels: Channels,
        at_rest: Callable[[Vector], Vector],
        angular: Bool[np.ndarray, " n_q"] | None = None,
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
        x, p = self.x, self.p
        innovations, spreads = np.full((2, len(q)), np.nan)
        # a number too large for differences as small as the gate is no position
        readable = np.isfinite(q) & (q + GATE * self._measured != q)
        is_used = True
        for i, variance in enumerate(self._variances):
            if not readable[i]:
                is_used = False
                continue
            row = p[i]
            spread = row[i] + variance
            innovation = q[i] - x[i]
            if self._angular is not None and self._angular[i]:
                innovation = (innovation + np.pi) % (2 * np.pi) - np.pi
            innovations[i], spreads[i] = innovation, spread
            if not abs(innovation) <= GATE * math.sqrt(max(spread, 0.0)):
                is_used, p = False, self._pushed
                continue
            gain = row / spread
            x = x + gain * innovation
            across = gain[:, None] * row
            p = p - across - across.T + spread * gain[:, None] * gain
        self.x, self.p, self.innovations, self.spreads = x, p, innovations, spreads
        is_finite = math.isfinite(x.sum() + p.sum())
        if is_used and is_finite:
            self.missed = min(self.missed, -1) + 1
            return
        self.unused += 1
        if is_finite and 0 <= self.missed < self._lost_after - 1:
            self.missed += 1
        else:
            self.missed = -self._lost_after
            self.x, self.p = self._at_rest(np.where(readable, q, 0.0)), self._start

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
    `estimate.c` of an export to C computes. Positions are not wrapped, and all are used.

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
    return filter_records(model, [experiment], [x0], noise)[0]


@_DIVERGES
def filter_records(
    model: Model,
    records: Sequence[Experiment],
    starts: Sequence[Float[Array | np.ndarray, " n_x"]],
    noise: FilterNoise,
) -> list[FilterResult]:
    """`kalman_filter` along several records, which takes little longer than along one.

    Args:
        model: the model of all records.
        records: the records.
        starts: a first state for each, (n_x,).
        noise: the standard deviations.

    Raises:
        InputError: see `kalman_filter`.
    """
    where, n_x = "kalman_filter", model.state_size
    for record in records:
        require_fit(model, record)
    x = np.stack([checked_vector("x0", start, n_x, where) for start in starts])
    noise = noise.checked(n_x, model.channels.n_q, where)
    signals = [np.asarray(input_signal(model, one).u, np.float64) for one in records]
    formula = _step_formula(model, signals[0].shape[1:])
    # shorter records go on with their last samples, to no effect
    q = _padded([one.q for one in records])
    u = _padded([signal.reshape(len(signal), -1) for signal in signals])
    process = np.diag(np.asarray(noise.process) ** 2)
    variances = np.asarray(noise.measured) ** 2
    p = np.tile(np.diag(np.asarray(noise.start) ** 2), (len(records), 1, 1))
    rows: list[tuple[np.ndarray, ...]] = []
    for k in range(len(q)):
        innovations, spreads = np.empty((2, len(records), len(variances)))
        for i, variance in enumerate(variances):
            row = p[:, i]
            spreads[:, i] = spread = row[:, i] + variance
            innovations[:, i] = q[k, :, i] - x[:, i]
            gain = row / spread[:, None]
            x = x + gain * innovations[:, i, None]
            across = gain[:, :, None] * row[:, None]
            # in the form of Joseph, which keeps it symmetric
            p = p - across - across.mT + spread[:, None, None] * gain[:, :, None] * gain[:, None]
        rows.append((x, p.diagonal(axis1=1, axis2=2), innovations, spreads))
        if k < len(u):
            points = np.concatenate([x, u[k]], axis=1)
            slopes = evaluate(formula, points, derivatives=True)
            a = slopes.reshape(len(records), n_x, -1)[:, :, :n_x]
            x, p = evaluate(formula, points), a @ p @ a.mT
            p = (p + p.mT) / 2 + process
    states, squares, innovations, spreads = (
        np.stack(part, axis=1) for part in zip(*rows, strict=True)
    )
    return [
        FilterResult(
            states[i, :n],
            np.sqrt(squares[i, :n]),
            innovations[i, :n],
            np.sqrt(spreads[i, :n]),
        )
        for i, n in enumerate(map(len, records))
    ]


def _padded(rows: Sequence[Float[np.ndarray, "_ n"]]) -> Float[np.ndarray, "longest runs n"]:
    """Rows of samples side by side, those of shorter ones continued by their last."""
    longest = max(map(len, rows))
    return np.stack([np.pad(r, ((0, longest - len(r)), (0, 0)), "edge") for r in rows], axis=1)


def checked_vector(name: str, value: ArrayLike, size: int, where: str) -> Vector:
    """A vector of finite numbers in double precision.

    Raises:
        InputError: another size, or a number that is not finite.
    """
    array = np.asarray(value, np.float64)
    if array.shape != (size,) or not np.isfinite(array).all():
        raise InputError(where, f"{name} {value}", f"{size} finite numbers")
    return array


@keep_latest(4)
def _step_formula(model: Model, shape: tuple[int, ...]) -> Formula:
    """The step of a model at many states and inputs."""
    equations = step_equations(model.simplify(), shape)
    n_x, along = equations.n_x, equations.along
    return Formula(
        lambda point: equations.function(point[:n_x], point[n_x:], None, None),
        n_x + equations.n_u,
        where=equations.where,
        slope=None if along is None else lambda point: along(point[:n_x], point[n_x:])[:, 1:],
    )
