"""Tustin-Net: trapezoidal positions, a network for the change of the velocities."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray
from pydantic import Field, model_validator

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.families.descriptions import Description
from tustinnet.families.family import (
    Arrays,
    Header,
    Lines,
    named_arrays,
    restore_arrays,
)
from tustinnet.families.networks import (
    InputTaps,
    NetworkEntries,
    NetworkFamily,
    NetworkHyper,
    describe_network,
    restore_network,
    summarise_network,
)
from tustinnet.models.blocks import Affine, Layers, Network, Scaling, feature_count, random_network
from tustinnet.models.contract import (
    AccelerationModel,
    Coordinates,
    InputVector,
    Internal,
    Model,
    State,
)
from tustinnet.models.sizes import LONGEST_TIME, MOST_TIMES
from tustinnet.models.step_layout import StepInput
from tustinnet.registry import SCALINGS
from tustinnet.signals.rest import usual_positions
from tustinnet.simulate.along import states_along
from tustinnet.simulate.input_signal import input_signal

_REST = "rest"  # the name of the array of positions at which the memory rests
_USUAL_SHARE = 0.5  # somebody turned the coordinate not long before, and part of that remains
_STATE_SPREAD = 0.1  # of their size, as a standard deviation; freer ones explain a hand's push


class TustinNet(AccelerationModel):
    """A Tustin-Net: trapezoidal positions, and a network for the accelerations.

        q[k+1] = q[k] + dt (v[k] + v[k+1]) / 2
        v[k+1] = v[k] + dt f(cat(sin q[k], cos q[k], v[k], u[k]))

    `f` is a feedforward network with M hidden layers, here with its inputs and outputs scaled:
    `f(z) = a * (W_{M+1} sigma(W_M ... sigma(W_1 z + b_1) ... + b_M))`. Linear coordinates enter
    as they are instead of by sine and cosine.

    With memory, `f` also has internal states as inputs, which follow each velocity and relax:

        z[k+1] = exp(-dt/t) z[k] + t (1 - exp(-dt/t)) (v[k] + v[k+1]) / 2

    for each relaxation time t, exact for the mean velocity of the period. They act like the
    deflection of a Maxwell element, as in a cable, rubber or creeping friction. Before a record
    begins somebody may have turned a coordinate away from where it rests: their expected value is
    a share of that.

    Attributes:
        network: the network.
        channels: the coordinates, in the order of q, the inputs, in the order of u, the period.
        relaxation_times: t of the internal states [s]; each gives one a coordinate.
        taps: the samples of the inputs that the network takes, see `AccelerationModel`.
        remembered: the share of the way from `rest` that internal states begin with.
        rest: where the coordinates rest, (n_q,) [rad or m], with a share above 0; never trained.

    References:
        Pozzoli, Gallieri, Scattolini (2020), Tustin neural networks: a class of recurrent nets
        for adaptive MPC of mechanical systems, arXiv 1911.01310.
        van Esch, Bonassi, Schön, section 3.1.
    """

    network: Network
    channels: Channels = eqx.field(static=True)
    relaxation_times: tuple[float, ...] = eqx.field(static=True, default=())
    # a field in the place of a property of the base class
    taps: tuple[int, ...] = eqx.field(static=True, default=())  # pyright: ignore[reportIncompatibleMethodOverride]
    remembered: float = eqx.field(static=True, default=0.0)
    rest: Float[Array, " n_q"] | None = None

    def __check_init__(self) -> None:
        if not all(time > 0 for time in self.relaxation_times):
            raise InputError(
                "memory", f"relaxation times {self.relaxation_times} s", "times above 0 s"
            )
        deflected = self.remembered > 0
        if deflected != (self.rest is not None) or (deflected and not self.internal):
            raise InputError(
                "remembered",
                f"a share of {self.remembered:g} with memory of "
                f"{self.relaxation_times} s and rest {self.rest}",
                "memory and rest beside a share",
            )
        features = feature_count(
            self.channels, len(self.internal), len(self.taps) or 1, len(self.network.scaling.pairs)
        )
        self.network.require_shape(features, self.channels.n_q)

    @property
    def internal(self) -> tuple[str, ...]:
        """The names of the internal states: of each coordinate one for each relaxation time."""
        return tuple(
            f"{c.name}, relaxing in {time:g} s"
            for time in self.relaxation_times
            for c in self.coordinates
        )

    def initial_internal(
        self, measured: Float[Array, " n_measured"], u: InputVector | None = None
    ) -> Internal:
        """The expected internal states: a share of the way from rest, of angles the shorter."""
        if self.rest is None:
            return super().initial_internal(measured)
        away = measured[self.channels.position] - self.rest.astype(measured.dtype)
        wrapped = jnp.arctan2(jnp.sin(away), jnp.cos(away))
        deflection = jnp.where(self.channels.angular, wrapped, away)
        return jnp.tile(self.remembered * deflection, len(self.relaxation_times))

    @property
    def internal_spread(self) -> Internal:
        """The standard deviations of internal states: a tenth of their size in training."""
        return _STATE_SPREAD * self.network.scaling.memory

    # a property in the place of a field of the base class: nobody assigns it
    @property
    def scaling(self) -> Scaling:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The units of the network."""
        return self.network.scaling

    def with_zero_output(self) -> "TustinNet":
        """The model with an output layer of zeros."""
        return eqx.tree_at(lambda m: m.network, self, self.network.with_zero_output())

    def acceleration(self, x: State, u: StepInput) -> Coordinates:
        """`f`, the mean acceleration over the coming period, (n_q,) [rad/s^2 or m/s^2]."""
        output = self.network(self.channels, x, self.input_at_taps(u))
        return self.network.scaling.acceleration * output

    def accelerate(
        self, x: State, u: StepInput
    ) -> tuple[Coordinates, Callable[[Coordinates], Internal]]:
        """The acceleration, and how the internal states follow the mean velocity."""
        z = x[self.channels.internal]
        return self.acceleration(x, u), lambda mean: self.relax(z, mean)

    def relax(self, z: Internal, v: Coordinates) -> Internal:
        """The internal states after a period with the mean velocity `v`."""
        if not self.relaxation_times:
            return z
        times = self.relaxation_times
        time = np.repeat(np.asarray(times), len(v))
        decay = np.exp(-self.dt / time)
        speed = v[np.tile(np.arange(len(v)), len(times))]
        return jnp.asarray((decay * z + (time * (1 - decay)) * speed).astype(z.dtype))

    def simplify(self) -> "TustinNet":
        """The model with the stem merged into the first hidden layer; it computes the same."""
        if self.network.stem is None:
            return self
        return replace(self, network=self.network.simplify())


Times = Annotated[
    tuple[Annotated[float, Field(gt=0, le=LONGEST_TIME)], ...], Field(max_length=MOST_TIMES)
]  # of relaxation [s]


class TustinNetHyper(NetworkHyper):
    """The table `[model]` of a Tustin-Net.

    Attributes:
        memory: relaxation times of internal states [s], none by default (see `TustinNet`).
        remembered: the share of a coordinate's way from its usual position with which these begin
            a record; none for a half.
        input_taps: samples of the inputs that it takes in every period, as `[-1, 0, 1]`, counted
            from the period's beginning; those above 0 look ahead. None: the period's mean.
        linear: whether a linear map is added to the network: at first it is the least-squares map
            of the training records, and the output of the network 0.

    The other keys are those of the network.
    """

    memory: Times = ()
    remembered: float | None = Field(default=None, ge=0, le=1)
    input_taps: InputTaps = ()
    linear: bool = False

    @property
    def layers(self) -> dict[str, Any]:
        """The keys that `Layers` takes."""
        return {**super().layers, "linear": self.linear}

    @property
    def share(self) -> float:
        """The share of a coordinate's way from rest with which internal states begin."""
        if not self.memory:
            return 0.0
        return _USUAL_SHARE if self.remembered is None else self.remembered

    @model_validator(mode="after")
    def _check_memory(self) -> "TustinNetHyper":
        if self.memory and self.scaling not in ("records", "standard"):
            raise ValueError(f"the scaling '{self.scaling}' has none for `memory`")
        if self.remembered is not None and not self.memory:
            raise ValueError("`remembered` is of internal states: give `memory`, or leave it out")
        return self


class TustinNetEntries(NetworkEntries):
    """The layers and the memory of a Tustin-Net."""

    relaxation_times: Times
    input_taps: InputTaps
    remembered: float = Field(ge=0, le=1)


class TustinNetDescription(Description):
    """The header of a Tustin-Net."""

    structure: TustinNetEntries


class TustinNetFamily(NetworkFamily):
    """The family of Tustin-Nets."""

    kind = "tustin-net"
    title = "Tustin-Net"
    hyper = TustinNetHyper
    description = TustinNetDescription
    model = TustinNet

    def builder(
        self,
        hyper: TustinNetHyper,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], TustinNet]:
        """A function that makes random weights; units and rest positions come from the records."""
        channels = experiments[0].channels
        share, rest = hyper.share, None
        if share:
            usual = usual_positions(np.concatenate([e.q for e in experiments]), channels.angular)
            rest = jnp.asarray(usual, jnp.float32)
        learn = SCALINGS[hyper.scaling]
        scaling = learn(experiments, velocity, hyper.memory)

        def build(key: PRNGKeyArray) -> TustinNet:
            model = random_tustin_net(
                channels,
                scaling,
                key,
                relaxation_times=hyper.memory,
                taps=hyper.input_taps,
                **hyper.layers,
            )
            return replace(model, remembered=share, rest=rest)

        if not hyper.linear:
            return build
        linear = _fit_linear_map(build(jax.random.key(0)), experiments, velocity)
        return lambda key: eqx.tree_at(
            lambda m: m.network.bypass, build(key).with_zero_output(), linear
        )

    def network(self, model: TustinNet) -> Network:
        """The network of the model."""
        return model.network

    def describe(self, model: TustinNet) -> tuple[Header, Arrays]:
        """The structure of the network for the header; arrays by their places in it."""
        structure = describe_network(model.network)
        structure["relaxation_times"] = list(model.relaxation_times)
        structure["input_taps"] = list(model.taps)
        structure["remembered"] = model.remembered
        rest = {} if model.rest is None else {_REST: np.asarray(model.rest)}
        return {"structure": structure}, named_arrays(model.network) | rest

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> TustinNet:
        """The Tustin-Net of a file, from structure and arrays."""
        channels = Channels.from_header(header)
        structure = header["structure"]
        times, taps = (tuple(structure[key]) for key in ("relaxation_times", "input_taps"))
        memory = len(times) * channels.n_q
        network = restore_network(structure, arrays, channels, channels.n_q, memory)
        share = float(structure["remembered"])
        rest = restore_arrays(lambda: jnp.zeros(channels.n_q), arrays, _REST) if share else None
        return TustinNet(network, channels, times, taps, share, rest)

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """Layers, units and memory."""
        structure = header["structure"]
        lines = summarise_network(structure, arrays)
        if structure["relaxation_times"]:
            memory = "relaxing in " + ", ".join(f"{t:g} s" for t in structure["relaxation_times"])
            if structure["remembered"]:
                rest = ", ".join(f"{x:.3g}" for x in arrays[_REST])
                memory += f"; begins with {structure['remembered']:g} of the way from ({rest})"
            lines.append(("memory", memory))
        return lines


FAMILY = TustinNetFamily()


def random_tustin_net(
    channels: Channels,
    scaling: Scaling,
    key: PRNGKeyArray,
    *,
    relaxation_times: Sequence[float] = (),
    taps: Sequence[int] = (),
    **layers: Any,
) -> TustinNet:
    """A Tustin-Net with random float32 weights, uniform within 1/sqrt(n_in) of 0.

    Args:
        channels: its coordinates, inputs and period.
        scaling: units of the network's inputs and outputs.
        key: the source of randomness.
        relaxation_times: relaxation times of the internal states [s].
        taps: the samples of the inputs that it takes.
        layers: hidden, stem, activation and output_bias, see `Layers`.
    """
    memory, pairs = len(relaxation_times) * channels.n_q, len(scaling.pairs)
    features = feature_count(channels, memory, len(taps) or 1, pairs)
    network = random_network(scaling, key, features, channels.n_q, Layers(**layers))
    return TustinNet(network, channels, tuple(relaxation_times), tuple(taps))


def _fit_linear_map(
    model: TustinNet, experiments: Sequence[Experiment], velocity: VelocitySource
) -> Affine:
    """The least-squares affine map from features to the changes of velocities along records."""
    channels, network = model.channels, model.network
    states = states_along(model, experiments, velocity)
    drives = [np.asarray(input_signal(model, e).u) for e in experiments]

    def compute_features(x: State, u: StepInput) -> Array:
        features, u = network.scaling.features, model.input_at_taps(u)
        if not network.odd:
            return features(channels, x, u)
        return (features(channels, x, u) - features(channels, -x, -u)) / 2

    features = np.concatenate(
        [
            np.asarray(jax.vmap(compute_features)(jnp.asarray(x[:-1]), jnp.asarray(u)))
            for x, u in zip(states, drives, strict=True)
        ]
    )
    change = np.concatenate([np.diff(x[:, channels.velocity], axis=0) for x in states])
    target = change / channels.dt / np.asarray(network.scaling.acceleration)
    constant = np.full(len(features), 0.0 if network.odd else 1.0)
    solution = np.linalg.lstsq(np.column_stack([features, constant]), target, rcond=None)[0]
    weight, bias = (jnp.asarray(a, jnp.float32) for a in (solution[:-1].T, solution[-1]))
    return Affine(weight, bias)
