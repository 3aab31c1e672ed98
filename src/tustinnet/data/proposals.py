"""Proposed records: inputs and releases that somebody could make next, in a TOML file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from tustinnet.channels import Channels
from tustinnet.data.declaration import Declaration, Name, Text, read_declaration
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError

_FAR = 1e6  # rad or m, or over s
_LONGEST = 1e5  # s
_MOST = 10**6  # samples
_RATE = "_dot"  # what the name of a velocity ends with, as in simulations that are written


@dataclass(frozen=True)
class Proposal:
    """A record that could be made.

    Attributes:
        name: what it is called.
        q: positions at its beginning, (n_q,) [rad or m].
        v: velocities there, (n_q,).
        u: inputs, a row a sample, (n, n_u).
        groups: what it would be made with, as `{"payload": "1kg"}`.
    """

    name: str
    q: Float[np.ndarray, " n_q"]
    v: Float[np.ndarray, " n_q"]
    u: Float[np.ndarray, "n n_u"]
    groups: Mapping[str, str] = field(default_factory=dict)


class _Declared(Declaration):
    """A proposal as the file has it.

    Attributes:
        name: what it is called.
        start: positions by the names of coordinates [rad or m], velocities by `NAME_dot`; 0 for
            those not given.
        seconds: how long it takes, without inputs.
        inputs: or a file of inputs, a column each with its name, a row a sample.
        groups: what it would be made with, as `{ payload = "1kg" }`.
    """

    name: Name
    start: dict[str, Annotated[float, Field(ge=-_FAR, le=_FAR)]] = Field(default_factory=dict)
    seconds: float | None = Field(default=None, gt=0, le=_LONGEST)
    inputs: Text | None = None
    groups: dict[Name, Name] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_way(self) -> "_Declared":
        if (self.seconds is None) == (self.inputs is None):
            raise ValueError("either `seconds`, without inputs, or `inputs`, a file of them")
        return self


class _File(Declaration):
    """A file of proposals."""

    proposals: list[_Declared] = Field(min_length=1, max_length=1000)


def read_proposals(path: Path, channels: Channels) -> list[Proposal]:
    """The proposals of a TOML file.

    Args:
        path: the file; files of inputs lie beside it or below.
        channels: of the model that is to simulate them.

    Raises:
        InputError: an unknown key, coordinate or input, a missing input, two of one name.
    """
    found = [_read(of, path, channels) for of in read_declaration(path, _File).proposals]
    names = [of.name for of in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(path, f"two proposals '{twice[0]}'", "different names")
    return found


def _read(of: _Declared, path: Path, channels: Channels) -> Proposal:
    where = f"{path}, proposal '{of.name}'"
    names = [c.name for c in channels.coordinates]
    known = [*names, *(name + _RATE for name in names)]
    if unknown := sorted(of.start.keys() - set(known)):
        raise InputError(f"{where}, start", f"no coordinate '{unknown[0]}'",
                         f"some of {', '.join(known)}, as in the model")  # fmt: skip
    q, v = (np.array([of.start.get(n + more, 0.0) for n in names]) for more in ("", _RATE))
    return Proposal(of.name, q, v, _inputs(of, where, path.parent, channels), of.groups)


def _inputs(of: _Declared, where: str, folder: Path, channels: Channels) -> np.ndarray:
    wanted = [i.name for i in channels.inputs]
    if of.inputs is None:
        assert of.seconds is not None
        samples = max(2, round(of.seconds / channels.dt) + 1)
        if samples > _MOST:
            raise InputError(where, f"{samples} samples", f"at most {_MOST}", "fewer seconds")
        return np.zeros((samples, len(wanted)))
    if PurePath(of.inputs).is_absolute() or ".." in PurePath(of.inputs).parts:
        raise InputError(f"{where}, inputs", f"'{of.inputs}'", "a file beside this one or below")
    columns = read_columns(folder / of.inputs, header=True)
    if missing := [name for name in wanted if name not in columns.names]:
        raise InputError(
            f"{where}, {of.inputs}", f"no column '{missing[0]}', only {', '.join(columns.names)}",
            f"the model's inputs: {', '.join(wanted) or 'none'}",
        )  # fmt: skip
    others = [n for n in columns.names if n not in wanted and n.lower() not in ("time", "t")]
    if others:
        raise InputError(
            f"{where}, {of.inputs}", f"a column '{others[0]}', which is no input of the model",
            f"{', '.join(wanted) or 'none'}, and perhaps time", "leave it out",
        )  # fmt: skip
    columns.fetch(wanted)
    u = np.stack([np.asarray(columns[name], float) for name in wanted], axis=1)
    if len(u) < 2 or not np.isfinite(u).all():
        raise InputError(f"{where}, {of.inputs}", "fewer than 2 samples, or not finite",
                         "finite inputs, a row a sample")  # fmt: skip
    return u
