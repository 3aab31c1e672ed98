"""The simulator."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel, State

LONG = 5000  # steps from which a gradient saves memory instead of time


def rollout(
    model: DiscreteModel,
    x0: Float[Array | np.ndarray, " n_x"],
    u: Float[Array | np.ndarray, "steps *drive"],
) -> Float[Array, "samples n_x"]:
    """Free run: the states that a model reaches from `x0` with only the input.

    The gradient of a rollout of more than 5000 steps keeps some states and computes those between
    them a second time: memory grows with the root of the steps instead of with the steps.

    Args:
        model: the model.
        x0: initial state [q, v, z], (n_x,).
        u: `u[k]` acts from sample k to sample k+1, (steps, n_u). Where the model is driven by
            straight lines (`model.drive` says how), both ends of every period, (steps, 2, n_u).

    Returns:
        (steps + 1, n_x); the first row is `x0`.
    """
    start, inputs = jnp.asarray(x0), jnp.asarray(u)
    n_x, n_u = model.state_size, len(model.inputs)
    if start.shape != (n_x,) or inputs.ndim < 2 or inputs.shape[1:] not in ((n_u,), (2, n_u)):
        raise InputError(
            "rollout",
            f"x0 of shape {start.shape} and u of shape {inputs.shape}",
            f"({n_x},) and (steps, {n_u}), or (steps, 2, {n_u}) for inputs on straight lines",
        )

    # a state keeps its precision from step to step: the widest of all that goes into it
    arrays = [leaf for leaf in jax.tree.leaves(model) if eqx.is_inexact_array(leaf)]
    start = start.astype(jnp.result_type(start, inputs, *arrays))

    def advance(x: State, u_k: Array) -> tuple[State, State]:
        following = model.step(x, u_k)
        return following, following

    def stretch(x: State, drive: Array) -> tuple[State, Array]:
        return jax.lax.scan(advance, x, drive, unroll=model.steps_a_turn)

    steps = len(inputs)
    if steps <= LONG:
        return jnp.concatenate([start[None], stretch(start, inputs)[1]])
    # of a long rollout a gradient keeps the states between stretches, and computes each anew
    length = math.isqrt(steps)
    whole = steps // length * length
    cut = inputs[:whole].reshape(-1, length, *inputs.shape[1:])
    end, states = jax.lax.scan(jax.checkpoint(stretch), start, cut)
    _, rest = stretch(end, inputs[whole:])
    return jnp.concatenate([start[None], states.reshape(whole, n_x), rest])
