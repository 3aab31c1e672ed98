"""JSON files and JSON lines: samples as objects, or columns as lists of numbers.

A list of objects or an object a line is a table, as is what is under the keys of an object:
`{"mass": 0.9, "entries": [{"time": 0.0, "angle": 1.2}, ...]}`. Names within one another are joined
as `motor/angle`, a list of two numbers is the columns `q[1]` and `q[2]`. Tables of the same columns
under several keys, or in a list, are records; those of motors that share their times are of one.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tustinnet.data.formats.reader import Array, Contents, Reader, parts_of_groups
from tustinnet.data.merged_topics import NOTE, TopicColumn, find_merged_topics
from tustinnet.data.text_dates import is_date, read_dates
from tustinnet.errors import InputError

_LARGEST = 2**28  # bytes; as objects of Python they take ten times as many
_NUMBER = (int, float)  # and truth values, which are integers


@dataclass
class _Arrays:
    """The arrays of a document, by names.

    Attributes:
        numbers: arrays of numbers, NaN where a row has none.
        others: descriptions of everything else.
        notes: remarks on how it was read.
    """

    numbers: dict[str, Array] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, value: Any) -> None:
        """Takes a value of the document and all that is in it."""
        if isinstance(value, Mapping) and {"columns", "data"} <= {*value}:  # `split` of pandas
            self.add(name, [dict(zip(value["columns"], row, strict=True)) for row in value["data"]])
        elif isinstance(value, Mapping) and _has_rows_by_number(value):
            self.add(name, [*value.values()])
        elif isinstance(value, Mapping):
            for key, item in value.items():
                self.add(f"{name}/{key}" if name else key, item)
        elif isinstance(value, list) and (len(value) > 1 or _has_long_lists(value)):
            self._add_rows(name, value)
        else:
            self.others[name or "the file"] = "no rows" if isinstance(value, list) else repr(value)

    def _add_rows(self, name: str, rows: Sequence[Any]) -> None:
        """Takes a row for each sample: objects, lists, numbers or texts of one kind."""
        some = [row for row in rows if row is not None]
        lengths = {len(row) for row in some if isinstance(row, list)}
        if some and all(isinstance(row, Mapping) for row in some):
            if _has_long_lists(some):  # each is a record of its own
                for number, row in enumerate(some, start=1):
                    self.add(f"{name}/{number}" if name else str(number), row)
                return
            for key in dict.fromkeys(key for row in some for key in row):
                values = [None if row is None else row.get(key) for row in rows]
                self._add_rows(f"{name}/{key}" if name else key, values)
        elif some and all(isinstance(row, _NUMBER) for row in some):
            self.numbers[name or "values"] = np.array(
                [np.nan if row is None else row for row in rows], float
            )
        elif len(lengths) == 1 and all(isinstance(row, list) for row in some):
            self._add_lists(name, rows, lengths.pop())
        elif some and all(isinstance(row, str) and is_date(row) for row in some):
            self._add_dates(name, rows)
        else:
            self.others[name] = "text" if all(isinstance(r, str) for r in some) else "no numbers"

    def _add_lists(self, name: str, rows: Sequence[Any], width: int) -> None:
        """Takes lists of one length: rows below names, or numbers."""
        if all(isinstance(cell, str) for cell in rows[0] or [None]):
            self._add_rows(name, [dict(zip(rows[0], row, strict=True)) for row in rows[1:]])
            return
        whole = [[None] * width if row is None else row for row in rows]
        if all(cell is None or isinstance(cell, _NUMBER) for row in whole for cell in row):
            self.numbers[name or "values"] = np.array(whole, float)
        else:
            self.others[name] = "lists that are no numbers"

    def _add_dates(self, name: str, rows: Sequence[str | None]) -> None:
        import polars as pl

        times = read_dates(pl.Series([row or "" for row in rows]))
        self.numbers[name] = times.fill_null(float("nan")).to_numpy()
        self.notes.append(f"'{name}': dates or times of day, read as seconds since midnight")


def _has_rows_by_number(value: Mapping[str, Any]) -> bool:
    """Whether the keys of an object are the numbers of rows, and not those of motors or records."""
    return bool(value) and all(map(str.isdigit, value)) and not _has_long_lists([*value.values()])


def _has_long_lists(items: Sequence[Any]) -> bool:
    """Whether objects have lists that are longer than there are objects."""
    values = [x for item in items if isinstance(item, Mapping) for x in item.values()]
    return max((len(x) for x in values if isinstance(x, list)), default=0) > len(items)


def _read(path: Path) -> _Arrays:
    """The contents of a file; names without the key that all of them are under."""
    arrays = _Arrays()
    arrays.add("", _parse(path, arrays.notes))
    while len({name.partition("/")[0] for name in arrays.numbers}) == 1 and all(
        "/" in name for name in arrays.numbers
    ):
        arrays.numbers = {name.partition("/")[2]: a for name, a in arrays.numbers.items()}
    return arrays


def _parse(path: Path, notes: list[str]) -> Any:
    """The document of a file, of JSON lines a list of them; `notes` gets a remark on a damaged end.

    Raises:
        InputError: a file that is too large.
        json.JSONDecodeError: one that is no JSON.
    """
    if path.stat().st_size > _LARGEST:
        raise InputError(
            path,
            f"{path.stat().st_size / 2**20:.0f} MiB of JSON",
            f"at most {_LARGEST / 2**20:.0f} MiB",
            "write it as CSV or Parquet",
        )
    text = path.read_text(encoding="utf-8-sig")
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        lines = [line for line in text.splitlines() if line.strip()]
        if len(lines) < 2 or lines[0].rstrip()[-1] not in "]}":
            raise
    try:
        last = [json.loads(lines[-1])]
    except json.JSONDecodeError:
        last = []
        notes.append("the last line is cut off, and left out")
    return [*map(json.loads, lines[:-1]), *last]


def _contents(path: Path) -> Contents:
    found = _read(path)
    topics = _topics(found.numbers)
    clocks = {name: topic.clock for name, topic in topics.items()}
    shapes = {name: array.shape for name, array in found.numbers.items()}
    shapes |= {
        name: (int(topic.rows.sum()), *shapes[topic.source][1:]) for name, topic in topics.items()
    }
    return Contents(
        [(name, shape) for name, shape in shapes.items() if shape[0] > 1],
        found.others,
        clocks,
        parts=parts_of_groups([(name, array.shape) for name, array in found.numbers.items()]),
        notes=(*found.notes, *([NOTE] if topics else [])),
    )


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    numbers = _read(path).numbers
    topics = _topics(numbers)
    chosen = {n: numbers[t.source][t.rows] for n, t in topics.items() if n in names}
    return {name: numbers[name] for name in names - chosen.keys()} | chosen


def _topics(numbers: Mapping[str, Array]) -> dict[str, TopicColumn]:
    """The columns of topics of different rates, none where all rows are whole."""
    rows = {len(array) for array in numbers.values()}
    if len(rows) != 1:
        return {}
    present = {
        name: np.atleast_1d(np.isfinite(array.reshape(len(array), -1)).all(axis=1))
        for name, array in numbers.items()
    }
    return find_merged_topics(present, lambda name: numbers[name])


READER = Reader("json", _contents, _arrays, speed=2e6)
