"""Records from columns, as a data card declares them."""

import hashlib
import statistics
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import LONGEST_DT, SHORTEST_DT
from tustinnet.data.alignment import align_columns
from tustinnet.data.card import Card, ColumnKey, FileCard, InputColumn, JoinCard, TimeCard
from tustinnet.data.card_files import list_record_files, require_inside
from tustinnet.data.columns import Column, Columns, are_numbers, find_column, frame_columns
from tustinnet.data.dataset import DataSet
from tustinnet.data.declaration import declare, read_declaration
from tustinnet.data.drafting.logs import find_clock_of
from tustinnet.data.experiment import (
    LARGEST,
    Experiment,
    begin_near_zero,
    unwrap_angles,
    with_near_set_points,
)
from tustinnet.data.formats.mat import OBJECT, object_remedy
from tustinnet.data.joining import join_columns, read_formatted
from tustinnet.errors import InputError
from tustinnet.signals import resampling
from tustinnet.wording import counted

_MOST_THINNED = 50  # samples of a log for one of a grid
_IRREGULAR_REMEDY = 'set `irregular = "resample"` (onto a grid) or "keep" under [time]'


def load_folder(
    folder: Path,
    card: Card,
    *,
    on_message: Callable[[str], None] | None = None,
    required: Collection[str] = (),
) -> DataSet:
    """Reads the records that a card names from a folder; without splits, those of all its logs.

    Args:
        folder: where the card's paths begin.
        card: what to read and what it means.
        on_message: if given, records that cannot be read or used are left out, and it is called
            with a sentence on each; not those that the card names one by one, and not all of a
            split.
        required: names of records that are never left out.

    Raises:
        InputError: a file is missing or damaged or outside of the folder, a column is not there,
            a number is not finite, the time base is not as declared, nothing moves; the message
            names file and row.
    """
    loaded, errors = _load_files(folder, card, required, raises=on_message is None)
    if loaded and card.dt is None:
        dt = _common_period([record.experiment for record in loaded], card)
        if dt is not None:
            card = card.model_copy(update={"dt": dt})
            return load_folder(folder, card, on_message=on_message, required=required)
    remaining = {record.experiment.split for record in loaded}
    for split, error in errors:
        if on_message is None or split not in remaining:
            raise error
        on_message(f"left out: {error}")
    experiments = _begin_near_zero(loaded, card)
    if not experiments and not card.splits:
        raise InputError(
            folder,
            f"no logs beside the card '{card.name}'",
            "files of columns, such as .csv, .parquet or .mat",
            "check the folder, or name files of its subfolders under [splits]",
        )
    if not experiments:
        raise InputError(
            folder,
            f"none of the files of the card '{card.name}' are there",
            ", ".join(e.file for files in card.splits.values() for e in files[:2]),
            "check the folder and the names under [splits]",
        )
    if card.dt is None:
        # every record has its own median interval; nearly equal ones come from one clock
        common = float(np.median([e.dt for e in experiments]))
        experiments = [replace(e, channels=replace(e.channels, dt=common)) for e in experiments]
    return DataSet(card.name, tuple(experiments))


def from_frame(
    frame: Any,
    card: Card | Mapping[str, Any] | str | Path,
    *,
    name: str = "frame",
    split: str | None = None,
    groups: Mapping[str, str] | None = None,
) -> Experiment:
    """One record from a pandas or polars data frame.

    Args:
        frame: the data frame; its columns are named in the card.
        card: a data card, its file, or its content as a mapping (`splits` is not needed).
        name: name of the record.
        split: `train`, `validation`, `test` or None.
        groups: conditions of the record, as `{"payload": "1kg"}`.
    """
    if isinstance(card, str | Path):
        card = read_declaration(Path(card), Card)
    elif not isinstance(card, Card):
        card = declare({"name": name, **card}, Card, name)
    reader = _ColumnReader(frame_columns(frame, name), name)
    record = _read_record(reader, card, name, split=split, groups=groups or {})
    return _begin_near_zero([record], card)[0]


def _load_files(
    folder: Path, card: Card, required: Collection[str], *, raises: bool
) -> "tuple[list[_LoadedRecord], list[tuple[str | None, InputError]]]":
    """The records of a card's files, and the errors of others with their splits.

    Args:
        folder: where the card's paths begin.
        card: what to read.
        required: names of records whose errors are raised.
        raises: whether all errors are raised.
    """
    # files of patterns are not among these
    named = {entry.file for entries in card.splits.values() for entry in entries}
    loaded: list[_LoadedRecord] = []
    errors: list[tuple[str | None, InputError]] = []
    entries = list_record_files(folder, card)
    # the inputs of a single log may be there to be simulated
    may_rest = [split for split, _ in entries] == ["test"]
    for split, entry in entries:
        try:
            records = _load_file(folder, split, entry, card, may_rest=may_rest)
        except InputError as error:
            if raises or entry.file in named or entry.name in required:
                raise
            records = [error]
        for record in records:
            if isinstance(record, _LoadedRecord):
                loaded.append(record)
            elif raises:
                raise record
            else:
                errors.append((split, record))
    return loaded, errors


def _common_period(records: Sequence[Experiment], card: Card) -> float | None:
    """The sampling period of records whose median intervals are not alike, as with much jitter.

    None where they are: then they need not be read again by another period.

    Raises:
        InputError: records of several sampling periods.
    """
    common = float(np.median([e.dt for e in records]))
    deviations = [abs(e.dt / common - 1) for e in records]
    # median intervals this near come from one clock
    if max(deviations) < 1e-3:
        return None
    if card.time is not None and max(deviations) > card.time.tolerance:
        usual = statistics.median_low([e.dt for e in records])
        other = max(records, key=lambda e: abs(e.dt / usual - 1))
        raise InputError(
            f"record '{other.name}'",
            f"samples {other.dt:.4g} s apart",
            f"about {usual:.4g} s as in other records",
            f'leave it out, or add `dt = {usual:.4g}` to the card and `irregular = "resample"` '
            "under [time]",
        )
    return common


@dataclass(frozen=True)
class _LoadedRecord:
    """A record as it was read, and the coordinates whose encoders wrap each turn in it."""

    experiment: Experiment
    wrapped: frozenset[int]


def _begin_near_zero(records: Sequence[_LoadedRecord], card: Card) -> list[Experiment]:
    """Records of one machine with wrapped angles moved by whole turns, see `begin_near_zero`.

    An encoder that wraps in a record also wraps in records that stay on one side of its zero.
    """
    wrapping = {j for record in records for j in record.wrapped}
    wrapped = [
        j for j, c in enumerate(card.coordinates) if (j in wrapping if c.wraps is None else c.wraps)
    ]
    from_zero = (begin_near_zero(record.experiment, wrapped) for record in records)
    return [with_near_set_points(record) for record in from_zero]


def _load_file(
    folder: Path, split: str | None, entry: FileCard, card: Card, *, may_rest: bool
) -> list[_LoadedRecord | InputError]:
    """The record of a file, or of each element of its cell arrays the record or its error.

    Args:
        folder: where the card's paths begin.
        split: of the record.
        entry: the file.
        card: what to read.
        may_rest: whether inputs are enough, and no position moves.
    """
    path = folder / entry.file
    require_inside(folder, path)
    columns = read_formatted(path, card.format)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()

    def read(columns: Columns, where: object, name: str) -> _LoadedRecord:
        if not entry.join:
            _require_width(columns, card, path)
        reader = _ColumnReader(columns, where, entry.rows)
        return _read_record(
            reader,
            card,
            name,
            split=split,
            groups=entry.groups,
            entry=entry,
            sha256=digest,
            may_rest=may_rest,
        )

    name = entry.name or path.stem
    if entry.join:
        _require_width(columns, card, path)
        joined = _join_files(columns, folder, entry, card)
        return [read(joined, path, name)]
    names = {key for key in card.columns if isinstance(key, str)}
    if entry.cell is not None:
        if entry.cell > columns.elements:
            has = f"{columns.elements} elements" if columns.elements else "no cell or struct arrays"
            expected = f"a cell {entry.cell} as in the card"
            raise InputError(path, has, expected, "cells count from 1")
        return [read(columns.element(entry.cell), f"{path}, cell {entry.cell}", name)]
    if entry.record is not None:
        if entry.record not in columns.parts:
            has = f"records {', '.join([*columns.parts][:12])}" if columns.parts else "one record"
            raise InputError(path, has, f"a record '{entry.record}' as in the card")
        return [read(columns.part(entry.record), f"{path}, record {entry.record}", name)]
    parts = _parts(columns, names)
    if not parts:
        return [read(columns, path, name)]  # without the columns anywhere, a message names the file
    records: list[_LoadedRecord | InputError] = []
    for label, part in parts.items():
        kind = "record" if columns.parts else "cell"
        try:
            records.append(read(part, f"{path}, {kind} {label}", f"{name}[{label}]"))
        except InputError as error:
            records.append(error)
    return records


def _require_width(columns: Columns, card: Card, path: Path) -> None:
    """Raises unless a file has as many columns as the card says, if it does."""
    count = len(columns.names)
    if card.format.columns is not None and count != card.format.columns:
        raise InputError(path, counted(count, "column"), f"{card.format.columns} as in the card")


def _join_files(columns: Columns, folder: Path, entry: FileCard, card: Card) -> Columns:
    """The columns of a record's own file and of its other files."""
    others: dict[str, tuple[Columns, JoinCard]] = {}
    for label, file in entry.join.items():
        require_inside(folder, folder / file)
        join = card.join[label]
        others[label] = read_formatted(folder / file, join.format), join
    return join_columns(columns, card.time, others, folder / entry.file)


def _parts(columns: Columns, names: set[str]) -> dict[str, Columns]:
    """The records in one file by label, where these columns are in them and not in the file."""
    if columns.parts:
        parts = {label: columns.part(label) for label in columns.parts}
        by_rows = any(part.rows is not None for part in columns.parts.values())
        has_names = any(names & {*p.names} - {*columns.names} for p in parts.values())
        if by_rows or has_names:
            columns.fetch_parts(names)
            return parts
        return {}
    parts = {}
    if not names <= {*columns.names}:
        parts = {str(k): columns.element(k) for k in range(1, columns.elements + 1)}
    if not any(names & {*part.names} - {*columns.names} for part in parts.values()):
        return {}
    columns.fetch_elements(names)
    return parts


class _ColumnReader:
    """Columns by name or number, within a range of rows, with checks whose messages name places."""

    def __init__(
        self, columns: Columns, where: object, rows: tuple[int, int] | None = None
    ) -> None:
        self.columns, self.where, self.rows = columns, where, rows

    def place(self, sample: int) -> str:
        """The place of a sample in the file."""
        first = self.rows[0] if self.rows else 0
        return f"{self.where}, {self.columns.place(sample + first)}"

    def name(self, key: ColumnKey) -> str:
        """The name of a column in the file."""
        names = self.columns.names
        if (column := find_column(names, key)) is not None:
            return column
        if isinstance(key, int):
            raise InputError(
                self.where,
                counted(len(names), "column"),
                f"a column {key} as in the card",
                "columns count from 1",
            )
        expected = f"one of: {', '.join(names[:12])}" + (", ..." if len(names) > 12 else "")
        others = self.columns.others
        for name, text in others.items():
            if key == name or (name and key.startswith((f"{name}.", f"{name}["))):
                remedy = object_remedy() if text == OBJECT else _header_hint(names)
                raise InputError(self.where, f"'{name}' is {text}", expected, remedy)
        problem, remedy = f"no column '{key}'", _header_hint(names)
        if "" in others:  # an object without a known name
            problem += f", but {others['']}, which cannot be read"
            remedy = object_remedy()
        raise InputError(self.where, problem, expected, remedy)

    def read(self, key: ColumnKey) -> Column:
        """The finite numbers of a column.

        Raises:
            InputError: no such column or rows, or a number that is not finite or too large.
        """
        name = self.name(key)
        column = self.columns[name]
        if self.rows is not None:
            first, stop = self.rows
            if stop > len(column):
                raise InputError(
                    self.where,
                    f"rows {first}..{stop}",
                    f"a range within 0..{len(column)} (0 is {self.columns.place(0)} of the file)",
                )
            column = column[first:stop]
        bad = np.flatnonzero(~(np.abs(column) <= LARGEST))
        if len(bad):
            raise InputError(
                f"{self.place(int(bad[0]))}, {name}",
                f"{column[bad[0]]} ({len(bad)} such)",
                f"a finite number of at most {LARGEST:g}",
                "repair or leave out these rows",
            )
        return column

    def read_matrix(
        self, keys: list[ColumnKey], like: Float[np.ndarray, "n q"] | None = None
    ) -> Float[np.ndarray, "n c"]:
        """Several columns side by side, as long as `like`.

        Raises:
            InputError: columns of several lengths, or as `read`.
        """
        columns = [self.read(key) for key in keys]
        lengths = {len(c) for c in columns} | ({len(like)} if like is not None else set())
        if len(lengths) > 1:
            raise InputError(
                self.where, f"columns {keys} have lengths {sorted(lengths)}", "equal lengths"
            )
        return np.stack(columns, axis=1) if columns else np.zeros((lengths.pop(), 0))


def _header_hint(names: Sequence[str]) -> str:
    """A probable defect of a text file's layout, judged by its column names."""
    if are_numbers(names):
        return "the file has no header: columns go by number"
    if len(names) == 1 and any(mark in names[0] for mark in ";\t"):
        return "set `delimiter` under [format]"
    return ""


def _read_record(
    reader: _ColumnReader,
    card: Card,
    name: str,
    *,
    split: str | None,
    groups: Mapping[str, str],
    entry: FileCard | None = None,
    sha256: str = "",
    may_rest: bool = False,
) -> _LoadedRecord:
    """The record in some columns, in SI units; `entry` is its file in the card, if it has one."""
    where, names = reader.where, [reader.name(key) for key in card.columns]
    clocks = {reader.columns.clocks[name] for name in names if name in reader.columns.clocks}
    reader.columns.fetch([*dict.fromkeys((*names, *clocks))])
    reader.columns = columns = align_columns(reader.columns, card, reader.name, where)
    if entry is not None and entry.seconds is not None:
        reader.rows = _rows_within(entry.seconds, reader, card)
    q = reader.read_matrix([c.column for c in card.coordinates])
    for j, c in enumerate(card.coordinates):
        if c.sine is not None:
            q[:, j] = np.arctan2(reader.read_matrix([c.sine], like=q)[:, 0], q[:, j])
    u, outputs = (
        _read_inputs(reader, columns, q)
        for columns in (card.input_columns(), card.output_columns())
    )
    q = (q - [c.offset for c in card.coordinates]) * [c.sign * c.factor() for c in card.coordinates]
    v, velocities = None, [c.velocity for c in card.coordinates if c.velocity is not None]
    if velocities:
        if len(velocities) < len(card.coordinates):
            missing = next(c.name for c in card.coordinates if c.velocity is None)
            expected = "one for every coordinate or none"
            raise InputError(card.name, f"no velocity column for '{missing}'", expected)
        factors = [c.sign * c.velocity_factor() for c in card.coordinates]
        v = reader.read_matrix([c.column for c in velocities]) * factors
    if len(q) < 2:
        raise InputError(where, counted(len(q), "sample"), "at least 2")
    if not np.ptp(q, axis=0).any() and not (may_rest and np.ptp(u, axis=0).any()):
        names = ", ".join(c.name for c in card.coordinates)
        raise InputError(
            where,
            f"nothing moves ({names})",
            "positions that change",
            "check the columns in the card or leave the record out",
        )
    angles = {j: c.name for j, c in enumerate(card.coordinates) if c.kind == "angular" and c.unwrap}
    wrapped = frozenset(j for j in angles if resampling.wraps_within_turn(q[:, j]))
    q, notes = unwrap_angles(q, angles)
    t, dt = _times(reader, card, len(q))
    columns.release()
    record = Experiment(
        name=name,
        t=t,
        q=q,
        u=u,
        outputs=outputs if outputs.shape[1] else None,
        channels=card.channels(dt),
        v=v,
        v_measured=bool(velocities) and all(c.measured for c in velocities),
        first_row=reader.rows[0] if reader.rows else 0,
        split=split,
        k_bar=entry and entry.k_bar,
        groups=tuple(groups.items()),
        source=entry.file if entry else "",
        sha256=sha256,
        notes=(*columns.notes, *notes),
    )
    if card.time is not None:
        record = _check_times(record, card.time, reader)
    return _LoadedRecord(record, wrapped)


def _rows_within(
    seconds: tuple[float, float], reader: _ColumnReader, card: Card
) -> tuple[int, int]:
    """The rows of a whole file from one time on and before another one [s], from its first on."""
    n = len(reader.columns[reader.name(card.coordinates[0].column)])
    t, dt = _times(reader, card, n) if n > 1 else (np.zeros(n), 0.0)
    # rounding must not move a range by a sample
    elapsed, near = t - t[:1], 1e-6 * dt
    first, stop = np.searchsorted(elapsed, np.subtract(seconds, near))
    end = elapsed[-1] if n else 0.0
    if first == n or seconds[1] > end + dt + near:
        raise InputError(
            reader.where,
            f"seconds {seconds[0]:g}..{seconds[1]:g}",
            f"a range within the {end:g} s that the file's record spans",
        )
    return int(first), int(stop)


def _times(reader: _ColumnReader, card: Card, n: int) -> tuple[Float[np.ndarray, " n"], float]:
    """Timestamps of all samples and the sampling period [s]."""
    if card.time is None:
        if card.dt is None:
            raise _no_period(reader)
        return np.arange(n) * card.dt, card.dt
    t = reader.read(card.time.column) * card.time.factor()
    if len(t) != n:
        raise InputError(
            reader.where,
            f"{len(t)} timestamps for {n} samples",
            "equal numbers",
        )
    backward = np.flatnonzero(np.diff(t) <= 0)
    if len(backward):
        row = int(backward[0]) + 1
        verb = "repeats" if t[row] == t[row - 1] else "goes back from"
        raise InputError(
            f"{reader.place(row)}, column {card.time.column}",
            f"time {t[row]:g} s {verb} {t[row - 1]:g} s",
            "strictly increasing timestamps",
            "remove duplicate or misplaced rows",
        )
    median = float(np.median(np.diff(t)))
    if card.dt is None and not SHORTEST_DT <= median <= LONGEST_DT:
        raise InputError(
            reader.where,
            f"samples {median:.4g} s apart",
            f"{SHORTEST_DT:g} to {LONGEST_DT:g} s",
            "check `unit` under [time]",
        )
    return t, card.dt or median


def _no_period(reader: _ColumnReader) -> InputError:
    """The error where a card gives no sampling period, with the lines that would."""
    remedy = "add `dt = ...` (in seconds), or name the column of times under [time]"
    clock = find_clock_of(reader.columns)
    if clock is not None:
        name, unit, dt = clock.column, clock.unit, clock.dt
        remedy = (
            f"column '{name}' has samples {dt:.4g} s apart: add `dt = {dt:.4g}`, or [time] "
            f'with `column = "{name}"`' + ("" if unit == "s" else f' and `unit = "{unit}"`')
        )
    return InputError(
        reader.where, "no sampling period in the card", "`dt` or a time column", remedy
    )


def _read_inputs(
    reader: _ColumnReader, columns: Sequence[InputColumn], q: Float[np.ndarray, "n n_q"]
) -> Float[np.ndarray, "n n_u"]:
    """Inputs by their columns, as many samples as of the positions."""
    values = reader.read_matrix([i.column for i in columns], like=q)
    u = (values - [i.offset for i in columns]) * [i.factor for i in columns]
    return np.clip(u, *np.array([i.ends for i in columns]).reshape(-1, 2).T)


def _check_times(record: Experiment, card: TimeCard, reader: _ColumnReader) -> Experiment:
    """Accepts the record's time base, or resamples, keeps or refuses it as the card says."""
    t, dt = record.t, record.dt
    times = resampling.regularity(t, dt)
    if times.worst <= card.tolerance * dt:
        note = f"jitter {times.jitter:.2g} s (worst {times.worst:.2g} s) accepted"
        return replace(record, notes=(*record.notes, note))
    worst = resampling.describe_worst(t, times)
    ratio = max(times.median_dt / dt, 1e-300)
    is_far = ratio * _MOST_THINNED < 1  # hardly a sample would be left
    if is_far or (card.irregular != "resample" and abs(ratio - 1) > card.tolerance):
        power = round(np.log10(ratio) / 3)
        is_other_unit = power != 0 and abs(ratio / 1000.0**power - 1) < 0.2
        raise InputError(
            reader.where,
            f"samples {times.median_dt:.4g} s apart",
            f"{dt:g} s as in the card",
            f"check `unit` under [time] (it is {1000.0**power:g} times dt)"
            if is_other_unit
            else "correct `dt`"
            if is_far
            else 'correct `dt`, or set `irregular = "resample"` under [time]',
        )
    if card.irregular == "refuse":
        raise InputError(
            reader.place(times.worst_row),
            worst,
            f"{dt:g} s within {card.tolerance:.0%}",
            _IRREGULAR_REMEDY,
        )
    if card.irregular == "keep":
        note = f"irregular times kept as recorded: {worst}"
        return replace(record, notes=(*record.notes, note))
    resampling.require_short_grid(t, dt, reader.place)
    resampled = record.resample(dt)
    gaps = len(resampled.recording.gaps) if resampled.recording else 0
    suffix = f", {gaps} gap{'s' * (gaps > 1)} interpolated" if gaps else ""
    note = f"resampled onto a grid of {dt:g} s{suffix}"
    return replace(resampled, notes=(*record.notes, note))
