"""Parameters of a robot: values of its file, and ranges about them by file and records."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.added import PlacedForce, place_force
from tustinnet.models.chains import CENTER, DIAGONAL, INERTIAL
from tustinnet.models.forces import CURVE_SPEEDS, LARGEST_LOAD_SHARE, LAWS, Law
from tustinnet.models.parameters import Parameter
from tustinnet.systems.robot_channels import RobotChannels
from tustinnet.systems.robot_tree import felt
from tustinnet.wording import join_words

_MASS = 5.0  # factor by which a mass or a spread may differ from the file's
_SHARE = 0.3  # of a value or a size: the standard deviation of what a file says
_THINNEST = 1e-4  # spread [m] below which a body counts as thin; its thickness is not searched for
_GEARED, _GEARED_SHARE = 3.0, 0.1  # largest armature by a joint's inertia, and by the largest one
_DAMPING = 10.0  # largest damping by inertia [1/s]
_SPEED = 0.02  # speed at which 76 % of the Coulomb friction are reached [rad/s or m/s]
_STRIBECK = 5.0  # Stribeck speed by that speed: where its search begins
_STRIBECK_RANGE = 5.0  # factor by which it may differ
_GEAR = 10.0  # factor by which the stiffness and the play of a gear may differ from what is said
_SERVO = 10.0  # factor by which the gains of a servo may differ from the file's
_LIGHTLY = 0.1  # damping of a gear by that of an oscillation without overshoot, to begin with
_USUAL_SPEED = 0.99  # share of the samples of a record below its largest speed


class RecordedMotion(NamedTuple):
    """The motion of a joint in records.

    Attributes:
        force: largest force or torque of its actuators [N m or N]; 0 without one.
        speed: its largest speed [rad/s or m/s].
    """

    force: float
    speed: float


def recorded_motion(channels: RobotChannels, records: Sequence[Experiment]) -> list[RecordedMotion]:
    """The largest forces and speeds of each coordinate in records.

    They are rounded to 1, 2 or 5 times a power of ten, so that parts of the records give one
    system: forces up, speeds down, as the viscous friction of a range is the one by the other.

    Args:
        channels: coordinates and inputs of the robot as the records have them.
        records: the records.
    """
    motions, values = [], {p.name: p.nominal for p in _of_drives(channels)}
    for k in range(len(channels.tree.free)):
        force = 0.0
        for column, d in enumerate(channels.drives):
            if d.coordinate == k:
                acting = (
                    d.force(e.q[:, k], e.velocities()[:, k], d.acting(e, column), values)
                    for e in records
                )
                force += abs(d.ratio) * max(float(np.abs(f).max()) for f in acting)
        speed = max(float(np.quantile(np.abs(e.velocities()[:, k]), _USUAL_SPEED)) for e in records)
        motions.append(RecordedMotion(_round_up(force), speed and 1 / _round_up(1 / speed)))
    return motions


def place_frictions(channels: RobotChannels) -> tuple[PlacedForce, ...]:
    """Frictions of the chosen laws at every coordinate, beside its own Coulomb friction."""
    free = channels.tree.free
    return tuple(
        _place(LAWS[name], free[k], k)
        for name in channels.options.friction
        for k in range(len(free))
    )


def make_parameters(
    channels: RobotChannels, motions: Sequence[RecordedMotion] = ()
) -> tuple[Parameter, ...]:
    """The parameters of a robot, with ranges.

    Args:
        channels: its bodies, coordinates and inputs.
        motions: the motion of each coordinate in records, where there are some: ranges of friction
            follow from it where the file says nothing of the largest force or speed of a joint.

    Raises:
        InputError: a range of no free parameter, or one in which its value makes no sense.
    """
    tree, options = channels.tree, channels.options
    parameters = [
        p for i, body in enumerate(tree.bodies) if body.has_mass for p in _of_body(channels, i)
    ]
    for k in range(len(tree.free)):
        parameters += _of_joint(channels, k, motions[k] if motions else None)
    parameters += _of_drives(channels)
    return _with_ranges(parameters, options.ranges, f"{tree.path}, ranges")


def _of_drives(channels: RobotChannels) -> list[Parameter]:
    """The gains of servos, and the constants of motors."""
    parameters = []
    for d in channels.drives:
        units = channels.tree.joints[d.actuator.joint].units
        unit = {"kp": units.stiffness, "kv": units.damping, "gain": units.force}
        parameters += [
            _near(
                f"{d.label}.{name}",
                unit[name],
                value,
                _SERVO,
                prior=abs(value),
                basis=f"1/{_SERVO:g} to {_SERVO:g} times the value in the file",
            )
            for name, value in d.actuator.gains.items()
        ]
        if d.motor_constant is not None:
            value = channels.options.motor_constants[d.actuator.joint]
            # it sets the scale of all masses: searched for only where something else does
            is_fixed = d.motor_constant not in channels.options.ranges
            parameters.append(
                _near(d.motor_constant, f"{units.force}/A", value, _MASS, fixed=is_fixed)
            )
    return parameters


def _of_body(channels: RobotChannels, i: int) -> list[Parameter]:
    """The ten parameters of a body, with ranges about the file's values."""
    tree = channels.tree
    body = tree.bodies[i]
    values = {name: tree.nominal[f"{body.name}.{name}"] for name in INERTIAL}
    widest = max(values[name] for name in DIAGONAL)
    # how long the link is: to its centre, to the joints that it carries
    center = np.array([values[name] for name in CENTER]) - np.array(body.anchor)
    ends = [np.linalg.norm(b.position) for b in tree.bodies if b.parent == i]
    size = float(max([np.linalg.norm(center), 2 * widest, _THINNEST, *ends]))
    parameters = []
    for name, value in values.items():
        full, unit = f"{body.name}.{name}", "kg" if name == "mass" else "m"
        fixed = name in DIAGONAL and value < _THINNEST
        group = None if fixed else channels.options.per.get(body.name)
        if name == "mass" or name in DIAGONAL:
            # nobody knows what is carried
            prior = None if group is not None and name == "mass" else _SHARE * value
            basis = f"1/{_MASS:g} to {_MASS:g} times the value in the file"
            more = {"fixed": fixed, "prior": prior, "per": group, "basis": basis}
            parameter = _near(full, unit, value, _MASS, **more)
        else:
            most, prior = (size, size) if name in CENTER else (_MASS * widest, widest)
            parameter = Parameter(
                full,
                unit,
                value,
                value - most,
                value + most,
                prior=_SHARE * prior,
                per=group,
                basis="the value in the file and the size of the link",
            )
        parameters.append(parameter)
    return parameters


def _of_joint(channels: RobotChannels, k: int, motion: RecordedMotion | None) -> list[Parameter]:
    """Armature, frictions and offset of a coordinate, and springs, with their ranges."""
    tree, options = channels.tree, channels.options
    name, own = tree.free[k], tree.moved(k)
    joint = tree.joints[name]
    units = joint.units
    inertia, force = tree.largest_load(k)
    speed, speed_basis = joint.speed, "of the joint in the file"
    width = _SPEED
    armature, viscous, coulomb = (felt(own, kind) for kind in ("armature", "viscous", "coulomb"))
    if (effort := joint.effort or channels.limits(k).force) is not None:
        effort_basis = "the largest force of the joint in the file"
    elif motion is not None and motion.force > force:
        effort, effort_basis = (
            motion.force,
            "the largest force in the records, as the file has none",
        )
        if any(d.coordinate == k and d.actuator.gains for d in channels.drives):
            effort_basis += ", by its gains"
    else:
        effort = force
        effort_basis = "the force of gravity on what it carries, as it has no largest force"
    if motion is not None and not speed:
        speed, speed_basis = motion.speed, "in the records, in round numbers"
    largest_damping, damping_basis = max(
        (
            effort / speed if speed else 0.0,
            f"{effort:.3g} by {speed or 0.0:.3g}, {effort_basis}, and the largest speed "
            + speed_basis,
        ),
        (_DAMPING * inertia, f"{_DAMPING:g} times the inertia that it moves by the file"),
        (_MASS * viscous, f"{_MASS:g} times the value in the file"),
    )
    # gears make the inertia of a small motor larger than that of the links that it moves
    heaviest = max(
        tree.largest_load(i)[0]
        for i, other in enumerate(tree.free)
        if tree.joints[other].kind == joint.kind
    )
    largest_armature = max(_GEARED * inertia, _GEARED_SHARE * heaviest, _MASS * armature)
    motor_inertia = _weak(
        f"{name}.armature",
        units.inertia,
        armature,
        largest_armature,
        "some times the inertia that it moves by the file",
    )
    if name in options.elastic:
        motor_inertia = _behind_gear(motor_inertia)
    largest_coulomb = max(effort, _MASS * coulomb)
    parameters = [
        motor_inertia,
        _weak(f"{name}.viscous", units.damping, viscous, largest_damping, damping_basis),
        _weak(f"{name}.coulomb", units.force, coulomb, largest_coulomb, effort_basis),
        _near(f"{name}.coulomb_speed", units.speed, width, 100.0, fixed=True),
        # a force of either sign that a file does not have
        Parameter(
            f"{name}.offset",
            units.force,
            0.0,
            -effort,
            effort,
            prior=_SHARE * effort,
            basis=effort_basis,
        ),
    ]
    if "stribeck" in options.friction:
        slow = _STRIBECK * width
        parameters += [
            _weak(f"{name}.breakaway", units.force, 0.0, largest_coulomb),
            _near(f"{name}.stribeck_speed", units.speed, slow, _STRIBECK_RANGE, prior=slow),
        ]
    if "load" in options.friction:
        parameters.append(_weak(f"{name}.load_friction", "1", 0.0, LARGEST_LOAD_SHARE))
    if "curve" in options.friction:
        weights = _place(LAWS["curve"], name, k).brought
        parameters += [Parameter(w, units.force, 0.0, 0.0, effort) for w in weights]
    if (stiffness := options.elastic.get(name)) is not None:
        damping = _LIGHTLY * float(np.sqrt(stiffness * motor_inertia.nominal))
        largest = 10 * damping / _LIGHTLY
        parameters += [
            _near(f"{name}.gear_stiffness", units.stiffness, stiffness, _GEAR),
            Parameter(f"{name}.gear_damping", units.damping, damping, 0.0, largest),
        ]
    if (gap := options.backlash.get(name)) is not None:
        parameters.append(Parameter(f"{name}.backlash", units.position, gap, 0.0, _GEAR * gap))
    parameters += [
        _near(
            f"{j.name}.stiffness",
            j.units.stiffness,
            j.stiffness,
            _MASS,
            prior=_SHARE * j.stiffness,
        )
        for j, *_ in own
        if j.stiffness
    ]
    return parameters


def plain_friction(
    channels: RobotChannels, values: Mapping[str, float]
) -> tuple[dict[str, float], list[str]]:
    """The friction of each joint as a file has it, and remarks on what is not just so.

    Frictions beside the viscous and the Coulomb one that follow from the speed alone, or settle in
    steady motion, are brought to the nearest of these two over the speeds of a friction curve.

    Args:
        channels: the bodies, coordinates and inputs of the robot.
        values: values of all parameters by name, those of further forces included.

    Returns:
        The values without those of such frictions, the remarks.
    """
    import scipy.optimize  # takes half a second

    plain, remarks = dict(values), []
    for k, name in enumerate(channels.tree.free):
        own = {f"{name}.{kind}": 0.0 for kind in ("viscous", "coulomb", "coulomb_speed")}
        speeds = CURVE_SPEEDS[-1] * values[f"{name}.coulomb_speed"] * np.linspace(0.01, 1.0, 100)
        total, laws = np.zeros(len(speeds)), []
        for law in LAWS.values():
            force = _place(law, name, k)
            if law.is_at_input or not values.keys() - own.keys() >= (brought := {*force.brought}):
                continue
            given = force.values(values)
            forward, backward = (
                law.steady_force(jnp.asarray(sign * speeds), given) for sign in (1.0, -1.0)
            )
            if forward is None or not np.allclose(forward, -np.asarray(backward)):
                continue
            total, laws = total + np.asarray(forward), [*laws, law.name]
            plain = {n: x for n, x in plain.items() if n not in brought}
        if not total.any():
            continue
        columns = np.stack([speeds, np.ones(len(speeds))], axis=1)
        (viscous, dry), _ = scipy.optimize.nnls(columns, total)
        plain[f"{name}.viscous"] += viscous
        plain[f"{name}.coulomb"] += dry
        off, unit = np.abs(columns @ [viscous, dry] - total).max(), channels.tree.joints[name].units
        remarks.append(
            f"{name}: {join_words(laws)} in the file as {dry:.3g} {unit.force} of Coulomb and "
            f"{viscous:.3g} {unit.damping} of viscous friction, up to {off:.2g} {unit.force} off"
        )
    return plain, remarks


def _behind_gear(armature: Parameter) -> Parameter:
    """The armature behind an elastic gear: the motor moves by itself, so it is not 0."""
    nominal = armature.nominal or _SHARE * armature.upper / _GEARED
    # no prior holds it, and with a bound that is too low stiffnesses make up for it
    most = max(_GEAR * armature.upper, 2 * nominal)
    basis = f"up to {most / nominal:.3g} times the first value"
    return Parameter(armature.name, armature.unit, nominal, nominal / 100, most, basis=basis)


def _place(law: Law, name: str, k: int) -> PlacedForce:
    """A friction at the coordinate of a joint."""
    return place_force(law, name, ((k, 1.0),), (f"{name}.coulomb", f"{name}.coulomb_speed"))


def _near(name: str, unit: str, value: float, factor: float, **more: Any) -> Parameter:
    """A parameter within a factor of the value that a file or a person says."""
    lower, upper = sorted((value / factor, value * factor))
    return Parameter(name, unit, value, lower, upper, **more)


def _weak(name: str, unit: str, value: float, largest: float, basis: str = "") -> Parameter:
    """A parameter from 0 on, of which a file often says nothing."""
    return Parameter(name, unit, value, 0.0, largest, prior=_SHARE * largest, basis=basis)


def _with_ranges(
    parameters: Sequence[Parameter], ranges: Mapping[str, tuple[float, float]], where: str
) -> tuple[Parameter, ...]:
    """Parameters with the ranges that the user gave.

    Raises:
        InputError: a range of no free parameter, or one in which its value makes no sense.
    """
    free = {p.name: p for p in parameters if not p.fixed}
    for name, (lower, _) in ranges.items():
        if name not in free:
            near = difflib.get_close_matches(name, free, 3, 0.3)
            is_fixed = any(p.name == name for p in parameters)
            raise InputError(
                where,
                f"the parameter '{name}' is fixed" if is_fixed else f"no parameter '{name}'",
                "a parameter that is searched for" + (f", as {', '.join(near)}" if near else ""),
            )
        if free[name].lower > 0 >= lower:
            raise InputError(where, f"'{name}' from {lower:g} on", "a range above 0")
    return tuple(
        replace(p, lower=ranges[p.name][0], upper=ranges[p.name][1], basis="`ranges` of load_robot")
        if p.name in ranges
        else p
        for p in parameters
    )


def _round_up(value: float) -> float:
    """The next of 1, 2 and 5 times a power of ten; 0 for 0."""
    if value <= 0:
        return 0.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(n * power for n in (1, 2, 5, 10) if value <= n * power * (1 + 1e-9)))
