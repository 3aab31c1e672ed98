"""MDF files of measurement systems, versions 3 and 4: groups of channels, as `CAN1/speed`.

asammdf evaluates conversions from raw numbers that are formulas as Python code. It opens the file
without any, and without files beside this one that attachments name; it is given those that are no
formulas with the numbers themselves (ASAM MDF 4.1, section 6.17).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.formats.reader import REAL, Array, Contents, Reader
from tustinnet.errors import InputError

# types of channels that are integers or floating point numbers, by the version of the format
_NUMBERS = {3: {*range(4), *range(9, 17)}, 4: {*range(6)}}
_HAS_INVALIDATION = 2  # a flag of channels
# types of conversions by that version: none, lines, fractions, tables, names of values and ranges
_CONVERSIONS = {3: {0, 1, 2, 9, 11, 12, 65535}, 4: {0, 1, 2, 4, 5, 7, 8}}
_FORMULA = {3: 10, 4: 3}
_MOST_CONVERSIONS = 8  # that refer to others


class _Channel(NamedTuple):
    """A channel: its name, its place in the file, and what asammdf does not get to see.

    Attributes:
        name: its name, with that of its group.
        group: number of its group.
        group_name: name of its group.
        number: its number in the group.
        block: what the file says of it.
        conversion: how its numbers follow from raw ones, None for raw ones.
        is_master: whether it is the times of its group.
    """

    name: str
    group: int
    group_name: str
    number: int
    block: Any
    conversion: Any
    is_master: bool


class _File(NamedTuple):
    """A file that is open, its version (3, also for 2, or 4) and its channels."""

    mdf: Any
    version: int
    channels: list[_Channel]


def _contents(path: Path) -> Contents:
    arrays, others, clocks, units = [], {}, {}, {}
    with _open(path) as file:
        masters = {c.group: c for c in file.channels if c.is_master}
        for channel in file.channels:
            group = file.mdf.groups[channel.group]
            length = int(group.channel_group.cycles_nr)
            if length < 2:
                others[channel.group_name] = f"a group of {length} samples"
                continue
            if channel.block.data_type not in _NUMBERS[file.version]:
                reason = "text or bytes"
            elif (group.channel_dependencies or [None])[channel.number] is not None:
                reason = "an array or a structure"
            else:
                reason = _reason_to_refuse(channel.conversion, file.version)
            if reason:
                others[channel.name] = reason
                continue
            arrays.append((channel.name, (length,)))
            units[channel.name] = "s" if channel.is_master else _unit(channel)
            if channel.group in masters:
                clocks[channel.name] = masters[channel.group].name
    listed = {name for name, _ in arrays}
    return Contents(arrays, others, {c: t for c, t in clocks.items() if t in listed}, units)


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    with _open(path) as file:
        return {c.name: _samples(path, file, c) for c in file.channels if c.name in names}


def _samples(path: Path, file: _File, channel: _Channel) -> Array:
    """The samples of a channel; those marked as invalid are NaN."""
    samples, invalid = file.mdf.get(
        group=channel.group,
        index=channel.number,
        raw=True,
        samples_only=True,
        ignore_invalidation_bits=True,
    )
    if samples.ndim != 1 or samples.dtype.kind not in REAL:
        raise InputError(
            f"{path}, {channel.name}", f"arrays of shape {samples.shape[1:]}", "numbers"
        )
    samples = _convert(channel.conversion, samples)
    if invalid is not None and np.any(invalid):
        samples = np.where(np.asarray(invalid), np.nan, samples.astype(float))
    return samples


def _reason_to_refuse(conversion: Any, version: int, depth: int = 0) -> str:
    """The reason why a conversion, which so many refer to, is not applied; empty where it is."""
    if conversion is None:
        return ""
    if depth > _MOST_CONVERSIONS:
        return f"converted by more than {_MOST_CONVERSIONS} conversions that refer to one another"
    kind = conversion.conversion_type
    if kind == _FORMULA[version]:
        return "converted by a formula, which is not evaluated"
    if kind not in _CONVERSIONS[version]:
        return f"converted by a rule of type {kind}, which is not known here"
    inner = (_reason_to_refuse(c, version, depth + 1) for c in _referenced(conversion))
    return next(filter(None, inner), "")


def _convert(conversion: Any, raw: Array) -> Array:
    """Numbers from raw ones, (n,).

    A name of a value says nothing of its number: values that have one stay raw, but where the
    others are converted; there they are no numbers, as "sensor not available" is none.
    """
    if conversion is None:
        return raw
    are_names = not _referenced(conversion)
    values = conversion.convert(raw, ignore_value2text_conversions=are_names)
    return values if values.dtype.kind in REAL else np.full(len(raw), np.nan)  # all have names


def _referenced(conversion: Any) -> list[Any]:
    """The conversions to which one refers; texts have no formula, not even an empty one."""
    blocks = getattr(conversion, "referenced_blocks", None) or {}
    return [block for block in blocks.values() if hasattr(block, "formula")]


@contextmanager
def _open(path: Path) -> Iterator[_File]:
    from asammdf import MDF

    with path.open("rb") as stream:
        is_finished = stream.read(8).rstrip() == b"MDF"  # else "UnFinMF"
        stream.seek(60)
        is_finished &= stream.read(4) == bytes(4)  # what is to be repaired; reserved before 4.0
    if not is_finished:
        raise InputError(
            path, "no MDF file, or one whose recording was cut short", "a whole MDF file"
        )
    # buses are decoded by conversions, and by data bases that the file names
    options: Any = {"process_bus_logging": False}
    with MDF(path, **options) as mdf:
        version = 4 if mdf.version >= "4" else 3
        yield _File(mdf, version, list(_take_channels(path, mdf, version)))


def _take_channels(path: Path, mdf: Any, version: int) -> Iterator[_Channel]:
    """The channels of a file, their conversions and attachments taken from them.

    Raises:
        InputError: one that is not inside of its record, of which the library reads other memory.
    """
    for number, (name, group) in enumerate(zip(_group_names(mdf), mdf.groups, strict=True)):
        master = mdf.masters_db.get(number)
        for index, block in enumerate(group.channels):
            is_master = index == master
            place = _place(name, group, index, is_master=is_master)
            _require_inside_record(path, place, group.channel_group, block, version)
            conversion, block.conversion = block.conversion, None
            if version == 4:
                block.attachment = None
            yield _Channel(place, number, name, index, block, conversion, is_master)


def _require_inside_record(path: Path, place: str, group: Any, block: Any, version: int) -> None:
    if version == 4:
        first = 8 * block.byte_offset + block.bit_offset
        has_bit = block.flags & _HAS_INVALIDATION
        is_inside = not has_bit or block.pos_invalidation_bit < 8 * group.invalidation_bytes_nr
    else:
        first = block.start_offset + 8 * getattr(block, "additional_byte_offset", 0)
        is_inside = True
    if not is_inside or first + block.bit_count > 8 * group.samples_byte_nr:
        raise InputError(f"{path}, {place}", "outside of its record", "a whole MDF file")


def _group_names(file: Any) -> list[str]:
    """Names of the groups: that of the acquisition, a number where it has none or not its own."""
    names: list[str] = []
    for number, group in enumerate(file.groups):
        name = getattr(group.channel_group, "acq_name", "") or f"group {number + 1}"
        names.append(name if name not in names else f"{name}[{number + 1}]")
    return names


def _place(group_name: str, group: Any, index: int, *, is_master: bool) -> str:
    """The name of a channel; further ones of a name in a group are numbered."""
    name = "time" if is_master else group.channels[index].name
    earlier = sum(channel.name == name for channel in group.channels[:index])
    return f"{group_name}/{name}" + (f"[{earlier + 1}]" if earlier else "")


def _unit(channel: _Channel) -> str:
    unit = getattr(channel.block, "unit", "") or getattr(channel.conversion, "unit", "")
    return unit.decode("latin1").strip("\0 ") if isinstance(unit, bytes) else str(unit or "")


READER = Reader("asammdf", _contents, _arrays, "mdf")
