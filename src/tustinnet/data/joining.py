"""Records that are spread over several files: their columns side by side, each with its times."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tustinnet.data.card import FormatCard, JoinCard, TimeCard
from tustinnet.data.columns import Column, Columns, find_column
from tustinnet.data.readers import read_columns
from tustinnet.data.units import TIME
from tustinnet.errors import InputError


def read_formatted(path: Path, form: FormatCard) -> Columns:
    """The columns of a file whose layout a card describes, as far as it does."""
    return read_columns(
        path,
        header=form.header,
        delimiter=form.delimiter,
        decimal=form.decimal,
        encoding=form.encoding,
        skips_damaged=form.damaged_rows == "skip",
    )


class _Clock(NamedTuple):
    """Times of a file [s]: the file, its column of times, the factor to s and the first time."""

    columns: Columns
    column: str
    factor: float
    begin: float | None = None

    def seconds(self) -> Column:
        times = self.columns[self.column] * self.factor
        return times if self.begin is None or not len(times) else times - times[0] + self.begin


def join_columns(
    first: Columns,
    time: TimeCard | None,
    others: Mapping[str, tuple[Columns, JoinCard]],
    where: object,
) -> Columns:
    """The columns of a record of several files; those of the others are called `label/column`.

    Args:
        first: columns of the record's own file.
        time: its times, as the card says.
        others: columns of the other files and what the card says of them, by label.
        where: the record's file, for messages.

    Returns:
        Columns of which each has the times of its file, as topics of a bag have; where no other
        file has times, the rows belong together one by one.

    Raises:
        InputError: a column of times that is not there; other files with times, and none here.
    """
    sources = {name: (first, name) for name in first.names}
    units, labels = dict(first.units), dict(first.labels)
    clocks = dict(first.clocks)
    times: dict[str, _Clock] = {}
    has_times = any(card.column is not None for _, card in others.values())
    own = None
    if has_times:
        if time is None:
            raise InputError(
                where,
                "other files of the record have times, and the card has no [time]",
                "the column of times of this file under [time]",
            )
        own = _column_name(first, time.column, where)
        if own not in clocks:
            times[f"{own} in s"] = _Clock(first, own, time.factor())
            clocks |= dict.fromkeys(first.names, f"{own} in s")
    notes = list(first.notes)
    for label, (columns, card) in others.items():
        names = {name: f"{label}/{name}" for name in columns.names}
        sources |= {new: (columns, name) for name, new in names.items()}
        units |= {names[name]: unit for name, unit in columns.units.items()}
        labels |= {names[name]: text for name, text in columns.labels.items()}
        notes += [f"{label}: {note}" for note in columns.notes]
        if card.column is not None and own is not None:
            column = _column_name(columns, card.column, f"{where}, {label}")
            base = times.get(clocks[own])
            begin = None
            if card.starts_together:
                begin = float((first[clocks[own]] if base is None else base.seconds())[0])
            clock = f"{label}/{column} in s"
            times[clock] = _Clock(columns, column, TIME[card.unit], begin)
            clocks |= dict.fromkeys(names.values(), clock)
        elif own is not None:
            clocks |= dict.fromkeys(names.values(), clocks[own])

    def read(chosen: Sequence[str]) -> list[Column]:
        for columns in {id(c): c for c, _ in sources.values()}.values():
            columns.fetch(
                [sources[n][1] for n in chosen if n in sources and sources[n][0] is columns]
            )
        return [
            times[name].seconds() if name in times else sources[name][0][sources[name][1]]
            for name in chosen
        ]

    others_of = {
        f"{label}/{n}": text for label, (c, _) in others.items() for n, text in c.others.items()
    }
    return Columns(
        tuple(sources),
        read,
        None,
        tuple(notes),
        {**first.others, **others_of},
        {name: clock for name, clock in clocks.items() if name in sources},
        units,
        labels,
    )


def _column_name(columns: Columns, key: int | str, where: object) -> str:
    """The name of a column that a card names, or numbers."""
    name = find_column(columns.names, key)
    if name is None:
        raise InputError(
            where, f"no column '{key}' of times", f"one of: {', '.join(columns.names[:12])}"
        )
    return name
