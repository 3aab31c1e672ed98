"""Proposed records: inputs and releases that could be recorded next, in a TOML file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from tustinnet.channels import Channels
from tustinnet.data.declaration import Declaration, Name, Text, read_declaration
from tustinnet.data.quantities import ValueReader
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError

_FARTHEST_START = 1e6  # rad or m, or over s
MOST_SAMPLES = 10**6  # samples
_RATE = "_dot"  # ending of the name of a velocity, as in files of simulations


@dataclass(frozen=True)
class Proposal:
    """A record that could be made.

    Attributes:
        name: name of the record.
        q: positions at its beginning, (n_q,) [rad or m].
        v: velocities there, (n_q,).
        u: inputs, a row a sample, (n, n_u).
        groups: conditions of the record, as `{"payload": "1kg"}`.
    """

    name: str
    q: Float[np.ndarray, " n_q"]
    v: Float[np.ndarray, " n_q"]
    u: Float[np.ndarray, "n n_u"]
    groups: Mapping[str, str] = field(default_factory=dict)


class _ProposalTable(Declaration):
    """A proposal as it stands in the file.

    Attributes:
        name: name of the record.
        start: positions by the names of coordinates, velocities by `NAME_dot`; numbers in the unit
            of the data card's column, or texts with a unit, as `"60deg"`; 0 for the others.
        seconds: duration of a record without inputs.
        inputs: or a file of inputs, a column each with its name, a row a sample.
        groups: conditions of the record, as `{ payload = "1kg" }`.
    """

    name: Name
    start: dict[str, float | Text] = Field(default_factory=dict)
    seconds: float | None = Field(default=None, gt=0, le=1e5)
    inputs: Text | None = None
    groups: dict[Name, Name] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_inputs(self) -> "_ProposalTable":
        if (self.seconds is None) == (self.inputs is None):
            raise ValueError("either `seconds`, without inputs, or `inputs`, a file of them")
        return self


class _ProposalFile(Declaration):
    """A file of proposals."""

    proposals: list[_ProposalTable] = Field(min_length=1, max_length=1000)


def read_proposals(path: Path, channels: Channels, values: ValueReader) -> list[Proposal]:
    """The proposals of a TOML file.

    Args:
        path: the file; files of inputs lie beside it or below.
        channels: channels of the model that simulates them.
        values: reads the values of starts.

    Raises:
        InputError: an unknown key, coordinate or input, a missing input, two of one name.
    """
    proposals: list[Proposal] = []
    coordinates = [c.name for c in channels.coordinates]
    keys = [*coordinates, *(name + _RATE for name in coordinates)]
    for table in read_declaration(path, _ProposalFile).proposals:
        where = f"{path}, proposal '{table.name}'"
        if unknown := sorted(table.start.keys() - set(keys)):
            raise InputError(
                f"{where}, start",
                f"no coordinate '{unknown[0]}'",
                f"some of {', '.join(keys)}, as in the model",
            )
        start = values.read(f"{where}, start", table.start)
        if not all(abs(value) <= _FARTHEST_START for (value,) in start.values()):
            raise InputError(
                f"{where}, start", "out of range", f"at most {_FARTHEST_START:g} rad or m"
            )
        q, v = (
            np.array([start.get(name + end, (0.0,))[0] for name in coordinates])
            for end in ("", _RATE)
        )
        u = _inputs(table, where, path.parent, channels)
        proposals.append(Proposal(table.name, q, v, u, table.groups))
    names = [p.name for p in proposals]
    if duplicates := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(path, f"two proposals '{duplicates[0]}'", "different names")
    return proposals


def _inputs(table: _ProposalTable, where: str, folder: Path, channels: Channels) -> np.ndarray:
    """The inputs of a proposal, (n, n_u): zeros over its duration, or those of its file."""
    names = [i.name for i in channels.inputs]
    if table.inputs is None:
        assert table.seconds is not None
        samples = max(2, round(table.seconds / channels.dt) + 1)
        if samples > MOST_SAMPLES:
            raise InputError(
                where, f"{samples} samples", f"at most {MOST_SAMPLES}", "fewer seconds"
            )
        return np.zeros((samples, len(names)))
    if PurePath(table.inputs).is_absolute() or ".." in PurePath(table.inputs).parts:
        raise InputError(f"{where}, inputs", f"'{table.inputs}'", "a file beside this one or below")
    columns = read_columns(folder / table.inputs, header=True)
    named = [n for n in columns.names if n in names or n.lower() not in ("time", "t")]
    if sorted(named) != sorted(names):
        raise InputError(
            f"{where}, {table.inputs}",
            f"columns {', '.join(columns.names)}",
            f"the model's inputs: {', '.join(names) or 'none'}, and perhaps time",
        )
    columns.fetch(names)
    u = np.stack([np.asarray(columns[name], float) for name in names], axis=1)
    if len(u) < 2 or not np.isfinite(u).all():
        raise InputError(
            f"{where}, {table.inputs}",
            "fewer than 2 samples, or not finite",
            "finite inputs, a row a sample",
        )
    return u
