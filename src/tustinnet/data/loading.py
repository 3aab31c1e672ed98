"""From columns to records, as a data card says."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import LONGEST_DT, SHORTEST_DT
from tustinnet.data.card import Card, ColumnKey, FileCard
from tustinnet.data.card_files import list_record_files, require_inside
from tustinnet.data.columns import NUMBERED, Column, Columns, frame_columns
from tustinnet.data.dataset import DataSet
from tustinnet.data.declaration import declare, read_declaration
from tustinnet.data.experiment import LARGEST, Experiment, unwrap_angles
from tustinnet.data.mat_file import OBJECT, OBJECT_REMEDY
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError
from tustinnet.signals import resampling

_SAME_UNIT = 0.2  # a period this near to dt times a power of 1000 is in another unit
_LEAST_RATIO = 1e-300  # of a median interval to dt; its logarithm is wanted
_SAME_INSTANT = 1e-6  # periods; rounding must not move a range by a sample
_SAME_CLOCK = 1e-3  # relative; median intervals this near come from one clock
_WHAT_IRREGULAR_OFFERS = 'set `irregular = "resample"` (onto a grid) or "keep" under [time]'


def load_folder(folder: Path, card: Card) -> DataSet:
    """Reads the records that a card names from a folder.

    Args:
        folder: where the card's paths begin.
        card: what to read and what it means.

    Raises:
        InputError: a file is missing or damaged or outside of the folder, a column is not there,
            a number is not finite, the time base is not as declared, nothing moves; the message
            names file and row.
    """
    entries = list_record_files(folder, card)
    experiments = [e for split, entry in entries for e in _load_file(folder, split, entry, card)]
    if not experiments:
        raise InputError(
            folder,
            f"none of the files of the card '{card.name}' are there",
            ", ".join(e.file for files in card.splits.values() for e in files[:2]) or "[splits]",
            "check the folder and the names under [splits]",
        )
    return DataSet(card.name, _with_common_period(experiments, card))


def _with_common_period(experiments: list[Experiment], card: Card) -> tuple[Experiment, ...]:
    """Without a declared period every record has its own median; nearly equal ones are one."""
    if card.dt is not None:
        return tuple(experiments)
    common = float(np.median([e.dt for e in experiments]))
    return tuple(
        replace(e, channels=replace(e.channels, dt=common))
        if abs(e.dt / common - 1) < _SAME_CLOCK
        else e
        for e in experiments
    )


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
        card: a data card, its file, or the same as a mapping (`splits` is not needed).
        name: what the record is called.
        split: `train`, `validation`, `test` or None.
        groups: what the record was made with, as `{"payload": "1kg"}`.
    """
    if isinstance(card, str | Path):
        declared = read_declaration(Path(card), Card)
    else:
        declared = card if isinstance(card, Card) else declare({"name": name, **card}, Card, name)
    return _experiment(
        frame_columns(frame, name),
        declared,
        name,
        split=split,
        groups=tuple((groups or {}).items()),
    )


def _load_file(folder: Path, split: str, entry: FileCard, card: Card) -> list[Experiment]:
    """The record of a file, or those of the elements of its cell arrays."""
    path = folder / entry.file
    require_inside(folder, path)
    columns = read_columns(path, header=card.format.header, delimiter=card.format.delimiter)
    digest, name = _sha256(path), entry.name or path.stem
    records = []
    for number, found in _records_in(columns, entry.cell, card, path).items():
        if card.format.columns is not None and len(found.names) != card.format.columns:
            raise InputError(
                path, f"{len(found.names)} columns", f"{card.format.columns} as in the card"
            )
        of_many = number is not None and entry.cell is None
        records.append(
            _experiment(
                found, card, f"{name}[{number}]" if of_many else name,
                where=path if number is None else f"{path}, cell {number}", split=split,
                part=entry, k_bar=entry.k_bar, groups=tuple(entry.groups.items()),
                source=entry.file, sha256=digest,
            )
        )  # fmt: skip
    return records


def _records_in(
    columns: Columns, cell: int | None, card: Card, path: Path
) -> dict[int | None, Columns]:
    """The columns of each record of a file, by the number of its cell, None for the file itself."""
    names = {key for key in card.columns if isinstance(key, str)}
    if cell is None and (not columns.elements or names <= set(columns.names)):
        return {None: columns}
    if cell is not None and cell > columns.elements:
        there = f"{columns.elements} elements" if columns.elements else "no cell or struct arrays"
        raise InputError(path, there, f"a cell {cell} as in the card", "cells count from 1")
    numbers = range(1, columns.elements + 1) if cell is None else (cell,)
    found: dict[int | None, Columns] = {number: columns.element(number) for number in numbers}
    if cell is None and not any(
        names & set(of.names) - set(columns.names) for of in found.values()
    ):
        return {None: columns}  # the columns are nowhere: it is said of the file
    if cell is None:
        columns.fetch_elements(names)
    return found


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _experiment(
    columns: Columns,
    card: Card,
    name: str,
    *,
    where: object = None,
    part: FileCard | None = None,
    **metadata: Any,
) -> Experiment:
    where = name if where is None else where
    pick = _Picker(columns, where, part and part.rows)
    columns.fetch([pick.name(key) for key in card.columns])
    if part is not None and part.seconds is not None:
        pick.rows = _rows_within(part.seconds, pick, card)
    q = pick.stack([c.column for c in card.coordinates])
    u = pick.stack([i.column for i in card.inputs], like=q)
    q = (q - [c.offset for c in card.coordinates]) * [c.sign * c.factor() for c in card.coordinates]
    u = (u - [i.offset for i in card.inputs]) * [i.sign * i.scale for i in card.inputs]
    v, measured = _velocities(pick, card)
    if len(q) < 2:
        raise InputError(where, f"{len(q)} samples", "at least 2")
    if not np.ptp(q, axis=0).any():
        names = ", ".join(c.name for c in card.coordinates)
        raise InputError(
            where,
            f"nothing moves ({names})",
            "positions that change",
            "check the columns in the card or leave the record out",
        )
    angles = {j: c.name for j, c in enumerate(card.coordinates) if c.kind == "angular" and c.unwrap}
    q, notes = unwrap_angles(q, angles)
    t, dt = _times(pick, card, len(q), where)
    experiment = Experiment(
        name=name, t=t, q=q, u=u, v=v, v_measured=measured, notes=(*columns.notes, *notes),
        channels=card.channels(dt), first_row=pick.rows[0] if pick.rows else 0, **metadata,
    )  # fmt: skip
    return experiment if card.time is None else _judge_times(experiment, card, where, pick)


class _Picker:
    """Finds columns by name or number and says which are there when one is not."""

    def __init__(self, columns: Columns, where: object, rows: tuple[int, int] | None) -> None:
        self.columns, self.where, self.rows = columns, where, rows

    def place(self, sample: int) -> str:
        """Where a sample stands in the file."""
        return f"{self.where}, {self.columns.place(sample + (self.rows[0] if self.rows else 0))}"

    def stack(
        self, keys: list[ColumnKey], like: Float[np.ndarray, "n q"] | None = None
    ) -> Float[np.ndarray, "n c"]:
        picked = [self.one(key) for key in keys]
        lengths = {len(column) for column in picked} | ({len(like)} if like is not None else set())
        if len(lengths) > 1:
            raise InputError(
                self.where, f"columns {keys} have lengths {sorted(lengths)}", "equal lengths"
            )
        return np.stack(picked, axis=1) if picked else np.zeros((lengths.pop(), 0))

    def name(self, key: ColumnKey) -> str:
        """What a column of the card is called in the file."""
        names = self.columns.names
        if isinstance(key, int):
            if not 1 <= key <= len(names):
                raise InputError(
                    self.where,
                    f"{len(names)} columns",
                    f"a column {key} as in the card",
                    "columns count from 1",
                )
            return names[key - 1]
        if key not in names:
            shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
            found, remedy = _other(key, self.columns.others)
            raise InputError(
                self.where, found or f"no column '{key}'", f"one of: {shown}",
                remedy or _header_hint(names),
            )  # fmt: skip
        return key

    def one(self, key: ColumnKey) -> Column:
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


def _other(key: str, others: Mapping[str, str]) -> tuple[str, str]:
    """What a name of the card is where it is no column, and what to do; empty where nothing is."""
    for name, other in others.items():
        if key == name or (name and key.startswith((f"{name}.", f"{name}["))):
            return f"'{name}' is {other}", OBJECT_REMEDY if other == OBJECT else ""
    if "" in others:  # an object whose name is not known
        return f"no column '{key}', but {others['']}, which cannot be read", OBJECT_REMEDY
    return "", ""


def _header_hint(names: Sequence[str]) -> str:
    """What may be wrong with the layout of a text file, judged by its column names."""
    if all(name.startswith(NUMBERED) for name in names):
        return "the file has no header: columns go by number"
    if len(names) == 1 and any(mark in names[0] for mark in ";\t"):
        return "set `delimiter` under [format]"
    return ""


def _velocities(pick: _Picker, card: Card) -> tuple[Float[np.ndarray, "n n_q"] | None, bool]:
    declared = [c.velocity for c in card.coordinates]
    given = [v for v in declared if v is not None]
    if not given:
        return None, False
    if len(given) < len(declared):
        missing = next(c.name for c in card.coordinates if c.velocity is None)
        raise InputError(
            card.name, f"no velocity column for '{missing}'", "one for every coordinate or none"
        )
    factors = [c.sign * c.velocity_factor() for c in card.coordinates]
    return pick.stack([v.column for v in given]) * factors, all(v.measured for v in given)


def _rows_within(seconds: tuple[float, float], pick: _Picker, card: Card) -> tuple[int, int]:
    """The rows of a whole file from one time on and before another one [s], from its first on."""
    n = len(pick.columns[pick.name(card.coordinates[0].column)])
    t, dt = _times(pick, card, n, pick.where) if n > 1 else (np.zeros(n), 0.0)
    elapsed, near = t - t[:1], _SAME_INSTANT * dt
    first, stop = np.searchsorted(elapsed, np.subtract(seconds, near))
    end = elapsed[-1] if n else 0.0
    if first == n or seconds[1] > end + dt + near:
        raise InputError(
            pick.where, f"seconds {seconds[0]:g}..{seconds[1]:g}",
            f"a range within the {end:g} s that the file's record spans",
        )  # fmt: skip
    return int(first), int(stop)


def _times(
    pick: _Picker, card: Card, n: int, where: object
) -> tuple[Float[np.ndarray, " n"], float]:
    if card.time is None:
        dt = float(card.dt or np.nan)
        return np.arange(n) * dt, dt
    t = pick.one(card.time.column) * card.time.factor()
    if len(t) != n:
        raise InputError(where, f"{len(t)} timestamps for {n} samples", "equal numbers")
    bad = np.flatnonzero(np.diff(t) <= 0)
    if len(bad):
        row = int(bad[0]) + 1
        kind = "repeats" if t[row] == t[row - 1] else "goes back from"
        raise InputError(
            f"{pick.place(row)}, column {card.time.column}",
            f"time {t[row]:g} s {kind} {t[row - 1]:g} s",
            "strictly increasing timestamps",
            "remove duplicate or misplaced rows",
        )
    median = float(np.median(np.diff(t)))
    if card.dt is None and not SHORTEST_DT <= median <= LONGEST_DT:
        raise InputError(
            where,
            f"median interval {median:.4g} s",
            f"{SHORTEST_DT:g} to {LONGEST_DT:g} s",
            "check `unit` under [time]",
        )
    return t, card.dt or median


def _judge_times(e: Experiment, card: Card, where: object, pick: _Picker) -> Experiment:
    """Accepts the record's time base, or resamples, keeps or refuses it as the card says."""
    assert card.time is not None
    found = resampling.regularity(e.t, e.dt)
    if found.worst <= card.time.tolerance * e.dt:
        told = f"jitter {found.jitter:.2g} s (worst {found.worst:.2g} s) accepted"
        return replace(e, notes=(*e.notes, told))
    interval = e.t[found.worst_row] - e.t[found.worst_row - 1]
    told = (
        f"interval of {interval:.4g} s before sample {found.worst_row} "
        f"(median {found.median_dt:.4g} s)"
    )
    ratio = max(found.median_dt / e.dt, _LEAST_RATIO)
    if card.time.irregular != "resample" and abs(ratio - 1) > card.time.tolerance:
        power = round(np.log10(ratio) / 3)
        another_unit = power != 0 and abs(ratio / 1000.0**power - 1) < _SAME_UNIT
        raise InputError(
            where,
            f"median interval {found.median_dt:.4g} s",
            f"{e.dt:g} s as in the card",
            f"check `unit` under [time] (it is {1000.0**power:g} times dt)"
            if another_unit
            else 'correct `dt`, or set `irregular = "resample"` under [time]',
        )
    if card.time.irregular == "refuse":
        raise InputError(
            pick.place(found.worst_row),
            told,
            f"{e.dt:g} s within {card.time.tolerance:.0%}",
            _WHAT_IRREGULAR_OFFERS,
        )
    if card.time.irregular == "keep":
        return replace(e, notes=(*e.notes, f"irregular times kept as recorded: {told}"))
    resampling.require_short_grid(e.t, e.dt, pick.place)
    gridded = e.resample(e.dt)
    gaps = len(gridded.recording.gaps) if gridded.recording else 0
    filled = f", {gaps} gap{'s' * (gaps > 1)} interpolated" if gaps else ""
    note = f"resampled onto a grid of {e.dt:g} s{filled}"
    return replace(gridded, notes=(*e.notes, note))
