"""What a single file of columns holds, without a card: guesses, and the draft of a card."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from tustinnet.data.columns import NUMBERED, Column, Columns
from tustinnet.data.readers import read_columns
from tustinnet.data.units import TIME
from tustinnet.errors import InputError
from tustinnet.signals.encoder import encoder_count

Role = Literal["time", "position", "velocity", "input", "constant", "no numbers"]

_MOST = 60  # columns that are looked at
_CLOCK = re.compile(r"(?i)(^|[^a-z])(t|time|times|timestamp|clock|sec|seconds)([^a-z]|$)")
_DRIVE = re.compile(
    r"(?i)(^|[^a-z])(u|in|input|volts?|voltage|torque|force|current|control|command|pwm|motor)"
    r"([^a-z]|$)"
)
_TIME_UNIT = re.compile(r"(?i)(^|[^a-z])(ms|us|ns)([^a-z]|$)")
_REGULAR = 0.5  # relative deviation of the intervals of a clock whose name does not say so
_SMOOTH = 0.3  # a position moves by less than this share of its spread from sample to sample
_HELD = 0.2  # of samples: an input that changes less often is held at levels
_DERIVATIVE = 0.9  # correlation of a velocity with the slope of its position


@dataclass(frozen=True)
class ColumnReport:
    """One column.

    Attributes:
        name: what it is called.
        role: what it looks like.
        range: smallest and largest finite value.
        distinct: how many different values.
        count: the step of its values, where it is quantised as an encoder is.
        remark: a few words on the guess.
    """

    name: str
    role: Role
    range: tuple[float, float] | None = None
    distinct: int = 0
    count: float | None = None
    remark: str = ""


@dataclass(frozen=True)
class FileReport:
    """A file of columns.

    Attributes:
        name: the file's name.
        rows: how many samples.
        dt: median interval [s], where there is a column of times.
        jitter: largest deviation of an interval from it [s].
        time_unit: the unit of the times, guessed.
        columns: per column.
        notes: what reading it found.
        draft: a data card to start from, in TOML.
    """

    name: str
    rows: int
    dt: float | None
    jitter: float | None
    time_unit: str
    columns: tuple[ColumnReport, ...]
    notes: tuple[str, ...]
    draft: str


@np.errstate(all="ignore")  # what is no number, or too large, is told and does not count
def inspect_file(path: Path) -> FileReport:
    """Looks at a file that no card describes; everything but the numbers is a guess.

    Raises:
        InputError: the file cannot be read, or has no column of numbers.
    """
    columns = read_columns(path)
    notes = list(columns.notes)
    if columns.elements:
        notes.append(f"{columns.elements} cells or structs; the columns are of the first one")
        columns = columns.element(1)
    if len(columns.names) > _MOST:
        notes.append(f"{len(columns.names)} columns; the first {_MOST} are looked at")
    values, reports = _read(columns)
    if not values:
        raise InputError(path, "no column of numbers", "a column of times, positions or inputs")
    clock = _clock(values)
    unit = "s" if clock is None else _time_unit(clock, values[clock])
    found = {
        name: ColumnReport(name, "time", _range(column), len(column), None, f"in {unit}?")
        if name == clock
        else _judge(name, column)
        for name, column in values.items()
    }
    found = _with_velocities(found, values)
    reports = tuple(found.get(r.name, r) for r in reports)
    steps = None
    if clock is not None:
        steps = np.diff(values[clock]) * TIME[unit]
    dt = None if steps is None else float(np.median(steps))
    jitter = None if steps is None or dt is None else float(np.abs(steps - dt).max())
    rows = max(map(len, values.values()))
    report = FileReport(path.name, rows, dt, jitter, unit, reports, tuple(notes), "")
    return FileReport(**{**vars(report), "draft": _draft(report)})


def _read(columns: Columns) -> tuple[dict[str, Column], list[ColumnReport]]:
    """The columns of numbers, and a first report of each column."""
    values, reports = {}, []
    for name in columns.names[:_MOST]:
        try:
            column = columns[name]
        except InputError as error:
            reports.append(ColumnReport(name, "no numbers", remark=str(error).split(": ", 1)[-1]))
            continue
        values[name] = column
        reports.append(ColumnReport(name, "constant"))
    reports += [ColumnReport(n, "no numbers", remark=other) for n, other in columns.others.items()]
    return values, reports


def _range(column: Column) -> tuple[float, float] | None:
    finite = column[np.isfinite(column)]
    return (float(finite.min()), float(finite.max())) if len(finite) else None


def _clock(values: dict[str, Column]) -> str | None:
    """The column that looks like times: it increases, and is called so or does so regularly."""
    rising = {}
    for name, column in values.items():
        steps = np.diff(column)
        if len(steps) and np.isfinite(column).all() and (steps > 0).all():
            rising[name] = float(np.std(steps) / np.mean(steps))
    named = [name for name in rising if _CLOCK.search(name)]
    regular = [name for name, spread in rising.items() if spread < _REGULAR]
    return next(iter([*named, *regular]), None)


def _time_unit(name: str, column: Column) -> str:
    """By the name, else by the size of the intervals: whole ones are no seconds."""
    told = _TIME_UNIT.search(name)
    if told:
        return told[2].lower()
    step = float(np.median(np.diff(column)))
    if step < 1 or (column != np.round(column)).any():
        return "s"
    return "ms" if step < 1000 else "us" if step < 1e6 else "ns"


def _judge(name: str, column: Column) -> ColumnReport:
    """Smooth columns are positions, held or rough ones inputs, if their names say nothing else."""
    finite = column[np.isfinite(column)]
    lost = len(column) - len(finite)
    remark = f"{lost} not finite" if lost else ""
    distinct = len(np.unique(finite))
    if distinct < 2:
        return ColumnReport(name, "constant", _range(column), distinct, None, remark)
    steps = np.diff(finite)
    changes = float(np.mean(steps != 0))
    rough = float(np.sqrt(np.mean(steps**2)) / np.std(finite))
    jump = float(np.abs(steps[steps != 0]).min() / np.ptp(finite))
    held = changes < _HELD and jump > 1 / 50
    count = encoder_count(finite)
    if _DRIVE.search(name) or held or rough > _SMOOTH:
        told = "held levels" if held else "rough" if rough > _SMOOTH else "by its name"
        return ColumnReport(name, "input", _range(column), distinct, None, remark or told)
    told = f"steps of {count:.6g}, as encoder counts" if count else "smooth"
    return ColumnReport(name, "position", _range(column), distinct, count, remark or told)


def _with_velocities(
    found: dict[str, ColumnReport], values: dict[str, Column]
) -> dict[str, ColumnReport]:
    """The same, with positions that are another one's slope told to be velocities."""
    positions = [name for name, report in found.items() if report.role == "position"]
    for of in positions:
        for name in positions:
            if name != of and found[of].role == "position" and _is_slope(values[of], values[name]):
                old = found[name]
                found[name] = ColumnReport(
                    name, "velocity", old.range, old.distinct, None, f"slope of '{of}'"
                )
    return found


def _is_slope(position: Float[np.ndarray, " n"], other: Float[np.ndarray, " m"]) -> bool:
    if len(position) != len(other) or len(position) < 5:
        return False
    slope = np.gradient(position)
    usable = np.isfinite(slope) & np.isfinite(other)
    if usable.sum() < 5 or not np.ptp(slope[usable]) or not np.ptp(other[usable]):
        return False
    return bool(np.corrcoef(slope[usable], other[usable])[0, 1] > _DERIVATIVE)


# --- the draft of a card ---


def _draft(report: FileReport) -> str:
    """A card for the file, with what is to be checked said behind it."""
    by_role: dict[str, list[ColumnReport]] = {}
    for column in report.columns:
        by_role.setdefault(column.role, []).append(column)
    lines = [f"name = {_quoted(Path(report.name).stem)}"]
    if report.dt is None:
        lines += ["dt = 0.01  # s: no column of times was found, say how far apart samples are"]
    else:
        lines += [
            f"dt = {float(f'{report.dt:.6g}')}  # s, the median interval", "", "[time]",
            f"column = {_key(by_role['time'][0].name)}", f'unit = "{report.time_unit}"',
        ]  # fmt: skip
    velocities = {c.remark: c for c in by_role.get("velocity", [])}
    positions = by_role.get("position") or by_role.get("input", [])[:1]
    for column in positions:
        lines += ["", "[[coordinates]]", *_coordinate(column)]
        velocity = velocities.get(f"slope of '{column.name}'")
        if velocity:
            at = f"velocity = {{ column = {_key(velocity.name)}, measured = false }}"
            lines.append(f"{at}  # say its unit; measured: by a sensor of its own?")
    if not positions:
        lines += ["", "# [[coordinates]]: no column looks like a position"]
    for column in by_role.get("input", []):
        if column not in positions:
            lines += [
                "", "[[inputs]]", f"name = {_name(column.name)}", f"column = {_key(column.name)}",
                'unit = "V"  # say which',
            ]  # fmt: skip
    lines += ["", "[splits]", f"train = [{_quoted(report.name)}]"]
    lines.append('# validation = ["another file"]')
    return "\n".join(lines) + "\n"


def _coordinate(column: ColumnReport) -> list[str]:
    lines = [f"name = {_name(column.name)}", 'kind = "angular"  # or "linear"']
    lines.append(f"column = {_key(column.name)}")
    if column.count is not None and abs(column.count - 1) < 1e-6:
        return [*lines, 'unit = "counts"', "counts_per_revolution = 4096  # say how many"]
    return [*lines, 'unit = "rad"  # or deg, rev, ...; m, mm, ... of a linear one']


def _key(name: str) -> str:
    return name.removeprefix(NUMBERED) if name.startswith(NUMBERED) else _quoted(name)


def _name(name: str) -> str:
    return _quoted(re.sub(r"[\s/\\]+", "_", name).lstrip(".") or "column")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
