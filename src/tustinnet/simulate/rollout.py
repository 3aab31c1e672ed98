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
from tustinnet.simulate.engine_rollouts import layered_steps
from tustinnet.simulate.input_signal import InputSignal

LONG_ROLLOUT = 5000  # steps from which a gradient saves memory instead of time

Inputs = InputSignal | Float[Array | np.ndarray, "..."]


@eqx.filter_jit
def rollout(
    model: Model,
    x0: Float[Array | np.ndarray, "..."],
    u: Inputs,
    measured: Float[Array | np.ndarray, "known n_measured"] | None = None,
) -> Float[Array, "samples n_x"]:
    """Free run: the states that a model reaches from `x0` with only the input.

    The gradient of a rollout of more than 5000 steps keeps some states and computes those between
    them a second time: memory grows with the root of the steps instead of with the steps.

    Args:
        model: the model.
        x0: initial state [q, v, z], (n_x,).
        u: an `InputSignal`, as `input_signal` makes it of a record; or inputs of which `u[k]` acts
            from sample k to sample k+1, (steps, n_u); or an array with the inputs of the model's
            steps.
        measured: positions and velocities [q, v] of the first samples, (known, 2 n_q), which take
            the place of the model's own before it steps on; so internal states follow a record.

    Returns:
        The states, (steps + 1, n_x); the first row is `x0`. Rows of measured samples hold what the
        model predicted there.
    """
    start, n_x, n_u = jnp.asarray(x0), model.state_size, model.channels.n_u
    inputs = jnp.asarray(u.u if isinstance(u, InputSignal) else u)
    shape, kind = inputs.shape, precision(model, start, inputs)
    fits = start.shape == (n_x,) and len(shape) in (2, 3) and shape[-1] == n_u
    if not fits or (len(shape) == 3 and not _steps_with(model, shape[1:], kind)):
        raise InputError(
            "rollout",
            f"x0 of shape {start.shape} and u of shape {shape}",
            f"({n_x},) and (steps, {n_u}), or what `input_signal` makes of a record",
        )
    trajectory = _trajectory(u, measured)
    start = start.astype(kind)

    def advance(x: State, now: _Trajectory) -> tuple[State, State]:
        x_next = _advance(model, x, now)
        return x_next, x_next

    return jnp.concatenate([start[None], _scan(advance, start, trajectory)])


def _steps_with(model: Model, shape: tuple[int, ...], kind: np.dtype) -> bool:
    """Whether a model's step takes inputs of a shape that is no vector, in a precision."""
    x, u = (jax.ShapeDtypeStruct(s, kind) for s in ((model.state_size,), shape))
    try:
        return jax.eval_shape(model.step, x, u).shape == x.shape
    except (TypeError, ValueError):
        return False


class _Trajectory(NamedTuple):
    """Inputs and measured states of every step of a simulation, time first.

    Attributes:
        u: input of the step.
        period: how long the step is [s], None for the model's sampling period.
        measured: measured positions and velocities, None where nothing is put back.
        is_put_back: whether they take the place of the model's own before the step.
    """

    u: Array
    period: Array | None
    measured: Array | None
    is_put_back: Bool[Array, "..."] | None


def _trajectory(u: Inputs, measured: Any) -> _Trajectory:
    signal = u if isinstance(u, InputSignal) else InputSignal(u)
    inputs = jnp.asarray(signal.u)
    period = None if signal.periods is None else jnp.asarray(signal.periods)
    if measured is None:
        return _Trajectory(inputs, period, None, None)
    steps, count = len(inputs), len(measured)
    padded = jnp.pad(jnp.asarray(measured)[:steps], ((0, max(0, steps - count)), (0, 0)))
    return _Trajectory(inputs, period, padded, jnp.arange(steps) < count)


def _advance(model: Model, x: State, now: _Trajectory) -> State:
    """The state after a step, from the measured one where that is put back."""
    if now.measured is not None and now.is_put_back is not None:
        corrected = jnp.concatenate([now.measured.astype(x.dtype), x[model.channels.internal]])
        x = jnp.where(now.is_put_back, corrected, x)
    return model.step(x, now.u) if now.period is None else model.advance(x, now.u, now.period)


def _scan(advance: Callable[..., Any], start: Any, trajectory: Any) -> Any:
    """The loop over time; of a long one a gradient keeps the states between stretches only."""
    steps = jax.tree.leaves(trajectory)[0].shape[0]
    # a symbol where a length is exported open
    if not isinstance(steps, int) or steps <= LONG_ROLLOUT:
        return jax.lax.scan(advance, start, trajectory)[1]

    def stretch(x: Any, part: Any) -> tuple[Any, Any]:
        return jax.lax.scan(advance, x, part)

    length = math.isqrt(steps)
    stretches = steps // length
    whole = stretches * length
    cut = jax.tree.map(lambda a: a[:whole].reshape(stretches, length, *a.shape[1:]), trajectory)
    end, states = jax.lax.scan(jax.checkpoint(stretch), start, cut)
    _, rest = stretch(end, jax.tree.map(lambda a: a[whole:], trajectory))
    return jnp.concatenate([states.reshape(whole, *states.shape[2:]), rest])


def rollouts(
    model: Model,
    x0: Float[Array | np.ndarray, "batch n_x"],
    u: Inputs,
    measured: Float[Array | np.ndarray, "batch known n_measured"] | None = None,
    *,
    only_layers: bool = False,
) -> Float[Array, "batch samples n_x"]:
    """Free runs of a batch, as `jax.vmap` of `rollout` computes them, with a cheaper gradient.

    Reverse differentiation through `rollout` adds to the gradient of every weight at every step.
    Here the backward pass only keeps the derivatives by the outputs of the `Affine` layers, and
    one product of these with the inputs of the layers gives the gradient of a weight, summed
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
    start, parts = jnp.asarray(x0), _Parts.from_model(model)
    steps = np.shape(u.u if isinstance(u, InputSignal) else u)[1]
    if not parts.layers or steps > LONG_ROLLOUT:
        return jax.vmap(partial(rollout, model))(start, u, measured)
    if only_layers and measured is None and not isinstance(u, InputSignal):
        inputs = jnp.asarray(u)
        kind = precision(model, start, inputs)
        engine_steps = layered_steps(model, inputs.shape[2:], kind)
        if engine_steps is not None:
            return engine_steps.states(start.astype(kind), inputs)
    u, measured = jax.tree.map(jnp.asarray, (u, measured))
    # time first, as the loop takes it
    trajectory = jax.vmap(_trajectory, out_axes=1)(u, measured)
    start = start.astype(precision(model, start, trajectory.u))
    calls = _count_calls(parts, start, trajectory)

    def zero_slots(layers: list[Affine]) -> list[Array]:
        return [
            jnp.zeros((steps, len(start), count, len(layer.weight)), start.dtype)
            for layer, count in zip(layers, calls, strict=True)
        ]

    def record(
        layers: list[Affine],
        rest: list[Any],
        start: Array,
        trajectory: _Trajectory,
        slots: list[Array],
    ) -> tuple[Array, list[Array]]:
        """States, and the inputs of each layer at every step; derivatives go to `slots`."""
        transposed = [layer.weight.T for layer in layers]  # once, not at every step

        def advance(x: Array, now: tuple[_Trajectory, list[Array]]) -> tuple[Array, Any]:
            def step(x: State, now: _Trajectory, slots: list[Array]) -> tuple[State, list[Array]]:
                recorders = [
                    _LayerRecorder(layer, weight, slot)
                    for layer, weight, slot in zip(layers, transposed, slots, strict=True)
                ]
                x_next = _advance(parts.rebuild(recorders, rest), x, now)
                return x_next, [recorder.stacked_inputs() for recorder in recorders]

            x_next, layer_inputs = jax.vmap(step)(x, *now)
            return x_next, (x_next, layer_inputs)

        states, layer_inputs = _scan(advance, start, (trajectory, slots))
        return (jnp.concatenate([start[:, None], jnp.swapaxes(states, 0, 1)], axis=1), layer_inputs)

    @jax.custom_vjp
    def run(layers: list[Affine], rest: list[Any], start: Array, trajectory: _Trajectory) -> Array:
        return record(layers, rest, start, trajectory, zero_slots(layers))[0]

    def forward(
        layers: list[Affine], rest: list[Any], start: Array, trajectory: _Trajectory
    ) -> tuple[Array, Any]:
        states, pull_back, layer_inputs = jax.vjp(
            partial(record, layers), rest, start, trajectory, zero_slots(layers), has_aux=True
        )
        return states, (pull_back, layer_inputs, layers)

    def backward(saved: Any, gradient: Array) -> tuple[Any, ...]:
        pull_back, layer_inputs, layers = saved
        by_rest, by_start, by_trajectory, deltas = pull_back(gradient)
        by_layers = [
            _layer_gradient(layer, delta, z)
            for layer, delta, z in zip(layers, deltas, layer_inputs, strict=True)
        ]
        return by_layers, by_rest, by_start, by_trajectory

    run.defvjp(forward, backward)
    return run(parts.layers, parts.rest, start, trajectory)


class _Parts(NamedTuple):
    """A model taken apart: its layers, everything else, and how it is put together again."""

    layers: list[Affine]
    rest: list[Any]
    rebuild: Callable[[list[Any], list[Any]], Model]

    @classmethod
    def from_model(cls, model: Model) -> "_Parts":
        leaves, structure = jax.tree.flatten(model, is_leaf=is_layer)
        places = [i for i, leaf in enumerate(leaves) if is_layer(leaf)]

        def rebuild(layers: list[Any], rest: list[Any]) -> Model:
            filled = list(rest)
            for place, layer in zip(places, layers, strict=True):
                filled[place] = layer
            return jax.tree.unflatten(structure, filled)

        others = [None if is_layer(leaf) else leaf for leaf in leaves]
        return cls([leaves[i] for i in places], others, rebuild)


def _count_calls(parts: _Parts, start: Array, trajectory: _Trajectory) -> list[int]:
    """The number of calls of each layer in a step: one, or one a stage of an integrator."""
    counts = [0] * len(parts.layers)

    def counting(i: int, layer: Affine) -> Callable[[Array], Array]:
        def act(z: Array) -> Array:
            counts[i] += 1
            return layer(z)

        return act

    def step(x: State, now: _Trajectory) -> State:
        counters = [counting(i, layer) for i, layer in enumerate(parts.layers)]
        return _advance(parts.rebuild(counters, parts.rest), x, now)

    jax.eval_shape(step, start[0], jax.tree.map(lambda a: a[0, 0], trajectory))
    return counts


class _LayerRecorder:
    """A layer that records its inputs and leads the derivatives of its outputs into slots."""

    def __init__(self, layer: Affine, transposed: Array, slots: Array) -> None:
        self._layer, self._transposed, self._slots = layer, transposed, slots
        self._inputs: list[Array] = []

    def stacked_inputs(self) -> Array:
        """The inputs of all calls in a step, (calls, n_in); some layers have no part in it."""
        empty = jnp.zeros((0, len(self._transposed)), self._transposed.dtype)
        return jnp.stack(self._inputs) if self._inputs else empty

    def __call__(self, z: Array) -> Array:
        slot = self._slots[len(self._inputs)]
        self._inputs.append(z)
        product = _product(z, self._layer.weight, self._transposed, slot)
        return product if self._layer.bias is None else product + self._layer.bias


@jax.custom_vjp
def _product(z: Array, weight: Array, transposed: Array, slot: Array) -> Array:
    """`W z`; the derivative by it goes to `slot`, whose value does not matter, and on to `z`."""
    return z @ transposed


_product.defvjp(
    lambda z, weight, transposed, slot: (z @ transposed, weight),
    lambda weight, delta: (delta @ weight, None, None, delta),
)


def _layer_gradient(
    layer: Affine, delta: Float[Array, "*sum n_out"], z: Float[Array, "*sum n_in"]
) -> Affine:
    """The gradient of a layer: derivatives by its outputs times its inputs, over steps and runs."""
    count = math.prod(delta.shape[:-1])
    delta, z = delta.reshape(count, delta.shape[-1]), z.reshape(count, z.shape[-1])
    weight = (delta.T @ z).astype(layer.weight.dtype)
    if layer.bias is None:
        return Affine(weight, None)
    return Affine(weight, jnp.sum(delta, axis=0).astype(layer.bias.dtype))


def precision(model: Model, *signals: Array) -> np.dtype:
    """The precision of states, the widest of all that goes into them, which no step changes."""
    arrays = [leaf for leaf in jax.tree.leaves(model) if eqx.is_inexact_array(leaf)]
    return jnp.result_type(*signals, *arrays, jnp.float32)
