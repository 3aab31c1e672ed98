"""Long tables: rows with a time, the name or number of a signal or joint, and its values.

Databases and drives export them, as `time,signal,value` and `time,motor_id,position,current`. Here
they become columns by signal.
"""

from collections.abc import Sequence

import numpy as np

from tustinnet.data.columns import Column, Columns
from tustinnet.errors import InputError

_MOST_SIGNALS, _FEWEST_VALUES = 60, 10
_TURNS = 0.9  # of the rows are of another signal than the row before, where signals take turns


def spread_signals(
    columns: Columns, names: Sequence[str], label: str, texts: Sequence[str]
) -> Columns | None:
    """The columns of a long table by signal, None of another table.

    Signals of the same times share a column of times; others have one of their own. With several
    values in a row, columns are called by the signal and the value, as `elbow/position`.

    Args:
        columns: the table.
        names: the signal of each row.
        label: name of the column that says it.
        texts: all columns of texts, which have no values.
    """
    signals, which = np.unique(np.asarray(names, str), return_inverse=True)
    numbers = [name for name in columns.names if name not in (label, *texts)]
    counts = np.bincount(which)
    is_long = 2 <= len(signals) <= _MOST_SIGNALS and counts.min() >= _FEWEST_VALUES
    if not is_long or len(numbers) < 2 or {*numbers, ""} & {*signals}:
        return None
    try:
        columns.fetch(numbers)
    except InputError:  # another text
        return None
    rows = [which == k for k in range(len(signals))]
    takes_turns = float(np.mean(np.diff(which) != 0)) > _TURNS
    # mostly other rows have the time of a row, too
    most = 1 - min(0.5, 0.9 * (1 - 1 / len(signals)))
    time = next(
        (
            name
            for name in numbers
            if (takes_turns or len(np.unique(columns[name])) <= most * len(which))
            and all((np.diff(columns[name][row]) > 0).all() for row in rows)
        ),
        None,
    )
    if time is None:
        return None
    t, values = columns[time], [name for name in numbers if name != time]
    order = sorted(range(len(signals)), key=lambda k: int(np.argmax(rows[k])))
    is_common = all(np.array_equal(t[rows[0]], t[row]) for row in rows)
    columns_by_name: dict[str, Column] = {time: t[rows[0]]} if is_common else {}
    clocks: dict[str, str] = {}
    units: dict[str, str] = {}
    for k in order:
        signal, clock = str(signals[k]), f"{signals[k]}/{time}"
        own = {signal if len(values) == 1 else f"{signal}/{value}": value for value in values}
        if not is_common:
            columns_by_name[clock] = t[rows[k]]
            clocks |= dict.fromkeys([clock, *own], clock)
        for name, value in own.items():
            columns_by_name[name] = columns[value][rows[k]]
            units |= {name: columns.units[value]} if value in columns.units else {}
    times = {time, *clocks.values()} & columns_by_name.keys()
    units |= dict.fromkeys(times, columns.units[time]) if time in columns.units else {}
    return Columns(
        tuple(columns_by_name),
        lambda names: [columns_by_name[name] for name in names],
        notes=(*columns.notes, f"a row for each value: columns by '{label}'"),
        others={name: "texts" for name in texts if name != label},
        clocks=clocks,
        units=units,
    )
