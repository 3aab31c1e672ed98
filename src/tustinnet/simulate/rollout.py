"""The simulator: the loop over time, for one free run and for a batch of them."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tustinnet.errors import InputError
from tustinnet.models.blocks import Affine, is_layer
from tustinnet.models.contract import Model, State
from tustinnet.simulate.drive import Drive
from tustinnet.simulate.engine_rollouts import layered_steps

LONG = 5000  # steps from which a gradient saves memory instead of time

Driven = Drive | Float[Array | np.ndarray, "..."]


@eqx.filter_jit
def rollout(
    model: Model,
    x0: Float[Array | np.ndarray, "..."],
    u: Driven,
    measured: Float[Array | np.ndarray, "known n_measured"] | None = None,
) -> Float[Array, "samples n_x"]:
    """Free run: the states that a model reaches from `x0` with only the input.

    The gradient of a rollout of more than 5000 steps keeps some states and computes those between
    them a second time: memory grows with the root of the steps instead of with the steps.

    Args:
        model: the model.
        x0: initial state [q, v, z], (n_x,).
        u: a `Drive`, as `drive_of` makes it of a record; or inputs of which `u[k]` acts from
            sample k to sample k+1, (steps, n_u); or an array of what the model's steps take.
        measured: positions and velocities [q, v] of the first samples, (known, 2 n_q), which take
            the place of the model's own before it steps on; so internal states follow a record.

    Returns:
        The states, (steps + 1, n_x); the first row is `x0`. Rows of measured samples hold what the
        model predicted there.
    """
    start, n_x, n_u = jnp.asarray(x0), model.state_size, model.channels.n_u
    shape = np.shape(u.u if isinstance(u, Drive) else u)
    fits = start.shape == (n_x,) and len(shape) in (2, 3) and shape[-1] == n_u
    if not fits or (len(shape) == 3 and not _steps_with(model, shape[1:])):
        raise InputError(
            "rollout", f"x0 of shape {start.shape} and u of shape {shape}",
            f"({n_x},) and (steps, {n_u}), or what `drive_of` makes of a record",
        )  # fmt: skip
    course = _course(u, measured)
    start = start.astype(precision(model, start, course.u))

    def advance(x: State, now: _Course) -> tuple[State, State]:
        following = _advanced(model, x, now)
        return following, following

    return jnp.concatenate([start[None], _loop(advance, start, course)])


def _steps_with(model: Model, shape: tuple[int, ...]) -> bool:
    """Whether a model's step takes what is no vector of inputs."""
    x, u = (jax.ShapeDtypeStruct(s, precision(model)) for s in ((model.state_size,), shape))
    try:
        return jax.eval_shape(model.step, x, u).shape == x.shape
    except (TypeError, ValueError):
        return False


class _Course(NamedTuple):
    """What every step of a simulation is given, time first.

    Attributes:
        u: what the model's step is given.
        period: how long the step is [s], None for the model's sampling period.
        known: measured positions and velocities, None where nothing is put back.
        put_back: the steps before which they are.
    """

    u: Array
    period: Array | None
    known: Array | None
    put_back: Bool[Array, "..."] | None


def _course(u: Driven, measured: Any) -> _Course:
    drive = u if isinstance(u, Drive) else Drive(u)
    seen = jnp.asarray(drive.u)
    period = None if drive.periods is None else jnp.asarray(drive.periods)
    if measured is None:
        return _Course(seen, period, None, None)
    steps, count = len(seen), len(measured)
    known = jnp.pad(jnp.asarray(measured)[:steps], ((0, max(0, steps - count)), (0, 0)))
    return _Course(seen, period, known, jnp.arange(steps) < count)


def _advanced(model: Model, x: State, now: _Course) -> State:
    if now.known is not None and now.put_back is not None:
        given = jnp.concatenate([now.known.astype(x.dtype), x[model.channels.internal]])
        x = jnp.where(now.put_back, given, x)
    return model.step(x, now.u) if now.period is None else model.advance(x, now.u, now.period)


def _loop(advance: Callable[..., Any], start: Any, course: Any) -> Any:
    """The loop over time; of a long one a gradient keeps the states between stretches only."""
    steps = jax.tree.leaves(course)[0].shape[0]
    if not isinstance(steps, int) or steps <= LONG:  # a symbol where a length is exported open
        return jax.lax.scan(advance, start, course)[1]

    def stretch(x: Any, part: Any) -> tuple[Any, Any]:
        return jax.lax.scan(advance, x, part)

    length = math.isqrt(steps)
    stretches = steps // length
    whole = stretches * length
    cut = jax.tree.map(lambda a: a[:whole].reshape(stretches, length, *a.shape[1:]), course)
    end, states = jax.lax.scan(jax.checkpoint(stretch), start, cut)
    _, rest = stretch(end, jax.tree.map(lambda a: a[whole:], course))
    return jnp.concatenate([states.reshape(whole, *states.shape[2:]), rest])


def rollouts(
    model: Model,
    x0: Float[Array | np.ndarray, "batch n_x"],
    u: Driven,
    measured: Float[Array | np.ndarray, "batch known n_measured"] | None = None,
    *,
    only_layers: bool = False,
) -> Float[Array, "batch samples n_x"]:
    """Free runs of a batch: what `jax.vmap` makes of `rollout`, with a cheaper gradient.

    Reverse differentiation through `rollout` adds to the gradient of every weight at every step.
    Here the backward pass only keeps the derivatives by the outputs of the `Affine` layers, and
    one product of these with what went into the layers gives the gradient of a weight, summed
    over all steps and runs. Whatever else is in the model is differentiated as usual. Forward
    differentiation is not defined.

    Args:
        model: the model; its `Affine` layers do not act inside a loop of a step's own.
        x0: initial states, (batch, n_x).
        u: as for `rollout`, with the batch first.
        measured: as for `rollout`, with the batch first.
        only_layers: whether nothing is differentiated by but `Affine` layers and `x0`. Machine
            code then does the steps where it can, and all other derivatives are zero.

    Returns:
        (batch, steps + 1, n_x).
    """
    start, parts = jnp.asarray(x0), _taken_apart(model)
    steps = np.shape(u.u if isinstance(u, Drive) else u)[1]
    if not parts.layers or steps > LONG:
        return jax.vmap(partial(rollout, model))(start, u, measured)
    if only_layers and measured is None and not isinstance(u, Drive):
        drive = jnp.asarray(u)
        kind = precision(model, start, drive)
        by_engine = layered_steps(model, drive.shape[2:], kind)
        if by_engine is not None:
            return by_engine.states(start.astype(kind), drive)
    u, measured = jax.tree.map(jnp.asarray, (u, measured))
    # time first, as the loop takes it
    course = jax.vmap(_course, out_axes=1)(u, measured)
    start = start.astype(precision(model, start, course.u))
    calls = _calls(parts, start, course)

    def no_slots(layers: list[Affine]) -> list[Array]:
        return [
            jnp.zeros((steps, len(start), count, len(layer.weight)), start.dtype)
            for layer, count in zip(layers, calls, strict=True)
        ]

    @jax.custom_vjp
    def run(layers: list[Affine], rest: list[Any], start: Array, course: _Course) -> Array:
        return _listened(parts.rebuilt, layers, rest, (start, course), no_slots(layers))[0]

    def forward(
        layers: list[Affine], rest: list[Any], start: Array, course: _Course
    ) -> tuple[Array, Any]:
        def listen(rest: list[Any], begin: tuple[Array, _Course], slots: list[Array]) -> Any:
            return _listened(parts.rebuilt, layers, rest, begin, slots)

        states, back, heard = jax.vjp(listen, rest, (start, course), no_slots(layers), has_aux=True)
        return states, (back, heard, layers)

    def backward(kept: Any, gradient: Array) -> tuple[Any, ...]:
        back, heard, layers = kept
        by_rest, (by_start, by_course), deltas = back(gradient)
        by_layers = [_summed(*of) for of in zip(layers, deltas, heard, strict=True)]
        return by_layers, by_rest, by_start, by_course

    run.defvjp(forward, backward)
    return run(parts.layers, parts.rest, start, course)


class _Parts(NamedTuple):
    """A model taken apart: its layers, everything else, and how it is put together again."""

    layers: list[Affine]
    rest: list[Any]
    rebuilt: Callable[[list[Any], list[Any]], Model]


def _taken_apart(model: Model) -> _Parts:
    leaves, structure = jax.tree.flatten(model, is_leaf=is_layer)
    places = [i for i, leaf in enumerate(leaves) if is_layer(leaf)]

    def rebuilt(layers: list[Any], rest: list[Any]) -> Model:
        filled = list(rest)
        for place, layer in zip(places, layers, strict=True):
            filled[place] = layer
        return jax.tree.unflatten(structure, filled)

    others = [None if is_layer(leaf) else leaf for leaf in leaves]
    return _Parts([leaves[i] for i in places], others, rebuilt)


def _listened(
    rebuilt: Callable[[list[Any], list[Any]], Model],
    layers: list[Affine],
    rest: list[Any],
    begin: tuple[Array, _Course],
    slots: list[Array],
) -> tuple[Array, list[Array]]:
    """States, and what went into each layer at every step; derivatives go to `slots`."""
    start, course = begin
    transposed = [layer.weight.T for layer in layers]  # once, not at every step

    def advance(x: Array, now: tuple[_Course, list[Array]]) -> tuple[Array, Any]:
        def one(x: State, now: _Course, slots: list[Array]) -> tuple[State, list[Array]]:
            ears = [_Ear(*of) for of in zip(layers, transposed, slots, strict=True)]
            following = _advanced(rebuilt(ears, rest), x, now)
            return following, [ear.all_heard() for ear in ears]

        following, heard = jax.vmap(one)(x, *now)
        return following, (following, heard)

    states, heard = _loop(advance, start, (course, slots))
    return jnp.concatenate([start[:, None], jnp.swapaxes(states, 0, 1)], axis=1), heard


def _calls(parts: _Parts, start: Array, course: _Course) -> list[int]:
    """How often each layer acts in a step: once in most models, at every stage of an integrator."""
    counts = [0] * len(parts.layers)

    def counting(i: int, layer: Affine) -> Callable[[Array], Array]:
        def act(z: Array) -> Array:
            counts[i] += 1
            return layer(z)

        return act

    def step(x: State, now: _Course) -> State:
        counters = [counting(*of) for of in enumerate(parts.layers)]
        return _advanced(parts.rebuilt(counters, parts.rest), x, now)

    jax.eval_shape(step, start[0], jax.tree.map(lambda a: a[0, 0], course))
    return counts


class _Ear:
    """Stands in a model where a layer was: does the same and notes what goes in."""

    def __init__(self, layer: Affine, transposed: Array, slots: Array) -> None:
        self._layer, self._transposed, self._slots = layer, transposed, slots
        self.heard: list[Array] = []

    def all_heard(self) -> Array:
        """What went in at each call; layers of an encoder have no part in a step."""
        nothing = jnp.zeros((0, len(self._transposed)), self._transposed.dtype)
        return jnp.stack(self.heard) if self.heard else nothing

    def __call__(self, z: Array) -> Array:
        slot = self._slots[len(self.heard)]
        self.heard.append(z)
        product = _product(z, self._layer.weight, self._transposed, slot)
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
    layer: Affine, delta: Float[Array, "*sum n_out"], z: Float[Array, "*sum n_in"]
) -> Affine:
    """The gradient of a layer: its outputs' derivatives times its inputs, over steps and runs."""
    count = math.prod(delta.shape[:-1])
    delta, z = delta.reshape(count, delta.shape[-1]), z.reshape(count, z.shape[-1])
    weight = (delta.T @ z).astype(layer.weight.dtype)
    if layer.bias is None:
        return Affine(weight, None)
    return Affine(weight, jnp.sum(delta, axis=0).astype(layer.bias.dtype))


def precision(model: Model, *signals: Array) -> np.dtype:
    """A state keeps its precision from step to step: the widest of all that goes into it."""
    arrays = [leaf for leaf in jax.tree.leaves(model) if eqx.is_inexact_array(leaf)]
    return jnp.result_type(*signals, *arrays, jnp.float32)
