"""Logs as they are found in files: their columns, their clock, the records in them."""

import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tustinnet.channels import LONGEST_DT, SHORTEST_DT
from tustinnet.data.alignment import find_covered
from tustinnet.data.columns import NUMBERED, Columns, are_numbers
from tustinnet.data.drafting.names import INPUTS, NameReading, read_name
from tustinnet.data.drafting.numbers import Values
from tustinnet.data.drafting.vocabulary import LINEAR, QUALIFIERS, Qualifier
from tustinnet.data.readers import is_text, read_columns
from tustinnet.data.text_file import DAMAGED_ROWS, NO_HEADER
from tustinnet.data.units import TIME
from tustinnet.errors import InputError
from tustinnet.signals.outliers import TO_DEVIATION
from tustinnet.wording import counted

_MOST_COLUMNS = 60  # that are examined
_SHORTEST_RECORD = 20  # samples of a record
_DAMAGED = re.compile("the text '|an empty cell")  # messages on cells that are no numbers
_EPOCHS = (("s", 5e8, 5e9), ("ms", 5e11, 5e12), ("us", 5e14, 5e15), ("ns", 5e17, 5e18))
_LOGGED_PERIODS = (5e-5, 2.0)  # s, that logs of mechanisms have
_VECTOR = re.compile("d{0,2}([xyz])(dot|ddot|p|pp|d|dd)?")  # and its derivatives
_TICKS = re.compile(r"(?<![\d.])(10+)\s?([mun\N{MICRO SIGN}\N{GREEK SMALL LETTER MU}]s)(?![a-z])")
_RATE = re.compile(r"(.*[a-z])D{1,2}(?![A-Za-z])")  # `angleD`, which is one beside `angle`
_TERMS = ("p", "i", "d")  # of a controller, by their last words
_EPISODES = {"episode", "run", "trial", "versuch", "experiment", "take", "traj", "trajectory"}


class ClockLevels(NamedTuple):
    """Levels that decide on clocks and on the ends of records.

    All are set by hand, not measured.

    Attributes:
        regular: relative deviation of the intervals of a clock that has another name.
        jitter: relative deviation of intervals, from which on it says something of their
            kind.
        slow: usual step of intervals over their usual deviation; of jitter it is the root of 2.
        rest: share of the usual interval, below which a twentieth of the steps of a motion is.
        round: relative; a period this near to one of two digits is that.
        near: share of the intervals, without which the longer ones are no gaps.
        gap: longest interval within a record [periods].
        counts: correlation of what counts with the time.
    """

    regular: float = 0.5
    jitter: float = 1e-3
    slow: float = 0.5
    rest: float = 0.25
    round: float = 5e-4
    near: float = 0.95
    gap: float = 10.0
    counts: float = 1 - 1e-6


CLOCK = ClockLevels()


@dataclass(frozen=True)
class JoinedFile:
    """Another file of a record, whose columns are called by its label.

    Attributes:
        file: the file below the folder of the card.
        column: its column of times, None where row belongs to row.
        unit: unit of these times.
        is_sure: whether the unit is sure.
        starts_together: whether it begins with the record's own file, as the clocks have nothing
            else in common.
        has_header: as that of a log.
        has_damaged_rows: as that of a log.
    """

    file: str
    column: str | None
    unit: str = "s"
    is_sure: bool = True
    starts_together: bool = False
    has_header: bool | None = None
    has_damaged_rows: bool = False


@dataclass(frozen=True)
class Log:
    """The columns of a file, or of one element of its cell or struct arrays.

    Attributes:
        file: the file below the folder of the card.
        cell: number of the element, None for a whole file.
        values: columns of numbers, all of one length.
        texts: what the other columns are, by name.
        notes: remarks on how the file was read.
        has_header: whether the first row of a file whose columns have no names is a header; None
            where they have names.
        record: label of one of several records in the file, None for a whole file.
        clocks: columns of times, of which the first has those of all samples here; empty
            where columns have no times of their own.
        units: units by column, where the file has them.
        has_damaged_rows: whether rows that are no samples are left out.
        labels: what the file calls columns in texts beside them.
        descriptions: what a README says of columns by their names.
        clock_of: the column of the times of each column that has times of its own.
        spans: first and last time of each of these columns in the file.
        joined: other files of the record by their labels.
        factor: seconds in a unit of the first of `clocks`.
        numbers: the number of each column in its file, where only some of the files name them.
    """

    file: str
    cell: int | None
    values: Mapping[str, Values]
    texts: Mapping[str, str]
    notes: tuple[str, ...]
    has_header: bool | None = None
    record: str | None = None
    clocks: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    has_damaged_rows: bool = False
    labels: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)
    clock_of: Mapping[str, str] = field(default_factory=dict)
    spans: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    joined: Mapping[str, JoinedFile] = field(default_factory=dict)
    factor: float = 1.0
    numbers: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.values.values())))

    @property
    def place(self) -> str:
        """The file, and the part of it in brackets."""
        label = self.cell if self.record is None else self.record
        return self.file if label is None else f"{self.file}[{label}]"

    def trim(self, motion: Collection[str], inputs: Collection[str]) -> "Log":
        """The samples at which all columns of a card have values, as loading takes them.

        Args:
            motion: columns of positions and velocities.
            inputs: columns of inputs, which keep their last value.
        """
        used = {self.clock_of[name] for name in (*motion, *inputs) if name in self.clock_of}
        spans = {clock: self.spans[clock] for clock in {*used, *self.clocks[:1]}}
        if len(spans) < 2:
            return self
        of_inputs = spans.keys() - {self.clock_of.get(name) for name in motion} - {self.clocks[0]}
        is_covered = find_covered(self.values[self.clocks[0]] * self.factor, spans, of_inputs)
        values = {name: column[is_covered] for name, column in self.values.items()}
        return replace(self, values=values)


@dataclass(frozen=True)
class Piece:
    """The samples of a log that are one record.

    Attributes:
        log: the log.
        rows: first sample and the one after the last.
        t: its times from 0 on [s].
        because: why it is a part of its file, empty for a whole one.
    """

    log: Log
    rows: tuple[int, int]
    t: Values
    because: str = ""

    def column(self, name: str) -> Values:
        """The samples of a column in the piece."""
        return self.log.values[name][slice(*self.rows)]

    def part(self, first: int, stop: int, because: str) -> "Piece":
        """A part of the piece, by samples of it."""
        rows = (self.rows[0] + first, self.rows[0] + stop)
        return replace(self, rows=rows, t=self.t[first:stop], because=because)

    @property
    def whole(self) -> bool:
        """Whether it has all samples of its log."""
        return self.rows == (0, len(self.log))

    @property
    def place(self) -> str:
        """Its log, and which samples of it, in words."""
        first, stop = self.rows
        return self.log.place + ("" if self.whole else f", samples {first + 1} to {stop}")

    @property
    def seconds(self) -> float:
        """Its duration [s]."""
        return float(self.t[-1] - self.t[0]) if len(self.t) > 1 else 0.0


@dataclass(frozen=True)
class Clock:
    """The time base of all logs.

    Attributes:
        column: the column of times, None without one.
        unit: its unit.
        because: why it is taken for that.
        dt: period [s], None where nothing says it.
        worst: largest deviation of an interval from it [s], gaps aside.
        sure: whether the unit is sure.
        others: other columns that are times or counters, with the reason.
    """

    column: str | None
    unit: str = "s"
    because: str = ""
    dt: float | None = None
    worst: float = 0.0
    sure: bool = True
    others: dict[str, str] = field(default_factory=dict)


def read_logs(folder: Path, files: Sequence[str], on_message: Callable[[str], None]) -> list[Log]:
    """Reads the logs of a folder.

    Args:
        folder: the folder of the card.
        files: the files, below it.
        on_message: called with a sentence on each file that is left out.

    Raises:
        InputError: no file has columns of numbers.
    """
    logs: list[Log] = []
    errors: list[InputError] = []
    for file in _without_set_points(files, on_message):
        try:
            logs += _read_file(folder, file)
        except InputError as error:
            errors.append(error)
    if not logs:
        raise (
            errors[0]
            if errors
            else InputError(folder, "no logs", "files of columns, such as .csv, .parquet or .mat")
        )
    for error in errors:
        on_message(f"left out: {error}")
    return logs


def _without_set_points(files: Sequence[str], on_message: Callable[[str], None]) -> list[str]:
    """The files but those whose names say set points, beside the same of what was measured."""
    words = {file: re.findall(r"[^\W_]+", file.lower()) for file in files}

    def without(file: str, kind: Qualifier) -> tuple[str, ...]:
        return tuple(word for word in words[file] if word not in QUALIFIERS[kind])

    measured = {without(f, "measured") for f in files if QUALIFIERS["measured"] & {*words[f]}}
    left_out = [
        file
        for file in files
        if QUALIFIERS["command"] & {*words[file]} and without(file, "command") in measured
    ]
    for file in left_out:
        on_message(f"left out: {file}: set points by its name")
    return [file for file in files if file not in left_out]


def keep_usual(logs: Sequence[Log], on_message: Callable[[str], None]) -> list[Log]:
    """The logs that have the columns of most samples, without others that some have beside them.

    Columns that are named as positions go before others, which have up to twice as many samples.

    Args:
        logs: the logs.
        on_message: called with a sentence on each log that is left out.
    """
    logs, samples = _name_as_others(logs, on_message), Counter[tuple[str, ...]]()
    for log in logs:
        samples[tuple(log.values)] += len(log)
    _, most = samples.most_common(1)[0]
    often = [names for names, count in samples.items() if 2 * count >= most]
    usual = max(often, key=lambda names: (_has_position(names), samples[names]))
    for log in logs:
        # a file may have more columns than the others, and not fewer
        if not {*usual} <= {*log.values}:
            missing = ", ".join(sorted({*usual} - {*log.values})[:4])
            on_message(f"left out: {log.file}: other columns than most files (no {missing})")
    return [
        replace(log, values={name: log.values[name] for name in usual})
        for log in logs
        if {*usual} <= {*log.values}
    ]


def _has_position(names: Sequence[str]) -> bool:
    return any(read_name(name.replace("/", ".")).stated(["position"]) for name in names)


def _is_silent(name: str) -> bool:
    """Whether a name states neither a position nor a velocity nor an input."""
    return not read_name(name.replace("/", ".")).stated(("position", "velocity", *INPUTS))


def _name_as_others(logs: Sequence[Log], on_message: Callable[[str], None]) -> Sequence[Log]:
    """The logs; those whose columns have no names with the names of others of as many columns."""
    named = {len(log.values): log for log in logs if log.has_header is None}
    bare = [log.file for log in logs if log.has_header is False and len(log.values) in named]
    if not bare or any(log.texts for log in logs):
        return logs

    def with_names(log: Log) -> Log:
        names = [*(named[len(log.values)] if log.file in bare else log).values]
        values = dict(zip(names, log.values.values(), strict=True))
        numbers = {name: k for k, name in enumerate(names, start=1)}
        return replace(log, values=values, has_header=None, numbers=numbers)

    files = ", ".join(bare[:4]) + (", ..." if len(bare) > 4 else "")
    on_message(f"no header in {files}: columns are called as in the other files")
    return [*map(with_names, logs)]


def _read_file(folder: Path, file: str) -> list[Log]:
    """The logs in a file; of a text file with a few damaged rows without these."""
    try:
        logs = _read_whole_file(folder, file)
    except InputError:
        if not is_text(folder / file):
            raise
        whole = _read_undamaged(folder, file)
        if whole is None:
            raise
        return [whole]
    if not is_text(folder / file):
        return logs
    has_texts = any(_DAMAGED.match(text) for text in logs[0].texts.values())
    lacks_some = any(_lacks_some(name, values) for name, values in logs[0].values.items())
    if has_texts or lacks_some:
        whole = _read_undamaged(folder, file)
        if whole is not None and (lacks_some or len(whole.values) > len(logs[0].values)):
            return [whole]
    return logs


def _lacks_some(name: str, values: Values) -> bool:
    """Whether a column that is named as a motion or an input has gaps between its numbers."""
    finite = np.flatnonzero(np.isfinite(values))
    has_gaps = len(finite) > 1 and len(finite) <= finite[-1] - finite[0]
    return bool(has_gaps) and not _is_silent(name)


def _read_undamaged(folder: Path, file: str) -> Log | None:
    """The log in a text file without its damaged rows, None where these are many or none."""
    try:
        columns = read_columns(folder / file, skips_damaged=True)
        log = _read_log(columns, file, None)
    except InputError:
        return None
    damaged = next((int(n.split()[0]) for n in columns.notes if n.endswith(DAMAGED_ROWS)), 0)
    # a file with more damaged rows is no table
    if not 0 < damaged <= 0.1 * len(log) or len(log) < _SHORTEST_RECORD:
        return None
    notes = [f"{file}: {note}" if note.endswith(DAMAGED_ROWS) else note for note in log.notes]
    return replace(log, has_damaged_rows=True, notes=tuple(notes))


def _read_whole_file(folder: Path, file: str) -> list[Log]:
    columns = read_columns(folder / file)
    if columns.parts:
        parts = {label: columns.part(label) for label in columns.parts}
        columns.fetch_parts({name for part in parts.values() for name in part.names})
        logs = [replace(_read_log(part, file, None), record=k) for k, part in parts.items()]
        return [
            replace(log, notes=(f"{file}: {counted(len(logs), 'record')}", *log.notes))
            for log in logs
        ]
    if not columns.elements:
        return [_read_log(columns, file, None)]
    elements = [columns.element(number) for number in range(1, columns.elements + 1)]
    columns.fetch_elements({name for element in elements for name in element.names})
    logs = [_read_log(element, file, number) for number, element in enumerate(elements, start=1)]
    note = f"{file}: {len(logs)} cells or structs, each a record"
    return [replace(log, notes=(note, *log.notes)) for log in logs]


def _read_log(columns: Columns, file: str, cell: int | None) -> Log:
    """The columns of numbers that have the length of most of them."""
    values: dict[str, Values] = {}
    texts = dict(columns.others)
    notes = list(columns.notes)
    examined = columns.names[:_MOST_COLUMNS]
    if len(columns.names) > _MOST_COLUMNS and columns.clocks:
        examined = _most_telling(columns)
        text = f"{len(examined)} of {len(columns.names)} columns are looked at"
        notes.append(f"{text}, those named as positions and inputs first")
    elif len(columns.names) > _MOST_COLUMNS:
        notes.append(f"{len(columns.names)} columns; the first {_MOST_COLUMNS} are looked at")
    for name in examined:
        try:
            values[name] = columns[name]
        except InputError as error:
            texts[name] = str(error).split(": ", 1)[-1]
    clocks, times, spans = columns.clocks, (), {}
    if clocks:
        own = {clocks[name] for name in values if name in clocks and clocks[name] in values}
        spans = {c: (float(values[c][0]), float(values[c][-1])) for c in own if len(values[c])}
        values = _on_common_times(values, clocks, columns.units)
        base = next(iter(values))
        times = (base, *(name for name in values if name != base and name in clocks.values()))
    for name in [*values]:  # columns of one name are numbered: `q`, `q #2`
        first = name.rpartition(" #")[0]
        if first in values and np.array_equal(values[first], values[name], equal_nan=True):
            del values[name]
            texts[name] = f"'{first}' once more"
    lengths = Counter(len(column) for column in values.values() if len(column) > 1)
    if not lengths:
        raise InputError(file, "no column of numbers", "a column of times, positions or inputs")
    usual = max(lengths, key=lambda length: (lengths[length], length))
    for name in [name for name, column in values.items() if len(column) != usual]:
        texts[name] = f"{len(values.pop(name))} values, where the others have {usual}"
    has_header = NO_HEADER not in columns.notes if are_numbers(columns.names) else None
    return Log(
        file,
        cell,
        values,
        texts,
        tuple(notes),
        has_header,
        clocks=times,
        units=columns.units,
        labels=columns.labels,
        clock_of={name: clocks[name] for name in values if clocks.get(name) in spans},
        spans=spans,
    )


def _on_common_times(
    values: Mapping[str, Values], clocks: Mapping[str, str], units: Mapping[str, str]
) -> dict[str, Values]:
    """Columns with times of their own at those of the column that is most likely a position."""

    def likelihood(name: str) -> float:
        reading = read_name(name.replace("/", "."), units.get(name, ""))
        is_command = reading.qualifier == "command"
        return 0.0 if is_command else reading.quantities.get("position", 0.0)

    own = [n for n in values if n in clocks and clocks[n] != n and clocks[n] in values] or [*clocks]
    base = clocks[max(own, key=likelihood)]
    t = values[base]
    common = {base: t}
    for name in (n for n in values if n in own or n in {*clocks.values()} - {base}):
        times, column = values[clocks[name]], values[name]
        if clocks[name] == base or len(times) < 2:
            common[name] = column
        else:  # held, as inputs are
            last = np.searchsorted(times, t, "right") - 1
            common[name] = column[np.clip(last, 0, len(column) - 1)]
    return common


def _most_telling(columns: Columns) -> tuple[str, ...]:
    """Columns that are named as positions, velocities or inputs, then others, and their times."""
    own = [name for name in columns.names if columns.clocks.get(name) != name]
    chosen = {*sorted(own, key=_is_silent)[:_MOST_COLUMNS]}
    chosen |= {columns.clocks[name] for name in chosen if name in columns.clocks}
    return tuple(name for name in columns.names if name in chosen)


def find_clock_of(columns: Columns) -> Clock | None:
    """The clock in the columns of one file, None where it has none."""
    try:
        log = _read_log(columns, "", None)
    except InputError:
        return None
    clock = find_clock([log], read_names([log]))
    return None if clock.column is None else clock


# --- the clock ---


def find_clock(logs: Sequence[Log], readings: Mapping[str, NameReading]) -> Clock:
    """The column of times: it rises in every record, and has such a name or does so regularly.

    One without a name stands before all others, or is regular to a thousandth: motions rise, too.
    Where no column has a name, intervals that jitter tell it from these.
    """
    candidates: list[tuple[float, str]] = []
    spreads: dict[str, float] = {}
    others: dict[str, str] = {}
    own_times = logs[0].clocks
    is_first = True  # but for counters and what never changes
    others |= dict.fromkeys(own_times[1:], "times of other columns")
    for name, reading in readings.items():
        if own_times and name != own_times[0]:
            continue
        columns = [log.values[name] for log in logs]
        intervals = _intervals(columns)
        if intervals is None:
            is_first &= not any(map(np.ptp, columns))
            continue
        relative = np.concatenate([x / np.median(x) for x in map(_rises, columns) if len(x)])
        spread = TO_DEVIATION * float(np.median(np.abs(relative - 1)))
        weight = reading.quantities.get("time", 0.0)
        may_count = weight == 0 and bool((intervals == 1).all())
        if reading.quantity == "counter" or (may_count and _are_whole(columns)):
            others[name] = "counts the samples"
            continue
        is_likely = is_first or name.startswith(NUMBERED)
        most = CLOCK.regular if is_likely else CLOCK.jitter
        is_irregular = spread > most or _change_slowly(relative) or _steps_back(columns)
        if weight == 0 and (is_irregular or _speaks_of_motion(reading)):
            is_first = False
            continue
        # of two clocks the first or regular one; else that which begins near 0, and none
        # before another one that may only count the samples
        begins_late = abs(columns[0][0]) > 1e8
        points = weight - 2 * min(spread, 1.0) - 0.1 * begins_late - may_count + 0.5 * is_first
        candidates.append((points, name))
        spreads[name] = spread
        is_first &= weight > 0
    if not candidates:
        return _find_rounded_clock(logs, readings, others)
    # the first of equal ones
    best = max(candidates, key=lambda candidate: round(candidate[0], 3))[1]
    others |= {
        name: "rises as a clock does"
        for _, name in candidates
        # what has no name may be a motion: beside a named clock, of whole numbers, less regular
        if name != best
        and (
            not name.startswith(NUMBERED)
            or (
                best.startswith(NUMBERED)
                and spreads[name] <= CLOCK.jitter
                and not _are_whole([log.values[name] for log in logs])
            )
        )
    }
    times = [log.values[best] for log in logs]
    others |= {
        name: "the same times"
        for name in readings
        if name not in {best, *others}
        and all(np.array_equal(log.values[name], log.values[best]) for log in logs)
    }
    others |= {
        name: "counts with the time"
        for name in readings
        if name not in {best, *others} and _counts_with(times, [log.values[name] for log in logs])
    }
    unit, because, sure = "s", "in s, as the file says", True
    if not own_times or logs[0].joined or logs[0].units.get(best) != "s":
        unit, because, sure = _time_unit(best, readings[best], times)
    reason = "by its name" if readings[best].quantities.get("time") else "it rises regularly"
    if not readings[best].quantities.get("time") and spreads[best] > CLOCK.jitter:
        reason = f"it rises, by steps that vary by {spreads[best]:.2g}: check that it is the time"
    intervals = _intervals(times)
    assert intervals is not None
    if ticks := _TICKS.search(best):  # cards have no such unit
        unit = "us" if ticks[2][0] not in "mun" else ticks[2]
        dt, _ = _period(intervals * TIME[unit] * int(ticks[1]))
        reason = f"times in ticks of {ticks[0]}: their mean interval is the period"
        return Clock(None, dt=dt, others={**others, best: reason})
    dt, worst = _period(intervals * TIME[unit])
    if not SHORTEST_DT <= dt <= LONGEST_DT:
        return Clock(None, others={**others, best: f"rises, but {dt:.3g} s apart"})
    if not because.endswith(reason):  # a unit in the name says what the name is
        because = f"{reason}; {because}"
    return Clock(best, unit, because, dt, worst, sure, others)


@np.errstate(all="ignore")  # constants count nothing
def _counts_with(times: Sequence[Values], columns: Sequence[Values]) -> bool:
    """Whether whole numbers of a column rise with the time in every record, but for rounding."""
    if min(map(len, times)) <= _SHORTEST_RECORD or not _are_whole(columns):
        return False
    pairs = zip(times, columns, strict=True)
    return all(float(np.corrcoef(t, x)[0, 1]) > CLOCK.counts for t, x in pairs)


def _find_rounded_clock(
    logs: Sequence[Log], readings: Mapping[str, NameReading], others: dict[str, str]
) -> Clock:
    """The period of times that repeat as they have few digits, which a card cannot read."""
    for name in (n for n, r in readings.items() if "time" in r.quantities):
        columns = [log.values[name] for log in logs]
        steps = _steps(columns)
        largest = float(steps.max(initial=0.0))
        lines = [np.linspace(c[0], c[-1], len(c)) for c in columns]
        worst = max(np.abs(c - line).max() for c, line in zip(columns, lines, strict=True))
        if not (steps >= 0).all() or not worst > 0:
            continue
        unit, _, sure = _time_unit(name, readings[name], columns)
        interval, reason = np.mean(steps), "times that repeat: their mean interval"
        if worst > 2 * largest:
            interval, reason = (
                np.median(steps[steps > 0]),
                "times that repeat: their usual interval",
            )
        dt = float(f"{interval * TIME[unit]:.4g}")
        reason = f"{reason} is the period"
        return Clock(None, unit, "", dt, 0.0, sure, {**others, name: reason})
    return Clock(None, others=others)


def _speaks_of_motion(reading: NameReading) -> bool:
    return bool(reading.stated(reading.quantities))


def _intervals(columns: Sequence[Values]) -> Values | None:
    """The intervals of a column that rises, restarts aside; None for another one."""
    steps = _steps(columns)
    if not np.isfinite(steps).all() or not len(steps):
        return None
    rising = steps > 0
    # a log of several records restarts its clock; a few repeated stamps do no clock harm
    if (steps < 0).sum() > max(2, 0.02 * len(steps)) or rising.mean() < 0.97:
        return None
    if (~rising).any() and max(map(len, columns)) < _SHORTEST_RECORD:
        return None
    return steps[rising]


def _steps(columns: Sequence[Values]) -> Values:
    """The changes of a column from one sample to the next, in all records."""
    return np.concatenate([np.diff(column) for column in columns])


def _are_whole(columns: Sequence[Values]) -> bool:
    """Whether columns are of whole numbers."""
    return all((column == np.round(column)).all() for column in columns)


def _rises(column: Values) -> Values:
    """The steps by which a column rises."""
    steps = np.diff(column)
    return steps[steps > 0]


def _steps_back(columns: Sequence[Values]) -> bool:
    """Whether a column falls a little, as a motion does; a clock that starts again falls far."""
    steps = _steps(columns)
    return bool(((steps < 0) & (steps > -CLOCK.gap * np.median(steps))).any())


def _change_slowly(intervals: Values) -> bool:
    """Whether intervals change as slowly as a motion does, or nearly rest; those of a clock jitter.

    Medians, as a clock may be late at times, and have other intervals at first.
    """
    usual = float(np.median(intervals))
    spread = float(np.median(np.abs(intervals - usual)))
    varies = spread > CLOCK.jitter * usual
    is_slow = varies and np.median(np.abs(np.diff(intervals))) < CLOCK.slow * spread
    return bool(is_slow) or float(np.quantile(intervals, 0.05)) < CLOCK.rest * usual


def _without_gaps(intervals: Values, period: float) -> Values:
    """The intervals of a clock that are no gaps between records."""
    return intervals[intervals <= CLOCK.gap * period]


def _period(intervals: Values) -> tuple[float, float]:
    """The period of a clock, and the largest deviation from it, gaps aside."""
    median = float(np.median(intervals))
    near = intervals[intervals < 1.5 * median]
    regular = intervals[np.abs(intervals / median - 1) < 0.1]
    if len(regular) > CLOCK.near * len(intervals):  # but for a few, as the first
        near = regular
    fewest = CLOCK.near * len(intervals)
    if (
        len(_without_gaps(intervals, median)) < fewest
    ):  # bursts of samples: what is between them is no gap
        dt = float(intervals.mean())
    elif len(near) < fewest:
        dt = median
    else:
        dt = float(near.mean())  # of timestamps in whole ms, 3, 3 and 4 are 3.33
    kept = _without_gaps(intervals, dt)
    dt = next(
        (
            nice
            for nice in (float(f"{dt:.1g}"), float(f"{dt:.2g}"))
            if abs(dt / nice - 1) < CLOCK.round
        ),
        float(f"{dt:.6g}"),
    )
    return dt, float(np.abs(kept - dt).max(initial=0.0))


def _time_unit(name: str, reading: NameReading, columns: Sequence[Values]) -> tuple[str, str, bool]:
    """The unit of times, the reason, and whether it is sure."""
    steps = _steps(columns)
    step, first = float(np.median(steps[steps > 0])), float(columns[0][0])
    is_named = reading.unit in TIME and reading.quantity == "time"
    is_whole = _are_whole(columns)
    if is_named and (is_whole or step * TIME[reading.unit] >= _LOGGED_PERIODS[0]):
        return reading.unit, f"in {reading.unit} by its name", True
    for word, unit in (
        ("millis", "ms"),
        ("micros", "us"),
        ("nanos", "ns"),
        ("ns", "ns"),
        ("ms", "ms"),
        ("us", "us"),
        ("nsec", "ns"),
        ("nsecs", "ns"),
    ):
        if word in reading.words:
            return unit, f"in {unit} by its name", True
    for unit, low, high in _EPOCHS:
        if low < first < high and _LOGGED_PERIODS[0] <= step * TIME[unit] <= _LOGGED_PERIODS[1]:
            return unit, f"in {unit}: it begins at {first:.4g}, a time since 1970", True
    if not is_whole:
        return "s", f"in s: intervals of {step:.4g}", step < _LOGGED_PERIODS[1] and not is_named
    fits = [unit for unit in ("ms", "us", "ns") if 5e-4 <= step * TIME[unit] <= _LOGGED_PERIODS[1]]
    # of several the one whose period is nearest to 10 ms
    nearest = min(fits, key=lambda unit: abs(np.log(100 * step * TIME[unit])), default=None)
    unit = nearest or ("s" if step < _LOGGED_PERIODS[1] else "ns")
    if step == 1:
        return "ms", "in ms? whole numbers 1 apart", False
    return unit, f"in {unit}: whole numbers {step:.4g} apart", len(fits) == 1


# --- the records in the logs ---


def find_pieces(
    logs: Sequence[Log],
    clock: Clock,
    readings: Mapping[str, NameReading],
    on_message: Callable[[str], None] = lambda _: None,
) -> list[Piece]:
    """The records in the logs: cut where the clock starts again, at gaps, and between episodes.

    Args:
        logs: the logs.
        clock: their time base.
        readings: the meaning of the names of their columns.
        on_message: called with a sentence on records that are too short, and left out.
    """
    dt = clock.dt or 0.01
    episodes = [
        name
        for name, reading in readings.items()
        if _EPISODES & {*reading.words} and _is_episode([log.values[name] for log in logs])
    ]
    pieces = []
    for log in logs:
        n = len(log)
        t = (
            dt * np.arange(n)
            if clock.column is None
            else log.values[clock.column] * TIME[clock.unit]
        )
        steps = np.diff(t)
        cuts = {int(k) + 1: "the clock starts again" for k in np.flatnonzero(steps < -dt)}
        for name in episodes:
            changed = np.flatnonzero(np.diff(log.values[name]) != 0) + 1
            cuts |= {int(k): f"'{name}' changes" for k in changed}
        for k in np.flatnonzero(steps > CLOCK.gap * dt):
            cuts.setdefault(int(k) + 1, f"a gap of {steps[k]:.3g} s")
        edges = [0, *sorted(cuts), n]
        for first, stop in pairwise(edges):
            because = cuts.get(first) or (cuts.get(stop, "") if len(edges) > 2 else "")
            pieces.append(Piece(log, (first, stop), t[first:stop] - t[first], because))
    long = [piece for piece in pieces if len(piece.t) >= _SHORTEST_RECORD]
    short: dict[str, list[str]] = {}
    for piece in pieces if long else ():
        if len(piece.t) < _SHORTEST_RECORD:
            short.setdefault(piece.log.place, []).append(str(len(piece.t)))
    for place, lengths in short.items():
        texts = ", ".join(lengths[:4]) + (", ..." if len(lengths) > 4 else "")
        on_message(
            f"left out: {place}: fewer than {_SHORTEST_RECORD} samples in a record ({texts})"
        )
    return long or pieces


def _is_episode(columns: Sequence[Values]) -> bool:
    """Whether a column numbers records: whole numbers, few of them, which change rarely."""
    changes = sum(int((np.diff(column) != 0).sum()) for column in columns)
    samples = sum(map(len, columns))
    return all((c == np.round(c)).all() for c in columns) and changes * _SHORTEST_RECORD < samples


def read_names(logs: Sequence[Log]) -> dict[str, NameReading]:
    """The readings of the names of all columns; `column 3` of a file without names says nothing."""
    units, labels = logs[0].units, logs[0].labels
    names = {n: labels.get(n, "" if n.startswith(NUMBERED) else n) for n in logs[0].values}
    for name, text in names.items():
        rate = _RATE.match(text)
        if rate and not any(re.match(rf"{re.escape(rate[1])}(?![A-Za-z])", n) for n in names):
            names[name] = text.replace(rate[0], rate[1], 1)  # as of `axisD`, a term of a controller
    readings = {name: read_name(text, units.get(name, "")) for name, text in names.items()}
    for name in readings.keys() & logs[0].descriptions.keys():
        readings[name] = readings[name].with_description(logs[0].descriptions[name])
    words = {word for r in readings.values() for word in r.words}
    goals = {r.words[1:] for r in readings.values() if {*r.words[:1]} & QUALIFIERS["command"]}
    for name, reading in [*readings.items()]:
        if reading.words[:1] == ("current",) and reading.words[1:] in goals:  # beside `target_x`
            readings[name] = replace(read_name(" ".join(reading.words[1:])), name=name)
        terms = {(*reading.words[:-1], term) for term in _TERMS}
        if reading.words in terms and terms <= {r.words for r in readings.values()}:
            readings[name] = replace(read_name("error"), name=name, words=reading.words)
    return {
        name: replace(r, kind=None) if _is_output(r, words) else r for name, r in readings.items()
    }


def _is_output(reading: NameReading, words: Collection[str]) -> bool:
    """Whether x, y or z in a name is no direction: an element `x[1]` of a vector, or y without x.

    Args:
        reading: the meaning of the name.
        words: the words of all names.
    """
    letters = [m[1] for word in reading.words if (m := _VECTOR.fullmatch(word))]
    if not letters or reading.unit or {*reading.words} & LINEAR - {"x", "y", "z"}:
        return False
    return any(word.isdigit() for word in reading.words) or (letters == ["y"] and "x" not in words)
