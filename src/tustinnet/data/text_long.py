"""Long tables: a row for each value, with its time and the name of its signal.

Databases export them, as `time,signal,value`. Here they become columns by signal.
"""

from collections.abc import Sequence

import numpy as np

from tustinnet.data.columns import Column, Columns
from tustinnet.errors import InputError


def spread_signals(columns: Columns, names: Sequence[str], label: str) -> Columns | None:
    """The columns of a long table by signal, None where a table of three columns is none.

    Signals of the same times share a column of times; others have one of their own.

    Args:
        columns: the table, with one column of texts.
        names: texts of that column, row by row.
        label: name of that column.
    """
    signals, which = np.unique(np.asarray(names, str), return_inverse=True)
    counts = np.bincount(which)
    time, value = (name for name in columns.names if name != label)
    # at most 60 signals, of at least ten values each
    is_long = 2 <= len(signals) <= 60 and counts.min() >= 10
    if not is_long or time in signals or "" in signals:
        return None
    try:
        t, values = columns[time], columns[value]
    except InputError:  # another text
        return None
    repeated = 1 - len(np.unique(t)) / len(t)
    # mostly other rows have the time of a row, too
    rising = all((np.diff(t[which == k]) > 0).all() for k in range(len(signals)))
    if not rising or repeated < min(0.5, 0.9 * (1 - 1 / len(signals))):
        return None
    rows = [which == k for k in range(len(signals))]
    order = sorted(range(len(signals)), key=lambda k: int(np.argmax(rows[k])))
    columns_by_name: dict[str, Column] = {}
    clocks: dict[str, str] = {}
    if all(np.array_equal(t[rows[0]], t[row]) for row in rows):
        columns_by_name[time] = t[rows[0]]
        columns_by_name |= {str(signals[k]): values[rows[k]] for k in order}
    else:
        for k in order:
            name, clock = str(signals[k]), f"{signals[k]}/{time}"
            columns_by_name |= {clock: t[rows[k]], name: values[rows[k]]}
            clocks |= {clock: clock, name: clock}
    note = f"a row for each value: columns by '{label}'"
    times = {time, *clocks.values()} & columns_by_name.keys()
    units = dict.fromkeys(times, columns.units[time]) if time in columns.units else {}
    return Columns(
        tuple(columns_by_name),
        lambda names: [columns_by_name[name] for name in names],
        notes=(*columns.notes, note),
        clocks=clocks,
        units=units,
    )
