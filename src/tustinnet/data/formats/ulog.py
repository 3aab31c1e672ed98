"""ULog files of PX4: topics, as `vehicle_attitude/q[0]`."""

from pathlib import Path
from typing import Any

import numpy as np

from tustinnet.data.formats.reader import REAL, Array, Contents, Reader
from tustinnet.errors import InputError

_TIME = "timestamp"  # us, in every topic


def _contents(path: Path) -> Contents:
    log = _read(path)
    arrays, others, clocks = [], {}, {}
    for topic in log.data_list:
        name = _topic_name(topic)
        clock = f"{name}/time"
        arrays.append((clock, (len(topic.data[_TIME]),)))
        clocks[clock] = clock
        for field, column in topic.data.items():
            if field == _TIME:
                continue
            if column.dtype.kind in REAL:
                arrays.append((f"{name}/{field}", column.shape))
                clocks[f"{name}/{field}"] = clock
            else:
                others[f"{name}/{field}"] = "no real numbers"
    notes = [f"times count from the start of the log, {log.start_timestamp / 1e6:g} s after boot"]
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) / 1e3
        notes.append(f"{len(log.dropouts)} dropouts of the logger, {lost:g} s together")
    units = dict.fromkeys(clocks.values(), "s")
    return Contents(arrays, others, clocks, units, notes=tuple(notes))


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    topics = sorted({name.partition("/")[0].partition("[")[0] for name in names})
    log = _read(path, topics)
    arrays: dict[str, Array] = {}
    for topic in log.data_list:
        name = _topic_name(topic)
        if f"{name}/time" in names:
            # unsigned: a stamp before the start must not become a large one
            elapsed = topic.data[_TIME].astype(np.int64) - int(log.start_timestamp)
            arrays[f"{name}/time"] = elapsed / 1e6
        for field, column in topic.data.items():
            if f"{name}/{field}" in names:
                arrays[f"{name}/{field}"] = column
    return arrays


def _read(path: Path, topics: list[str] | None = None) -> Any:
    from pyulog import ULog

    log = ULog(str(path), topics)
    if log.file_corruption:
        raise InputError(path, "parts of the file are damaged", "a whole ULog file")
    return log


def _topic_name(topic: Any) -> str:
    """The name of a topic; the further ones of a name are numbered, as PX4 does."""
    return f"{topic.name}[{topic.multi_id}]" if topic.multi_id else topic.name


READER = Reader("pyulog", _contents, _arrays, "ulog")
