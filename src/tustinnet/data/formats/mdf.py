"""MDF files of measurement systems, versions 3 and 4: groups of channels, as `CAN1/speed`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tustinnet.data.formats.reader import REAL, Array, Contents, Reader
from tustinnet.errors import InputError

_NUMBERS = range(6)  # types of channels that are integers or floating point numbers


def _contents(path: Path) -> Contents:
    arrays, others, clocks, units = [], {}, {}, {}
    with _open(path) as file:
        for number, name in enumerate(_group_names(file)):
            group = file.groups[number]
            length = int(group.channel_group.cycles_nr)
            master = file.masters_db.get(number)
            clock = "" if master is None else f"{name}/time"
            if length < 2:
                others[name] = f"a group of {length} samples"
                continue
            if clock:
                arrays.append((clock, (length,)))
                clocks[clock], units[clock] = clock, "s"
            for index, channel in enumerate(group.channels):
                place = _place(name, group, index)
                if index == master:
                    continue
                if channel.data_type not in _NUMBERS:
                    others[place] = "text or bytes"
                    continue
                arrays.append((place, (length,)))
                units[place] = _unit(channel)
                if clock:
                    clocks[place] = clock
    return Contents(arrays, others, clocks, units)


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    arrays: dict[str, Array] = {}
    with _open(path) as file:
        for number, name in enumerate(_group_names(file)):
            group = file.groups[number]
            if f"{name}/time" in names:
                arrays[f"{name}/time"] = file.get_master(number)
            for index in range(len(group.channels)):
                place = _place(name, group, index)
                if place in names and place not in arrays:
                    arrays[place] = _samples(path, place, file, number, index)
    return arrays


def _samples(path: Path, place: str, file: Any, group: int, index: int) -> Array:
    """The samples of a channel; those marked as invalid are NaN."""
    signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
    if signal.samples.dtype.kind not in REAL:  # states that have names
        signal = file.get(group=group, index=index, raw=True, ignore_invalidation_bits=True)
    samples = signal.samples
    if samples.ndim != 1:
        raise InputError(f"{path}, {place}", f"arrays of shape {samples.shape[1:]}", "numbers")
    if signal.invalidation_bits is not None and np.any(signal.invalidation_bits):
        samples = np.where(np.asarray(signal.invalidation_bits), np.nan, samples.astype(float))
    return samples


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    from asammdf import MDF

    with path.open("rb") as stream:
        is_finished = stream.read(8).rstrip() == b"MDF"  # else "UnFinMF"
    if not is_finished:
        raise InputError(
            path, "no MDF file, or one whose recording was cut short", "a whole MDF file"
        )
    with MDF(path) as file:
        yield file


def _group_names(file: Any) -> list[str]:
    """Names of the groups: that of the acquisition, a number where it has none or not its own."""
    names: list[str] = []
    for number, group in enumerate(file.groups):
        name = getattr(group.channel_group, "acq_name", "") or f"group {number + 1}"
        names.append(name if name not in names else f"{name}[{number + 1}]")
    return names


def _place(group_name: str, group: Any, index: int) -> str:
    """The name of a channel; further ones of a name in a group are numbered."""
    name = group.channels[index].name
    earlier = sum(channel.name == name for channel in group.channels[:index])
    return f"{group_name}/{name}" + (f"[{earlier + 1}]" if earlier else "")


def _unit(channel: Any) -> str:
    unit = getattr(channel, "unit", "") or getattr(channel.conversion, "unit", "")
    return unit.decode("latin1").strip("\0 ") if isinstance(unit, bytes) else str(unit or "")


READER = Reader("asammdf", _contents, _arrays, "mdf")
