"""The choice of coordinates, their velocities and inputs, from the roles of the columns."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from tustinnet.channels import Kind
from tustinnet.data.drafting.assignment import NO_REASON, Verdict
from tustinnet.data.drafting.channel_names import name_channels
from tustinnet.data.drafting.evidence import Role, stage_of
from tustinnet.data.drafting.findings import Choice, Findings, Question
from tustinnet.data.drafting.inputs import describe_input, describe_system_input
from tustinnet.data.drafting.names import INPUTS
from tustinnet.data.drafting.positions import describe_coordinate, describe_speed
from tustinnet.data.drafting.relations import find_copy
from tustinnet.data.drafting.system_columns import SystemChannels, match_columns

_COSINE = re.compile(r"(?i)(?<![a-z])(cosinus|cosine|cos)[ _(]*|\)$")
ROLE_BY_ANSWER: dict[str, Role] = {
    "none": "other",
    "position": "position",
    "velocity": "velocity",
    "input": "input",
    "set point": "set point",
}


def choose_channels(findings: Findings) -> Choice:
    """Chooses coordinates with their velocities, inputs, and says why others are not used."""
    choice = Choice()
    positions = findings.columns("position")
    is_of_speeds = not positions
    positions = positions or findings.columns("velocity")
    inputs = findings.columns("input") or _set_points(findings)
    _ask_for_roles(findings, choice)
    names = name_channels(positions, inputs, findings.readings)
    for column in findings.sines:  # `cos_theta` and `sin_theta` are `theta`
        angle = _COSINE.sub("", names.get(column, ""))
        names[column] = angle if angle and angle not in names.values() else names.get(column, "")
    matched = {} if is_of_speeds else _match_velocities(positions, findings, choice)
    for column in positions:
        if is_of_speeds:
            coordinate = describe_speed(column, names[column], findings, choice)
        else:
            kind = _kind_by_inputs(inputs, findings)
            velocity = matched.get(column)
            coordinate = describe_coordinate(
                column, names[column], velocity, kind, findings, choice
            )
        choice.coordinates.append(coordinate)
    _without_unknown_velocities(matched, choice)
    for column in inputs:
        choice.inputs.append(describe_input(column, names[column], findings, choice))
    _explain_unused([*positions, *matched.values()], inputs, findings, choice)
    return choice


def choose_system_channels(findings: Findings, system: SystemChannels) -> Choice:
    """Chooses the columns of a system's coordinates and inputs, under the names that it has."""
    choice, matches = Choice(), match_columns(system, findings)
    choice.missing = matches.missing
    coordinates = [c for c in system.coordinates if c.name in matches.coordinates]
    positions = [matches.coordinates[c.name] for c in coordinates]
    matched = _match_velocities(positions, findings, choice)
    for c, column in zip(coordinates, positions, strict=True):
        described = describe_coordinate(
            column, c.name, matched.get(column), None, findings, choice, system_kind=c.kind
        )
        choice.coordinates.append(
            replace(
                described,
                because=(matches.because[column], *described.because),
                doubts=(*filter(None, [matches.doubts.get(column)]), *described.doubts),
            )
        )
    _without_unknown_velocities(matched, choice)
    inputs = [i for i in system.inputs if i.name in matches.inputs]
    for i in inputs:
        column = matches.inputs[i.name]
        described = describe_system_input(column, i, findings)
        choice.inputs.append(
            replace(
                described,
                because=(matches.because[column],),
                doubts=(*filter(None, [matches.doubts.get(column)]), *described.doubts),
            )
        )
    columns = [matches.inputs[i.name] for i in inputs]
    _explain_unused([*positions, *matched.values()], columns, findings, choice)
    for name in choice.unused.keys() - matched.values():
        choice.unused[name] = f"no channel of {system.name}: {choice.unused[name]}"
    return choice


def _set_points(findings: Findings) -> list[str]:
    """The set points that are inputs where nothing else is: those of positions, if there are some.

    A machine whose controller is part of what is modelled has no other input.
    """
    verdicts = findings.verdicts
    followed: dict[str, str] = {}
    for name in findings.columns("set point"):
        followed.setdefault(verdicts[name].leads or name, name)
    leading = [n for p, n in followed.items() if p != n and verdicts[p].role == "position"]
    return leading or [*followed.values()]


def _ask_for_roles(findings: Findings, choice: Choice) -> None:
    """Asks for the roles of columns that could nearly as well be something else, once a family."""
    families: dict[tuple[object, ...], list[str]] = {}
    for name, verdict in findings.verdicts.items():
        if verdict.is_open:
            key = verdict.role, verdict.rival, verdict.margin, verdict.is_by_name
            families.setdefault(key, []).append(name)
    for (role, rival, margin, is_by_name), names in families.items():
        more = f" (and {', '.join(repr(n) for n in names[1:])})" if len(names) > 1 else ""
        why = "as its name says" if is_by_name else f"{margin:.1f} points less"
        text = f"what is '{names[0]}'{more}: {role}, or {rival} ({why})?"
        assumption = str(role) if role in ROLE_BY_ANSWER else "none"
        choice.questions.append(
            Question(f"role {names[0]}", text, assumption, tuple(ROLE_BY_ANSWER))
        )


def _explain_unused(
    motion: Sequence[str], inputs: Sequence[str], findings: Findings, choice: Choice
) -> None:
    """Says why each column that is neither of the motion nor an input is not used."""
    for name, verdict in findings.verdicts.items():
        if name not in (*motion, *inputs, *choice.unused):
            rival = {"position": "a position", "input": "an input"}.get(verdict.rival or "")
            doubt = f"; check {rival}?" if rival and verdict.is_open else ""
            choice.unused[name] = _why_unused(name, verdict, motion, inputs, findings) + doubt


def _why_unused(
    name: str,
    verdict: Verdict,
    motion: Sequence[str],
    inputs: Sequence[str],
    findings: Findings,
) -> str:
    """The reason why a column of a role is not used."""
    if verdict.role == "constant":
        return "constant" + ", another one in each record" * (findings.numbers[name].distinct > 1)
    for used in (*inputs, *motion):
        factor = find_copy(findings.samples[used], findings.samples[name])
        if factor and used in inputs:
            return f"proportional to the input '{used}'"
        if factor:
            return f"{factor:.6g} times '{used}'"
    reading = findings.readings[name]
    if verdict.role in ("input", "other") and reading.quantity in INPUTS and inputs:
        # of several that of its joint
        near = sorted(inputs, key=lambda u: -len({*findings.readings[u].words} & {*reading.words}))
        rest = [u for u in near if stage_of(findings.readings[u]) != stage_of(reading)]
        return f"an effect of '{rest[0]}'" if rest else f"beside the input '{near[0]}'"
    if "velocity" in (verdict.role, reading.quantity):
        slopes = {position: findings.slopes.between(position, name)[0] for position in motion}
        nearest = max(slopes, key=lambda position: abs(slopes[position]), default="")
        if nearest and slopes[nearest] > 0.9:
            return f"a second velocity of '{nearest}'"
        if nearest and slopes[nearest] < -0.9:
            return f"a velocity in the other direction than '{nearest}'"
        return "a velocity, and the slope of no position"
    article = "an" if verdict.role[0] in "aei" else "a"
    what = "no quantity of the motion" if verdict.role == "other" else f"{article} {verdict.role}"
    return what if verdict.because == NO_REASON else f"{what}: {verdict.because}"


# --- velocities ---


def _match_velocities(
    positions: Sequence[str], findings: Findings, choice: Choice
) -> dict[str, str]:
    """The velocity column of each position, if every one has one."""
    partners = {v.partner: n for n, v in findings.verdicts.items() if v.role == "velocity"}
    matched = {p: partners[p] for p in positions if p in partners}
    missing = [p for p in positions if p not in matched]
    if not missing:
        return matched
    for position, velocity in matched.items():
        choice.unused[velocity] = (
            f"the velocity of '{position}'; a card has one for every coordinate or none, and "
            f"'{missing[0]}' has none"
        )
    return {}


def _without_unknown_velocities(matched: Mapping[str, str], choice: Choice) -> None:
    """Leaves out all velocities where the unit of one is unknown: a card has all of them or none.

    Raw values of a drive's register are neither counts per second nor in a usual unit.
    """
    unknown = [c.column for c in choice.coordinates if c.column in matched and not c.velocity]
    if not unknown:
        return
    for position, velocity in matched.items():
        choice.unused[velocity] = (
            "a velocity in a unit that nothing says"
            if position in unknown
            else f"the velocity of '{position}'; that of '{unknown[0]}' has no known unit"
        )
    choice.coordinates[:] = [replace(c, velocity=None) for c in choice.coordinates]


def _kind_by_inputs(inputs: Iterable[str], findings: Findings) -> Kind | None:
    """The kind of coordinates that are driven by torques only, or by forces only."""
    quantities = [findings.readings[name].quantity for name in inputs]
    if {*quantities} == {"torque"}:
        return "angular"
    return "linear" if quantities == ["force"] else None
