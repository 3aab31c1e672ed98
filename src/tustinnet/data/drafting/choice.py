"""The choice of coordinates and inputs among the columns, with units and open questions."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tustinnet.channels import Kind
from tustinnet.data.drafting.numbers import Values
from tustinnet.data.drafting.names import INPUTS, NameReading, Quantity
from tustinnet.data.drafting.numbers import Numbers, counts_in_turn, is_decimal
from tustinnet.data.drafting.relations import (
    Slopes,
    compare_courses,
    explained_acceleration,
    find_copy,
)
from tustinnet.data.drafting.roles import FAINT, Verdict
from tustinnet.data.units import ANGLE, LENGTH, convert_to_si

_SAME_FACTOR = 0.02  # relative; factors of units this near are equal
_MOST_RADIANS = 20.0  # an angle without a unit that moves farther is in degrees
_MOST_METRES = 5.0  # a length without a unit that moves farther is in mm
_OVERFLOWS = (2.0**16, 2.0**32)  # where counters start again, not encoders
_USUAL_COUNTS = 4096
_CLEAR = 3.0  # score of a column that is surely a position
_TELLING, _IDLE = 0.3, 0.1  # share of an acceleration that tells, share of it that is nothing
_ROLES = ("none", "position", "velocity", "input", "set point")
_QUANTITY_UNITS: dict[Quantity, str] = {
    "voltage": "V", "current": "A", "torque": "N m", "force": "N", "pressure": "bar",
}  # fmt: skip
# what moves first comes first: of a voltage and the current that it drives, the voltage is the input
_RANKS: dict[Quantity, int] = {
    "voltage": 0, "duty": 0, "control": 0, "torque": 1, "force": 1, "current": 2, "pressure": 3,
}  # fmt: skip
# SI units in units of speeds, of angles and of lengths
_ANGULAR_SPEEDS = {**{f"{u}/s": f for u, f in ANGLE.items()}, "rpm": 2 * np.pi / 60}
_LINEAR_SPEEDS = {**{f"{u}/s": f for u, f in LENGTH.items()}, "km/h": 1 / 3.6}
_SENSORS = {"tacho", "tachometer", "gyro", "imu", "resolver", "drehrate"}
_DISTURBANCES = {"disturbance", "stoerung", "wind", "stoermoment", "stoerkraft"}


@dataclass(frozen=True)
class Question:
    """What the columns do not say.

    Attributes:
        key: name of the answer.
        text: the question.
        assumption: the answer that is taken without another one.
        options: answers that are possible, () for any text or number.
        is_number: whether the answer is a positive number.
    """

    key: str
    text: str
    assumption: str
    options: tuple[str, ...] = ()
    is_number: bool = False


@dataclass(frozen=True)
class VelocityChoice:
    """The velocity column of a coordinate; attributes as in the card."""

    column: str
    unit: str | None
    measured: bool
    because: str


@dataclass(frozen=True)
class CoordinateChoice:
    """A coordinate of the draft.

    Attributes:
        column: its column.
        name: its name.
        kind: angular or linear.
        unit: its unit as the card has it.
        counts: encoder counts in a turn, None where not known.
        resolution: encoder count [rad or m], None where not known.
        velocity: its velocity column, if there is one.
        because: the reasons, a sentence each.
        doubts: what to check, a sentence each.
    """

    column: str
    name: str
    kind: Kind
    unit: str
    counts: int | None = None
    resolution: float | None = None
    velocity: VelocityChoice | None = None
    because: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class InputChoice:
    """An input of the draft; attributes as those of a coordinate."""

    column: str
    name: str
    unit: str
    because: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass
class Choice:
    """Coordinates, inputs, columns that are not used, and open questions.

    Attributes:
        coordinates: the coordinates in the order of their columns.
        inputs: the inputs.
        unused: the reason for each column that is not used.
        questions: what the columns do not say.
    """

    coordinates: list[CoordinateChoice] = field(default_factory=list)
    inputs: list[InputChoice] = field(default_factory=list)
    unused: dict[str, str] = field(default_factory=dict)
    questions: list[Question] = field(default_factory=list)


@dataclass(frozen=True)
class Findings:
    """Everything that is known of the columns when channels are chosen."""

    readings: Mapping[str, NameReading]
    numbers: Mapping[str, Numbers]
    samples: Mapping[str, Sequence[Values]]
    times: Sequence[Values]
    slopes: Slopes
    verdicts: Mapping[str, Verdict]
    answers: Mapping[str, str]

    def columns(self, role: str) -> list[str]:
        """The columns of a role, in the order of the file."""
        return [name for name, verdict in self.verdicts.items() if verdict.role == role]


def choose_channels(findings: Findings) -> Choice:
    """Chooses coordinates with their velocities, inputs, and says why others are not used."""
    choice = Choice()
    positions = _without_copies(_clear_positions(findings, choice), findings, choice)
    velocities = findings.columns("velocity")
    only_speeds = not positions and bool(velocities)
    if only_speeds:
        positions = _without_copies(velocities, findings, choice)
        velocities = []
    if not positions:
        positions = _most_like_positions(findings)
    inputs = [name for name in _choose_inputs(findings, choice) if name not in positions]
    names = _channel_names(positions, inputs, findings.readings)
    matched = _match_velocities(positions, velocities, findings, choice)
    for column in positions:
        if only_speeds:
            coordinate = _speed_coordinate(column, names[column], findings, choice)
        else:
            kind = _kind_by_inputs(inputs, findings)
            velocity = matched.get(column)
            coordinate = _coordinate(column, names[column], velocity, kind, findings, choice)
        choice.coordinates.append(coordinate)
    for column in inputs:
        choice.inputs.append(_input(column, names[column], findings, choice))
    used = {*positions, *inputs, *matched.values()}
    for name, verdict in findings.verdicts.items():
        if name not in used and name not in choice.unused:
            choice.unused[name] = _why_unused(name, verdict)
    return choice


def _why_unused(name: str, verdict: Verdict) -> str:
    article = "an" if verdict.role[0] in "aeio" else "a"
    what = "constant" if verdict.role == "constant" else f"{article} {verdict.role}"
    what = {"other": "no quantity of the motion", "flag": "a flag"}.get(verdict.role, what)
    return what if verdict.role == "constant" else f"{what}: {verdict.because}"


def _clear_positions(findings: Findings, choice: Choice) -> list[str]:
    """Positions without those for which little speaks, where for others much does."""
    positions = findings.columns("position")
    scores = {name: findings.verdicts[name].score for name in positions}
    answered = {name for name in positions if f"role {name}" in findings.answers}
    if max(scores.values(), default=0.0) < _CLEAR:
        return positions
    for name in positions:
        if scores[name] < FAINT and name not in answered:
            choice.unused[name] = (
                f"perhaps a position ({findings.verdicts[name].because}), beside columns that say so"
            )
            choice.questions.append(
                Question(f"role {name}", f"what is '{name}'?", "none", _ROLES)
            )
    return [name for name in positions if name not in choice.unused]


def _most_like_positions(findings: Findings) -> list[str]:
    """The column to take for a position where none looks like one."""
    for role in ("input", "set point", "flag", "other"):
        if names := findings.columns(role):
            smooth = [name for name in names if findings.numbers[name].smooth]
            return [(smooth or names)[0]]
    return []


def _without_copies(names: list[str], findings: Findings, choice: Choice) -> list[str]:
    """Positions without those that repeat another one, in another unit or filtered."""
    kept: list[str] = []
    # raw readings and columns with a unit before those that were made of them
    order = sorted(names, key=lambda name: (
        findings.readings[name].qualifier in ("filtered", "model"),
        not findings.readings[name].unit or findings.readings[name].unit == "counts",
        names.index(name),
    ))  # fmt: skip
    for name in order:
        for other in kept:
            a, b = findings.readings[name], findings.readings[other]
            factor = find_copy(findings.samples[other], findings.samples[name])
            # a stiff machine moves as one, and motor and load are two coordinates nevertheless
            is_one_thing = a.object == b.object or not (a.object and b.object)
            if factor is not None and is_one_thing:
                choice.unused[name] = f"{factor:.6g} times '{other}'"
                break
            is_alike = a.object == b.object and a.quantity == b.quantity
            if is_alike and (a.qualifier != b.qualifier or a.unit != b.unit):
                course = compare_courses(findings.samples[other], findings.samples[name])
                if course.correlation > 0.9:
                    choice.unused[name] = f"the quantity of '{other}' once more"
                    break
        else:
            kept.append(name)
    return [name for name in names if name in kept]


# --- velocities ---


def _match_velocities(
    positions: Sequence[str], velocities: Sequence[str], findings: Findings, choice: Choice
) -> dict[str, str]:
    """The velocity column of each position, if every one has one."""
    candidates: list[tuple[float, str, str]] = []
    for velocity in velocities:
        for position in positions:
            correlation, _ = findings.slopes.between(position, velocity)
            a, b = findings.readings[velocity], findings.readings[position]
            is_alike = bool(a.object) and a.object == b.object
            fits = None in (a.kind, b.kind) or a.kind == b.kind
            if correlation < (0.6 if is_alike else 0.9) or not fits:
                continue
            is_raw = a.qualifier not in ("filtered", "model", "command")
            candidates.append((correlation + 0.2 * is_alike + 0.1 * is_raw, position, velocity))
    matched: dict[str, str] = {}
    for _, position, velocity in sorted(candidates, key=lambda c: -c[0]):
        if position not in matched and velocity not in matched.values():
            matched[position] = velocity
    for velocity in velocities:
        if velocity in matched.values():
            continue
        near = [p for score, p, v in candidates if v == velocity]
        correlations = [findings.slopes.between(p, velocity)[0] for p in positions]
        if near:
            choice.unused[velocity] = f"a second velocity of '{near[0]}'"
        elif correlations and min(correlations) < -0.9:
            choice.unused[velocity] = (
                f"a velocity in the other direction than '{positions[int(np.argmin(correlations))]}'"
            )
        else:
            choice.unused[velocity] = (
                f"a velocity, and the slope of no position ({findings.verdicts[velocity].because})"
            )
    if len(matched) < len(positions):
        missing = next(p for p in positions if p not in matched)
        for position, velocity in matched.items():
            choice.unused[velocity] = (
                f"the velocity of '{position}'; a card has one for every coordinate or none, and "
                f"'{missing}' has none"
            )
        return {}
    return matched


def _is_measured(position: str, velocity: str, findings: Findings) -> tuple[bool, str]:
    """Whether a velocity column has a sensor of its own, and the reason."""
    words = {*findings.readings[velocity].words}
    if found := words & _SENSORS:
        return True, f"a sensor of its own by its name ('{found.pop()}')"
    if findings.readings[velocity].qualifier == "measured" and words & {"meas", "measured", "mess"}:
        return True, "measured by its name"
    a = np.concatenate([np.gradient(q) for q in findings.samples[position]])
    b = np.concatenate(list(findings.samples[velocity]))
    if np.ptp(a) and np.ptp(b) and np.corrcoef(a, b)[0, 1] > 0.9999:
        return False, "computed from the positions: it is their difference"
    return False, "taken for computed from the positions; measured = true if by a sensor of its own"


# --- coordinates ---


def _coordinate(
    column: str, name: str, velocity: str | None, input_kind: Kind | None, findings: Findings,
    choice: Choice,
) -> CoordinateChoice:  # fmt: skip
    """A coordinate with its unit: by name, by wraps, by its velocity, by its steps, by its size."""
    reading, numbers = findings.readings[column], findings.numbers[column]
    because = list(findings.verdicts[column].reasons)
    doubts: list[str] = []
    unit = reading.unit
    if unit == "rad" and numbers.whole and not reading.in_brackets:
        unit = ""  # whole numbers are no radians: a word, as the German one for a wheel
    kind: Kind | None = reading.kind
    counts: int | None = None
    velocity_unit = findings.readings[velocity].unit if velocity else ""
    factor = findings.slopes.between(column, velocity)[1] if velocity else None
    if numbers.wrap is not None and not unit:
        kind = "angular"
        if numbers.wrap == 360.0 and not (numbers.whole and numbers.distinct > 350):
            unit = "deg"
        elif numbers.wrap == 1.0:
            unit = "rev"
        elif numbers.wrap < 7:
            unit = "rad"
        elif numbers.wrap == 360.0:
            unit = "deg"
        else:
            unit = "counts"
    if unit in ("", "counts") and numbers.wrap not in (None, *_OVERFLOWS, 360.0, 1.0):
        counts = round(numbers.wrap or 0) if (numbers.wrap or 0) > 7 else None
    if not unit:
        unit = _unit_by_velocity(numbers, velocity_unit, factor, kind)
        if unit:
            because.append(f"in {unit} by its velocity '{velocity}'")
    if not unit:
        unit = _unit_by_steps(numbers, kind)
        if unit:
            because.append(f"in {unit} by its steps of {numbers.count:.6g}")
    if unit and kind is None:
        kind = "linear" if unit in LENGTH else "angular" if unit in ANGLE else None
    if kind is None and velocity_unit:
        kind = findings.readings[velocity or ""].kind
    if kind is None and input_kind is not None:
        kind = input_kind
        because.append(f"{kind}, as a {'torque' if kind == 'angular' else 'force'} drives it")
    key = f"unit {column}"
    if key in findings.answers:
        unit = findings.answers[key]
        kind = kind if unit == "counts" else "linear" if unit in LENGTH else "angular"
        because.append(f"in {unit} as you say")
    elif not unit:
        kind_said = kind is not None
        guessed_kind: Kind = kind or "angular"
        unit, is_clear = _unit_by_size(numbers, guessed_kind)
        reason = f"in {unit} by its range {_range(numbers)}"
        if kind_said and is_clear:
            because.append(reason)
        else:
            doubts.append(f"the unit: {reason}" + ("" if kind_said else ", if it is an angle"))
            options = ("rad", "deg", "counts", "m", "mm")
            choice.questions.append(
                Question(key, f"unit of the position '{column}' (range {_range(numbers)})", unit, options)
            )
        kind = guessed_kind
    if unit not in (*ANGLE, *LENGTH, "counts"):
        kind = _kind_of_unit(unit)
    if kind is None:
        kind = "angular"
    if unit == "counts" and kind == "angular":
        counts = counts or _counts_by_velocity(velocity_unit, factor) or _counts_by_copy(column, findings)
        counts = _ask_counts(column, counts, numbers, findings, choice, because, doubts)
        resolution = None
    elif unit == "counts":
        resolution = _ask_resolution(column, velocity_unit, factor, findings, choice, doubts)
    else:
        resolution = None
        step = numbers.count
        if step is not None and not numbers.levels:
            if kind == "angular" and unit in ANGLE:
                counts = counts_in_turn(step, 2 * np.pi / ANGLE[unit])
            factor_to_si = _si_factor(unit)
            if counts is None and factor_to_si is not None and numbers.smooth:
                resolution = float(f"{step * factor_to_si:.6g}")
    return CoordinateChoice(
        column, name, kind, unit, counts, resolution,
        _velocity(column, velocity, unit, kind, factor, findings), tuple(because), tuple(doubts),
    )  # fmt: skip


def _kind_by_inputs(inputs: Sequence[str], findings: Findings) -> Kind | None:
    """The kind of coordinates that are driven by torques only, or by forces only."""
    quantities = {findings.readings[name].quantity for name in inputs}
    if quantities == {"torque"}:
        return "angular"
    return "linear" if quantities == {"force"} and len(inputs) == 1 else None


def _range(numbers: Numbers) -> str:
    low, high = numbers.range or (np.nan, np.nan)
    return f"{low:.4g} .. {high:.4g}"


def _si_factor(unit: str) -> float | None:
    try:
        return convert_to_si(unit)[0]
    except ValueError:
        return None


def _kind_of_unit(unit: str) -> Kind:
    try:
        return "angular" if convert_to_si(unit)[1] == "rad" else "linear"
    except ValueError:
        return "linear"


def _unit_by_velocity(
    numbers: Numbers, velocity_unit: str, factor: float | None, kind: Kind | None
) -> str:
    """The unit of a position by the factor of its velocity, empty where it says none."""
    if factor is None or factor <= 0:
        return ""
    tables: list[tuple[Mapping[str, float], Mapping[str, float]]] = []
    if kind != "linear":
        tables.append((ANGLE, _ANGULAR_SPEEDS))
    if kind != "angular":
        tables.append((LENGTH, _LINEAR_SPEEDS))
    for units, speeds in tables:
        for unit in (u for u in units if u not in ("in", "um", "mrad")):
            for speed, size in speeds.items():
                # a factor of 1 without any unit says only that both have the same
                if speed != velocity_unit and (velocity_unit or speed == f"{unit}/s"):
                    continue
                if abs(factor * size / units[unit] - 1) < _SAME_FACTOR:
                    # counts may have any factor
                    return "" if numbers.whole and not velocity_unit else unit
    if numbers.whole and numbers.largest > 50 and _counts_by_velocity(velocity_unit, factor):
        return "counts"
    return ""


def _unit_by_steps(numbers: Numbers, kind: Kind | None) -> str:
    """The unit of a position by the step of its encoder, empty where that says none."""
    step = numbers.count
    if step is None:
        return ""
    if numbers.whole and abs(step - 1) < 1e-6:
        return "counts"
    if kind == "linear" or is_decimal(step):
        return ""
    for unit, turn in (("deg", 360.0), ("rad", 2 * np.pi), ("rev", 1.0)):
        if counts_in_turn(step, turn) is not None:
            return unit
    return ""


def _unit_by_size(numbers: Numbers, kind: Kind) -> tuple[str, bool]:
    """The unit of a position by its range, and whether that is clear."""
    if numbers.whole and numbers.distinct > 2:
        return "counts", True
    if kind == "linear":
        if numbers.largest <= _MOST_METRES:
            return "m", numbers.largest <= 3
        return "mm", numbers.largest > 30
    if numbers.largest <= _MOST_RADIANS:
        return "rad", numbers.largest <= 2.5 * np.pi
    return "deg", 30 < numbers.largest <= 400


def _counts_by_velocity(velocity_unit: str, factor: float | None) -> int | None:
    """Counts in a turn, by the factor from a position in counts to a velocity in a known unit."""
    if velocity_unit not in _ANGULAR_SPEEDS or not factor or factor <= 0:
        return None
    counts = 2 * np.pi / _ANGULAR_SPEEDS[velocity_unit] / factor
    for usual in (4096, 2048, 8192, 1024, 16384, 512, 65536, 2000, 4000, 1000, 10000, 2400, 20000,
                  1440, 3600, 1200, 2880, 2500, 500, 360, 8000, 5000, 1600, 3200, 40000):  # fmt: skip
        if abs(counts / usual - 1) < _SAME_FACTOR / 2:
            return usual
    return round(counts) if counts >= 1 else None


def _counts_by_copy(column: str, findings: Findings) -> int | None:
    """Counts in a turn, by another column that is the position in rad or degrees."""
    for other, reading in findings.readings.items():
        if other == column or reading.unit not in ANGLE or other not in findings.samples:
            continue
        factor = find_copy(findings.samples[column], findings.samples[other])
        if factor:
            return round(2 * np.pi / ANGLE[reading.unit] / abs(factor))
    return None


def _ask_counts(
    column: str, counts: int | None, numbers: Numbers, findings: Findings, choice: Choice,
    because: list[str], doubts: list[str],
) -> int:  # fmt: skip
    """Counts in a turn, as known, as answered, or as assumed with a question."""
    key = f"counts {column}"
    if key in findings.answers:
        because.append(f"{findings.answers[key]} counts in a turn as you say")
        return int(float(findings.answers[key]))
    if counts is not None:
        because.append(f"{counts} counts in a turn")
        return counts
    overflow = f", which starts again at {numbers.wrap:.0f}" if numbers.wrap in _OVERFLOWS else ""
    choice.questions.append(
        Question(
            key, f"counts in a turn of the encoder '{column}'{overflow}", str(_USUAL_COUNTS),
            is_number=True,
        )  # fmt: skip
    )
    doubts.append(f"counts in a turn: {_USUAL_COUNTS} is assumed")
    return _USUAL_COUNTS


def _ask_resolution(
    column: str, velocity_unit: str, factor: float | None, findings: Findings, choice: Choice,
    doubts: list[str],
) -> float:  # fmt: skip
    """The length of a count [m], by its velocity, as answered, or as assumed with a question."""
    key = f"resolution {column}"
    if key in findings.answers:
        return float(findings.answers[key])
    if velocity_unit in _LINEAR_SPEEDS and factor:
        return float(f"{factor * _LINEAR_SPEEDS[velocity_unit]:.4g}")
    text = f"length of a count of '{column}' [m]"
    choice.questions.append(Question(key, text, "1e-05", is_number=True))
    doubts.append("the length of a count: 1e-05 m is assumed")
    return 1e-5


def _velocity(
    column: str, velocity: str | None, unit: str, kind: Kind, factor: float | None,
    findings: Findings,
) -> VelocityChoice | None:  # fmt: skip
    """The velocity column of a coordinate with its unit: by its name, else by the factor."""
    if velocity is None or factor is None:
        return None
    measured, because = _is_measured(column, velocity, findings)
    speed: str | None = findings.readings[velocity].unit or None
    if speed is None and unit in (*ANGLE, *LENGTH):
        units = ANGLE if kind == "angular" else LENGTH
        speeds = _ANGULAR_SPEEDS if kind == "angular" else _LINEAR_SPEEDS
        for candidate in (f"{unit}/s", *speeds):
            if abs(factor * speeds[candidate] / units[unit] - 1) < 2 * _SAME_FACTOR:
                speed = candidate
                because += f"; in {candidate} by its size"
                break
    elif speed is None and unit == "counts" and kind == "angular" and abs(factor - 1) > 0.05:
        because += "; check its unit"
    return VelocityChoice(velocity, speed, measured, because)


def _speed_coordinate(
    column: str, name: str, findings: Findings, choice: Choice
) -> CoordinateChoice:
    """A speed as a coordinate of its own, where no position is measured."""
    reading, numbers = findings.readings[column], findings.numbers[column]
    unit, doubts = reading.unit, []
    key = f"unit {column}"
    if key in findings.answers:
        unit = findings.answers[key]
    elif not unit:
        unit = "m/s" if reading.kind == "linear" else "rpm" if numbers.largest > 300 else "rad/s"
        doubts = [f"the unit: {unit} by its range {_range(numbers)}"]
        options = ("rad/s", "rpm", "deg/s", "m/s", "mm/s", "V")
        choice.questions.append(
            Question(key, f"unit of the speed '{column}' (range {_range(numbers)})", unit, options)
        )
    because = (
        *findings.verdicts[column].reasons,
        "no position is measured, so the speed is the coordinate (docs/how-to/speed-only.md)",
    )
    return CoordinateChoice(column, name, "linear", unit, because=because, doubts=tuple(doubts))


# --- inputs ---


def _choose_inputs(findings: Findings, choice: Choice) -> list[str]:
    """The columns that move first: commands before measured values, voltages before currents."""
    candidates = findings.columns("input")
    set_points = findings.columns("set point")
    if not candidates and set_points:
        # a machine whose controller is part of what is modelled
        kept = [name for name in set_points if findings.readings[name].qualifier == "command"]
        chosen = kept or set_points
        by_follower: dict[str | None, str] = {}
        for name in chosen:  # of a position's and its speed's set point the first
            by_follower.setdefault(findings.verdicts[name].leads or name, name)
        positions = [n for n in by_follower.values() if _leads_position(n, findings)]
        return positions or list(by_follower.values())
    kept = []
    for name in candidates:
        copy = next((o for o in kept if _is_copy(o, name, findings)), None)
        if copy is not None:
            choice.unused[name] = f"proportional to the input '{copy}'"
            continue
        kept.append(name)
    ranked = {name: _rank(name, findings) for name in kept}
    best = _best_rank(ranked, findings)
    inputs: list[str] = []
    for name in kept:
        reading, rank = findings.readings[name], ranked[name]
        is_disturbance = bool(_DISTURBANCES & {*reading.words})
        if best is None or rank == best or is_disturbance:
            inputs.append(name)
        elif rank is None:
            what = findings.verdicts[name].because
            choice.unused[name] = f"perhaps an input ({what}), beside columns that say so"
        else:
            first = next(n for n in kept if ranked[n] == best)
            is_later = rank > best
            choice.unused[name] = (
                f"an effect of '{first}', which moves first" if is_later
                else f"explains little of the motion, unlike '{first}'"
            )  # fmt: skip
    return inputs


def _best_rank(
    ranked: Mapping[str, tuple[int, int] | None], findings: Findings
) -> tuple[int, int] | None:
    """The first rank in the chain of causes of which a column moves anything."""
    ranks = sorted({rank for rank in ranked.values() if rank is not None})
    if len(ranks) < 2:
        return next(iter(ranks), None)
    positions = findings.columns("position")
    shares = {
        rank: max(
            (explained_acceleration(findings.samples[name], findings.samples[p], findings.times)
             for name in ranked if ranked[name] == rank for p in positions),
            default=0.0,
        )
        for rank in ranks
    }  # fmt: skip
    most = max(shares.values())
    # friction and loads hide what an input does; a column that explains nothing beside it is none
    return next(rank for rank in ranks if most < _TELLING or shares[rank] > _IDLE * most)


def _leads_position(name: str, findings: Findings) -> bool:
    """Whether a set point is that of a position."""
    leads = findings.verdicts[name].leads
    return leads is not None and findings.verdicts[leads].role == "position"


def _is_copy(first: str, second: str, findings: Findings) -> bool:
    return find_copy(findings.samples[first], findings.samples[second]) is not None


def _rank(name: str, findings: Findings) -> tuple[int, int] | None:
    """The place of an input in the chain of causes: by quantity, then commands before others."""
    reading = findings.readings[name]
    ranks = [
        (-weight, _RANKS[quantity])
        for quantity, weight in reading.quantities.items()
        if quantity in _RANKS
    ]
    if not ranks:
        return None if reading.qualifier != "command" else (0, 0)
    quantity_rank = min(ranks)[1]
    order = {"command": 0, None: 1, "measured": 2, "filtered": 3, "model": 4}[reading.qualifier]
    # a commanded current moves before a measured torque
    return (0 if order == 0 else 1 + quantity_rank, order)


def _input(column: str, name: str, findings: Findings, choice: Choice) -> InputChoice:
    """An input with its unit: by its name, else by the quantity that its words say."""
    reading, numbers = findings.readings[column], findings.numbers[column]
    doubts: list[str] = []
    quantity = reading.quantity
    key = f"unit {column}"
    unit = findings.answers.get(key) or reading.unit
    if not unit and quantity in _QUANTITY_UNITS and reading.quantities[quantity] >= 3:
        unit = _QUANTITY_UNITS[quantity]
    if not unit and quantity == "duty":
        unit = "%" if 1.5 < numbers.largest <= 100 else "1"
    leads = findings.verdicts[column].leads
    if not unit and leads is not None:
        unit = findings.readings[leads].unit
    if not unit:
        weak = [q for q in reading.quantities if q in _QUANTITY_UNITS]
        unit = _QUANTITY_UNITS[weak[0]] if weak else "1"
        doubts.append(f"the unit: {unit} is assumed")
        choice.questions.append(
            Question(key, f"unit of the input '{column}' (range {_range(numbers)})", unit)
        )
    verdict = findings.verdicts[column]
    if verdict.role == "set point":
        doubts.append("a set point: the model includes the controller")
    if verdict.rival in ("position", "set point"):
        doubts.append(f"an input, or a {verdict.rival}?")
    return InputChoice(column, name, unit, verdict.reasons, tuple(doubts))


# --- names ---


def _channel_names(
    positions: Sequence[str], inputs: Sequence[str], readings: Mapping[str, NameReading]
) -> dict[str, str]:
    """Names of channels by column, as short as they stay different: the last parts of paths."""
    columns = [*positions, *inputs]
    names: dict[str, str] = {}
    for length in (1, 2, 3, 99):
        for is_short in (True, False):
            remaining = [c for c in columns if c not in names]
            named = {c: _part_of_name(c, length, readings[c], is_short) for c in remaining}
            counts = Counter(named.values())
            for column, name in named.items():
                if name and counts[name] == 1 and name not in names.values():
                    names[column] = name
    return names


def _part_of_name(column: str, length: int, reading: NameReading, is_short: bool) -> str:
    """The last parts of a column's name as the name of a channel, without its unit if `is_short`."""
    name = _without_unit(column, reading) if is_short else column
    parts = [part for part in re.split(r"[/.]", name) if part.strip()]
    return re.sub(r"[\s\\]+", "_", "_".join(parts[-length:]).strip())


def _without_unit(name: str, reading: NameReading) -> str:
    """A channel's name without the unit in it."""
    if not reading.unit:
        return name
    if reading.in_brackets:
        shorter = re.sub(r"[\W_]*[\[({<][^\[\](){}<>]*[\])}>]", "", name)
        return re.sub(r"(?i)(_in_\S+|/.*)$", "", shorter) if shorter == name else shorter
    return re.sub(r"([\W_]*(per|[^\W\d_]{1,6}))?[\W_]*[^\W\d_]+\d*[\W_]*$", "", name) if (
        reading.unit.endswith("/s") and not re.search(r"(?i)(rpm|dps|mps|rads)\d*$", name)
    ) else re.sub(r"[\W_]*[^\W\d_]+\d*[\W_]*$", "", name)
