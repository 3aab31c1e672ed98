"""TDMS files of LabVIEW: groups of channels, as `motion/angle`."""

from pathlib import Path
from typing import Any

import numpy as np

from tustinnet.data.formats.reader import REAL, Array, Contents, Reader
from tustinnet.errors import InputError

_UNITS = ("unit_string", "NI_UnitDescription", "NI_ChannelUnits", "Unit")  # properties


def _contents(path: Path) -> Contents:
    from nptdms import TdmsFile

    arrays, others, clocks, units = [], {}, {}, {}
    # of a path, what stands in a file `.tdms_index` beside it would be believed
    with path.open("rb") as stream, TdmsFile.open(stream) as file:
        _require_whole(path, file)
        for channel in _channels(file):
            name, kind = _name(channel), np.dtype(channel.dtype).kind
            if kind not in f"{REAL}M" or len(channel) < 2:
                text = "no numbers" if kind not in f"{REAL}M" else f"of {len(channel)} values"
                others[name] = text
                continue
            clock = _clock(channel, clocks, file)
            if clock:
                if clock not in clocks:
                    arrays.append((clock, (len(channel),)))
                    clocks[clock], units[clock] = clock, "s"
                clocks[name] = clock
            arrays.append((name, (len(channel),)))
            texts = (channel.properties.get(key) for key in _UNITS)
            units[name] = next((text for text in texts if isinstance(text, str)), "")
    return Contents(arrays, others, clocks, units)


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    from nptdms import TdmsFile

    arrays: dict[str, Array] = {}
    clocks: dict[str, str] = {}
    with path.open("rb") as stream, TdmsFile.open(stream) as file:
        _require_whole(path, file)
        begin = _begin(file)
        for channel in _channels(file):
            if len(channel) < 2:
                continue
            clock = _clock(channel, clocks, file)
            if clock in names and clock not in arrays:
                arrays[clock] = _times(channel, begin)
            clocks.setdefault(clock, clock)
            if _name(channel) in names:
                values = channel[:]
                if values.dtype.kind == "M":
                    values = (values - values[:1]).astype("timedelta64[ns]").astype(float) / 1e9
                arrays[_name(channel)] = values
    return arrays


def _require_whole(path: Path, file: Any) -> None:
    if file.file_status.incomplete_final_segment:
        raise InputError(path, "its last segment is cut short", "a whole TDMS file")


def _channels(file: Any) -> list[Any]:
    return [channel for group in file.groups() for channel in group.channels()]


def _name(channel: Any) -> str:
    return f"{channel.group_name}/{channel.name}"


def _waveform(channel: Any) -> tuple[Any, ...] | None:
    """Beginning, offset, step and length of a waveform channel, None of another one."""
    step = channel.properties.get("wf_increment")
    if not isinstance(step, float | int) or not step > 0:
        return None
    begin = channel.properties.get("wf_start_time")
    return begin, channel.properties.get("wf_start_offset", 0.0), step, len(channel)


def _clock(channel: Any, clocks: dict[str, str], file: Any) -> str:
    """The name of the times of a channel, which its group's channels share; empty without any."""
    waveform = _waveform(channel)
    if waveform is None:
        return ""
    group = next(group for group in file.groups() if group.name == channel.group_name)
    first = next(c for c in group.channels() if _waveform(c) is not None and len(c) > 1)
    names = {c.name for c in group.channels()}
    if _waveform(first) == waveform and "time" not in names:
        return f"{channel.group_name}/time"
    return f"{_name(channel)}/time"


def _begin(file: Any) -> np.datetime64 | None:
    """The earliest beginning of a waveform in the file."""
    begins = (waveform[0] for c in _channels(file) if (waveform := _waveform(c)) is not None)
    return min((begin for begin in begins if isinstance(begin, np.datetime64)), default=None)


def _times(channel: Any, begin: Any) -> Array:
    """Times of a waveform channel [s] from the beginning of the earliest one in the file on."""
    start, offset, step, length = _waveform(channel) or (None, 0.0, 1.0, len(channel))
    later = 0.0
    if begin is not None and isinstance(start, np.datetime64):
        later = float((start - begin) / np.timedelta64(1, "ns")) / 1e9
    return later + offset + step * np.arange(length)


READER = Reader("nptdms", _contents, _arrays, "tdms")
