"""Tustin-Net: trapezoidal positions, a network for the change of the velocities."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PRNGKeyArray

from tustinnet.data.experiment import Coordinate, Experiment, Input, VelocitySource
from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel, InputVector, State
from tustinnet.models.network import ACTIVATIONS, Affine, fold, random_affine


class Scaling(eqx.Module):
    """Units of the network's inputs and outputs. Never trained.

    Attributes:
        position_offset: subtracted from linear positions [m], (n_linear,).
        position_scale: divides linear positions [m], (n_linear,).
        velocity: divides velocities [rad/s or m/s], (n_q,).
        input: divides inputs, (n_u,).
        acceleration: multiplies the network's output [rad/s^2 or m/s^2], (n_q,).
        memory: divides the internal states [rad or m], (n_z,).
    """

    position_offset: Float[Array, " n_linear"]
    position_scale: Float[Array, " n_linear"]
    velocity: Float[Array, " n_q"]
    input: Float[Array, " n_u"]
    acceleration: Float[Array, " n_q"]
    memory: Float[Array, " n_z"] = eqx.field(default_factory=lambda: jnp.zeros(0, jnp.float32))


class TustinNet(DiscreteModel):
    """Tustin-Net.

        q[k+1] = q[k] + dt (v[k] + v[k+1]) / 2
        v[k+1] = v[k] + dt f(cat(sin q[k], cos q[k], v[k], u[k]))

    `f` is a feedforward network with M hidden layers, here with its inputs and outputs scaled:
    `f(z) = a * (W_{M+1} sigma(W_M ... sigma(W_1 z + b_1) ... + b_M))`. Linear coordinates enter
    as they are instead of by sine and cosine.

    With memory, `f` also sees internal states, which follow each velocity and relax:

        z[k+1] = exp(-dt/t) z[k] + t (1 - exp(-dt/t)) (v[k] + v[k+1]) / 2

    for each relaxation time t, exact for the mean velocity of the period. They are what the
    deflection of a Maxwell element is: what a cable, rubber or creeping friction remembers.

    Attributes:
        stem: an affine layer without activation before the first hidden layer, or None. It adds
            nothing to what the network can represent but changes how it trains; `folded` merges
            it into the first hidden layer.
        hidden: the M hidden layers.
        output: the output layer, without bias unless asked for.
        scaling: units of the network's inputs and outputs.
        activation: name of sigma, a key of `ACTIVATIONS`.
        coordinates: the coordinates, in the order of q.
        inputs: the inputs, in the order of u.
        dt: sampling period [s].
        relaxation_times: t of the internal states [s]; each gives one a coordinate.

    References:
        Pozzoli, Gallieri, Scattolini (2020), Tustin neural networks: a class of recurrent nets
        for adaptive MPC of mechanical systems, arXiv 1911.01310.
        van Esch, Bonassi, Schön, section 3.1.
    """

    stem: Affine | None
    hidden: tuple[Affine, ...]
    output: Affine
    scaling: Scaling
    activation: str = eqx.field(static=True)
    coordinates: tuple[Coordinate, ...] = eqx.field(static=True)
    inputs: tuple[Input, ...] = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    relaxation_times: tuple[float, ...] = eqx.field(static=True, default=())

    def __check_init__(self) -> None:
        if not all(time > 0 for time in self.relaxation_times):
            raise InputError(
                "memory", f"relaxation times {self.relaxation_times} s", "times above 0 s"
            )
        if self.activation not in ACTIVATIONS:
            raise InputError(
                "activation", f"unknown '{self.activation}'", f"one of {', '.join(ACTIVATIONS)}"
            )
        if not self.hidden:
            raise InputError("hidden layers", "none", "at least one")
        width = feature_count(self.coordinates, self.inputs) + len(self.memory)
        layers = [*([self.stem] if self.stem else []), *self.hidden, self.output]
        for layer in layers:
            if layer.weight.shape[1] != width:
                raise InputError(
                    "network", f"a layer takes {layer.weight.shape[1]} values", f"{width}"
                )
            width = layer.weight.shape[0]
        if width != len(self.coordinates):
            raise InputError("network", f"{width} outputs", f"{len(self.coordinates)} coordinates")

    @property
    def memory(self) -> tuple[str, ...]:
        """What its internal states are called."""
        return tuple(
            f"{c.name}, relaxing in {time:g} s"
            for time in self.relaxation_times
            for c in self.coordinates
        )

    def features(self, x: State, u: InputVector) -> Float[Array, " n_0"]:
        """What the network sees: sines, cosines, linear positions, velocities, inputs, scaled."""
        n_q = len(self.coordinates)
        angle, length = _parted(x[:n_q], self.angular)
        s = self.scaling
        return jnp.concatenate(
            [
                jnp.sin(angle),
                jnp.cos(angle),
                (length - s.position_offset) / s.position_scale,
                x[n_q : 2 * n_q] / s.velocity,
                x[2 * n_q :] / s.memory,
                u / s.input,
            ]
        )

    def acceleration(self, x: State, u: InputVector) -> Float[Array, " n_q"]:
        """`f`, the mean acceleration over the coming period, (n_q,) [rad/s^2 or m/s^2]."""
        sigma = ACTIVATIONS[self.activation]
        z = self.features(x, u)
        if self.stem is not None:
            z = self.stem(z)
        for layer in self.hidden:
            z = sigma(layer(z))
        return self.scaling.acceleration * self.output(z)

    def step(self, x: State, u: InputVector) -> State:
        """One period: velocities by the network, positions by the trapezoidal rule."""
        n_q = len(self.coordinates)
        q, v = x[:n_q], x[n_q : 2 * n_q]
        v_next = v + self.dt * self.acceleration(x, u)
        q_next = q + self.dt * (v + v_next) / 2
        return jnp.concatenate([q_next, v_next, self.relaxed(x[2 * n_q :], (v + v_next) / 2)])

    def relaxed(self, z: Float[Array, " n_z"], v: Float[Array, " n_q"]) -> Float[Array, " n_z"]:
        """The internal states after a period with the mean velocity `v`."""
        if not self.relaxation_times:
            return z
        return jnp.asarray(relax(z, v, self.dt, self.relaxation_times))

    def folded(self) -> "TustinNet":
        """The same function with the stem merged into the first hidden layer."""
        if self.stem is None:
            return self
        return eqx.tree_at(
            lambda m: (m.stem, m.hidden),
            self,
            (None, (fold(self.stem, self.hidden[0]), *self.hidden[1:])),
            is_leaf=lambda leaf: leaf is None,
        )


def _parted(q: Float[Array, " n_q"], angular: np.ndarray) -> tuple[Array, Array]:
    """Angular and linear positions; no gather, whose gradient is slow, where all are of a kind."""
    if angular.all():
        return q, q[:0]
    if not angular.any():
        return q[:0], q
    return q[angular], q[~angular]


def relax(
    z: Float[Array | np.ndarray, " n_z"],
    v: Float[Array | np.ndarray, " n_q"],
    dt: float,
    times: Sequence[float],
) -> Float[Array | np.ndarray, " n_z"]:
    """`exp(-dt/t) z + t (1 - exp(-dt/t)) v`, first all coordinates of the first time."""
    time = np.repeat(np.asarray(times), len(v))
    left = np.exp(-dt / time)
    moved = v[np.tile(np.arange(len(v)), len(times))]
    return (left * z + (time * (1 - left)) * moved).astype(z.dtype)


def feature_count(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> int:
    """Without memory: three features per angular coordinate, two per linear one, one per input."""
    return sum(3 if c.kind == "angular" else 2 for c in coordinates) + len(inputs)


def random_tustin_net(
    coordinates: tuple[Coordinate, ...],
    inputs: tuple[Input, ...],
    dt: float,
    scaling: Scaling,
    key: PRNGKeyArray,
    *,
    hidden: Sequence[int] = (100, 100),
    stem: int | None = None,
    activation: str = "leaky_relu",
    output_bias: bool = False,
    relaxation_times: Sequence[float] = (),
) -> TustinNet:
    """A Tustin-Net with random float32 weights, uniform within 1/sqrt(n_in) of 0.

    Args:
        coordinates: the coordinates, in the order of q.
        inputs: the inputs, in the order of u.
        dt: sampling period [s].
        scaling: units of the network's inputs and outputs.
        key: the source of randomness.
        hidden: units of each hidden layer.
        stem: units of the affine layer before them, if any.
        activation: a key of `ACTIVATIONS`.
        output_bias: whether the output layer has a bias (the paper: no).
        relaxation_times: those of the internal states [s].
    """
    if not hidden or min(hidden) < 1 or (stem is not None and stem < 1):
        raise InputError(
            "network", f"hidden layers {tuple(hidden)}, stem {stem}", "at least 1 unit"
        )
    seen = feature_count(coordinates, inputs) + len(relaxation_times) * len(coordinates)
    widths = [seen, *([stem] if stem else []), *hidden]
    keys = jax.random.split(key, len(widths))
    layers = [
        random_affine(n_in, n_out, k)
        for n_in, n_out, k in zip(widths[:-1], widths[1:], keys[:-1], strict=True)
    ]
    first_hidden = 1 if stem else 0
    return TustinNet(
        stem=layers[0] if stem else None,
        hidden=tuple(layers[first_hidden:]),
        output=random_affine(widths[-1], len(coordinates), keys[-1], bias=output_bias),
        scaling=scaling,
        activation=activation,
        coordinates=tuple(replace(c) for c in coordinates),
        inputs=tuple(replace(i) for i in inputs),
        dt=dt,
        relaxation_times=tuple(relaxation_times),
    )


def learn_scaling(
    experiments: Sequence[Experiment],
    velocity: VelocitySource = "auto",
    relaxation_times: Sequence[float] = (),
) -> Scaling:
    """Scaling from the records of the training split.

    Linear positions are centred and divided by their standard deviation, velocities and inputs
    divided by their root mean square, and the network's output is measured in root mean squares
    of the velocity's change per period. Internal states are divided by their root mean square.

    Args:
        experiments: the training records.
        velocity: which velocities to use.
        relaxation_times: those of the internal states [s].
    """
    first = experiments[0]
    q = np.concatenate([e.q for e in experiments])
    velocities = [e.velocities(velocity) for e in experiments]
    change = np.concatenate([np.diff(v, axis=0) for v in velocities]) / first.dt
    linear = np.array([c.kind == "linear" for c in first.coordinates])
    return _scaling(
        position_offset=q[:, linear].mean(axis=0),
        position_scale=q[:, linear].std(axis=0),
        velocity=_rms(np.concatenate(velocities)),
        input=_rms(np.concatenate([e.u for e in experiments])),
        acceleration=_rms(change),
        memory=_rms(
            np.concatenate([_remembered(v, first.dt, relaxation_times) for v in velocities])
        ),
    )


def _remembered(
    v: Float[np.ndarray, "n n_q"], dt: float, times: Sequence[float]
) -> Float[np.ndarray, "n n_z"]:
    """The internal states along a record."""
    z = np.zeros((len(v), len(times) * v.shape[1]))
    if times:
        for k, mean in enumerate((v[:-1] + v[1:]) / 2):
            z[k + 1] = relax(z[k], mean, dt, times)
    return z


def published_scaling(experiments: Sequence[Experiment]) -> Scaling:
    """Scaling as in the paper's public code, from the stored velocity columns.

    One scale per coordinate, the mean over records of mean |v| / mean |q|, divides the velocity
    and multiplies the network's output, which is the velocity's increment per step. Inputs are
    not scaled. Only for angular coordinates.
    """
    ratios = [
        np.abs(e.velocities("file")).mean(axis=0) / np.abs(e.q).mean(axis=0) for e in experiments
    ]
    return scaling_of_increments(np.mean(ratios, axis=0), experiments[0])


def scaling_of_increments(
    scale: np.ndarray, like: Experiment, dtype: DTypeLike = jnp.float32
) -> Scaling:
    """Scaling of a network that maps `v / scale` to velocity increments per step over `scale`."""
    linear = sum(c.kind == "linear" for c in like.coordinates)
    return _scaling(
        position_offset=np.zeros(linear),
        position_scale=np.ones(linear),
        velocity=scale,
        input=np.ones(len(like.inputs)),
        acceleration=scale / like.dt,
        dtype=dtype,
    )


def _rms(signal: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.mean(signal**2, axis=0))
    return np.where(size > 0, size, 1.0)  # a signal that never acts is left as it is


def _scaling(dtype: DTypeLike = jnp.float32, **fields: np.ndarray) -> Scaling:
    return Scaling(**{name: jnp.asarray(value, dtype) for name, value in fields.items()})
