"""The simulator, for one free run and for a batch of them."""

import math
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel, State
from tustinnet.models.network import Affine

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

    start = start.astype(precision(model, start, inputs))

    def advance(x: State, u_k: Array) -> tuple[State, State]:
        following = model.step(x, u_k)
        return following, following

    def stretch(x: State, drive: Array) -> tuple[State, Array]:
        return jax.lax.scan(advance, x, drive)

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


def rollouts(
    model: DiscreteModel,
    x0: Float[Array | np.ndarray, "batch n_x"],
    u: Float[Array | np.ndarray, "batch steps *drive"],
) -> Float[Array, "batch samples n_x"]:
    """Free runs of a batch: what `jax.vmap` makes of `rollout`, with a cheaper gradient.

    Reverse differentiation through `rollout` adds to the gradient of every weight at every step.
    Here the backward pass only keeps the derivatives by the outputs of the `Affine` layers, and
    one product of these with what went into the layers gives the gradient of a weight, summed
    over all steps and runs. Whatever else is in the model is differentiated as usual. Forward
    differentiation is not defined.

    Args:
        model: the model; each of its `Affine` layers acts at most once a step.
        x0: initial states, (batch, n_x).
        u: as for `rollout`, (batch, steps, ...).

    Returns:
        (batch, steps + 1, n_x).
    """
    start, drive = jnp.asarray(x0), jnp.asarray(u)
    leaves, structure = jax.tree.flatten(model, is_leaf=_is_layer)
    places = [i for i, leaf in enumerate(leaves) if _is_layer(leaf)]
    if not places or drive.shape[1] > LONG:
        return jax.vmap(partial(rollout, model))(start, drive)
    start = start.astype(precision(model, start, drive))
    others = [None if _is_layer(leaf) else leaf for leaf in leaves]

    def rebuilt(layers: list[Any], rest: list[Any]) -> DiscreteModel:
        filled = list(rest)
        for place, layer in zip(places, layers, strict=True):
            filled[place] = layer
        return jax.tree.unflatten(structure, filled)

    def listen(
        layers: list[Affine], rest: list[Any], start: Array, drive: Array, slots: list[Array]
    ) -> tuple[Array, list[Array]]:
        """States, and what went into each layer at every step; derivatives go to `slots`."""
        transposed = [layer.weight.T for layer in layers]  # once, not at every step

        def advance(x: Array, now: tuple[Array, list[Array]]) -> tuple[Array, Any]:
            def one(x: State, u_k: Array, slots_k: list[Array]) -> tuple[State, list[Array]]:
                ears = [_Ear(*of) for of in zip(layers, transposed, slots_k, strict=True)]
                following = rebuilt(ears, rest).step(x, u_k)
                return following, [ear.heard for ear in ears]

            following, heard = jax.vmap(one)(x, *now)
            return following, (following, heard)

        _, (states, heard) = jax.lax.scan(advance, start, (jnp.swapaxes(drive, 0, 1), slots))
        return jnp.concatenate([start[:, None], jnp.swapaxes(states, 0, 1)], axis=1), heard

    def no_slots(layers: list[Affine], start: Array, drive: Array) -> list[Array]:
        shape = drive.shape[1], len(start)
        return [jnp.zeros((*shape, len(layer.weight)), start.dtype) for layer in layers]

    @jax.custom_vjp
    def run(layers: list[Affine], rest: list[Any], start: Array, drive: Array) -> Array:
        return listen(layers, rest, start, drive, no_slots(layers, start, drive))[0]

    def forward(
        layers: list[Affine], rest: list[Any], start: Array, drive: Array
    ) -> tuple[Array, Any]:
        slots = no_slots(layers, start, drive)
        states, back, heard = jax.vjp(
            partial(listen, layers), rest, start, drive, slots, has_aux=True
        )
        return states, (back, heard, layers)

    def backward(kept: Any, gradient: Array) -> tuple[Any, ...]:
        back, heard, layers = kept
        *by_others, deltas = back(gradient)
        by_layers = [_summed(*of) for of in zip(layers, deltas, heard, strict=True)]
        return by_layers, *by_others

    run.defvjp(forward, backward)
    return run([leaves[i] for i in places], others, start, drive)


class _Ear:
    """Stands in a model where a layer was: does the same and notes what goes in."""

    def __init__(self, layer: Affine, transposed: Array, slot: Array) -> None:
        self._layer, self._transposed, self._slot = layer, transposed, slot
        self.heard: Array = jnp.zeros(layer.weight.shape[1], slot.dtype)
        self._called = False

    def __call__(self, z: Array) -> Array:
        if self._called:
            raise InputError("rollouts", "a layer that acts twice in a step", "layers of its own")
        self._called, self.heard = True, z
        product = _product(z, self._layer.weight, self._transposed, self._slot)
        return product if self._layer.bias is None else product + self._layer.bias


@jax.custom_vjp
def _product(z: Array, weight: Array, transposed: Array, slot: Array) -> Array:
    """`W z`; the derivative by it goes to `slot`, whose value does not matter, and on to `z`."""
    return z @ transposed


def _product_forward(
    z: Array, weight: Array, transposed: Array, slot: Array
) -> tuple[Array, Array]:
    return z @ transposed, weight


def _product_backward(weight: Array, delta: Array) -> tuple[Any, ...]:
    return delta @ weight, None, None, delta


_product.defvjp(_product_forward, _product_backward)


def _summed(
    layer: Affine, delta: Float[Array, "steps batch n_out"], z: Float[Array, "steps batch n_in"]
) -> Affine:
    """The gradient of a layer: its outputs' derivatives times its inputs, over steps and runs."""
    delta, z = delta.reshape(-1, delta.shape[-1]), z.reshape(-1, z.shape[-1])
    weight = (delta.T @ z).astype(layer.weight.dtype)
    if layer.bias is None:
        return Affine(weight, None)
    return Affine(weight, jnp.sum(delta, axis=0).astype(layer.bias.dtype))


def _is_layer(node: Any) -> bool:
    return isinstance(node, Affine)


def precision(model: DiscreteModel, *signals: Array) -> np.dtype:
    """A state keeps its precision from step to step: the widest of all that goes into it."""
    arrays = [leaf for leaf in jax.tree.leaves(model) if eqx.is_inexact_array(leaf)]
    return jnp.result_type(*signals, *arrays)
