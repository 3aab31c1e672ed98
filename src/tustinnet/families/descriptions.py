"""Descriptions of models in the headers of model files, checked before they are used."""

from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, Field, model_validator

from tustinnet.channels import (
    LONGEST_DT,
    SAME_PERIOD,
    SHORTEST_DT,
    Channels,
    Coordinate,
    Input,
    PDController,
)
from tustinnet.data.declaration import Declaration, declare
from tustinnet.errors import InputError
from tustinnet.registry import FAMILIES


class Entries(Declaration):
    """A table in a header: JSON types as they are, never converted; further keys are allowed."""

    model_config = ConfigDict(extra="allow", strict=True)


class Description(Entries):
    """Kind and channels of a model, or of a part of one; families add keys of their own."""

    kind: str
    coordinates: list[Coordinate] = Field(min_length=1)
    inputs: list[Input]
    dt: float = Field(ge=SHORTEST_DT, le=LONGEST_DT)
    controller: PDController | None = None

    @model_validator(mode="after")
    def _check_channels(self) -> "Description":
        Channels(tuple(self.coordinates), tuple(self.inputs), self.dt)
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


def check_description(header: Mapping[str, Any], where: object) -> None:
    """Raises unless a description of a model, and those of its parts, are as families write them.

    Args:
        header: the description.
        where: the file, and the place of a part in it.

    Raises:
        InputError: an unknown kind, an entry that is missing or of another type or size, a part
            with other channels than the whole.
    """
    kind: Any = header.get("kind")
    if kind not in FAMILIES:
        raise InputError(f"{where}, kind", f"{kind!r}", f"one of {', '.join(FAMILIES.names())}")
    family = FAMILIES[kind]
    declare(dict(header), family.description, where, strict=True)
    for name, part in family.parts(header).items():
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
    return abs(first / second - 1) <= SAME_PERIOD
