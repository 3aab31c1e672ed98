"""Initial states, also those from which a model explains the first samples of a record best."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel, State
from tustinnet.simulation.initial_state import initial_state, padded_state, samples_fitted
from tustinnet.simulation.rollout import precision, rollout

_FEWEST = 3  # samples that say something of a velocity
_PARABOLA = 6  # samples of the parabola that the search begins with
_TURNS = 12  # Levenberg-Marquardt steps; from a parabola 3 or 4 are enough
_FIRST_DAMPING = 1e-3
_LEFT_OUT = (0.0, 0.25, 0.5)  # parts of the samples, from the first on
_EXPLAINED = 3.0  # standard deviations (root mean square) that a model may leave
_UNKNOWN_ERROR = 1e-3  # [rad or m], of positions whose resolution nobody declared


def start_states(
    model: DiscreteModel, experiments: Sequence[Experiment], start: str
) -> Float[np.ndarray, "records n_x"]:
    """Where the free runs of records start, (records, n_x).

    Args:
        model: the model.
        experiments: the records.
        start: a name that `initial_state` knows, internal states then at 0; or `model-N`, the
            state from which the model explains the first N samples best (`model_starts`).

    Raises:
        InputError: an unknown start, or records too short for it.
    """
    samples = samples_fitted(start)
    if not samples:
        return np.stack([padded_state(model, initial_state(e, start)) for e in experiments])
    guess = guessed_states(model, experiments, samples)
    u = np.stack([model.drive(e)[: samples - 1] for e in experiments])
    q = np.stack([e.q[:samples] for e in experiments])
    return np.asarray(_compiled(model, guess, u, q))


def guessed_states(
    model: DiscreteModel, experiments: Sequence[Experiment], samples: int
) -> Float[np.ndarray, "records n_x"]:
    """Where the search for `model-N` begins: parabolas through the first samples.

    Raises:
        InputError: records too short for it.
    """
    shortest = min(experiments, key=len)
    if not _FEWEST <= samples <= len(shortest):
        raise InputError(
            shortest.name,
            f"start 'model-{samples}'",
            f"{_FEWEST} to {len(shortest)} samples for the fit",
        )
    parabola = f"derived-{min(samples, _PARABOLA)}"
    return np.stack([padded_state(model, initial_state(e, parabola)) for e in experiments])


def position_weights(model: DiscreteModel) -> Float[np.ndarray, " n_q"]:
    """One over the standard deviation of the positions' errors, (n_q,) [1/rad or 1/m].

    An encoder that counts in steps of `r` errs by `r / sqrt(12)`.
    """
    steps = [c.resolution for c in model.coordinates]
    return np.array([np.sqrt(12.0) / r if r else 1.0 / _UNKNOWN_ERROR for r in steps])


def model_starts(
    model: DiscreteModel,
    guess: Float[Array | np.ndarray, "batch n_x"],
    u: Float[Array | np.ndarray, "batch steps *drive"],
    q: Float[Array | np.ndarray, "batch samples n_q"],
) -> Float[Array, "batch n_x"]:
    """Initial states by least squares through the model.

    Minimises the squared position errors over the samples, each over the encoder's standard
    deviation; internal states are kept near the guess with a standard deviation of 1 in their
    unit. Where that leaves more than 3 standard deviations (root mean square), something else
    still acted, as a rule the hand that let go: the first quarter of the samples is left out,
    then the first half. Where that does not help either, all samples count.

    Levenberg-Marquardt with exact derivatives. The result can be differentiated by the
    model's parameters: its last step is, at the solution, by the theorem of implicit functions
    without the second derivatives of the residuals (as in Gauss-Newton).

    Args:
        model: the model.
        guess: where the search begins, (batch, n_x).
        u: what acts between the samples, (batch, samples - 1, ...).
        q: measured positions, (batch, samples, n_q).

    Returns:
        (batch, n_x).
    """
    begin, drive, measured = jnp.asarray(guess), jnp.asarray(u), jnp.asarray(q)
    kind = precision(model, begin, drive, measured)
    weight = jnp.asarray(position_weights(model), kind)
    return jax.vmap(partial(_one, model, weight))(begin.astype(kind), drive, measured)


_compiled = eqx.filter_jit(model_starts)


def _one(model: DiscreteModel, weight: Array, guess: State, u: Array, q: Array) -> State:
    most = max(0, len(q) - _FEWEST)  # fewer samples would be explained by any model
    left_out = jnp.asarray([min(int(part * len(q)), most) for part in _LEFT_OUT])
    kept = (jnp.arange(len(q)) >= left_out[:, None]).astype(guess.dtype)

    # the search itself is not differentiated, only its solution
    of, to, begin, drive, measured = jax.lax.stop_gradient((model, weight, guess, u, q))

    def fitted(mask: Array) -> _Fit:
        return _fitted(lambda x: _residuals(of, to, mask, begin, drive, measured, x), begin)

    fits = jax.vmap(fitted)(kept)
    explained = fits.cost <= _EXPLAINED**2 * q.shape[1] * jnp.sum(kept, axis=1)
    # the first that is explained; where none is, the fault is the model's and all samples count
    chosen = jnp.argmax(explained)
    x, jacobian, mask = fits.x[chosen], fits.jacobian[chosen], kept[chosen]
    return _with_derivative((x, jacobian), model, weight, mask, guess, u, q)


def _residuals(
    model: DiscreteModel, weight: Array, kept: Array, guess: State, u: Array, q: Array, x: State
) -> Array:
    n_q = q.shape[1]
    error = (rollout(model, x, u)[:, :n_q] - q) * weight * kept[:, None]
    return jnp.concatenate([error.ravel(), (x - guess)[2 * n_q :]])


@eqx.filter_custom_jvp
def _with_derivative(solution: tuple[State, Array], *arguments: Any) -> State:
    """The solution; how it moves with the arguments of `_residuals` is known at it only."""
    return solution[0]


@_with_derivative.def_jvp
def _move(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[State, State]:
    (x, jacobian), *arguments = primals
    _, moved = eqx.filter_jvp(partial(_residuals, x=x), tuple(arguments), tangents[1:])
    return x, -_step(jacobian, moved, jnp.zeros((), x.dtype))


class _Fit(NamedTuple):
    """A state, its residuals, their derivatives by it and their squared sum."""

    x: State
    residuals: Array
    jacobian: Array
    cost: Array


def _fitted(residuals: Callable[[State], Array], begin: State) -> _Fit:
    """Levenberg-Marquardt."""

    def again(x: State) -> tuple[Array, Array]:
        found = residuals(x)
        return found, found

    def turn(_: Array, carry: tuple[_Fit, State, Array]) -> tuple[_Fit, State, Array]:
        best, tried, damping = carry
        jacobian, found = jax.jacfwd(again, has_aux=True)(tried)
        there = _Fit(tried, found, jacobian, jnp.sum(found**2))
        better = there.cost < best.cost
        best = jax.tree.map(lambda yes, no: jnp.where(better, yes, no), there, best)
        damping = jnp.where(better, damping / 10, damping * 10)
        return best, best.x - _step(best.jacobian, best.residuals, damping), damping

    # the beginning is what is tried first, so that the model is written into the program once
    shape = jax.eval_shape(residuals, begin)
    nothing = jnp.zeros(shape.shape, shape.dtype)
    unknown = _Fit(
        begin,
        nothing,
        jnp.zeros((*shape.shape, len(begin)), shape.dtype),
        jnp.full((), jnp.inf, shape.dtype),
    )
    damping = jnp.asarray(10 * _FIRST_DAMPING, begin.dtype)
    return jax.lax.fori_loop(0, 1 + _TURNS, turn, (unknown, begin, damping))[0]


def _step(jacobian: Array, r: Array, damping: Array) -> State:
    normal = jacobian.T @ jacobian
    # columns in units of their own size: positions, velocities, whatever a state stands for
    size = jnp.sqrt(jnp.diagonal(normal))
    size = jnp.where(size > 0, size, 1.0)
    scaled = normal / (size[:, None] * size) + damping * jnp.eye(len(size), dtype=size.dtype)
    return jnp.linalg.solve(scaled, jacobian.T @ r / size) / size
