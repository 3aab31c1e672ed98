"""Parts of networks: layers, units, features of a state."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource, moving_coordinates
from tustinnet.errors import InputError

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "leaky_relu": lambda z: jax.nn.leaky_relu(z, 0.01),
    "relu": jax.nn.relu,
    "tanh": jnp.tanh,
    "silu": jax.nn.silu,
    "softplus": jax.nn.softplus,
}


_TOGETHER = 0.3  # of a coordinate's spread: less apart, two coordinates move together


class Affine(eqx.Module):
    """`z -> W z + b`, the bias optional.

    Attributes:
        weight: `W`, (n_out, n_in).
        bias: `b`, (n_out,), or None.
    """

    weight: Float[Array, "n_out n_in"]
    bias: Float[Array, " n_out"] | None

    def __call__(self, z: Float[Array, " n_in"]) -> Float[Array, " n_out"]:
        """Applies the map."""
        product = z @ self.weight.T
        return product if self.bias is None else product + self.bias

    def zeros(self) -> "Affine":
        """A map of the same shape with an output of zero."""
        return jax.tree.map(jnp.zeros_like, self)


def is_layer(node: object) -> bool:
    """Whether a part of a model is an `Affine` layer."""
    return isinstance(node, Affine)


def fold(first: Affine, second: Affine) -> Affine:
    """The affine map that applies `first`, then `second`."""
    bias = second.bias
    if first.bias is not None:
        carried = second.weight @ first.bias
        bias = carried if bias is None else bias + carried
    return Affine(second.weight @ first.weight, bias)


def random_affine(n_in: int, n_out: int, key: PRNGKeyArray, *, bias: bool = True) -> Affine:
    """Float32 weights, and perhaps biases, uniform within 1/sqrt(n_in) of 0."""
    bound = n_in**-0.5
    for_weight, for_bias = jax.random.split(key)
    weight = jax.random.uniform(for_weight, (n_out, n_in), jnp.float32, -bound, bound)
    if not bias:
        return Affine(weight, None)
    return Affine(weight, jax.random.uniform(for_bias, (n_out,), jnp.float32, -bound, bound))


class Scaling(eqx.Module):
    """Units of a network's features and outputs. Never trained.

    Attributes:
        position_offset: subtracted from linear positions [m], (n_linear,).
        position_scale: divides linear positions [m], (n_linear,).
        velocity: divides velocities [rad/s or m/s], (n_q,).
        input: divides inputs, (n_u,).
        acceleration: multiplies the accelerations of a network [rad/s^2 or m/s^2], (n_q,).
        memory: divides internal states that are fed to a network, (n_z,).
        angle_centre: subtracted from the sines, then from the cosines of angles, (2 n_angular,), or
            none.
        angle_scale: divides both of an angle, (n_angular,), or none.
        pair_scale: divides the differences of the positions of `pairs`, then of their velocities,
            (2 n_pairs,).
        pairs: coordinates of a kind that move together, whose differences are features, too.
    """

    position_offset: Float[Array, " n_linear"]
    position_scale: Float[Array, " n_linear"]
    velocity: Float[Array, " n_q"]
    input: Float[Array, " n_u"]
    acceleration: Float[Array, " n_q"]
    memory: Float[Array, " n_z"] = eqx.field(default_factory=lambda: jnp.zeros(0, jnp.float32))
    angle_centre: Float[Array, " _"] = eqx.field(default_factory=lambda: jnp.zeros(0, jnp.float32))
    angle_scale: Float[Array, " _"] = eqx.field(default_factory=lambda: jnp.zeros(0, jnp.float32))
    pair_scale: Float[Array, " _"] = eqx.field(default_factory=lambda: jnp.zeros(0, jnp.float32))
    pairs: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())

    def features(
        self, channels: Channels, x: Float[Array, " n_x"], u: Float[Array, "*taps n_u"]
    ) -> Float[Array, " n_0"]:
        """The inputs of a network: sines, cosines, linear positions, velocities, inputs, scaled.

        Differences of pairs, of angles their sines, follow the velocities. As many of the internal
        states as `memory` has units for stand before the inputs. Of several samples of the inputs
        one stands after the other.
        """
        angle, length = _split_by_kind(x[channels.position], channels.angular)
        circle = jnp.concatenate([jnp.sin(angle), jnp.cos(angle)])
        if len(self.angle_scale):
            circle = (circle - self.angle_centre) / jnp.tile(self.angle_scale, 2)
        features = [
            circle,
            (length - self.position_offset) / self.position_scale,
            x[channels.velocity] / self.velocity,
        ]
        if self.pairs:
            features.append(pair_differences(self.pairs, channels, x) / self.pair_scale)
        if len(self.memory):
            features.append(x[channels.internal] / self.memory)
        return jnp.concatenate([*features, jnp.ravel(u / self.input)])


def pair_differences(
    pairs: Sequence[tuple[int, int]], channels: Channels, x: Float[Array, " n_x"]
) -> Float[Array, " _"]:
    """Differences of the positions of pairs, of angles their sines, then of their velocities.

    Args:
        pairs: two coordinates each, of the same kind.
        channels: the coordinates.
        x: a state.
    """
    q, v = x[channels.position], x[channels.velocity]
    apart = [q[j] - q[i] for i, j in pairs]
    positions = [
        jnp.sin(d) if channels.angular[i] else d for d, (i, _) in zip(apart, pairs, strict=True)
    ]
    return jnp.stack([*positions, *(v[j] - v[i] for i, j in pairs)])


def feature_count(channels: Channels, memory: int = 0, taps: int = 1, pairs: int = 0) -> int:
    """The number of features of a network.

    Three per angular coordinate, two per linear one and per pair, one per internal state, and one
    per input and tap.
    """
    own = 2 * channels.n_q + int(channels.angular.sum())
    return own + 2 * pairs + memory + taps * channels.n_u


def _split_by_kind(q: Float[Array, " n_q"], angular: np.ndarray) -> tuple[Array, Array]:
    """Angular and linear positions; no gather, whose gradient is slow, where all are of a kind."""
    if angular.all():
        return q, q[:0]
    if not angular.any():
        return q[:0], q
    return q[angular], q[~angular]


class Network(eqx.Module):
    """A feedforward network of the features of a state.

    `W_{M+1} sigma(W_M ... sigma(W_1 z + b_1) ... + b_M)`

    Attributes:
        stem: an affine layer without activation before the first hidden layer, or None. It adds
            nothing to what the network can represent but changes how it trains; `simplify` merges
            it into the first hidden layer.
        hidden: the M hidden layers.
        output: the output layer, without bias unless asked for.
        scaling: units of its features and outputs.
        activation: name of sigma, a key of `ACTIVATIONS`.
        bypass: an affine map of the features that is added to the output, or None.
        odd: whether its output is `(f(x, u) - f(-x, -u)) / 2` with these layers as `f`: a symmetric
            mechanism on the other side accelerates to the other side.
    """

    stem: Affine | None
    hidden: tuple[Affine, ...]
    output: Affine
    scaling: Scaling
    activation: str = eqx.field(static=True)
    bypass: Affine | None = None
    odd: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            raise InputError(
                "activation", f"unknown '{self.activation}'", f"one of {', '.join(ACTIVATIONS)}"
            )
        if not self.hidden:
            raise InputError("hidden layers", "none", "at least one")
        if self.odd and self.output.bias is not None:
            raise InputError("network", "odd, with a bias of the output", "one of both")
        layers = [*([self.stem] if self.stem else []), *self.hidden, self.output]
        for before, layer in pairwise(layers):
            if layer.weight.shape[1] != before.weight.shape[0]:
                raise InputError(
                    "network",
                    f"a layer takes {layer.weight.shape[1]} values",
                    f"{before.weight.shape[0]}",
                )

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of its features and of its outputs."""
        first = self.stem if self.stem is not None else self.hidden[0]
        return first.weight.shape[1], self.output.weight.shape[0]

    def __call__(
        self, channels: Channels, x: Float[Array, " n_x"], u: Float[Array, "*taps n_u"]
    ) -> Float[Array, " n_out"]:
        """The output of the network at a state and an input, in its own units."""
        output = self._output(self.scaling.features(channels, x, u))
        if not self.odd:
            return output
        return (output - self._output(self.scaling.features(channels, -x, -u))) / 2

    def _output(self, features: Float[Array, " n_0"]) -> Float[Array, " n_out"]:
        sigma = ACTIVATIONS[self.activation]
        z = features
        if self.stem is not None:
            z = self.stem(z)
        for layer in self.hidden:
            z = sigma(layer(z))
        output = self.output(z)
        return output if self.bypass is None else output + self.bypass(features)

    def with_zero_output(self) -> "Network":
        """A network whose output layer and bypass are zero."""
        bypass = None if self.bypass is None else self.bypass.zeros()
        return replace(self, output=self.output.zeros(), bypass=bypass)

    def require_shape(self, n_features: int, n_outputs: int) -> None:
        """Raises unless it has so many features and outputs."""
        if self.shape != (n_features, n_outputs):
            raise InputError(
                "network",
                f"{self.shape[0]} features and {self.shape[1]} outputs",
                f"{n_features} and {n_outputs}",
            )

    def simplify(self) -> "Network":
        """An equal network with the stem merged into the first hidden layer."""
        if self.stem is None:
            return self
        first = fold(self.stem, self.hidden[0])
        return replace(self, stem=None, hidden=(first, *self.hidden[1:]))

    def trainable_layers(self, frozen: int) -> list[Affine]:
        """The layers that train when the first so many hidden ones do not; a stem counts with it.

        The output layer and the bypass always train.
        """
        layers = [*self.hidden[frozen:], self.output, *([self.bypass] if self.bypass else [])]
        return layers if self.stem is None or frozen else [self.stem, *layers]


@dataclass(frozen=True)
class Layers:
    """The layers of a network.

    Attributes:
        hidden: units of each hidden layer.
        stem: units of the affine layer before them, if any.
        activation: a key of `ACTIVATIONS`.
        output_bias: whether the output layer has a bias (the paper: no).
        linear: whether an affine map of the features is added to the output, at first zero.
        odd: whether the network is odd, see `Network`.
    """

    hidden: Sequence[int] = (100, 100)
    stem: int | None = None
    activation: str = "leaky_relu"
    output_bias: bool = False
    linear: bool = False
    odd: bool = False

    def __post_init__(self) -> None:
        hidden, stem = tuple(self.hidden), self.stem
        if not hidden or min(hidden) < 1 or (stem is not None and stem < 1):
            raise InputError("network", f"hidden layers {hidden}, stem {stem}", "at least 1 unit")


def random_network(
    scaling: Scaling, key: PRNGKeyArray, n_features: int, n_outputs: int, layers: Layers
) -> Network:
    """A network with random float32 weights, uniform within 1/sqrt(n_in) of 0.

    Args:
        scaling: units of its features and outputs.
        key: the source of randomness.
        n_features: number of features.
        n_outputs: number of outputs.
        layers: its layers.
    """
    stem, hidden = layers.stem, layers.hidden
    widths = [n_features, *([stem] if stem else []), *hidden]
    keys = jax.random.split(key, len(widths))
    affine = [
        random_affine(n_in, n_out, k)
        for n_in, n_out, k in zip(widths[:-1], widths[1:], keys[:-1], strict=True)
    ]
    return Network(
        stem=affine[0] if stem else None,
        hidden=tuple(affine[1 if stem else 0 :]),
        output=random_affine(widths[-1], n_outputs, keys[-1], bias=layers.output_bias),
        scaling=scaling,
        activation=layers.activation,
        bypass=random_affine(n_features, n_outputs, keys[-1]).zeros() if layers.linear else None,
        odd=layers.odd,
    )


def learn_scaling(
    experiments: Sequence[Experiment],
    velocity: VelocitySource = "auto",
    relaxation_times: Sequence[float] = (),
) -> Scaling:
    """Units from the training records.

    Linear positions are centred and divided by their standard deviation, velocities and inputs
    divided by their root mean square, and accelerations are measured in root mean squares
    of the velocity's change per period. States that follow the velocity and relax are divided by
    their root mean square. What never moves or acts has units of 1.

    Args:
        experiments: the training records.
        velocity: which velocities to use.
        relaxation_times: relaxation times of the internal states [s].
    """
    channels = experiments[0].channels
    q = np.concatenate([e.q for e in experiments])[:, ~channels.angular]
    velocities = [e.velocities(velocity) for e in experiments]
    change = np.concatenate([np.diff(v, axis=0) for v in velocities]) / channels.dt
    internal = [relaxing_states(v, channels.dt, relaxation_times) for v in velocities]
    return make_scaling(
        position_offset=q.mean(axis=0),
        position_scale=np.where(
            moving_coordinates(experiments)[~channels.angular], q.std(axis=0), 1.0
        ),
        velocity=root_mean_square(np.concatenate(velocities)),
        input=root_mean_square(np.concatenate([e.u for e in experiments])),
        acceleration=root_mean_square(change),
        memory=root_mean_square(np.concatenate(internal)),
    )


def learn_standard_scaling(
    experiments: Sequence[Experiment],
    velocity: VelocitySource = "auto",
    relaxation_times: Sequence[float] = (),
) -> Scaling:
    """Units from the training records in which all features are of the size of 1.

    Like `learn_scaling`, and the sines and cosines of an angle are centred and divided by the
    radius within which they move: an angle that stays near a position counts as much as one that
    turns around. Coordinates of a kind that move together, as both ends of a shaft do, also enter
    by their differences, in units of these: they are what a shaft or a belt acts by, and would be
    lost beside the positions.

    Args:
        experiments: the training records.
        velocity: which velocities to use.
        relaxation_times: relaxation times of the internal states [s].
    """
    scaling = learn_scaling(experiments, velocity, relaxation_times)
    channels = experiments[0].channels
    q = np.concatenate([e.q for e in experiments])
    v = np.concatenate([e.velocities(velocity) for e in experiments])
    moving = moving_coordinates(experiments)
    angle = q[:, channels.angular]
    circle = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
    radius = np.sqrt(np.sum(circle.var(axis=0).reshape(2, -1), axis=0))
    spread, speed = q.std(axis=0), root_mean_square(v)
    pairs: list[tuple[int, int]] = []
    apart: list[float] = []  # the spread of the difference of each pair, and of its speed
    speed_apart: list[float] = []
    for i, j in combinations(np.flatnonzero(moving).tolist(), 2):
        if channels.angular[i] != channels.angular[j]:
            continue
        difference = q[:, j] - q[:, i]
        size = np.std(np.sin(difference) if channels.angular[i] else difference)
        rate = np.sqrt(np.mean((v[:, j] - v[:, i]) ** 2))
        together = difference.std() < _TOGETHER * min(spread[i], spread[j])
        if together and size > 0 and 0 < rate < min(speed[i], speed[j]):
            pairs.append((i, j))
            apart.append(float(size))
            speed_apart.append(float(rate))
    return replace(
        scaling,
        angle_centre=jnp.asarray(circle.mean(axis=0), jnp.float32),
        angle_scale=jnp.asarray(np.where(moving[channels.angular], radius, 1.0), jnp.float32),
        pair_scale=jnp.asarray([*apart, *speed_apart], jnp.float32),
        pairs=tuple(pairs),
    )


def relaxing_states(
    v: Float[np.ndarray, "n n_q"], dt: float, times: Sequence[float]
) -> Float[np.ndarray, "n n_z"]:
    """States along a record that follow each velocity and relax, from 0; see `TustinNet`."""
    import scipy.signal  # takes a second, and few networks remember

    mean = np.concatenate([np.zeros((1, v.shape[1])), (v[:-1] + v[1:]) / 2])
    states = [
        scipy.signal.lfilter([time * (1 - decay)], [1.0, -decay], mean, axis=0)
        for time, decay in ((time, np.exp(-dt / time)) for time in times)
    ]
    return np.concatenate([np.zeros((len(v), 0)), *states], axis=1)


def root_mean_square(signal: Float[np.ndarray, "n c"]) -> Float[np.ndarray, " c"]:
    """The root mean square of each column, 1 where a signal never acts."""
    size = np.sqrt(np.mean(signal**2, axis=0))
    return np.where(size > 0, size, 1.0)


def make_scaling(dtype: type = np.float32, **fields: np.ndarray) -> Scaling:
    """Units from plain arrays."""
    arrays: dict[str, Any] = {name: jnp.asarray(value, dtype) for name, value in fields.items()}
    return Scaling(**arrays)
