"""The choice of coordinates, their velocities and inputs among the columns."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tustinnet.channels import Kind
from tustinnet.data.drafting.channel_names import name_channels
from tustinnet.data.drafting.findings import Choice, Findings, Question
from tustinnet.data.drafting.inputs import choose_inputs, describe_input, describe_system_input
from tustinnet.data.drafting.positions import describe_coordinate, describe_speed
from tustinnet.data.drafting.relations import compare_courses, find_copy
from tustinnet.data.drafting.roles import FAINT, Verdict
from tustinnet.data.drafting.system_columns import SystemChannels, match_columns

_COSINE = re.compile(r"(?i)(?<![a-z])(cosinus|cosine|cos)[ _(]*|\)$")
_CLEAR = 3.0  # score of a column that is surely a position
_ROLES = ("none", "position", "velocity", "input", "set point")


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
    inputs = [name for name in choose_inputs(findings, choice) if name not in positions]
    names = name_channels(positions, inputs, findings.readings)
    for column in findings.sines:  # `cos_theta` and `sin_theta` are `theta`
        angle = _COSINE.sub("", names.get(column, ""))
        names[column] = angle if angle and angle not in names.values() else names.get(column, "")
    matched = _match_velocities(positions, velocities, findings, choice)
    for column in positions:
        if only_speeds:
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
    used = {*positions, *inputs, *matched.values()}
    for name, verdict in findings.verdicts.items():
        if name not in used and name not in choice.unused:
            choice.unused[name] = _why_unused(verdict)
    return choice


def choose_system_channels(findings: Findings, system: SystemChannels) -> Choice:
    """Chooses the columns of a system's coordinates and inputs, under the names that it has."""
    choice, matches = Choice(), match_columns(system, findings)
    choice.missing = matches.missing
    coordinates = [c for c in system.coordinates if c.name in matches.coordinates]
    positions = [matches.coordinates[c.name] for c in coordinates]
    velocities = [name for name in findings.columns("velocity") if name not in positions]
    matched = _match_velocities(positions, velocities, findings, choice)
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
    for i in system.inputs:
        if (column := matches.inputs.get(i.name)) is not None:
            described = describe_system_input(column, i, findings)
            choice.inputs.append(
                replace(
                    described,
                    because=(matches.because[column],),
                    doubts=(*filter(None, [matches.doubts.get(column)]), *described.doubts),
                )
            )
    used = {*positions, *matches.inputs.values(), *matched.values()}
    for name, verdict in findings.verdicts.items():
        if name not in used and name not in choice.unused:
            choice.unused[name] = f"no channel of {system.name}: {_why_unused(verdict)}"
    return choice


def _why_unused(verdict: Verdict) -> str:
    """The reason why a column of a role is not used."""
    if verdict.role == "constant":
        return "constant"
    article = "an" if verdict.role[0] in "aei" else "a"
    what = "no quantity of the motion" if verdict.role == "other" else f"{article} {verdict.role}"
    return f"{what}: {verdict.because}"


def _clear_positions(findings: Findings, choice: Choice) -> list[str]:
    """Positions without those for which little speaks, where for others much does."""
    positions = findings.columns("position")
    scores = {name: findings.verdicts[name].score for name in positions}
    answered = {name for name in positions if f"role {name}" in findings.answers}
    if max(scores.values(), default=0.0) < _CLEAR:
        return positions
    for name in positions:
        if scores[name] < FAINT and name not in answered:
            because = findings.verdicts[name].because
            choice.unused[name] = f"perhaps a position ({because}), beside columns that say so"
            choice.questions.append(Question(f"role {name}", f"what is '{name}'?", "none", _ROLES))
    return [name for name in positions if name not in choice.unused]


def _most_like_positions(findings: Findings) -> list[str]:
    """The column to take for a position where none looks like one."""
    for role in ("input", "set point", "flag", "other"):
        # a column of times that repeat is no position
        if names := [
            n
            for n in findings.columns(role)
            if findings.readings[n].quantities.get("time", 0.0) < _CLEAR
        ]:
            smooth = [name for name in names if findings.numbers[name].smooth]
            return [(smooth or names)[0]]
    return []


def _without_copies(names: list[str], findings: Findings, choice: Choice) -> list[str]:
    """Positions without those that repeat another one, in another unit or filtered."""
    kept: list[str] = []
    # raw readings and columns with a unit before those that were made of them
    order = sorted(
        names,
        key=lambda name: (
            findings.readings[name].qualifier in ("filtered", "model"),
            not findings.readings[name].unit or findings.readings[name].unit == "counts",
            names.index(name),
        ),
    )
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
            opposite = positions[int(np.argmin(correlations))]
            choice.unused[velocity] = f"a velocity in the other direction than '{opposite}'"
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


def _kind_by_inputs(inputs: Sequence[str], findings: Findings) -> Kind | None:
    """The kind of coordinates that are driven by torques only, or by forces only."""
    quantities = {findings.readings[name].quantity for name in inputs}
    if quantities == {"torque"}:
        return "angular"
    return "linear" if quantities == {"force"} and len(inputs) == 1 else None
