"""Columns with times of their own, brought onto the times of one of them.

Topics of a bag and groups of a measurement file are each sampled by a clock of their own. Signals
are brought over by the rules for resampling (`signals.resampling`): positions by a spline, what was
measured by straight lines, held inputs as the mean of the values that were held.
"""

from collections.abc import Callable, Collection, Mapping
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.card import Card, ColumnKey, CoordinateCard
from tustinnet.data.columns import Column, Columns
from tustinnet.errors import InputError
from tustinnet.signals import resampling

Times = Float[np.ndarray, " n"]
Grid = Float[np.ndarray, " m"]
Matrix = Float[np.ndarray, "_ c"]
Resample = Callable[[Times, Matrix, Grid], Matrix]  # times, values, other times


def align_columns(
    columns: Columns, card: Card, name: Callable[[ColumnKey], str], where: object
) -> Columns:
    """The columns of a card at the times of its time column; others unchanged where no need is.

    Args:
        columns: columns of a file.
        card: what they mean.
        name: function that gives the name of a column in the file.
        where: the file, for messages.

    Raises:
        InputError: columns of several clocks without a time column in the card; times that do not
            rise, or do not overlap.
    """
    rules = _rules(card, name)
    clocks = {column: columns.clocks.get(column) for column in rules}
    time = None if card.time is None else name(card.time.column)
    used = clocks if time is None else {time: columns.clocks.get(time), **clocks}
    if len({*used.values()}) <= 1:
        return columns
    lacking = next((column for column, clock in used.items() if clock is None), None)
    if lacking is not None:
        other = next(column for column, clock in used.items() if clock is not None)
        raise InputError(
            where,
            f"'{lacking}' has no times of its own, '{other}' has",
            "columns with times, or all of them without",
            "name other columns",
        )
    if time is None:
        first, second = [next(n for n, c in used.items() if c == k) for k in {*used.values()}][:2]
        raise InputError(
            where,
            f"'{first}' and '{second}' are sampled at different times",
            "the times to bring them onto",
            f'set `column = "{clocks[name(card.coordinates[0].column)]}"` under [time]',
        )
    assert card.time is not None
    base = columns.clocks[time]
    # a clock that is no column of the file is in s
    second = card.time.factor() if base == time else 1.0
    own = {clock: columns[clock] for clock in dict.fromkeys(used.values()) if clock is not None}
    for clock, t in own.items():
        if len(t) < 2 or not (np.diff(t) > 0).all():
            raise InputError(
                f"{where}, {clock}", "times that do not increase strictly", "at least 2 that do"
            )
    others = {clocks[n] for n, rule in rules.items() if rule is not resampling.resample_held}
    inside = find_covered(
        own[base], {c: (t[0], t[-1]) for c, t in own.items()}, own.keys() - others
    )
    if inside.sum() < 2:
        spans = ", ".join(
            f"{clock} {t[0] * second:.6g}..{t[-1] * second:.6g} s" for clock, t in own.items()
        )
        raise InputError(
            where,
            f"the columns have no time in common ({spans})",
            "times of one clock",
            "name other columns, or another file",
        )
    grid = own[base][inside]
    aligned: dict[str, Column] = {time: columns[time][inside]}
    for column, rule in rules.items():
        clock = clocks[column]
        if clock == base or clock is None:
            aligned[column] = columns[column][inside]
        elif not np.isfinite(columns[column]).all():
            aligned[column] = np.interp(grid, own[clock], columns[column])  # refused as it is read
        else:
            covered = np.clip(grid, own[clock][0], None)
            aligned[column] = rule(own[clock], columns[column][:, None], covered)[:, 0]
    lost = len(inside) - int(inside.sum())
    notes = [
        *(
            [f"{lost} of {len(inside)} samples of {base} left out: others have none"]
            if lost
            else []
        ),
        *(
            _note(clock, own[clock] * second, base, [c for c, k in clocks.items() if k == clock])
            for clock in own
            if clock != base
        ),
    ]
    return Columns(
        columns.names,
        lambda names: [aligned[n] if n in aligned else columns[n] for n in names],
        notes=(*columns.notes, *notes),
        others=columns.others,
    )


def _rules(card: Card, name: Callable[[ColumnKey], str]) -> dict[str, Resample]:
    """The rules by which the columns of a card are resampled, by their names in the file."""
    rules: dict[str, Resample] = {}
    for coordinate in card.coordinates:
        rules[name(coordinate.column)] = partial(_resample_position, coordinate)
        if coordinate.sine is not None:
            both = name(coordinate.column), name(coordinate.sine)
            rules |= dict.fromkeys(both, resampling.resample_positions)
        if coordinate.velocity is not None:
            rules.setdefault(name(coordinate.velocity.column), resampling.resample_linear)
    for entry in (*card.input_columns(), *card.output_columns()):
        hold = entry.input.hold or "zero-order"
        rule = resampling.BY_HOLD.get(hold, resampling.resample_held)  # of an unknown one
        rules.setdefault(name(entry.column), rule)
    return rules


def find_covered(
    t: Times, spans: Mapping[str, tuple[float, float]], held: Collection[str]
) -> Bool[np.ndarray, " n"]:
    """Marks the times of one clock at which the columns of all clocks have values.

    Args:
        t: times that increase [s].
        spans: first and last time of each clock [s], by its name.
        held: clocks of held inputs only, which keep their last value.
    """
    # rounding must not move an end by a sample
    slack = 1e-6 * float(np.median(np.diff(t)))
    begin = max(first for first, _ in spans.values())
    end = min((last for clock, (_, last) in spans.items() if clock not in held), default=t[-1])
    return (t >= begin - slack) & (t <= end + slack)


def _note(clock: str, t: Times, base: str, names: list[str]) -> str:
    """A remark on columns that were brought from times [s] onto others, and on gaps in them."""
    steps = np.diff(t)
    gaps = int((steps > resampling.LONGEST_INTERVAL * np.median(steps)).sum())
    text = f"{', '.join(names[:4])}{', ...' if len(names) > 4 else ''} brought from {clock} "
    text += f"({1 / np.median(steps):.4g} Hz) onto {base}"
    return text + (f", over {gaps} gap{'s' * (gaps > 1)}" if gaps else "")


def _resample_position(coordinate: CoordinateCard, t: Times, column: Matrix, grid: Grid) -> Matrix:
    if coordinate.kind == "linear" or not coordinate.unwrap:
        return resampling.resample_positions(t, column, grid)
    factor = coordinate.factor()
    angle = column[:, 0] * factor
    unwrapped = resampling.unwrap_angle(angle)[0]
    moved = resampling.resample_positions(t, unwrapped[:, None], grid)
    if resampling.wraps_within_turn(angle):  # and it still shows that it does
        moved = angle.min() + (moved - angle.min()) % (2 * np.pi)
    return moved / factor
