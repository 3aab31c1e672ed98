"""Initial states from which a model explains the first samples of a record best."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.models.contract import Model, State
from tustinnet.simulate.drive import Drive
from tustinnet.simulate.rollout import precision, rollout

FEWEST = 3  # samples that say something of a velocity
TURNS = 12  # Levenberg-Marquardt steps; from a parabola 3 or 4 are enough
HELD_TURNS = 8  # before them, with internal states held
HELD = 30.0  # times as near to the guess as they are kept in the end
FIRST_DAMPING = 1e-3
_RISING = 4  # power of its place among the samples with which one weighs
_FEW = 5  # samples for each of these powers: what is left must say a velocity, too
EXPLAINED = 2.5  # standard deviations (root mean square) that a model may leave
_UNKNOWN_ERROR = 1e-3  # [rad or m], of positions whose resolution nobody declared


def position_weights(model: Model) -> Float[np.ndarray, " n_q"]:
    """One over the standard deviation of the positions' errors, (n_q,) [1/rad or 1/m].

    An encoder that counts in steps of `r` errs by `r / sqrt(12)`.
    """
    errors = [r / np.sqrt(12.0) if r else _UNKNOWN_ERROR for r in model.channels.resolution]
    return 1.0 / np.array(errors)


def sample_shares(
    samples: int,
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """What errors weigh by their place among the samples: the more the later, and all the same."""
    places = np.arange(1, samples + 1) / samples
    return places ** min(_RISING, samples / _FEW), np.ones(samples)


def model_starts(
    model: Model,
    guess: Float[Array | np.ndarray, "batch n_x"],
    drive: Drive,
    q: Float[Array | np.ndarray, "batch samples n_q"],
) -> Float[Array, "batch n_x"]:
    """Initial states by least squares through the model.

    Minimises the squared position errors over the samples, each over the encoder's standard
    deviation; internal states are kept near the guess, with the model's `internal_spread` as
    standard deviations. Errors weigh the more, the later they are: that of the k-th of N samples
    (k/N)^4, or (k/N)^(N/5) where there are fewer than 20. At first something else often still acts,
    as a rule the hand that lets go, and a model that is nearly right can take that for an internal
    state. Where more than 2.5 standard deviations (root mean square, weighed) are left, the fault
    is the model's, and all samples weigh the same.

    Levenberg-Marquardt with exact derivatives, in few turns. Where a hand acted, the parabola may
    be far from the motion after it, and internal states then grow to explain that, from where the
    search does not come back in time. So where it explains nothing, it is also begun with internal
    states that are held near the guess.

    The result can be differentiated by the model's parameters: its last step is, at the solution,
    by the theorem of implicit functions without the second derivatives of the residuals (as in
    Gauss-Newton).

    Args:
        model: the model.
        guess: where the search begins, (batch, n_x).
        drive: what acts between the samples, (batch, samples - 1, ...).
        q: measured positions, (batch, samples, n_q).

    Returns:
        (batch, n_x).
    """
    begin, measured = jnp.asarray(guess), jnp.asarray(q)
    drive = jax.tree.map(jnp.asarray, drive)
    kind = precision(model, begin, jnp.asarray(drive.u), measured)
    weight = jnp.asarray(position_weights(model), kind)
    return jax.vmap(partial(_one, model, weight))(begin.astype(kind), drive, measured)


def _one(model: Model, weight: Array, guess: State, u: Drive, q: Array) -> State:
    rising, even = map(jnp.asarray, sample_shares(len(q)))
    # the first that explains the samples is taken, or the last
    most = HELD_TURNS if model.internal else 0
    held = jnp.array([0, most, 0] if most else [0, 0])
    shares = jnp.stack([*[rising] * (len(held) - 1), even])
    weights = shares.astype(guess.dtype)[:, :, None] * weight

    # the search itself is not differentiated, only its solution
    of, to, begin, drive, measured = jax.lax.stop_gradient((model, weights, guess, u, q))

    def fitted(to: Array, held: Array) -> _Fit:
        def residuals(x: State, near: Array) -> Array:
            errors = _residuals(of, to, begin, drive, measured, x)
            return jnp.concatenate([errors[: q.size], near * errors[q.size :]])

        return _fitted(residuals, begin, held, most)

    fits = jax.vmap(fitted)(to, held)
    explained = fits.cost <= EXPLAINED**2 * q.shape[1] * jnp.sum(shares**2, axis=1)
    chosen = jnp.argmax(explained.at[-1].set(True))
    solution = fits.x[chosen], fits.jacobian[chosen]
    return _with_derivative(solution, model, weights[chosen], guess, u, q)


def _residuals(model: Model, weight: Array, guess: State, u: Drive, q: Array, x: State) -> Array:
    of = model.channels
    spread = model.internal_spread.astype(x.dtype)
    error = (rollout(model, x, u)[:, of.position] - q) * weight
    return jnp.concatenate([error.ravel(), (x - guess)[of.internal] / spread])


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


def _fitted(
    residuals: Callable[[State, Array], Array], begin: State, held: Array, most: int
) -> _Fit:
    """Levenberg-Marquardt, so many turns with internal states held, then with free ones.

    Args:
        residuals: of a state, and of how near to the guess its internal states are kept.
        begin: where the search begins.
        held: turns with internal states held.
        most: as many turns of these as there can be.
    """
    first = jnp.asarray(10 * FIRST_DAMPING, begin.dtype)

    def again(x: State, near: Array) -> tuple[Array, Array]:
        found = residuals(x, near)
        return found, found

    def turn(i: Array, carry: tuple[_Fit, State, Array]) -> tuple[_Fit, State, Array]:
        best, tried, damping = carry
        # from the first free turn on costs are others: what was best is tried again
        fresh = i == held
        best = best._replace(cost=jnp.where(fresh, jnp.inf, best.cost))
        tried, damping = jnp.where(fresh, best.x, tried), jnp.where(fresh, first, damping)
        near = jnp.where(i < held, HELD, 1.0).astype(begin.dtype)
        jacobian, found = jax.jacfwd(again, has_aux=True)(tried, near)
        there = _Fit(tried, found, jacobian, jnp.sum(found**2))
        better = (there.cost < best.cost) & (i <= held + TURNS)
        best = jax.tree.map(lambda yes, no: jnp.where(better, yes, no), there, best)
        damping = jnp.where(better, damping / 10, damping * 10)
        return best, best.x - _step(best.jacobian, best.residuals, damping), damping

    # the beginning is what is tried first, so that the model is written into the program once
    shape = jax.eval_shape(residuals, begin, first)
    nothing = jnp.zeros(shape.shape, shape.dtype)
    unknown = _Fit(
        begin,
        nothing,
        jnp.zeros((*shape.shape, len(begin)), shape.dtype),
        jnp.full((), jnp.inf, shape.dtype),
    )
    return jax.lax.fori_loop(0, most + 1 + TURNS, turn, (unknown, begin, first))[0]


def _step(jacobian: Array, r: Array, damping: Array) -> State:
    normal = jacobian.T @ jacobian
    # columns in units of their own size: positions, velocities, whatever a state stands for
    size = jnp.sqrt(jnp.diagonal(normal))
    size = jnp.where(size > 0, size, 1.0)
    scaled = normal / (size[:, None] * size) + damping * jnp.eye(len(size), dtype=size.dtype)
    return jnp.linalg.solve(scaled, jacobian.T @ r / size) / size
