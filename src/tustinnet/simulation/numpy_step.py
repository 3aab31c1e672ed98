"""A step of a Tustin-Net that needs NumPy only, for control loops."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel
from tustinnet.models.tustin import TustinNet, relax

Vector = Float[np.ndarray, " _"]
NumpyStep = Callable[[Vector, Vector], Vector]


def _leaky_relu(z: Vector) -> None:
    np.maximum(z, 0.01 * z, out=z)


def _relu(z: Vector) -> None:
    np.maximum(z, 0.0, out=z)


def _tanh(z: Vector) -> None:
    np.tanh(z, out=z)


def _silu(z: Vector) -> None:
    z /= 1 + np.exp(-z)


def _softplus(z: Vector) -> None:
    np.logaddexp(z, 0.0, out=z)


# the activations of the model, each in the place of its argument
_IN_PLACE = {
    "leaky_relu": _leaky_relu,
    "relu": _relu,
    "tanh": _tanh,
    "silu": _silu,
    "softplus": _softplus,
}


def numpy_step(model: DiscreteModel, dtype: type[np.floating] = np.float64) -> NumpyStep:
    """A function that steps a Tustin-Net without JAX.

    Equal to `model.step` to rounding. It is called once a period, as in a controller or an
    estimator, where starting a compiled program would cost more than the arithmetic.

    Args:
        model: a Tustin-Net.
        dtype: precision of weights and states.

    Returns:
        `step(x, u) -> x`, arrays of (n_x,) and (n_u,) in, (n_x,) out.

    Raises:
        InputError: another kind of model.
    """
    if not isinstance(model, TustinNet):
        raise InputError(
            "numpy_step", f"a {type(model).__name__}", "a Tustin-Net", "use jax.jit(model.step)"
        )
    net = model.folded()
    n_q, n_u, angular = len(net.coordinates), len(net.inputs), net.angular
    angles, lengths = np.flatnonzero(angular), np.flatnonzero(~angular)
    n_a, n_l = len(angles), len(lengths)
    # scaling is part of the first layer and of the last one
    s = {name: np.asarray(value, np.float64) for name, value in vars(net.scaling).items()}
    n_z = len(net.memory)
    unit = np.concatenate(
        [np.ones(2 * n_a), s["position_scale"], s["velocity"], s["memory"], s["input"]]
    )
    shift = np.concatenate([np.zeros(2 * n_a), s["position_offset"], np.zeros(n_q + n_z + n_u)])
    layers = []
    for i, layer in enumerate(net.hidden):
        weight = np.asarray(layer.weight, np.float64)
        bias = np.zeros(len(weight)) if layer.bias is None else np.asarray(layer.bias, np.float64)
        if i == 0:
            weight = weight / unit
            bias = bias - weight @ shift
        layers.append((weight.astype(dtype), bias.astype(dtype)))
    gain = net.dt * s["acceleration"]
    last = (gain[:, None] * np.asarray(net.output.weight, np.float64)).astype(dtype)
    offset = np.zeros(n_q) if net.output.bias is None else gain * np.asarray(net.output.bias)
    offset, half = offset.astype(dtype), dtype(net.dt / 2)
    activate = _IN_PLACE[net.activation]
    positions = 2 * n_a + n_l
    width = positions + n_q + n_z
    # z relaxes and follows the mean velocity of the period
    left, moved = (
        np.asarray(relax(np.full(n_z, z), np.full(n_q, v), net.dt, net.relaxation_times), dtype)
        for z, v in ((1.0, 0.0), (0.0, 1.0))
    )
    times = len(net.relaxation_times)

    def step(x: Vector, u: Vector) -> Vector:
        features = np.empty(width + n_u, dtype)
        angle = x[:n_q] if not n_l else x[angles]
        np.sin(angle, out=features[:n_a])
        np.cos(angle, out=features[n_a : 2 * n_a])
        if n_l:
            features[2 * n_a : positions] = x[lengths]
        v = x[n_q : 2 * n_q]
        features[positions:width] = x[n_q:]
        features[width:] = u
        z = features
        for weight, bias in layers:
            z = weight @ z
            z += bias
            activate(z)
        following = np.empty(2 * n_q + n_z, dtype)
        v_next = following[n_q : 2 * n_q]
        np.add(last @ z, v, out=v_next)
        v_next += offset
        np.add(v, v_next, out=following[:n_q])
        if n_z:
            mean = np.tile(following[:n_q] / 2, times)
            following[2 * n_q :] = left * x[2 * n_q :] + moved * mean
        following[:n_q] *= half
        following[:n_q] += x[:n_q]
        return following

    return step
