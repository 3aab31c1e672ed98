"""Tables whose columns are described by rows above them, as scopes of controllers export them.

Each row says a name, a unit or more of every column, behind a word for that: `Name;position;u`,
`Unit;mm;N m`, `SampleTime[ms];2;2`. Either all columns have the times of the first one, or each
has its own before it, and the word stands before each: `Name;position;Name;torque`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from tustinnet.data.text_dialect import Header, Table, is_unit
from tustinnet.data.units import TIME

_NAMES = ("name", "signal", "symbol", "symbolname", "channel", "variable")
_UNITS = ("unit", "units", "einheit")
_QUANTITY = re.compile(r"(?<=\S)\s+\(.*\)$")  # `mm (Length)`
_TIME_UNIT = re.compile(r"time\s*[\[(](s|ms|us|ns)[\])]")


@dataclass(frozen=True)
class Pairs:
    """Pairs of columns of times and of values.

    Attributes:
        names: names of the columns, times before their values.
        units: units by the names of columns, as far as they are known.
        factor: seconds in a unit of the times, None where the file does not say it.
    """

    names: tuple[str, ...]
    units: dict[str, str]
    factor: float | None

    @property
    def clocks(self) -> dict[str, str]:
        """The column of times of each column, where their unit is known."""
        if self.factor is None:
            return {}
        pairs = zip(self.names[::2], self.names[1::2], strict=True)
        return {name: time for time, value in pairs for name in (time, value)}


def find_pairs(above: Sequence[Sequence[str]], table: Table) -> Pairs | None:
    """The pairs of columns that rows above the samples describe, None where they describe none.

    Args:
        above: cells of the rows above the first sample.
        table: the shape of the samples.
    """
    if table.width < 4 or table.width % 2:
        return None
    rows = [row for row in above if len(row) == table.width and len({*row[::2]}) == 1]
    described = _Described({row[0].lower(): row[1::2] for row in rows if row[0]})
    if len(described.rows) < 2 or not described.names:
        return None
    unit = described.time_unit
    times = [f"{name}/time" for name in described.names]
    return Pairs(
        tuple(n for pair in zip(times, described.names, strict=True) for n in pair),
        described.units | dict.fromkeys(times if unit else [], "s"),
        None if unit is None else TIME[unit],
    )


def find_described(above: Sequence[Sequence[str]], table: Table) -> Header | None:
    """The names and units of columns of common times, as find_pairs finds those of pairs."""
    rows = [row for row in above if len(row) == table.width > 2]
    described = _Described({row[0].lower(): row[1:] for row in rows if row[0]})
    if len(described.rows) < 3 or not described.names or described.time_unit is None:
        return None
    return Header(["time", *described.names], {"time": described.time_unit} | described.units, 0)


@dataclass(frozen=True)
class _Described:
    """Descriptions of columns, a row each, by their first words in lower case."""

    rows: dict[str, Sequence[str]]

    @property
    def names(self) -> Sequence[str]:
        """The names, all different; empty where no row says them."""
        names = next((self.rows[word] for word in _NAMES if word in self.rows), [])
        return names if all(names) and len({*names}) == len(names) else []

    @property
    def units(self) -> dict[str, str]:
        """The units by the names of columns, as far as they are known, also from comments."""
        texts = next((self.rows[word] for word in _UNITS if word in self.rows), None)
        comments = next((row for word, row in self.rows.items() if "comment" in word), [])
        if texts is None:
            texts = [text if is_unit(text) else "" for text in comments]
        pairs = zip(self.names, texts, strict=False)
        return {name: _QUANTITY.sub("", text) for name, text in pairs if text}

    @property
    def time_unit(self) -> str | None:
        """The unit of the times, None where no row says it."""
        matches = (_TIME_UNIT.search(word) for word in self.rows)
        return next((match[1] for match in matches if match), None)
