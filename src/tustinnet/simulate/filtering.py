"""Estimates of a model's states along a record, by a Kalman filter that sees positions only."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.contract import Model, require_fit
from tustinnet.simulate.input_signal import input_signal

Deviations = Float[Array | np.ndarray, " _"]
Rows = Float[Array | np.ndarray, "..."]
Vector = Float[np.ndarray, " _"]


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


@dataclass(frozen=True)
class FilterResult:
    """Estimates of a filter along a record.

    Attributes:
        states: estimates after the positions of the same sample are known, (n, n_x).
        deviations: the standard deviation of each of them, (n, n_x).
    """

    states: Float[np.ndarray, "n n_x"]
    deviations: Float[np.ndarray, "n n_x"]


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
        The estimated states and their standard deviations, after each sample's positions are known.

    Raises:
        InputError: another system's record; shapes that the model does not have; a standard
            deviation that is negative or not finite; no noise at a position that is measured.
    """
    require_fit(model, experiment)
    n_x = model.state_size

    def checked(name: str, value: Rows, size: int = n_x) -> Vector:
        array = np.asarray(value, np.float64)
        if array.shape != (size,) or not np.isfinite(array).all():
            raise InputError("kalman_filter", f"{name} {value}", f"{size} finite numbers")
        if (name != "x0" and (array < 0).any()) or (name == "measured" and not array.all()):
            raise InputError(
                "kalman_filter", f"{name} {value}", "standard deviations, those measured above 0"
            )
        return array

    x, start = checked("x0", x0), checked("start", noise.start)
    process = checked("process", noise.process)
    measured = checked("measured", noise.measured, model.channels.n_q)
    p, folded = np.diag(start**2), model.simplify()
    u = np.asarray(input_signal(model, experiment).u)
    states, variances = [], []
    for k, q in enumerate(experiment.q):
        # one position after the other, in the form of Joseph, which keeps the covariance symmetric
        for i, variance in enumerate(measured**2):
            row = p[i]
            spread = row[i] + variance
            gain = row / spread
            x = x + gain * (q[i] - x[i])
            p = p - np.outer(gain, row) - np.outer(row, gain) + np.outer(gain, gain) * spread
        states.append(x)
        variances.append(np.diag(p))
        if k < len(u):
            x, a = map(np.asarray, _predict(folded, x, u[k]))
            p = a @ p @ a.T + np.diag(process**2)
    return FilterResult(np.stack(states), np.sqrt(np.stack(variances)))


@eqx.filter_jit  # a step with its derivatives, written out for LLVM, takes longer to compile
def _predict(model: Model, x: Rows, u: Rows) -> tuple[Array, Array]:
    """The next state, and its Jacobian by this one."""

    def twice(x: Array) -> tuple[Array, Array]:
        x_next = model.step(x, jnp.asarray(u))
        return x_next, x_next

    a, x_next = jax.jacfwd(twice, has_aux=True)(jnp.asarray(x))
    return x_next, a
