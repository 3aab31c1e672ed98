"""Coordinates from position columns: kind, unit, resolution, and the velocity column's unit."""

import math
from collections.abc import Mapping

import numpy as np

from tustinnet.channels import Kind
from tustinnet.data.drafting.evidence import ANGULAR_SPEEDS, LINEAR_SPEEDS
from tustinnet.data.drafting.findings import (
    Choice,
    CoordinateChoice,
    Findings,
    Question,
    VelocityChoice,
    range_text,
)
from tustinnet.data.drafting.numbers import (
    Numbers,
    counts_in_turn,
    is_decimal,
    is_power_of_ten,
)
from tustinnet.data.units import ANGLE, LENGTH, TIME, convert_to_si

_COUNTS_A_SECOND = "counts/s"
_SAME_FACTOR = 0.02  # relative; factors of units this near are equal
_MOST_RADIANS = 20.0  # an angle without a unit that moves farther is in degrees
_MOST_METRES = 5.0  # a length without a unit that moves farther is in mm
_OVERFLOWS = (2.0**16, 2.0**32)  # where counters start again, not encoders
_ENCODERS = {"encoder", "encoders", "enc", "geber", "drehgeber", "resolver"}
_TILTS = {"pitch", "roll", "tilt"}  # against gravity, by less than half a turn
_UNITS_TO_CHOOSE = ("rad", "deg", "rev", "counts", "m", "mm")
_SENSORS = {"tacho", "tachometer", "gyro", "imu", "resolver", "drehrate"}


def describe_coordinate(
    column: str,
    name: str,
    velocity: str | None,
    input_kind: Kind | None,
    findings: Findings,
    choice: Choice,
    system_kind: Kind | None = None,
) -> CoordinateChoice:
    """A coordinate with its kind and unit, which the first of several kinds of evidence decides.

    Args:
        column: its column.
        name: its name.
        velocity: its velocity column, if there is one.
        input_kind: the kind of coordinate that the inputs move, if they say so.
        findings: what is known of the columns.
        choice: receives questions.
        system_kind: the kind of the joint whose position it is, where a system says it.
    """
    numbers = findings.numbers[column]
    because = list(findings.verdicts[column].reasons)
    doubts = [] if system_kind else _doubts(column, findings)
    if (sine := findings.sines.get(column)) is not None:
        factor = findings.slopes.between(column, velocity)[1] if velocity else None
        return CoordinateChoice(
            column,
            name,
            "angular",
            "rad",
            None,
            None,
            _velocity(column, velocity, "rad", "angular", factor, findings),
            tuple(because),
            (*doubts, f"the direction: '{column}' as the cosine, '{sine}' as the sine"),
            sine=sine,
        )
    factor = findings.slopes.between(column, velocity)[1] if velocity else None
    speed = findings.readings[velocity].unit if velocity else ""
    kind = system_kind or _find_kind(column, velocity, input_kind, findings, because)
    assumed: list[str] = []
    unit = _find_unit(column, speed, factor, kind, findings, because)
    if unit is None:
        unit = _unit_by_size(column, kind, findings, choice, because, doubts)
        assumed += ["unit"] if kind else ["kind", "unit"]
    known_kind, kind = kind, _kind_of_unit(unit, kind)
    counts = resolution = None
    if unit != "counts":
        counts, resolution = _resolution(numbers, unit, kind)
    elif kind == "angular":
        counts, is_assumed = _counts(column, speed, factor, findings, choice, because, doubts)
        if is_assumed:
            assumed += [key for key in ("kind",) if known_kind is None and key not in assumed]
            assumed.append("counts_per_revolution")
    else:
        resolution, is_assumed = _length_of_count(column, speed, factor, findings, choice, doubts)
        assumed += ["resolution"] * is_assumed
    in_turn = counts if unit == "counts" else None
    is_guess = kind == "angular" and "kind" in assumed
    return CoordinateChoice(
        column,
        name,
        kind,
        unit,
        counts,
        resolution,
        _velocity(column, velocity, unit, kind, factor, findings, in_turn),
        tuple(because),
        tuple(doubts),
        tuple(assumed),
        wraps=not is_guess or _jumps_by_turns_alone(findings.numbers[column], unit, counts),
    )


def _jumps_by_turns_alone(numbers: Numbers, unit: str, counts: int | None) -> bool:
    """Whether an angle has no jumps of more than half a turn but those of one that wraps."""
    turn = counts if unit == "counts" else 2 * np.pi / ANGLE[unit]
    return numbers.wrap is not None or turn is None or numbers.largest_step <= turn / 2


def _doubts(column: str, findings: Findings) -> list[str]:
    """The doubt whether a column is a position, where it could nearly as well be another thing."""
    verdict = findings.verdicts[column]
    return [f"a {verdict.role}, or {verdict.rival}?"] if verdict.is_open else []


def _find_kind(
    column: str,
    velocity: str | None,
    input_kind: Kind | None,
    findings: Findings,
    because: list[str],
) -> Kind | None:
    """The kind of a position: by wraps, by its name, by its velocity's, by what drives it."""
    reading = findings.readings[column]
    if findings.numbers[column].wrap is not None and not reading.unit:
        return "angular"
    kind = reading.kind or (findings.readings[velocity].kind if velocity else None)
    if kind is None and input_kind is not None:
        driver = "torque" if input_kind == "angular" else "force"
        because.append(f"{input_kind}, by the {driver} that drives it")
        return input_kind
    return kind


def _find_unit(
    column: str,
    speed: str,
    factor: float | None,
    kind: Kind | None,
    findings: Findings,
    because: list[str],
) -> str | None:
    """The unit of a position: as answered, by its name, wraps, velocity, steps; else None."""
    reading, numbers = findings.readings[column], findings.numbers[column]
    answer = findings.answer(f"unit {column}")
    if answer is not None:
        because.append(f"in {answer[0]} {answer[1]}")
        return answer[0]
    # whole numbers are no radians: a word, as the German one for a wheel
    is_word = reading.unit == "rad" and numbers.whole and not reading.in_brackets
    if reading.unit and not is_word and _is_card_unit(reading.unit):
        return reading.unit
    if numbers.wrap is not None:
        return _unit_of_turn(numbers)
    if unit := _unit_by_velocity(numbers, speed, factor, kind):
        because.append(f"in {unit} by its velocity")
        return unit
    if unit := _unit_by_steps(numbers, kind, is_named=bool(reading.quantities)):
        because.append(f"in {unit} by its steps of {numbers.count:.6g}")
        return unit
    return None


def _unit_of_turn(numbers: Numbers) -> str:
    """The unit in which a turn has the length at which a position starts again."""
    if numbers.wrap == 360.0:
        return "deg"
    return "counts" if numbers.whole else "rev" if numbers.wrap == 1.0 else "rad"


def _kind_of_unit(unit: str, kind: Kind | None) -> Kind:
    """The kind of a position in a unit; counts are of either kind."""
    if unit == "counts":
        return kind or "angular"
    if unit in ANGLE:
        return "angular"
    try:
        return "angular" if unit not in LENGTH and convert_to_si(unit)[1] == "rad" else "linear"
    except ValueError:
        return "linear"


def _is_card_unit(unit: str) -> bool:
    """Whether cards know a unit of positions."""
    if unit in (*ANGLE, *LENGTH, "counts"):
        return True
    if unit in TIME:  # a word, as of what was measured: `Boom Ms`
        return False
    try:
        convert_to_si(unit)
    except ValueError:
        return False
    return True


def _resolution(numbers: Numbers, unit: str, kind: Kind) -> tuple[int | None, float | None]:
    """Counts in a turn, or the step of a position [rad or m], where it moves in steps."""
    step = numbers.count
    if step is None or numbers.levels or numbers.range is None:
        return None, None
    if kind == "angular" and unit in ANGLE:
        counts = counts_in_turn(step, 2 * np.pi / ANGLE[unit])
        if counts is not None:
            return counts, None
    size = (ANGLE | LENGTH).get(unit)
    # a smaller step of 1, 0.1, ... is a file's rounding, no resolution
    is_coarse = step > 1e-4 * (numbers.range[1] - numbers.range[0])
    if size is None or not (is_coarse or not is_power_of_ten(step)):
        return None, None
    resolution = float(f"{step * size:.6g}")
    # rad or m, as cards have resolutions
    return None, resolution if 1e-12 < resolution < 1e6 else None


def _unit_by_velocity(
    numbers: Numbers, velocity_unit: str, factor: float | None, kind: Kind | None
) -> str:
    """The unit of a position by the factor of its velocity, empty where it says none."""
    if factor is None or factor <= 0:
        return ""
    if velocity_unit == _COUNTS_A_SECOND and abs(factor - 1) < _SAME_FACTOR:
        return "counts"
    tables: list[tuple[Mapping[str, float], Mapping[str, float]]] = []
    if kind != "linear":
        tables.append((ANGLE, ANGULAR_SPEEDS))
    if kind != "angular":
        tables.append((LENGTH, LINEAR_SPEEDS))
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


def _unit_by_steps(numbers: Numbers, kind: Kind | None, *, is_named: bool) -> str:
    """The unit of a position by the step of its encoder, empty where that says none.

    Converters from analog have steps of a power of two, of any quantity that no name says.
    """
    step = numbers.count
    if step is None:
        return ""
    if numbers.whole and abs(step - 1) < 1e-6:
        return "counts"
    if kind == "linear" or is_decimal(step):
        return ""
    for unit, turn in (("deg", 360.0), ("rad", 2 * np.pi), *[("rev", 1.0)] * is_named):
        if counts_in_turn(step, turn) is not None:
            return unit
    return ""


def _unit_by_size(
    column: str,
    kind: Kind | None,
    findings: Findings,
    choice: Choice,
    because: list[str],
    doubts: list[str],
) -> str:
    """The unit of a position by its range, with a question where that is not clear."""
    numbers = findings.numbers[column]
    # positions of one kind, of one machine, are in one unit
    wrapping = (
        _unit_of_turn(n)
        for name in findings.columns("position")
        if (n := findings.numbers[name]).wrap and findings.readings[name].kind == "angular"
    )
    if kind == "angular" and len(units := {*wrapping} & {*ANGLE}) == 1 and not numbers.whole:
        because.append(f"in {(unit := units.pop())} as another angle, which wraps")
        return unit
    of_kind = [n for n in findings.columns("position") if kind and _is_of_kind(n, kind, findings)]
    largest = max(findings.numbers[n].largest for n in (column, *of_kind))
    unit, is_clear = usual_unit(numbers, largest, kind or "angular")
    if unit == "rad" and largest > np.pi and _TILTS & {*findings.readings[column].words}:
        unit, is_clear = "deg", True
    reason = f"in {unit} by its range {range_text(numbers)}"
    # controllers of drives give the position of an encoder in turns, or in units of the machine
    is_of_encoder = bool(_ENCODERS & {*findings.readings[column].words})
    if kind is not None and is_clear and not is_of_encoder:
        because.append(reason)
        return unit
    doubts.append(f"the unit: {reason}" + ("" if kind else ", if it is an angle"))
    is_said = findings.readings[column].stated(["position"])
    what = "" if is_said else ", if it is a position and no speed"
    text = f"unit of the position '{column}' (range {range_text(numbers)}){what}"
    choice.questions.append(Question(f"unit {column}", text, unit, _UNITS_TO_CHOOSE))
    return unit


def _is_of_kind(column: str, kind: Kind, findings: Findings) -> bool:
    """Whether a position is of a kind by its name, and in a unit that nothing but its size says."""
    reading, numbers = findings.readings[column], findings.numbers[column]
    return reading.kind == kind and not (reading.unit or numbers.whole or numbers.wrap)


def usual_unit(numbers: Numbers, largest: float, kind: Kind) -> tuple[str, bool]:
    """The usual unit of positions of some size, and whether the size is clear."""
    if numbers.whole and numbers.distinct > 2:
        return "counts", True
    if kind == "linear":
        if largest <= _MOST_METRES:
            return "m", largest <= 3
        return "mm", largest > 30
    if largest <= _MOST_RADIANS:
        return "rad", largest <= 2.5 * np.pi
    return "deg", 30 < largest <= 400


def _counts_by_velocity(velocity_unit: str, factor: float | None) -> int | None:
    """Counts in a turn, by the factor from a position in counts to a velocity in a known unit."""
    if velocity_unit not in ANGULAR_SPEEDS or not factor or factor <= 0:
        return None
    counts = 2 * np.pi / ANGULAR_SPEEDS[velocity_unit] / factor
    usual = counts_in_turn(1.0, counts, _SAME_FACTOR / 2)
    return usual or (round(counts) if counts >= 1 else None)


def _counts(
    column: str,
    speed: str,
    factor: float | None,
    findings: Findings,
    choice: Choice,
    because: list[str],
    doubts: list[str],
) -> tuple[int, bool]:
    """Counts in a turn, and whether they are assumed: neither answered nor by velocity."""
    turn = findings.numbers[column].wrap
    key = f"counts {column}"
    if (answer := findings.answer(key)) is not None:
        because.append(f"{answer[0]} counts in a turn {answer[1]}")
        return int(float(answer[0])), False
    by_wrap = round(turn) if turn and turn not in _OVERFLOWS else None
    compared = _counts_by_velocity(speed, factor)
    if compared is not None and (by_wrap is None or abs(compared / by_wrap - 1) < _SAME_FACTOR):
        because.append(f"{by_wrap or compared} counts in a turn")
        return by_wrap or compared, False
    counts = by_wrap or 4096  # as many encoders have
    overflow = f", which starts again at {turn:.0f}" if turn else ""
    text = f"counts in a turn of the encoder '{column}'{overflow}"
    choice.questions.append(Question(key, text, str(counts), is_number=True))
    doubts.append(f"counts in a turn: {counts} is assumed" + (", as it wraps" if by_wrap else ""))
    return counts, True


def _length_of_count(
    column: str,
    velocity_unit: str,
    factor: float | None,
    findings: Findings,
    choice: Choice,
    doubts: list[str],
) -> tuple[float, bool]:
    """The length of a count [m], and whether it is assumed: neither answered nor by velocity."""
    key = f"resolution {column}"
    if key in findings.answers:
        return float(findings.answers[key]), False
    if velocity_unit in LINEAR_SPEEDS and factor:
        return float(f"{factor * LINEAR_SPEEDS[velocity_unit]:.4g}"), False
    text = f"length of a count of '{column}' [m]"
    choice.questions.append(Question(key, text, "1e-05", is_number=True))
    doubts.append("the length of a count: 1e-05 m is assumed")
    return 1e-5, True


# --- velocities ---


def _velocity(
    column: str,
    velocity: str | None,
    unit: str,
    kind: Kind,
    factor: float | None,
    findings: Findings,
    counts: int | None = None,
) -> VelocityChoice | None:
    """The velocity column of a coordinate with its unit: by its name, else by the factor.

    None where a position in counts has a velocity that is in no known unit.
    """
    if velocity is None or factor is None:
        return None
    measured, because = _is_measured(column, velocity, findings)
    speed: str | None = findings.readings[velocity].unit or None
    if speed == _COUNTS_A_SECOND and unit != "counts":
        return None
    if speed is None and unit in (*ANGLE, *LENGTH):
        units = ANGLE if kind == "angular" else LENGTH
        speeds = ANGULAR_SPEEDS if kind == "angular" else LINEAR_SPEEDS
        for candidate in (f"{unit}/s", *speeds):
            if abs(factor * speeds[candidate] / units[unit] - 1) < 2 * _SAME_FACTOR:
                speed = candidate
                because += f"; in {candidate} by its size"
                break
    elif speed is None and counts is not None and abs(factor - 1) > 0.05:
        in_turn = ((s, 2 * np.pi / size / factor) for s, size in ANGULAR_SPEEDS.items())
        speed = next((s for s, n in in_turn if abs(n / counts - 1) < _SAME_FACTOR / 2), None)
        if speed is None:
            return None
        because += f"; in {speed} by its size"
    return VelocityChoice(velocity, speed, measured, because)


def _is_measured(position: str, velocity: str, findings: Findings) -> tuple[bool, str]:
    """Whether a velocity column has a sensor of its own, and the reason."""
    words = {*findings.readings[velocity].words}
    if sensors := words & _SENSORS:
        return True, f"a sensor of its own by its name ('{sensors.pop()}')"
    if findings.readings[velocity].qualifier == "measured" and words & {"meas", "measured", "mess"}:
        return True, "measured by its name"
    a = np.concatenate([np.gradient(q) for q in findings.samples[position]])
    b = np.concatenate(list(findings.samples[velocity]))
    if np.ptp(a) and np.ptp(b) and np.corrcoef(a, b)[0, 1] > 0.9999:
        return False, "computed from the positions: it is their difference"
    return False, "taken for computed from the positions; measured = true if by a sensor of its own"


def describe_speed(column: str, name: str, findings: Findings, choice: Choice) -> CoordinateChoice:
    """A speed as a coordinate of its own, where no position is measured."""
    reading, numbers = findings.readings[column], findings.numbers[column]
    unit, doubts, assumed = reading.unit, _doubts(column, findings), ()
    key = f"unit {column}"
    if key in findings.answers:
        unit = findings.answers[key]
    elif not unit:
        # speeds of one machine are in one unit
        largest = max(findings.numbers[name].largest for name in findings.columns("velocity"))
        unit = "m/s" if reading.kind == "linear" else "rpm" if largest > 300 else "rad/s"
        doubts, assumed = (
            [*doubts, f"the unit: {unit} by its range {range_text(numbers)}"],
            ("unit",),
        )
        options = ("rad/s", "rpm", "deg/s", "m/s", "mm/s", "V")
        choice.questions.append(
            Question(
                key, f"unit of the speed '{column}' (range {range_text(numbers)})", unit, options
            )
        )
    because = (
        *findings.verdicts[column].reasons,
        "no position is measured, so the speed is the coordinate (docs/how-to/speed-only.md)",
    )
    return CoordinateChoice(
        column, name, "linear", unit, because=because, doubts=tuple(doubts), assumed=assumed
    )


def period_by_velocities(dt: float, findings: Findings) -> tuple[float, str] | None:
    """The sampling period [s] at which velocities are the slopes of their positions, and why.

    Args:
        dt: the period by which the slopes were computed [s].
        findings: what is known of the columns.

    Returns:
        The period, and the reason; without one where no unit is known, so that both are taken for
        the same: it is assumed. None where two velocities say different periods.
    """
    periods: list[tuple[float, float]] = []  # what a slope leaves of its velocity, and the period
    reason = ""
    sizes = {**ANGULAR_SPEEDS, **LINEAR_SPEEDS}
    for velocity, verdict in findings.verdicts.items():
        if verdict.role != "velocity" or (position := verdict.partner) is None:
            continue
        correlation, factor = findings.slopes.between(position, velocity)
        speed, unit = (findings.readings[n].unit for n in (velocity, position))
        if position in findings.sines:
            unit, speed = "rad", speed or "rad/s"
        if correlation < 0.99 or factor <= 0 or bool(unit) != bool(speed):
            continue
        if unit:  # else both are in one unit that nothing says
            if speed not in sizes or unit not in (*ANGLE, *LENGTH):
                continue
            factor *= sizes[speed] / (ANGLE | LENGTH)[unit]
            reason = "by the velocities, which are slopes of the positions"
        periods.append((math.sqrt(max(1 - correlation**2, 0.0)), dt / factor))
    if not periods:
        return None
    least, period = min(periods)
    if any(abs(p / period - 1) > max(_SAME_FACTOR, left + least) for left, p in periods):
        return None
    usual = float(f"{period:.2g}")
    period = usual if abs(period / usual - 1) < _SAME_FACTOR else float(f"{period:.4g}")
    return (period, reason) if 1e-4 <= period <= 1.0 else None
