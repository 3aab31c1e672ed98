"""Inspection of a single file of columns without a card: guesses, and the draft of a card."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from tustinnet.data.columns import NUMBERED, Column
from tustinnet.data.readers import read_columns
from tustinnet.data.units import TIME
from tustinnet.errors import InputError
from tustinnet.signals.encoder import encoder_count

Role = Literal["time", "position", "velocity", "input", "constant", "no numbers"]

_MOST = 60  # columns that are examined
_CLOCK = re.compile(r"(?i)(^|[^a-z])(t|time|times|timestamp|clock|sec|seconds)([^a-z]|$)")
_INPUT = re.compile(
    r"(?i)(^|[^a-z])(u|in|input|volts?|voltage|torque|force|current|control|command|pwm|motor)"
    r"([^a-z]|$)"
)
_TIME_UNIT = re.compile(r"(?i)(^|[^a-z])(ms|us|ns)([^a-z]|$)")
_REGULAR = 0.5  # relative deviation of the intervals of a clock that has another name
_SMOOTH = 0.3  # a position moves by less than this share of its spread from sample to sample
_FEW_CHANGES = 0.2  # of samples: an input that changes less often is held at levels
_DERIVATIVE = 0.9  # correlation of a velocity with the slope of its position


@dataclass(frozen=True)
class ColumnReport:
    """The result of an inspection of one column.

    Attributes:
        name: name of the column.
        role: its probable meaning.
        range: smallest and largest finite value.
        distinct: number of different values.
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
    """The result of an inspection of a file of columns.

    Attributes:
        name: the file's name.
        rows: number of samples.
        dt: median interval [s], where there is a column of times.
        jitter: largest deviation of an interval from it [s].
        time_unit: the unit of the times, guessed.
        columns: a report for each column.
        notes: remarks on how the file was read.
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


@np.errstate(all="ignore")  # what is no number, or too large, is reported and does not count
def inspect_file(path: Path) -> FileReport:
    """Inspects a file that no card describes; everything but the numbers is a guess.

    Args:
        path: the file.

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
    values: dict[str, Column] = {}
    reports: dict[str, ColumnReport] = {}
    for name in columns.names[:_MOST]:
        try:
            values[name] = columns[name]
            reports[name] = ColumnReport(name, "constant")  # holds its place
        except InputError as error:
            remark = str(error).split(": ", 1)[-1]
            reports[name] = ColumnReport(name, "no numbers", remark=remark)
    if not values:
        raise InputError(path, "no column of numbers", "a column of times, positions or inputs")
    clock = _find_clock(values)
    unit = "s" if clock is None else _guess_time_unit(clock, values[clock])
    for name, column in values.items():
        if name == clock:
            extent = float(column[0]), float(column[-1])
            reports[name] = ColumnReport(name, "time", extent, len(column), None, f"in {unit}?")
        else:
            reports[name] = _guess_role(name, column)
    positions = [name for name, report in reports.items() if report.role == "position"]
    for position in positions:
        for name in positions:
            is_position = reports[position].role == "position"
            if name != position and is_position and _is_slope(values[position], values[name]):
                reports[name] = replace(
                    reports[name], role="velocity", count=None, remark=f"slope of '{position}'"
                )
    others = [ColumnReport(n, "no numbers", remark=text) for n, text in columns.others.items()]
    dt = jitter = None
    if clock is not None:
        steps = np.diff(values[clock]) * TIME[unit]
        dt = float(np.median(steps))
        jitter = float(np.abs(steps - dt).max())
    report = FileReport(
        name=path.name,
        rows=max(map(len, values.values())),
        dt=dt,
        jitter=jitter,
        time_unit=unit,
        columns=(*reports.values(), *others),
        notes=tuple(notes),
        draft="",
    )
    return replace(report, draft=_draft(report))


def _find_clock(values: dict[str, Column]) -> str | None:
    """The column of times: it increases, and has such a name or does so regularly."""
    rising = {}
    for name, column in values.items():
        steps = np.diff(column)
        if len(steps) and np.isfinite(column).all() and (steps > 0).all():
            rising[name] = float(np.std(steps) / np.mean(steps))
    named = [name for name in rising if _CLOCK.search(name)]
    regular = [name for name, spread in rising.items() if spread < _REGULAR]
    return next(iter([*named, *regular]), None)


def _guess_time_unit(name: str, column: Column) -> str:
    """The unit of times by their name, else by the intervals: whole ones are no seconds."""
    match = _TIME_UNIT.search(name)
    if match:
        return match[2].lower()
    step = float(np.median(np.diff(column)))
    if step < 1 or (column != np.round(column)).any():
        return "s"
    return "ms" if step < 1000 else "us" if step < 1e6 else "ns"


def _guess_role(name: str, column: Column) -> ColumnReport:
    """A guess at a column: position if smooth, input if held or rough or by its name."""
    finite = column[np.isfinite(column)]
    extent = (float(finite.min()), float(finite.max())) if len(finite) else None
    lost = len(column) - len(finite)
    remark = f"{lost} not finite" if lost else ""
    distinct = len(np.unique(finite))
    if distinct < 2:
        return ColumnReport(name, "constant", extent, distinct, None, remark)
    steps = np.diff(finite)
    changes = float(np.mean(steps != 0))
    roughness = float(np.sqrt(np.mean(steps**2)) / np.std(finite))
    jump = float(np.abs(steps[steps != 0]).min() / np.ptp(finite))
    has_levels = changes < _FEW_CHANGES and jump > 1 / 50
    count = encoder_count(finite)
    if _INPUT.search(name) or has_levels or roughness > _SMOOTH:
        why = "held levels" if has_levels else "rough" if roughness > _SMOOTH else "by its name"
        return ColumnReport(name, "input", extent, distinct, None, remark or why)
    why = f"steps of {count:.6g}, as encoder counts" if count else "smooth"
    return ColumnReport(name, "position", extent, distinct, count, remark or why)


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
    """A card for the file, with comments on what must be checked."""
    by_role: dict[str, list[ColumnReport]] = {}
    for column in report.columns:
        by_role.setdefault(column.role, []).append(column)
    lines = [f"name = {_quote(Path(report.name).stem)}"]
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
        lines += [
            "", "[[coordinates]]", f"name = {_channel_name(column.name)}",
            'kind = "angular"  # or "linear"', f"column = {_key(column.name)}",
        ]  # fmt: skip
        if column.count is not None and abs(column.count - 1) < 1e-6:
            lines += ['unit = "counts"', "counts_per_revolution = 4096  # say how many"]
        else:
            lines += ['unit = "rad"  # or deg, rev, ...; m, mm, ... of a linear one']
        velocity = velocities.get(f"slope of '{column.name}'")
        if velocity:
            table = f"velocity = {{ column = {_key(velocity.name)}, measured = false }}"
            lines.append(f"{table}  # say its unit; measured: by a sensor of its own?")
    if not positions:
        lines += ["", "# [[coordinates]]: no column looks like a position"]
    for column in by_role.get("input", []):
        if column not in positions:
            lines += [
                "", "[[inputs]]", f"name = {_channel_name(column.name)}",
                f"column = {_key(column.name)}", 'unit = "V"  # say which',
            ]  # fmt: skip
    lines += ["", "[splits]", f"train = [{_quote(report.name)}]"]
    lines.append('# validation = ["another file"]')
    return "\n".join(lines) + "\n"


def _key(column: str) -> str:
    return column.removeprefix(NUMBERED) if column.startswith(NUMBERED) else _quote(column)


def _channel_name(column: str) -> str:
    return _quote(re.sub(r"[\s/\\]+", "_", column).lstrip(".") or "column")


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
