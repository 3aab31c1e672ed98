"""Tables of topics of different rates: in each row some columns have no value.

Loggers write what arrives, or topics are merged by their times, as `time,angle,volts` with
`0.01,1.2,` and `0.013,,3.5`. Here each column gets the times of the rows in which it has a value,
as a topic of a bag.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from tustinnet.data.columns import Column
from tustinnet.errors import InputError

_MISSING = 0.1  # of the rows; columns that lack fewer have damaged rows
NOTE = "rows with values of some columns only: each has the times of its own"
FEW_VALUES = "fewer than 10 values, or times that repeat"  # what is no topic
TIME = re.compile(r"(?i)time|zeit|stamp|(?<![a-z])t(?![a-z])")
_FEWEST_VALUES = 10  # of a topic, and of the others beside it

Rows = Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class TopicColumn:
    """A column of a topic.

    Attributes:
        source: the column of the table in which its numbers are.
        rows: the rows of these.
        clock: the column of their times: of a topic `column/time`, by its first column.
    """

    source: str
    rows: Rows
    clock: str


def find_merged_topics(
    present: Mapping[str, Rows], read: Callable[[str], Column]
) -> dict[str, TopicColumn]:
    """The columns of a table of topics by their names; none of a table whose rows are whole.

    Args:
        present: the rows in which each column of the table has a value.
        read: function that gives the numbers of a column that has one in every row.
    """
    missing = [(~rows).sum() for rows in present.values() if rows.sum() >= _FEWEST_VALUES]
    count = len(next(iter(present.values())))
    if max(missing, default=0) < max(_FEWEST_VALUES, _MISSING * count):
        return {}
    whole = [name for name, rows in present.items() if rows.all()]
    time = next((name for name in whole if _is_time(name, read)), None)
    if time is None:
        return {}
    t, columns, clocks = read(time), dict[str, TopicColumn](), dict[bytes, str]()
    for name, rows in present.items():
        if rows.sum() < _FEWEST_VALUES or (name != time and not (np.diff(t[rows]) > 0).all()):
            continue
        key = rows.tobytes()
        clock = clocks.setdefault(key, time if rows.all() else f"{name}/{time}")
        columns.setdefault(clock, TopicColumn(time, rows, clock))
        columns[name] = TopicColumn(name, rows, clock)
    return columns


def _is_time(name: str, read: Callable[[str], Column]) -> bool:
    """Whether a column has such a name, never falls, and is no counter of the rows."""
    if not TIME.search(name):
        return False
    try:
        steps = np.diff(read(name))
    except InputError:  # text
        return False
    return bool((steps >= 0).all() and steps.any() and (steps != 1).any())
