"""The role of each column: evidence from its name, its numbers and its relations, added up."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from tustinnet.data.drafting.names import INPUTS, NameReading, Quantity
from tustinnet.data.drafting.numbers import Numbers, Values, is_decimal
from tustinnet.data.drafting.relations import (
    Slopes,
    compare_courses,
    explained_acceleration,
    find_copy,
)

Role = Literal[
    "time",
    "position",
    "velocity",
    "acceleration",
    "input",
    "set point",
    "error",
    "flag",
    "counter",
    "constant",
    "other",
    "no numbers",
]

_DERIVATIVE = 0.97  # correlation with a slope that needs no name
_NAMED_DERIVATIVE = 0.75  # of a column whose name says velocity
_FOLLOWED = 0.9  # correlation of a position with its set point
FAINT = 1.9  # score of a position that may be something else
_DRIVEN, _DRIVING = 0.5, 0.15  # shares of accelerations that an input explains, and those of it
_WHITE = 1.2  # roughness of white noise is the root of 2
_AXES = {"x", "y", "z", "yaw", "pitch", "roll", "rx", "ry", "rz", "azimuth", "elevation"}
_CLEAR = 1.0  # a role whose score is by less above the next one is doubtful
_ROLES: dict[Quantity, Role] = {
    **dict.fromkeys(INPUTS, "input"),
    "position": "position",
    "velocity": "velocity",
    "acceleration": "acceleration",
    "error": "error",
    "flag": "flag",
    "counter": "counter",
    "other": "other",
}


@dataclass(frozen=True)
class Evidence:
    """Reason to take a column for something.

    Attributes:
        role: the role that it speaks for.
        weight: how much it counts.
        sentence: the reason in words.
    """

    role: Role
    weight: float
    sentence: str


@dataclass(frozen=True)
class Verdict:
    """The role of a column, and what speaks for it.

    Attributes:
        role: the role with the largest sum of weights.
        reasons: the sentences that speak for it, the strongest first.
        rival: the next best role where the decision is close, else None.
        score: the sum of the weights that speak for it.
        slope_of: the column of which it is the derivative, None without one.
        leads: the column that follows it as its set point, None without one.
    """

    role: Role
    reasons: tuple[str, ...]
    rival: Role | None = None
    score: float = 0.0
    slope_of: str | None = None
    leads: str | None = None

    @property
    def because(self) -> str:
        """The reasons as one text."""
        return "; ".join(self.reasons)


def judge_columns(
    readings: Mapping[str, NameReading],
    numbers: Mapping[str, Numbers],
    samples: Mapping[str, Sequence[Values]],
    slopes: Slopes,
    times: Sequence[Values],
) -> dict[str, Verdict]:
    """The verdicts on columns that are neither times nor counters.

    Args:
        readings: the meaning of the names.
        numbers: properties of the numbers.
        samples: samples of every column, record by record, without wraps.
        slopes: comparison of changes with integrals.
        times: times of each record [s].
    """
    verdicts: dict[str, Verdict] = {}
    for name in samples:
        evidence = _own_evidence(readings[name], numbers[name])
        verdicts[name] = _decide(numbers[name], evidence)
    for name in samples:
        if numbers[name].constant:
            continue
        evidence = _own_evidence(readings[name], numbers[name])
        slope_of = _find_integral(name, readings, numbers, verdicts, slopes)
        leads = _find_follower(name, readings, numbers, verdicts, samples)
        if slope_of is not None:
            evidence.append(_slope_evidence(name, slope_of, readings, verdicts, slopes))
        if leads is not None:
            evidence.append(_set_point_evidence(name, leads, readings))
        verdict = _decide(numbers[name], evidence)
        is_rate = verdict.role in ("velocity", "acceleration")
        verdicts[name] = Verdict(
            verdict.role,
            verdict.reasons,
            verdict.rival,
            verdict.score,
            slope_of if is_rate else None,
            leads if verdict.role == "set point" else None,
        )
    _leave_out_noise(readings, numbers, verdicts)
    _take_named_inputs(readings, verdicts, samples)
    _take_drivers_for_inputs(numbers, verdicts, samples, times)
    for name in samples:
        if (pair := _find_difference(name, readings[name], verdicts, samples)) is not None:
            verdicts[name] = Verdict("error", (f"'{pair[0]}' minus '{pair[1]}'",))
    return verdicts


def _leave_out_noise(
    readings: Mapping[str, NameReading],
    numbers: Mapping[str, Numbers],
    verdicts: dict[str, Verdict],
) -> None:
    """Takes columns of white noise beside positions of the same thing for no quantity of a motion.

    These are directions in which nothing moves: a marker's height, pitch and roll of a turntable.
    """
    moving = [n for n, v in verdicts.items() if v.role == "position" and numbers[n].smooth]
    for name, verdict in list(verdicts.items()):
        weights = readings[name].quantities
        says = max(weights, key=lambda q: weights[q], default=None)
        is_noise = numbers[name].roughness > _WHITE and not numbers[name].levels
        if not is_noise or says != "position" or verdict.role not in ("position", "input"):
            continue
        beside = next((n for n in moving if _are_siblings(readings[n], readings[name])), None)
        if beside is not None:
            verdicts[name] = Verdict("other", (f"only noise, beside '{beside}'",))


def _take_named_inputs(
    readings: Mapping[str, NameReading],
    verdicts: dict[str, Verdict],
    samples: Mapping[str, Sequence[Values]],
) -> None:
    """Takes columns named for an input and a position for inputs beside a position of that object.

    Alone, `yaw_current` may be the yaw that there is now; beside `yaw` it is a current.
    """
    positions = [n for n, v in verdicts.items() if v.role == "position"]
    for name in positions:
        weights = readings[name].quantities
        stated = readings[name].stated(INPUTS)
        if not stated or not readings[name].object:
            continue
        for other in positions:
            plain = not any(q in readings[other].quantities for q in INPUTS)
            if plain and other != name and readings[other].object == readings[name].object:
                course = compare_courses(samples[other], samples[name])
                if abs(course.correlation) < _FOLLOWED:
                    word = readings[name].word[stated[0]]
                    reason = f"'{word}' in its name, beside the position '{other}'"
                    verdicts[name] = Verdict("input", (reason,), score=weights[stated[0]])
                    break


def _are_siblings(first: NameReading, second: NameReading) -> bool:
    """Whether two names are of one thing but for an axis or a number."""
    a, b = ({*r.words} - _AXES for r in (first, second))
    return {w for w in a if not w.isdigit()} == {w for w in b if not w.isdigit()}


def _take_drivers_for_inputs(
    numbers: Mapping[str, Numbers],
    verdicts: dict[str, Verdict],
    samples: Mapping[str, Sequence[Values]],
    times: Sequence[Values],
) -> None:
    """Takes positions for inputs that explain the acceleration of another one as inputs do."""
    faint = [n for n, v in verdicts.items() if v.role == "position" and v.score < FAINT]
    for name in faint:
        driven = _find_driven(name, verdicts, samples, times)
        if driven is not None:
            share = f"{100 * driven[1]:.0f} %"
            reason = f"it explains {share} of the acceleration of '{driven[0]}', not the reverse"
            verdicts[name] = Verdict("input", (reason,), "position", 1.0)
    for name, verdict in list(verdicts.items()):
        # a position does not jump from level to level; a command does, also one in degrees
        if verdict.role == "position" and numbers[name].levels:
            driven = _find_driven(name, verdicts, samples, times, _DRIVEN)
            if driven is not None:
                share = f"{100 * driven[1]:.0f} %"
                reason = f"held levels, which explain {share} of the acceleration of '{driven[0]}'"
                verdicts[name] = Verdict("input", (reason,), "position", 1.0)
    if not any(verdict.role == "input" for verdict in verdicts.values()):
        _take_continuous_columns_for_inputs(numbers, verdicts)


def _take_continuous_columns_for_inputs(
    numbers: Mapping[str, Numbers], verdicts: dict[str, Verdict]
) -> None:
    """Takes columns that do not move in steps, as positions do, for inputs where there are none."""
    positions = [name for name, verdict in verdicts.items() if verdict.role == "position"]
    if any(numbers[name].count is not None for name in positions):
        for name in positions:
            if numbers[name].count is None and verdicts[name].score < FAINT:
                reason = "it has no steps, as the positions have"
                verdicts[name] = Verdict("input", (reason,), "position", 1.0)


def _decide(numbers: Numbers, evidence: Sequence[Evidence]) -> Verdict:
    """The role for which most speaks; lost samples are a remark."""
    lost = (f"{numbers.lost} not finite",) if numbers.lost else ()
    if numbers.constant:
        return Verdict("constant", ("it never changes", *lost))
    sums: dict[Role, float] = {}
    for item in evidence:
        sums[item.role] = sums.get(item.role, 0.0) + item.weight
    role, *others = sorted(sums, key=lambda r: -sums[r])
    rival: Role | None = next((r for r in others if sums[role] - sums[r] < _CLEAR), None)
    items = sorted((e for e in evidence if e.role == role), key=lambda e: -e.weight)
    return Verdict(role, (*(item.sentence for item in items), *lost), rival, sums[role])


# --- each kind of evidence with its sentence ---


def _own_evidence(reading: NameReading, numbers: Numbers) -> list[Evidence]:
    """Evidence in the name and the numbers of a column."""
    evidence = [*_name_evidence(reading), *_number_evidence(numbers)]
    if reading.stated(["voltage"]) and numbers.is_nearly_constant:
        evidence.append(Evidence("other", 12.0, "nearly constant, as the voltage of a supply"))
    return evidence


def _name_evidence(reading: NameReading) -> Iterator[Evidence]:
    """Evidence in the words and the unit of a name."""
    is_command = reading.qualifier == "command"
    top = max(reading.quantities.values(), default=0.0)
    for quantity, weight in reading.quantities.items():
        role = _ROLES.get(quantity)
        if role is None:
            continue
        word = reading.word[quantity]
        by = f"in {reading.unit} by its name" if word.startswith("[") else f"'{word}' in its name"
        if is_command and role in ("position", "velocity", "acceleration"):
            yield Evidence("set point", weight, by)
        else:
            yield Evidence(role, weight, by)
    if is_command:
        speaks_of_input = bool(reading.stated(INPUTS))
        if speaks_of_input:
            yield Evidence("input", 2.0, "named a command")
        else:
            yield Evidence("set point", 4.0 if top >= 3 else 2.5, "named a command")
            yield Evidence("input", 2.0, "named a command")
    if reading.qualifier == "model":
        yield Evidence("other", 4.0, "named simulated or predicted")


def _number_evidence(numbers: Numbers) -> Iterator[Evidence]:
    """Evidence in the numbers of a column alone."""
    if numbers.wrap is not None:
        yield Evidence("position", 4.0, f"it wraps at {numbers.wrap:.6g}")
    count = numbers.count
    if count is not None and numbers.smooth and not numbers.binary:
        is_encoder = numbers.whole or not is_decimal(count)
        yield Evidence(
            "position",
            1.5 if is_encoder else 0.3,
            f"steps of {count:.6g}, as encoder counts" if is_encoder else f"steps of {count:.6g}",
        )
    if numbers.binary and numbers.range in ((0.0, 1.0), (-1.0, 0.0)):
        yield Evidence("flag", 2.5, "only 0 and 1")
    if numbers.levels:
        yield Evidence("input", 2.0, "held levels")
    elif numbers.smooth:
        yield Evidence("position", 1.0, "smooth")
    else:
        yield Evidence("input", 1.5, "rough")


def _find_integral(
    name: str,
    readings: Mapping[str, NameReading],
    numbers: Mapping[str, Numbers],
    verdicts: Mapping[str, Verdict],
    slopes: Slopes,
) -> str | None:
    """The column of which one is the derivative: of the same thing by its name, or the nearest."""
    reading = readings[name]
    if numbers[name].levels or numbers[name].wrap is not None:
        return None
    if reading.stated(INPUTS):
        return None  # a voltage may be nearly proportional to the speed
    if reading.stated(["other"]):
        return None  # as the electrical speed of a motor of some poles
    speaks = max(reading.quantities.get(q, 0.0) for q in ("velocity", "acceleration")) >= 1
    if reading.stated(["position"]) and not speaks:
        return None  # of a position, another one may be the slope by chance
    best, best_score = None, 0.0
    for other, verdict in verdicts.items():
        if other == name or verdict.role not in ("position", "velocity") or numbers[other].levels:
            continue
        correlation, _ = slopes.between(other, name)
        is_alike = bool(reading.object) and reading.object == readings[other].object
        needed = _NAMED_DERIVATIVE if speaks else _DERIVATIVE
        fits = reading.kind is None or readings[other].kind in (None, reading.kind)
        if correlation < needed or not fits:
            continue
        # a position that is not a velocity itself, of the same name, measured rather than filtered
        score = correlation + 0.3 * is_alike + 0.01 * (readings[other].qualifier != "filtered")
        score -= 0.2 * (readings[other].qualifier in ("command", "model"))
        if score > best_score:
            best, best_score = other, score
    return best


def _slope_evidence(
    name: str,
    slope_of: str,
    readings: Mapping[str, NameReading],
    verdicts: Mapping[str, Verdict],
    slopes: Slopes,
) -> Evidence:
    """Evidence that a column is the derivative of another one."""
    correlation, _ = slopes.between(slope_of, name)
    # the slope of a velocity is an acceleration
    named = readings[name].quantities
    is_second = verdicts[slope_of].role == "velocity" or (
        named.get("acceleration", 0) > named.get("velocity", 0) and named["acceleration"] >= 3
    )
    role: Role = "acceleration" if is_second else "velocity"
    weight = 5.0 if correlation > _DERIVATIVE else 2.0
    return Evidence(role, weight, f"slope of '{slope_of}' (correlation {correlation:.3g})")


def _find_follower(
    name: str,
    readings: Mapping[str, NameReading],
    numbers: Mapping[str, Numbers],
    verdicts: Mapping[str, Verdict],
    samples: Mapping[str, Sequence[Values]],
) -> str | None:
    """The position or velocity that follows a column at a factor of about 1, None without one."""
    reading = readings[name]
    is_command = reading.qualifier == "command"
    is_stated = bool(reading.stated(reading.quantities))
    if (is_stated and not is_command) or (reading.unit and not is_command):
        return None
    if reading.stated(INPUTS):
        return None
    best, best_score = None, 0.0
    for other, verdict in verdicts.items():
        is_motion = verdict.role in ("position", "velocity")
        if other == name or not is_motion or readings[other].qualifier == "command":
            continue
        if numbers[name].count is not None and numbers[other].count is None and not is_command:
            continue  # an encoder is not the set point of a smooth column
        if find_copy(samples[name], samples[other]) is not None and not is_command:
            continue
        course = compare_courses(samples[name], samples[other])
        is_near = 0.8 < course.factor < 1.25 and course.correlation > _FOLLOWED
        if not is_near or (course.lead < 0 and course.correlation < 0.999):
            continue
        if not is_command and (course.correlation < 0.97 or course.lead < 1):
            continue
        is_alike = bool(reading.object) and reading.object == readings[other].object
        score = course.correlation + 0.3 * is_alike
        if score > best_score:
            best, best_score = other, score
    return best


def _find_driven(
    name: str,
    verdicts: Mapping[str, Verdict],
    samples: Mapping[str, Sequence[Values]],
    times: Sequence[Values],
    most_reverse: float = _DRIVING,
) -> tuple[str, float] | None:
    """The position that a column drives, and the share that it explains; None without one.

    The position explains at most `most_reverse` times as much of the column's own acceleration.
    """
    positions = [n for n, v in verdicts.items() if v.role == "position" and n != name]
    best: tuple[str, float] | None = None
    for position in positions:
        share = explained_acceleration(samples[name], samples[position], times)
        if share < _DRIVEN or (best and share <= best[1]):
            continue
        reverse = explained_acceleration(samples[position], samples[name], times)
        if reverse < most_reverse * share:
            best = position, share
    return best


def _find_difference(
    name: str,
    reading: NameReading,
    verdicts: Mapping[str, Verdict],
    samples: Mapping[str, Sequence[Values]],
) -> tuple[str, str] | None:
    """The set point and the value that follows it whose difference a column is, None without."""
    if verdicts[name].role in ("constant", "set point") or reading.qualifier == "command":
        return None
    for set_point, verdict in verdicts.items():
        if verdict.leads is None or name in (set_point, verdict.leads):
            continue
        pairs = zip(samples[set_point], samples[verdict.leads], strict=True)
        if find_copy(samples[name], [a - b for a, b in pairs]) is not None:
            return set_point, verdict.leads
    return None


def _set_point_evidence(name: str, leads: str, readings: Mapping[str, NameReading]) -> Evidence:
    """Evidence that a column is the set point of another one."""
    weight = 3.0 if readings[name].qualifier == "command" else 2.5
    return Evidence("set point", weight, f"'{leads}' follows it, one to one")
