"""Feedforward networks in models: their recipe keys and their place in files, for all families."""

from abc import abstractmethod
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import PyTree
from pydantic import AfterValidator, Field, field_validator, model_validator

from tustinnet.channels import Channels
from tustinnet.families.descriptions import Entries
from tustinnet.families.family import (
    Arrays,
    Hyper,
    LayeredStage,
    Lines,
    TrainedFamily,
    make_mask,
    restore_arrays,
)
from tustinnet.models.blocks import Layers, Network, Scaling, feature_count, random_network
from tustinnet.models.sizes import FARTHEST_TAP, MOST_LAYERS, MOST_TAPS, MOST_UNITS
from tustinnet.registry import SCALINGS


def _check_taps(taps: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(taps)) < len(taps):
        raise ValueError(f"a tap twice: {list(taps)}")
    return taps


Units = Annotated[int, Field(gt=0, le=MOST_UNITS)]
Hidden = Annotated[tuple[Units, ...], Field(min_length=1, max_length=MOST_LAYERS)]
Activation = Literal["leaky_relu", "relu", "tanh", "silu", "softplus"]
Tap = Annotated[int, Field(ge=-FARTHEST_TAP, le=FARTHEST_TAP)]
InputTaps = Annotated[tuple[Tap, ...], Field(max_length=MOST_TAPS), AfterValidator(_check_taps)]


class NetworkHyper(Hyper):
    """The table `[model]` of kinds with a feedforward network.

    Attributes:
        hidden: units of each hidden layer.
        stem: units of an affine layer before them, trained unfolded, or none.
        activation: leaky_relu, relu, tanh, silu or softplus.
        output_bias: whether the output layer has a bias.
        odd: whether its output changes its sign with positions, velocities and inputs: for
            mechanisms that are the same to both sides of zero.
        scaling: a name of the registry; `records` learns all units from the training records,
            `standard` also centres and scales sines and cosines of angles and adds differences of
            coordinates that move together.
    """

    hidden: Hidden = (100, 100)
    stem: Units | None = None
    activation: Activation = "leaky_relu"
    output_bias: bool = False
    odd: bool = False
    scaling: str = "records"

    @field_validator("scaling")
    @classmethod
    def _check_scaling(cls, scaling: str) -> str:
        if scaling not in SCALINGS:
            raise ValueError(f"no scaling '{scaling}'; known: {', '.join(SCALINGS.names())}")
        return scaling

    @model_validator(mode="after")
    def _check_bias(self) -> "NetworkHyper":
        if self.odd and self.output_bias:
            raise ValueError("an odd network has no `output_bias`: leave one out")
        return self

    @property
    def layers(self) -> dict[str, Any]:
        """The keys that `Layers` takes."""
        return self.model_dump(include={"hidden", "stem", "activation", "output_bias", "odd"})


class NetworkEntries(Entries):
    """The layers of a network in a header, as `describe_network` writes them."""

    hidden: Hidden
    stem: Units | None
    activation: Activation
    output_bias: bool
    linear: bool
    odd: bool
    centred_angles: bool
    pairs: list[tuple[int, int]]


def describe_network(network: Network) -> dict[str, Any]:
    """The entries of a model file's header on a network."""
    return {
        "hidden": [layer.weight.shape[0] for layer in network.hidden],
        "stem": None if network.stem is None else network.stem.weight.shape[0],
        "activation": network.activation,
        "output_bias": network.output.bias is not None,
        "linear": network.bypass is not None,
        "odd": network.odd,
        "centred_angles": len(network.scaling.angle_scale) > 0,
        "pairs": [list(pair) for pair in network.scaling.pairs],
    }


def restore_network(
    structure: dict[str, Any], arrays: Arrays, channels: Channels, outputs: int, memory: int = 0
) -> Network:
    """The network of a model file."""
    taps = len(structure.get("input_taps", ())) or 1
    centred = structure["centred_angles"]
    pairs = tuple((i, j) for i, j in structure["pairs"])
    features = feature_count(channels, memory, taps, len(pairs))
    keys = ("hidden", "stem", "activation", "output_bias", "linear", "odd")
    layers = Layers(**{key: structure[key] for key in keys})

    def make() -> Network:
        scaling = blank_scaling(channels, memory, centred, pairs)
        return random_network(scaling, jax.random.key(0), features, outputs, layers)

    return restore_arrays(make, arrays)


def blank_scaling(
    channels: Channels,
    memory: int = 0,
    centred: bool = False,
    pairs: tuple[tuple[int, int], ...] = (),
) -> Scaling:
    """Units of the right sizes, all 0, for the arrays of a file to be put into."""
    angular = int(channels.angular.sum())
    linear = channels.n_q - angular
    sizes = (
        linear,
        linear,
        channels.n_q,
        channels.n_u,
        channels.n_q,
        memory,
        2 * angular * centred,
        angular * centred,
        2 * len(pairs),
    )
    return Scaling(*(jnp.zeros(n, jnp.float32) for n in sizes), pairs=pairs)


def summarise_network(structure: dict[str, Any], arrays: Arrays) -> Lines:
    """Layers and units of a network."""
    bias = "with" if structure["output_bias"] else "without"
    layers = f"hidden {structure['hidden']}, {structure['activation']}, output {bias} bias"
    if structure["linear"]:
        layers += ", beside a linear map"
    if structure["odd"]:
        layers += ", odd"
    return [("network", layers), summarise_units(arrays)]


def summarise_units(arrays: Arrays) -> tuple[str, str]:
    """The units of a network."""
    names = ("position_offset", "position_scale", "velocity", "input", "acceleration")
    units = [f"{n} {[float(f'{v:.4g}') for v in arrays[f'scaling.{n}']]}" for n in names]
    return "scaling", ", ".join(units)


class NetworkFamily(TrainedFamily):
    """A kind of model with a feedforward network, whose hidden layers may be frozen."""

    stage = LayeredStage

    @abstractmethod
    def network(self, model: Any) -> Network:
        """The network of a model."""

    def check(self, hyper: NetworkHyper, stage: Any) -> None:
        """Checks that frozen layers exist, and that windows of an odd network are not mirrored."""
        if not 0 <= stage.frozen_layers <= len(hyper.hidden):
            raise ValueError(f"freezes {stage.frozen_layers} of {len(hyper.hidden)} hidden layers")
        if hyper.odd and stage.mirror:
            raise ValueError(
                "`mirror` does to the windows what `odd` does to the network: leave one out"
            )

    def trainable_mask(self, model: Any, stage: LayeredStage) -> PyTree:
        """A tree like the model, True at the layers that are not frozen."""
        return make_mask(model, self.network(model).trainable_layers(stage.frozen_layers))
