"""Tables in which each column of values has its own column of times before it.

Scopes of controllers export them: rows above the samples say the name, the unit and more of each
pair, as `Name;position;Name;torque`, `Unit;mm;Unit;N m`, `SampleTime[ms];2;SampleTime[ms];4`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from tustinnet.data.text_dialect import Table
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
    described = {
        row[0].lower(): row[1::2]
        for row in above
        if len(row) == table.width and row[0] and len({*row[::2]}) == 1
    }
    values = next((described[word] for word in _NAMES if word in described), [])
    if len(described) < 2 or not all(values) or len({*values}) < len(values) or not values:
        return None
    texts = next((described[word] for word in _UNITS if word in described), [])
    matches = (_TIME_UNIT.search(word) for word in described)
    unit = next((match[1] for match in matches if match), None)
    return Pairs(
        tuple(name for value in values for name in (f"{value}/time", value)),
        {v: _QUANTITY.sub("", text) for v, text in zip(values, texts, strict=False) if text}
        | dict.fromkeys([f"{value}/time" for value in values] if unit else [], "s"),
        None if unit is None else TIME[unit],
    )
