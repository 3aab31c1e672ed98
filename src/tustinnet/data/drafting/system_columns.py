"""The columns of a system's coordinates and inputs: by their names, then by what is left over."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from tustinnet.channels import Coordinate, Input, Kind
from tustinnet.data.drafting.findings import Findings
from tustinnet.data.drafting.names import INPUTS, NameReading, read_name
from tustinnet.data.drafting.vocabulary import CONTAINERS
from tustinnet.data.units import ANGLE, LENGTH, convert_to_si

_GENERAL = {*CONTAINERS, "axis", "motor", "actuator", "link", "gelenk", "achse"}
_WHOLE_NAME = 0.5  # of a score, for a name that holds all words of another one in their order
_IN_UNIT = 0.3  # for a column in the unit of the input
_ROLE = 0.2  # for a column that would be taken for that without the system
_DERIVED = 0.4  # less, for a filtered or simulated column
_PLACES = ("position", "other", "input", "set point", "counter")  # roles that a position may have


@dataclass(frozen=True)
class SystemChannels:
    """Coordinates and inputs that the card of a system has.

    Attributes:
        coordinates: the coordinates, in order.
        inputs: the inputs, in order; of unit `1` where any is possible.
        joints: of an input the coordinate on which it acts, where that is known.
        name: what the system is called.
    """

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    joints: Mapping[str, str]
    name: str


@dataclass
class Matches:
    """The columns of a system's channels.

    Attributes:
        coordinates: the column of each coordinate that has one, by name.
        inputs: the column of each input that has one, by name.
        because: the reason for each column.
        doubts: what to check of a column.
        missing: a sentence on each channel without a column.
    """

    coordinates: dict[str, str] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)
    because: dict[str, str] = field(default_factory=dict)
    doubts: dict[str, str] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)


def match_columns(system: SystemChannels, findings: Findings) -> Matches:
    """Matches columns with the coordinates and inputs of a system.

    A column belongs to the coordinate whose name it holds, or whose number where the columns have
    the numbers of the coordinates. Coordinates that are left over get the columns that are left
    over in their order where there are as many, with a doubt.

    Args:
        system: the system.
        findings: what is known of the columns.
    """
    matches = Matches()
    kinds: dict[str, Kind] = {c.name: c.kind for c in system.coordinates}
    places = {
        name: [c for c in findings.readings if _may_be_position(c, kind, findings)]
        for name, kind in kinds.items()
    }
    scores = {
        (name, column): _similarity(name, findings.readings[column], columns, kinds)
        + _ROLE * (findings.verdicts[column].role == "position")
        - _DERIVED * (findings.readings[column].qualifier in ("filtered", "model"))
        for name, columns in places.items()
        for column in columns
    }
    matches.coordinates = _assign(scores)
    for name, column in matches.coordinates.items():
        matches.because[column] = f"'{name}' in its name"
    _match_rest(system, places, findings, matches)
    for c in system.coordinates:
        if c.name not in matches.coordinates:
            matches.missing.append(f"no column was found for the coordinate '{c.name}'")
    _match_inputs(system, findings, matches)
    return matches


def _may_be_position(column: str, kind: Kind, findings: Findings) -> bool:
    """Whether a column can be a position of a kind."""
    reading = findings.readings[column]
    verdict = findings.verdicts.get(column)
    if verdict is None or verdict.role not in _PLACES or reading.qualifier == "command":
        return False
    others = (*INPUTS, "velocity", "acceleration", "error", "time")
    if reading.stated(others):
        return False
    if reading.unit in ANGLE or reading.unit in LENGTH:
        return (reading.unit in ANGLE) == (kind == "angular")
    return True


def _match_rest(
    system: SystemChannels,
    places: Mapping[str, Sequence[str]],
    findings: Findings,
    matches: Matches,
) -> None:
    """Matches what is left over in its order, where there is as much on both sides."""
    used = {*matches.coordinates.values()}
    rest = [c for c in system.coordinates if c.name not in matches.coordinates]
    for kind in ("linear", "angular"):
        names = [c.name for c in rest if c.kind == kind]
        # a column of any kind may also be that of a coordinate of the other kind
        kinds = (kind,) if len(names) < len(rest) else (None, kind)
        columns = [
            column
            for column in (places[names[0]] if names else ())
            if column not in used
            and findings.verdicts[column].role == "position"
            and findings.readings[column].qualifier not in ("filtered", "model")
            and findings.readings[column].kind in kinds
        ]
        if len(columns) != len(names):
            continue
        for name, column in zip(names, columns, strict=True):
            matches.coordinates[name] = column
            why = "left over" if len(names) == 1 else "by the order of the columns"
            matches.because[column] = f"the position of '{name}', {why}"
            matches.doubts[column] = f"is it '{name}'? no name says it"
            used.add(column)


def _match_inputs(system: SystemChannels, findings: Findings, matches: Matches) -> None:
    """Matches the inputs with columns that are no positions."""
    used = {*matches.coordinates.values()}
    columns = {
        i.name: [c for c in findings.verdicts if c not in used and _may_be_input(c, i, findings)]
        for i in system.inputs
    }
    joints = {i.name: system.joints.get(i.name, "") for i in system.inputs}
    scores = {}
    for i in system.inputs:
        for column in columns[i.name]:
            reading, verdict = findings.readings[column], findings.verdicts[column]
            own = _similarity(i.name, reading, columns[i.name], joints)
            joint = joints[i.name]
            if joint:
                own = max(own, _similarity(joint, reading, columns[i.name], {*joints.values()}))
            position = matches.coordinates.get(joint)
            if position is not None and reading.object:
                own = max(own, 0.9 * (reading.object == findings.readings[position].object))
            if position is not None and is_goal(i):
                own = max(own, 1.0 * (verdict.leads == position))
            scores[i.name, column] = (
                own
                + _IN_UNIT * (input_factor(reading.unit, i.unit) is not None)
                + _ROLE * (verdict.role == "input" or is_goal(i))
                - _DERIVED * (reading.qualifier in ("filtered", "model"))
            )
    matches.inputs = _assign(scores)
    for name, column in matches.inputs.items():
        matches.because[column] = f"the input '{name}' by its name"
    names = [i.name for i in system.inputs if i.name not in matches.inputs]
    fitting = {
        column
        for i in system.inputs
        if i.name in names
        for column in columns[i.name]
        if is_goal(i) or findings.verdicts[column].role == "input"
    }
    used |= {*matches.inputs.values()}
    remaining = [c for c in findings.verdicts if c in fitting - used]
    if len(names) == len(remaining):
        for name, column in zip(names, remaining, strict=True):
            matches.inputs[name] = column
            why = "left over" if len(names) == 1 else "by the order of the columns"
            matches.because[column] = f"the input '{name}', {why}"
            matches.doubts[column] = f"is it '{name}'? no name says it"
        names = []
    matches.missing += [f"no column was found for the input '{name}'" for name in names]


def is_goal(i: Input) -> bool:
    """Whether an input is a goal, of a servo, by its unit."""
    return i.unit in ("rad", "m", "rad/s", "m/s")


def _may_be_input(column: str, i: Input, findings: Findings) -> bool:
    """Whether a column can be an input: not if its name says something else."""
    reading, verdict = findings.readings[column], findings.verdicts[column]
    if is_goal(i):
        is_in_unit = not reading.unit or input_factor(reading.unit, i.unit) is not None
        is_force = bool(reading.stated(q for q in INPUTS if q != "control"))
        roles = {verdict.role, verdict.rival} & {"set point", "input"}
        return is_in_unit and not is_force and bool(roles)
    motion = reading.stated(("position", "velocity", "acceleration", "error"))
    # what a position follows one to one is its set point, and no force
    is_set_point = verdict.leads is not None and findings.verdicts[verdict.leads].role == "position"
    is_input = verdict.role in ("input", "set point") and not (motion or is_set_point)
    return bool(reading.stated(INPUTS)) or is_input


def _words(name: str) -> list[str]:
    """The words of a channel's name that tell it from others."""
    words = [*read_name(name).words]
    return [word for word in words if word not in _GENERAL] or words


def _similarity(
    name: str, reading: NameReading, columns: Sequence[str], names: Iterable[str]
) -> float:
    """Share of a channel's name that a column holds, 0 to 1.5; 0 unless all that tells it is there.

    Numbers alone count where columns have the numbers of all channels: columns that count from 0
    are not those of joints that count from 1.

    Args:
        name: name of the channel.
        reading: the column's name.
        columns: all columns that may be such channels.
        names: names of all channels of the sort.
    """
    words = _words(name)
    if not words or not {*words} <= {*reading.words}:
        return 0.0
    numbers = {word for word in words if word.isdigit()}
    own = {word for other in names for word in _words(other) if word.isdigit()}
    in_columns = {w for column in columns for w in read_name(column).words if w.isdigit()}
    if numbers and "0" in in_columns - own:
        return 0.0
    if numbers == {*words}:
        if not numbers or in_columns != own:
            return 0.0
    elif {word for word in reading.words if word.isdigit()} - numbers and numbers:
        return 0.0
    whole = "_".join(read_name(name).words)
    return 1.0 + _WHOLE_NAME * (whole in "_".join(reading.words))


def _assign(scores: Mapping[tuple[str, str], float]) -> dict[str, str]:
    """The columns of names, the highest scores first; less than a name in common counts nothing."""
    assigned: dict[str, str] = {}
    for (name, column), score in sorted(scores.items(), key=lambda item: -item[1]):
        if score >= 0.9 - _DERIVED and name not in assigned and column not in assigned.values():
            assigned[name] = column
    return assigned


def input_factor(unit: str, own_unit: str) -> float | None:
    """Units of an input in one unit of its column; None for another quantity, or an unknown one."""
    if not unit or not own_unit:
        return None
    try:
        (factor, base), (own, own_base) = convert_to_si(unit), convert_to_si(own_unit)
    except ValueError:
        return None
    return factor / own if base == own_base else None
