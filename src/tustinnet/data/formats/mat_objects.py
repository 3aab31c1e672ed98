"""Objects of MATLAB in MAT files: timeseries, timetables, tables, by the package mat-io."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.formats.reader import DEEPEST, Array

_SECONDS = {
    "seconds": 1.0,
    "milliseconds": 1e-3,
    "microseconds": 1e-6,
    "nanoseconds": 1e-9,
    "minutes": 60.0,
    "hours": 3600.0,
    "days": 86_400.0,
    "weeks": 604_800.0,
}


class ObjectArray(NamedTuple):
    """An array or a text in an object.

    Attributes:
        name: its name, as `ts.Data`.
        values: the array; empty for a text.
        clock: name of the array of its times [s], empty without one.
        text: the text, empty for an array.
    """

    name: str
    values: Array
    clock: str = ""
    text: str = ""


def can_read_objects() -> bool:
    """Whether the package mat-io is installed."""
    return find_spec("matio") is not None


def object_names(path: Path) -> list[str]:
    """Names of the variables of a file that are objects."""
    import matio

    return [name for name, (_, kind) in matio.whosmat(str(path)).items() if kind not in _PLAIN]


_PLAIN = {"double", "single", "char", "struct", "cell", "logical", "sparse", "function_handle"}
_PLAIN |= {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}


def object_arrays(path: Path, variables: list[str]) -> Iterator[ObjectArray]:
    """The arrays and texts in some variables, those of structs and cells too."""
    import matio

    for name, value in matio.load_from_mat(str(path), variable_names=variables).items():
        if not name.startswith("__"):
            yield from _walk(name, value, 0)


def _walk(name: str, value: Any, depth: int) -> Iterator[ObjectArray]:
    properties = getattr(value, "properties", None)
    if depth > DEEPEST:
        return
    if hasattr(value, "columns") and hasattr(value, "index"):
        yield from _table(name, value)
    elif isinstance(properties, dict):
        if {"Data_", "Data"} & {*properties} and {"Time_", "Time", "TimeInfo"} & {*properties}:
            yield from _timeseries(name, properties)
            return
        for key, inner in properties.items():
            yield from _walk(f"{name}.{str(key).rstrip('_')}", inner, depth + 1)
    elif isinstance(value, np.ndarray):
        yield from _walk_array(name, value, depth)


def _walk_array(name: str, value: Array, depth: int) -> Iterator[ObjectArray]:
    """The arrays in an array of structs or cells, and any of numbers, times or text."""
    if value.dtype.names:
        for k, element in enumerate(value.ravel(order="F"), 1):
            place = name if value.size == 1 else f"{name}({k})"
            for field in value.dtype.names:
                yield from _walk(f"{place}.{field}", element[field], depth + 1)
    elif value.dtype.kind == "O":
        for k, element in enumerate(value.ravel(order="F"), 1):
            is_object = value.size == 1 and hasattr(element, "properties")
            yield from _walk(name if is_object else f"{name}{{{k}}}", element, depth + 1)
    elif value.dtype.kind in "mM":
        yield ObjectArray(name, _seconds(value))
    elif value.dtype.kind in "fiub":
        yield ObjectArray(name, value)
    elif value.dtype.kind in "UT" and value.size == 1:
        yield from _text(name, value)


def _text(name: str, value: Any) -> Iterator[ObjectArray]:
    """A char row or a string scalar, unless it is empty or missing."""
    content = np.asarray(value).ravel()
    if content.size == 1 and isinstance(content[0], str) and content[0].strip():
        yield ObjectArray(name, np.empty(0), text=content[0].strip())


def _seconds(times: Array) -> Array:
    """Durations [s], or points in time [s] from the first one on."""
    times = times if times.dtype.kind == "m" else times - times.ravel()[:1]
    return times.astype("timedelta64[ns]").astype(np.float64) / 1e9


def _table(name: str, table: Any) -> Iterator[ObjectArray]:
    """The columns of a table or timetable, which mat-io gives as a data frame."""
    index, clock = table.index.to_numpy(), ""
    if index.dtype.kind in "mM":
        clock = f"{name}.{table.index.name or 'Time'}"
        yield ObjectArray(clock, _seconds(index), clock)
    for column in table.columns:
        values = table[column].to_numpy()
        if values.dtype.kind in "mM":
            values = _seconds(values)
        if values.dtype.kind in "fiub":
            yield ObjectArray(f"{name}.{column}", values, clock)


def _timeseries(name: str, properties: dict[str, Any]) -> Iterator[ObjectArray]:
    """Times and data of a timeseries; equidistant times are stored as their beginning and step."""
    data = np.asarray(properties.get("Data_", properties.get("Data")))
    times = np.asarray(properties.get("Time_", properties.get("Time", ())))
    info = _properties(properties.get("TimeInfo"))
    if not times.size and info:
        begin, step, length = (_number(info, key) for key in ("Start", "Increment", "Length"))
        times = begin + step * np.arange(int(min(length, 2**31)))
    units = "".join(map(str, np.asarray(info.get("Units", "seconds")).ravel())) or "seconds"
    if data.dtype.kind in "fiub" and times.dtype.kind in "fiub" and units in _SECONDS:
        clock = f"{name}.Time"
        yield ObjectArray(clock, times * _SECONDS[units], clock)
        yield ObjectArray(f"{name}.Data", data, clock)
        yield from _text(f"{name}.Name", properties.get("Name", ""))
        about = _properties(properties.get("DataInfo"))
        unit = about.get("Units_", about.get("Units", ""))
        # logging of Simulink has an object there, whose name is the unit
        yield from _text(f"{name}.DataInfo.Units", _properties(unit).get("Name", unit))


def _properties(value: Any) -> dict[str, Any]:
    """The properties of an object, none of anything else."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.flat[0]
    properties = getattr(value, "properties", None)
    return properties if isinstance(properties, dict) else {}


def _number(info: dict[str, Any], key: str) -> float:
    value = np.asarray(info.get(f"{key}_", info.get(key, 0.0)), float).ravel()
    return float(value[0]) if value.size else 0.0
