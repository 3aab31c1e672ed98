"""Descriptions of models in the headers of model files: their keys, checked before they are used.

A class for each kind, named in the registry (`DESCRIPTIONS`). No JAX is loaded for them.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from tustinnet.channels import LONGEST_DT, SHORTEST_DT, Channels, Coordinate, Input, PDController
from tustinnet.data.declaration import Declaration, declare
from tustinnet.errors import InputError
from tustinnet.families.summaries import CORRECTION, MEMBERS, PHYSICS
from tustinnet.models.sizes import (
    FARTHEST_TAP,
    LONGEST_TIME,
    LONGEST_WARM_UP,
    MOST_LAYERS,
    MOST_MEMBERS,
    MOST_STATES,
    MOST_SUBSTEPS,
    MOST_TAPS,
    MOST_TIMES,
    MOST_UNITS,
    MOST_UNROLLED,
)
from tustinnet.registry import DESCRIPTIONS, FAMILIES

_SAME_PERIOD = 1e-6  # relative; periods of parts this near are one

Units = Annotated[int, Field(gt=0, le=MOST_UNITS)]
Seconds = Annotated[float, Field(gt=0, le=LONGEST_TIME)]


def check_taps(taps: Sequence[int]) -> Sequence[int]:
    """The taps, all different."""
    if len(set(taps)) < len(taps):
        raise ValueError(f"a tap twice: {list(taps)}")
    return taps


Tap = Annotated[int, Field(ge=-FARTHEST_TAP, le=FARTHEST_TAP)]
Taps = Annotated[list[Tap], Field(max_length=MOST_TAPS), AfterValidator(check_taps)]


class Entries(Declaration):
    """A table in a header: JSON types as they are, never converted; further keys are allowed."""

    model_config = ConfigDict(extra="allow", strict=True)


class Description(Entries):
    """Kind and channels of a model, or of a part of one; the rest belongs to its family."""

    kind: str
    coordinates: tuple[Coordinate, ...] = Field(min_length=1)
    inputs: tuple[Input, ...]
    dt: float = Field(ge=SHORTEST_DT, le=LONGEST_DT)
    controller: PDController | None = None

    @model_validator(mode="after")
    def _check_channels(self) -> "Description":
        Channels(self.coordinates, self.inputs, self.dt)
        if self.controller is not None:
            self.controller.require_loops(self.coordinates, "controller")
            names = [i.name for i in self.inputs]
            computed = {loop.input for loop in self.controller.loops}
            others = [i.name for i in self.controller.inputs if i.name not in computed]
            points = [name for loop in self.controller.loops for name in loop.set_points]
            for name in (*points, *others):
                if name not in names:
                    raise ValueError(f"no input '{name}', which the controller requires")
        return self

    def parts(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """The descriptions of other models in this one, by their places."""
        yield from ()


class NetworkEntries(Entries):
    """The layers of a network."""

    hidden: list[Units] = Field(min_length=1, max_length=MOST_LAYERS)
    stem: Units | None
    activation: Literal["leaky_relu", "relu", "tanh", "silu", "softplus"]
    output_bias: bool
    linear: bool
    odd: bool
    centred_angles: bool
    pairs: list[tuple[int, int]]


class TustinNetEntries(NetworkEntries):
    """The layers and the memory of a Tustin-Net."""

    relaxation_times: list[Seconds] = Field(max_length=MOST_TIMES)
    input_taps: Taps
    remembered: float = Field(ge=0, le=1)


class TustinNetDescription(Description):
    """A Tustin-Net."""

    structure: TustinNetEntries


class NeuralODEDescription(Description):
    """A neural ODE."""

    structure: NetworkEntries
    substeps: int = Field(gt=0, le=MOST_UNROLLED)


class GRUEntries(Entries):
    """The sizes of a GRU."""

    hidden: Units
    warm_up: int = Field(ge=0, le=LONGEST_WARM_UP)
    input_taps: Taps


class GRUDescription(Description):
    """A gated recurrent unit."""

    structure: GRUEntries


class LinearEntries(Entries):
    """The size of a linear model."""

    internal: int = Field(ge=0, le=MOST_STATES)


class LinearDescription(Description):
    """A linear state-space model."""

    structure: LinearEntries


class SystemEntries(Entries):
    """The system of a grey box: its name, and the name of the file that defines it."""

    name: str
    file: str


# the first fields of `Parameter`
ParameterRow = tuple[str, str, float, float, float, bool]
RowWithPrior = tuple[str, str, float, float, float, bool, float]


class EulerLagrangeDescription(Description):
    """A grey box: the names of its parameters, and what was added to its system."""

    system: SystemEntries
    parameters: list[str]
    substeps: int = Field(gt=0, le=MOST_SUBSTEPS)
    terms: list[ParameterRow] = Field(default_factory=list)
    forces: list[str] = Field(default_factory=list)
    of_forces: list[ParameterRow | RowWithPrior] = Field(default_factory=list)
    sensors: list[ParameterRow] = Field(default_factory=list)
    gains: list[ParameterRow] = Field(default_factory=list)
    per: dict[str, str] = Field(default_factory=dict)
    groups: dict[str, list[str]] = Field(default_factory=dict)


class HybridDescription(Description):
    """A hybrid."""

    fades_at_rest: bool
    physics: dict[str, Any]
    correction: dict[str, Any]

    def parts(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """Physics and correction."""
        yield from ((PHYSICS, self.physics), (CORRECTION, self.correction))


class MemberEntries(Entries):
    """The weight of a member of a committee; its description is checked as a part."""

    weight: float = Field(ge=0, le=1)


class CommitteeDescription(Description):
    """A committee."""

    members: list[MemberEntries] = Field(min_length=1, max_length=MOST_MEMBERS)

    def parts(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """The members."""
        for i, member in enumerate(self.members):
            yield f"{MEMBERS}.{i}", member.model_dump(exclude={"weight"})


def check_description(header: Mapping[str, Any], where: object) -> None:
    """Raises unless a description of a model, and those of its parts, are as families write them.

    Args:
        header: the description.
        where: the file, and the place of a part in it.

    Raises:
        InputError: an unknown kind, an entry that is missing or of another type or size, a part
            with other channels than the whole.
    """
    kind = header.get("kind")
    if kind not in FAMILIES:
        raise InputError(f"{where}, kind", f"{kind!r}", f"one of {', '.join(FAMILIES.names())}")
    schema = DESCRIPTIONS[kind] if kind in DESCRIPTIONS.names() else Description
    description: Description = declare(dict(header), schema, where, strict=True)
    for name, part in description.parts():
        check_description(part, f"{where}, {name}")
        if _channels(part) != _channels(header) or not _is_same_period(part["dt"], header["dt"]):
            raise InputError(
                f"{where}, {name}",
                "other channels or another period than the whole model",
                "the same ones",
            )


def _channels(header: Mapping[str, Any]) -> list[tuple[str, str | None]]:
    """Names and kinds of the channels of a description."""
    return [(c["name"], c.get("kind")) for c in (*header["coordinates"], *header["inputs"])]


def _is_same_period(first: float, second: float) -> bool:
    return abs(first / second - 1) <= _SAME_PERIOD
