"""Inspection of a single file of columns without a card: guesses, and the draft of a card."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from tustinnet.data.columns import NUMBERED, Column, Columns
from tustinnet.data.readers import read_columns
from tustinnet.data.units import ANGLE, LENGTH, TIME
from tustinnet.errors import InputError
from tustinnet.signals.encoder import encoder_count

Role = Literal["time", "position", "velocity", "input", "constant", "no numbers"]

_MOST = 60  # columns that are examined
_CLOCK = re.compile(r"(?i)(^|[^a-z])(t|time|times|timestamp|clock|sec|seconds)([^a-z]|$)")
_TIME_UNIT = re.compile(r"(?i)(^|[^a-z])(ms|us|ns)([^a-z]|$)")
_REGULAR = 0.5  # relative deviation of the intervals of a clock that has another name
_SMOOTH = 0.3  # a position moves by less than this share of its spread from sample to sample
_FEW_CHANGES = 0.2  # of samples: an input that changes less often is held at levels
_DERIVATIVE = 0.9  # correlation of a velocity with the slope of its position

# endings of names, in lower case; `in` is rather an input than an inch
_POSITION_UNITS = {
    **{unit: unit for unit in (*ANGLE, *LENGTH) if unit != "in"},
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("degree", "degrees"), "deg"),
    **dict.fromkeys(("cnt", "cnts", "count", "counts", "tick", "ticks", "pulses"), "counts"),
    "\N{MICRO SIGN}m": "um",
}
_INPUT_UNITS = {
    **dict.fromkeys(("v", "volt", "volts"), "V"),
    **dict.fromkeys(("a", "amp", "amps"), "A"),
    **dict.fromkeys(("pct", "percent"), "%"),
    "mv": "mV", "ma": "mA", "n": "N", "nm": "N m", "mnm": "mN m",
}  # fmt: skip
# words in names, which decide where no unit does
_COMMANDS = {"cmd", "command", "setpoint", "target", "ref", "reference", "desired"}
_FORCES = {"u", "in", "input", "voltage", "torque", "force", "effort", "current", "control"}
_FORCES |= {"pwm", "duty"}
_DRIVES = {"motor", "drive", "actuator"}  # have encoders, too
_VELOCITIES = {"velocity", "velocities"}
_POSITIONS = {"enc", "encoder", "pos", "position", "angle"}


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
        unit: the unit that its name ends in, empty without one.
    """

    name: str
    role: Role
    range: tuple[float, float] | None = None
    distinct: int = 0
    count: float | None = None
    remark: str = ""
    unit: str = ""


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
    elif columns.parts:
        labels = [*columns.parts]
        notes.append(f"{len(labels)} records; the columns are of the first one, {labels[0]}")
        columns = columns.part(labels[0])
    examined = columns.names[:_MOST]
    if len(columns.names) > _MOST and not columns.clocks:
        notes.append(f"{len(columns.names)} columns; the first {_MOST} are looked at")
    elif len(columns.names) > _MOST:
        examined = _most_telling(columns)
        text = f"{len(examined)} of {len(columns.names)} columns are looked at"
        notes.append(f"{text}, those named as positions and inputs first")
    values: dict[str, Column] = {}
    reports: dict[str, ColumnReport] = {}
    for name in examined:
        try:
            values[name] = columns[name]
            reports[name] = ColumnReport(name, "constant")  # holds its place
        except InputError as error:
            remark = str(error).split(": ", 1)[-1]
            reports[name] = ColumnReport(name, "no numbers", remark=remark)
    if not values:
        raise InputError(path, "no column of numbers", "a column of times, positions or inputs")
    clocks = {name: columns.clocks[name] for name in values if name in columns.clocks}
    guesses, clock, unit = _guess_roles(values, columns.units, clocks)
    reports |= guesses
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
    return replace(report, draft=_draft(report, clock))


def find_clock(columns: Columns) -> tuple[str, str, float] | None:
    """The probable column of times of a file: its name, its unit, the median interval [s]."""
    values: dict[str, Column] = {}
    for name in columns.names[:_MOST]:
        with suppress(InputError):  # no numbers
            values[name] = columns[name]
    clock = _find_clock(values)
    if clock is None:
        return None
    unit = _guess_time_unit(clock, values[clock])
    return clock, unit, float(np.median(np.diff(values[clock]))) * TIME[unit]


def _most_telling(columns: Columns) -> tuple[str, ...]:
    """Columns that are named as positions, velocities or inputs, then others, and their times."""
    telling = _POSITIONS | _VELOCITIES | _COMMANDS | _FORCES | {"joint", "joints"}
    own = [name for name in columns.names if columns.clocks.get(name) != name]
    chosen = {*sorted(own, key=lambda name: not telling & {*_words(name)})[:_MOST]}
    chosen |= {columns.clocks[name] for name in chosen if name in columns.clocks}
    return tuple(name for name in columns.names if name in chosen)


def _guess_roles(
    values: Mapping[str, Column], units: Mapping[str, str], clocks: Mapping[str, str]
) -> tuple[dict[str, ColumnReport], str | None, str]:
    """Guesses at all columns of numbers, the column of times, and the unit of the times.

    Args:
        values: the columns.
        units: units by column, where the file has them.
        clocks: columns of times by column, where columns have times of their own.
    """
    clock = None if clocks else _find_clock(values)
    times = {*clocks.values(), clock}
    reports = {n: _guess_role(n, c, units.get(n, "")) for n, c in values.items() if n not in times}
    if clocks:  # the times are those of what is probably the first coordinate
        order = {"position": 0, "input": 1}
        timed = [name for name in reports if name in clocks] or [*clocks]
        first = min(timed, key=lambda n: order.get(reports[n].role, 2) if n in reports else 2)
        clock = clocks[first]
    unit = "s" if clock is None or clocks else _guess_time_unit(clock, values[clock])
    for name, report in reports.items():
        # of a position whose unit is known, another one may be the slope by chance
        if report.role == "velocity" or (report.role == "position" and not report.unit):
            others = {n: v for n, v in values.items() if clocks.get(n) == clocks.get(name)}
            slope_of = _find_position(name, reports, others)
            if slope_of is not None:
                reports[name] = replace(
                    report, role="velocity", count=None, remark=f"slope of '{slope_of}'"
                )
    for name, column in values.items():
        if name in times:
            extent = float(column[0]), float(column[-1])
            remark = "in s" if clocks else f"in {unit}?"
            reports[name] = ColumnReport(name, "time", extent, len(column), None, remark)
    return reports, clock, unit


def _find_clock(values: Mapping[str, Column]) -> str | None:
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


def _words(name: str) -> list[str]:
    """The words of a column's name in lower case, without numbers: `motorCnt 1` has two."""
    spaced = re.sub(r"(?<=[a-z]{2})(?=[A-Z])", "_", name).lower()
    words = (word.rstrip("0123456789") or word for word in re.split(r"[\W_]+", spaced))
    return [word for word in words if word and not word.isdigit()]


def _unit_at_end(words: Sequence[str]) -> tuple[Role, str] | None:
    """The role and the unit that the end of a column's name says, None where it says none."""
    *before, last = [word for word in words if word != "per"] or [""]
    if last in ("s", "sec") and before and before[-1] in _POSITION_UNITS:
        return "velocity", f"{_POSITION_UNITS[before[-1]]}/s"
    if last == "rpm":
        return "velocity", "rpm"
    if len(last) == 1 and (not before or (last in "anv" and _POSITIONS & {*before})):
        return None  # a name of one letter, or one of several encoders
    if last in _POSITION_UNITS:
        return "position", _POSITION_UNITS[last]
    return ("input", _INPUT_UNITS[last]) if last in _INPUT_UNITS else None


def _guess_role(name: str, column: Column, file_unit: str = "") -> ColumnReport:
    """A guess at a column: by its unit or that in its name, else by its values and its name."""
    finite = column[np.isfinite(column)]
    extent = (float(finite.min()), float(finite.max())) if len(finite) else None
    lost = len(column) - len(finite)
    remarks = [f"{lost} not finite"] if lost else []
    distinct = len(np.unique(finite))
    if distinct < 2:
        return ColumnReport(name, "constant", extent, distinct, None, "; ".join(remarks))
    steps = np.diff(finite)
    changes = float(np.mean(steps != 0))
    roughness = float(np.sqrt(np.mean(steps**2)) / np.std(finite))
    jump = float(np.abs(steps[steps != 0]).min() / np.ptp(finite))
    has_levels = changes < _FEW_CHANGES and jump > 1 / 50
    is_smooth = not has_levels and roughness <= _SMOOTH
    count = encoder_count(finite)
    words = _words(f"{name} [{file_unit}]" if file_unit else name)
    named, unit = _unit_at_end(words) or (None, "")
    role: Role
    if named is not None:
        is_command = named == "position" and bool(_COMMANDS & {*words})
        role = "input" if is_command else named
        source = "as the file says" if file_unit else "by its name"
        remarks.append(f"in {unit} {source}" + (", which is a command's" if is_command else ""))
    elif "action" in words:  # of robot learning: what was commanded
        role = "input"
        remarks.append("by its name")
    elif _VELOCITIES & {*words} and not (_COMMANDS | _POSITIONS) & {*words}:
        role = "velocity"
        remarks.append("by its name")
    elif _POSITIONS & {*words}:
        role = "position"
        remarks.append("by its name" if is_smooth else "by its name, though it is not smooth")
    elif not is_smooth:
        role = "input"
        remarks.append("held levels" if has_levels else "rough")
    elif (_COMMANDS | _FORCES) & {*words} or (count is None and _DRIVES & {*words}):
        role = "input"
        remarks.append("by its name")
    else:
        role = "position"
        remarks += [] if count else ["smooth"]
    if count and (role == "position" or is_smooth):
        remarks.append(f"steps of {count:.6g}, as encoder counts")
    count = count if role == "position" else None
    return ColumnReport(name, role, extent, distinct, count, "; ".join(remarks), unit)


def _find_position(
    name: str, reports: Mapping[str, ColumnReport], values: Mapping[str, Column]
) -> str | None:
    """The position of which a column is the slope, None where there is none."""
    column, unit = values[name], reports[name].unit
    for other, report in reports.items():
        position = values.get(other, column)
        is_angle = unit == "rpm" or unit.removesuffix("/s") not in LENGTH
        fits = not (unit and report.unit) or is_angle == (report.unit not in LENGTH)
        if other == name or report.role != "position" or not fits or len(position) != len(column):
            continue
        slope = np.gradient(position) if len(position) > 1 else position
        usable = np.isfinite(slope) & np.isfinite(column)
        if usable.sum() < 5 or not np.ptp(slope[usable]) or not np.ptp(column[usable]):
            continue
        if np.corrcoef(slope[usable], column[usable])[0, 1] > _DERIVATIVE:
            return other
    return None


# --- the draft of a card ---


def _draft(report: FileReport, clock: str | None) -> str:
    """A card for the file, with comments on why columns mean what it says and what to check.

    Args:
        report: the report on the file.
        clock: the column of times.
    """
    by_role: dict[str, list[ColumnReport]] = {}
    for column in report.columns:
        by_role.setdefault(column.role, []).append(column)
    lines = [f"name = {_quote(Path(report.name).stem)}"]
    if report.dt is None or clock is None:
        lines += ["dt = 0.01  # s: no column of times was found, say how far apart samples are"]
    else:
        lines += [
            f"dt = {float(f'{report.dt:.6g}')}  # s, the median interval", "", "[time]",
            f"column = {_key(clock)}", f'unit = "{report.time_unit}"  # check',
        ]  # fmt: skip
    positions = by_role.get("position") or by_role.get("input", [])[:1]
    inputs = [c for c in by_role.get("input", []) if c not in positions]
    by_remark = {c.remark: c for c in by_role.get("velocity", [])}
    velocities = {c.name: by_remark.get(f"slope of '{c.name}'") for c in positions}
    names = _channel_names([*positions, *inputs])
    roles = ("constant", "no numbers", "velocity")
    unused = [c for r in roles for c in by_role.get(r, []) if c not in velocities.values()]
    for column in positions:
        lines += _coordinate_lines(column, names[column.name])
        if (velocity := velocities[column.name]) is not None:
            says_unit = bool(velocity.unit and column.unit)
            entry = f", unit = {_quote(velocity.unit)}" if says_unit else ""
            line = f"velocity = {{ column = {_key(velocity.name)}{entry}, measured = false }}"
            check = "" if says_unit else "its unit; "
            line += f"  # check: {check}measured = true if by a sensor of its own"
            if None in velocities.values():
                line = f"# if every coordinate has one, or the others are left out:\n# {line}"
            lines.append(line)
    if not positions:
        lines += ["", "# [[coordinates]]: no column looks like a position"]
    for column in inputs:
        lines += [
            "", f"# {_quote(column.name)} as an input: {column.remark}",
            "[[inputs]]", f"name = {_quote(names[column.name])}", f"column = {_key(column.name)}",
            f"unit = {_quote(column.unit)}" if column.unit else 'unit = "V"  # check: say which',
        ]  # fmt: skip
    lines += [""] if unused else []
    for column in unused:
        why = column.remark or column.role
        if column.role == "velocity" and not why.startswith("slope of"):
            why += ", and the slope of no position"
            if not by_role.get("position"):
                why += "; a speed can be the coordinate itself: docs/how-to/speed-only.md"
        lines.append(f"# {_quote(column.name)} is not used: {why}")
    lines += [
        "", "# all logs beside this card are records; to choose some and what they are for:",
        "# [splits]", f"# train = [{_quote(report.name)}]", '# validation = ["another file"]',
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _coordinate_lines(column: ColumnReport, name: str) -> list[str]:
    """The lines of a coordinate in a card, but for its velocity."""
    unit = column.unit if column.role == "position" else ""
    if not unit and column.count is not None and abs(column.count - 1) < 1e-6:
        unit = "counts"
    kind = "linear" if unit in LENGTH else "angular"
    doubt = "" if column.role == "position" else "; check: no column looks like a position"
    lines = [
        "", f"# {_quote(column.name)} as a measured coordinate: {column.remark}{doubt}",
        "[[coordinates]]", f"name = {_quote(name)}", f"column = {_key(column.name)}",
    ]  # fmt: skip
    if not unit:
        return [
            *lines, 'kind = "angular"  # check: or "linear"',
            'unit = "rad"  # check: or deg, rev, ...; m, mm, ... of a linear one',
        ]  # fmt: skip
    lines += [f'kind = "{kind}"', f'unit = "{unit}"']
    if unit == "counts":
        lines += [
            "counts_per_revolution = 4096  # fill in: counts in a turn",
            '# (counts of a length: kind = "linear", and resolution = metres in a count)',
        ]
    return lines


def _channel_names(columns: Sequence[ColumnReport]) -> dict[str, str]:
    """Names of channels by column, without the units of columns where names stay different."""
    full = {c.name: re.sub(r"[\s/\\]+", "_", c.name).lstrip(".") or "column" for c in columns}
    short = {
        c.name: re.sub(r"[\W_]*[^\W\d_]+\d*[\W_]*$", "", full[c.name]) for c in columns if c.unit
    }
    counts = Counter({**full, **short}.values())
    return {
        name: short[name] if short.get(name) and counts[short[name]] == 1 else full[name]
        for name in full
    }


def _key(column: str) -> str:
    return column.removeprefix(NUMBERED) if column.startswith(NUMBERED) else _quote(column)


def _quote(text: str) -> str:
    """A text as TOML and JSON have it; TOML has no character 127."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
