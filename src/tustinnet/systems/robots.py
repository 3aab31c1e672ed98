"""Robots as systems: the moving bodies of a file, their parameters, ranges and equations."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.channels import Coordinate, Input
from tustinnet.data.experiment import Experiment
from tustinnet.data.units import convert_to_si
from tustinnet.errors import InputError
from tustinnet.models.added import PlacedForce, place_force
from tustinnet.models.chains import (
    CENTER,
    DIAGONAL,
    INERTIAL,
    Body,
    Chain,
    Rows3,
    Vector3,
    body_inertia,
    inertial_parameters,
)
from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.models.forces import LARGEST_LOAD_SHARE, LAWS, Law
from tustinnet.models.kinematics import BASE, Link
from tustinnet.models.lagrangian import (
    ChannelSource,
    LagrangianModel,
    LagrangianSystem,
    Parameter,
)
from tustinnet.models.motion_limits import MotionLimits
from tustinnet.models.physical_values import equations_in
from tustinnet.systems.files import find_robot_path, find_system
from tustinnet.systems.mjcf_text import mjcf_text
from tustinnet.systems.robot import (
    LinkInertia,
    Mimic,
    Robot,
    RobotJoint,
    force_name,
    join_inertias,
    place_inertia,
    repair_inertia,
    rotation_about,
)
from tustinnet.systems.robot_equations import Drive, RobotEquations, Spring
from tustinnet.systems.robot_reading import ROBOT_ENDINGS, read_robot
from tustinnet.systems.robot_shapes import with_inertias
from tustinnet.systems.robot_writing import JointValues, write_mjcf, write_urdf

FRICTIONS = ("stribeck", "load", "curve")  # laws beside viscous and Coulomb friction
ANY_UNIT = "1"  # of an input with a gain of the file: whatever the card says
_G = 9.81  # [m/s^2], for ranges
_MASS = 5.0  # factor by which a mass or a spread may differ from the file's
_SHARE = 0.3  # of a value or a size: the standard deviation of what a file says
_THINNEST = 1e-4  # spread [m] below which a body counts as thin; its thickness is not searched for
_GEARED, _GEARED_SHARE = 3.0, 0.1  # largest armature by a joint's inertia, and by the largest one
_DAMPING = 10.0  # largest damping by inertia [1/s]
_SPEED = 0.02  # speed at which 76 % of the Coulomb friction are reached [rad/s or m/s]
_STRIBECK = 5.0  # Stribeck speed by that speed: where its search begins
_STRIBECK_RANGE = 5.0  # factor by which it may differ
_GEAR = 10.0  # factor by which the stiffness and the play of a gear may differ from what is said
_LIGHTLY = 0.1  # damping of a gear by that of an oscillation without overshoot, to begin with
_USUAL_SPEED = 0.99  # share of the samples of a record below its largest speed
_LARGEST_SPEED_SHARE = 0.01  # of the largest speed of a joint: that speed where it is known


@dataclass(frozen=True)
class _Pose:
    """A frame in another one: rotation (3, 3), and origin (3,) [m]."""

    rotation: np.ndarray
    position: np.ndarray

    def __matmul__(self, other: "_Pose") -> "_Pose":
        rotation = self.rotation @ other.rotation
        return _Pose(rotation, self.position + self.rotation @ other.position)

    def place(self, inertia: LinkInertia) -> LinkInertia:
        """An inertia of the inner frame in the outer one."""
        return place_inertia(inertia, self.rotation, self.position)


def load_robot(
    path: str | Path,
    *,
    locked: Mapping[str, float] | None = None,
    motor_constants: Mapping[str, float] | None = None,
    per: Mapping[str, str] | None = None,
    friction: Sequence[str] = (),
    elastic: Mapping[str, float] | None = None,
    backlash: Mapping[str, float] | None = None,
    encoders: Mapping[str, str] | str = "link",
    default_density: float | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> LagrangianSystem:
    """A robot as a system, from a URDF file or one in MuJoCo's format.

    Args:
        path: the file, `arm.urdf` or `robot.xml`. In a system file a relative path is looked for
            beside that file first.
        locked: joints that do not move, with their positions [rad or m].
        motor_constants: joints whose input is the current of a motor, with the force or torque by
            current [N m/A or N/A].
        per: links whose mass, centre and inertia differ between groups of records, with the name of
            the group, `{"flange": "payload"}`.
        friction: friction of all joints beside the viscous and the Coulomb one: "stribeck" (more at
            the onset of motion), "load" (grows with the torque or force of gravity at the joint),
            "curve" (any dependence on the speed, also one that differs between directions). A
            recipe's `[model] forces` adds the same laws, to all joints or to some.
        elastic: joints between whose motor and link there is a spring, as in a harmonic drive, with
            its stiffness [N m/rad or N/m], from which the search begins.
        backlash: elastic joints with play in the gear, with its whole width [rad or m].
        encoders: where the encoders of elastic joints are, `{"joint2": "motor"}`: "motor" or
            "link", which is the default; a single word is for all elastic joints. The coordinate of
            a joint is what its encoder reads, at a motor in units of the joint.
        default_density: density [kg/m^3] by which links without an inertia get that of their
            shapes; for a URDF.
        ranges: smallest and largest value of parameters by name, `{"joint1.viscous": (0, 5)}`, in
            place of those that follow from the file and the records.

    Raises:
        InputError: a file that cannot be read, an option that names no such joint or link, a value
            that is no number in range, or a robot without equations here.
    """
    path = find_robot_path(path)
    file = find_system(path)
    if isinstance(file, str) or file.is_code:
        raise InputError(path, "no file of a robot", f"a file with {', '.join(ROBOT_ENDINGS)}")
    if default_density is not None:
        file = with_inertias(file, default_density)
    if isinstance(encoders, str):
        encoders = dict.fromkeys(elastic or {"": 0.0}, encoders)
    for named in (locked, motor_constants, per, elastic, backlash, encoders, ranges):
        if not isinstance(named, Mapping | None):
            raise InputError(path, f"an option {named!r}", "a value by name, as {'joint2': 0.0}")
    positions = _require_numbers(path, "locked", locked, is_positive=False)
    constants = _require_numbers(path, "motor_constants", motor_constants)
    springs = _require_numbers(path, "elastic", elastic)
    gaps = _require_numbers(path, "backlash", backlash)
    groups = tuple(sorted((per or {}).items()))
    if isinstance(friction, str):
        friction = (friction,)
    if unknown := [name for name in friction if name not in FRICTIONS]:
        raise InputError(
            path,
            f"friction '{unknown[0]}'",
            f"one of {_list(FRICTIONS)}",
            "viscous and Coulomb friction are always there",
        )
    chosen = tuple(name for name in FRICTIONS if name in friction)
    for joint, side in encoders.items():
        of_joint = f" of '{joint}'" if joint else ""
        if side not in ("motor", "link"):
            raise InputError(path, f"encoders{of_joint}: {side!r}", "'motor' or 'link'")
        if joint not in (elastic or {}) and encoders != {"": "link"}:
            raise InputError(
                path,
                f"encoders{of_joint}: {side!r}, and no elastic gear there",
                f"one of {_list([*elastic])}" if elastic else "joints with elastic gears",
                "give it a stiffness by elastic=; behind a rigid gear both encoders read alike",
            )
    at_motor = tuple(sorted(joint for joint, side in encoders.items() if side == "motor"))
    robot = RobotFile(
        file.text,
        file.path,
        positions,
        constants,
        groups,
        chosen,
        springs,
        gaps,
        at_motor,
        default_density,
        _require_ranges(path, ranges),
    )
    return robot.load()


@dataclass(frozen=True)
class RobotFile(ChannelSource):
    """A robot file and how it is used, from which systems are made.

    Attributes:
        text: the file's text, without includes.
        path: the file.
        locked: joints that do not move, with their positions [rad or m].
        motor_constants: joints whose input is a current, with the force by current [N m/A or N/A].
        per: links that differ between groups of records, with the name of the group.
        friction: friction of joints beside the viscous and the Coulomb one, of `FRICTIONS`.
        elastic: joints with a spring behind the motor, with its stiffness [N m/rad or N/m].
        backlash: elastic joints with play, with its width [rad or m].
        at_motor: elastic joints whose encoder is at the motor.
        default_density: density by which links of the text got their inertias [kg/m^3], or None.
        ranges: parameters with their smallest and largest value.
    """

    text: str
    path: Path
    locked: tuple[tuple[str, float], ...] = ()
    motor_constants: tuple[tuple[str, float], ...] = ()
    per: tuple[tuple[str, str], ...] = ()
    friction: tuple[str, ...] = ()
    elastic: tuple[tuple[str, float], ...] = ()
    backlash: tuple[tuple[str, float], ...] = ()
    at_motor: tuple[str, ...] = ()
    default_density: float | None = None
    ranges: tuple[tuple[str, tuple[float, float]], ...] = ()

    def load(self) -> LagrangianSystem:
        """The system with all joints that move freely, and all actuators.

        Raises:
            InputError: a robot without equations here.
        """
        return self._assembly().system(self)

    def for_channels(
        self, coordinates: Sequence[Coordinate], inputs: Sequence[Input], where: object
    ) -> LagrangianSystem:
        """The system with coordinates and inputs in another order, and as they are called there.

        An input may have the name of the actuator, or one that holds the name of its joint. A joint
        without an input is not driven.

        Args:
            coordinates: coordinates, each of the name of a joint.
            inputs: inputs.
            where: whose coordinates and inputs they are, for messages.

        Raises:
            InputError: a joint or an actuator is missing, or there is none of a name; an input in
                another unit than that of a force.
        """
        return self._assembly().arranged(coordinates, inputs, where, self).system(self)

    def for_records(self, records: Sequence[Experiment], where: object) -> LagrangianSystem:
        """The system for the coordinates and inputs of records, with ranges by their motion.

        Where the file says nothing of the largest force or speed of a joint, ranges of its friction
        follow from those in the records.

        Args:
            records: records of one kind.
            where: see `for_channels`.

        Raises:
            InputError: see `for_channels`.
        """
        first = records[0]
        assembly = self._assembly().arranged(first.coordinates, first.inputs, where, self)
        assembly.observe(records)
        return assembly.system(self)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on what counts otherwise than the file says it."""
        return tuple(f"{self.path.name}, {remark}" for remark in self._assembly().remarks)

    def input_joints(self) -> dict[str, str]:
        """Of each input the coordinate on which it acts, by name."""
        assembly = self._assembly()
        return {
            i.name: assembly.free[drive.coordinate]
            for i, drive in zip(assembly.inputs, assembly.drives, strict=True)
        }

    def call(self, **more: object) -> str:
        """The line of a system file that loads this robot as it is used, with more options.

        Args:
            more: options of `load_robot` in place of those that it has; what is given by joint or
                link, and the list of frictions, is added to theirs.
        """
        options: dict[str, object] = {
            "locked": dict(self.locked),
            "motor_constants": dict(self.motor_constants),
            "per": dict(self.per),
            "friction": [*self.friction],
            "elastic": dict(self.elastic),
            "backlash": dict(self.backlash),
            "encoders": dict.fromkeys(self.at_motor, "motor"),
            "default_density": self.default_density,
            "ranges": dict(self.ranges),
        }
        for name, value in more.items():
            own = options[name]
            if isinstance(own, dict) and isinstance(value, Mapping):
                options[name] = {**own, **value}
            elif isinstance(own, list) and isinstance(value, list):
                options[name] = [*dict.fromkeys([*own, *value])]
            else:
                options[name] = value
        written = "".join(f", {name}={value!r}" for name, value in options.items() if value)
        return f"SYSTEM = tn.load_robot('{self.path.name}'{written})"

    def with_values(
        self, values: Mapping[str, float], ending: str = ""
    ) -> tuple[str, tuple[str, ...]]:
        """The file's text with values of parameters in it, and the names of those that it lacks.

        Args:
            values: the parameters of the system by name. Where some have a value for each group of
                records, the one without a group is written.
            ending: the ending of the file to write; that of the file by default. A URDF is also
                written in MuJoCo's format.

        Raises:
            InputError: a file whose inertias do not count.
        """
        assembly = self._assembly()
        is_urdf = (ending or self.path.suffix) == ".urdf"
        links = assembly.link_inertias(values)
        joints = assembly.joint_values(values)
        if is_urdf:
            text = write_urdf(self.text, links, joints)
        elif self.path.suffix == ".urdf":
            text = mjcf_text(assembly.robot, links, joints, self.path)
        else:
            text = write_mjcf(self.text, links, joints, self.path)
        parameters = {f"{body}.{name}" for body in links for name in INERTIAL}
        kinds = ("viscous", "coulomb") if is_urdf else ("viscous", "coulomb", "armature")
        parameters |= {f"{joint}.{kind}" for joint in joints for kind in kinds}
        parameters |= {
            f"{joint}.stiffness" for joint, own in joints.items() if own.stiffness is not None
        }
        # what options of `load_robot` add is not in the file, whatever its value
        plain = RobotFile(self.text, self.path, self.locked).load().nominal()
        by_group = {name for name in values if name.partition("[")[0] in parameters}
        lacking = [
            name
            for name, x in values.items()
            if name not in parameters | by_group and x != plain.get(name, 0.0)
        ]
        return text, tuple(lacking)

    def _assembly(self) -> "_Assembly":
        constants, per = dict(self.motor_constants), dict(self.per)
        return _Assembly(
            read_robot(self.text, self.path),
            self.path,
            dict(self.locked),
            constants,
            per,
            self.friction,
            dict(self.elastic),
            dict(self.backlash),
            self.at_motor,
        )


def robot_in(model: Model | ContinuousModel) -> tuple[LagrangianModel, RobotFile] | None:
    """The equations of the robot in a model, and its file; None in a model of no robot."""
    equations = equations_in(model)
    if equations is None or not isinstance(equations.system.source, RobotFile):
        return None
    return equations, equations.system.source


class _Mismatch(NamedTuple):
    """Mismatch between a card and a robot's file.

    Attributes:
        problem: what is wrong.
        expected: what the file has.
        remedy: what to do.
        options: options of `load_robot` that belong to the remedy.
    """

    problem: str
    expected: str
    remedy: str
    options: Mapping[str, Mapping[str, object]] = {}


class _RecordedMotion(NamedTuple):
    """The motion of a joint in records.

    Attributes:
        force: largest force or torque of its actuators [N m or N]; 0 without one.
        speed: its largest speed [rad/s or m/s].
    """

    force: float
    speed: float


class _Assembly:
    """The bodies, coordinates and actuators of a robot, of which a system is made.

    Args:
        robot: the robot.
        path: its file, for messages.
        locked: positions of locked joints.
        motor_constants: force or torque by current, by joint.
        per: groups of records between which links differ, by link.
        friction: friction of joints beside the viscous and the Coulomb one.
        elastic: stiffness between motor and link, by joint.
        backlash: width of the play in the gear, by joint.
        at_motor: elastic joints whose encoder is at the motor.
    """

    def __init__(
        self,
        robot: Robot,
        path: Path,
        locked: dict[str, float],
        motor_constants: dict[str, float],
        per: dict[str, str],
        friction: tuple[str, ...],
        elastic: dict[str, float],
        backlash: dict[str, float],
        at_motor: tuple[str, ...],
    ) -> None:
        self.robot, self.path, self.per, self.friction = robot, path, per, friction
        self.remarks = robot.remarks
        self.elastic, self.backlash, self.at_motor = elastic, backlash, at_motor
        self.joints = {joint.name: joint for joint in robot.joints}
        moving = [joint.name for joint in robot.joints if joint.kind != "fixed"]
        for option, names in (("locked", locked), ("motor_constants", motor_constants)):
            for name in names:
                if name not in moving:
                    raise InputError(
                        path, f"{option}: no joint '{name}' that moves", f"one of {_list(moving)}"
                    )
        self.motor_constants = motor_constants
        self.locked: dict[str, float] = {}
        self.moved_by: dict[str, Mimic] = {}  # by joint: the coordinate, and the ratio to it
        for name in moving:
            root = self._follow(name)
            if name in locked:
                self.locked[name] = locked[name]
            elif root.joint in locked:
                self.locked[name] = root.ratio * locked[root.joint] + root.offset
            else:
                self.moved_by[name] = root
        self._require_within_limits()
        self.free = [name for name in self.moved_by if self.moved_by[name].joint == name]
        if not self.free:
            raise InputError(path, "no joint that moves", "a joint that turns or slides")
        for option, names, possible, why in (
            ("elastic", elastic, self.free, "moves by itself"),
            ("backlash", backlash, [*elastic], "is elastic: give it a stiffness by elastic="),
        ):
            if unknown := [name for name in names if name not in possible]:
                raise InputError(
                    path,
                    f"{option}: the joint '{unknown[0]}'",
                    f"a joint that {why}",
                    f"there are: {_list(possible)}",
                )
        self.coordinates = tuple(
            Coordinate(name, "angular" if self.joints[name].kind == "angular" else "linear")
            for name in self.free
        )
        self._assemble()
        self.inputs, self.drives = self._drives()
        self.recorded: dict[str, _RecordedMotion] = {}
        self._require_moving_links(per)

    def _require_moving_links(self, per: Mapping[str, str]) -> None:
        """Raises unless links that differ between groups move and have a mass of their own.

        Raises:
            InputError: no such link, or one that is fixed to another one.
        """
        moved = [body.name for body in self.bodies if body.has_mass]
        for name, group in per.items():
            if name in moved:
                continue
            owner = self.owners.get(name)
            if name not in self.owners:
                problem, remedy = f"no link '{name}'", ""
            elif owner is None:
                problem, remedy = f"the link '{name}' is fixed to the base, which does not move", ""
            elif (carrier := self.bodies[owner].name) == name:
                problem, remedy = f"the link '{name}' has no mass", ""
            else:
                problem = f"the link '{name}' is fixed to '{carrier}', and both are one body"
                remedy = f"name the link that moves: per={{'{carrier}': '{group}'}}"
            expected = f"a link that moves and has a mass: {_list(moved)}"
            raise InputError(self.path, f"per: {problem}", expected, remedy)

    def arranged(
        self,
        coordinates: Sequence[Coordinate],
        inputs: Sequence[Input],
        where: object,
        source: RobotFile,
    ) -> "_Assembly":
        """Assembly with coordinates and inputs in another order, see `RobotFile.for_channels`.

        Raises:
            InputError: all that does not agree, at once.
        """
        mismatches = self._compare_coordinates(coordinates)
        drives = [self._find_drive(i) for i in inputs]
        for i, k in zip(inputs, drives, strict=True):
            mismatches += self._compare_input(i, k, drives)
        if self.robot.actuators is not None:
            silent = [x.name for k, x in enumerate(self.inputs) if k not in drives]
            if silent:
                mismatches.append(
                    _Mismatch(
                        f"no input of the actuator{'s' * (len(silent) > 1)} "
                        f"{', '.join(map(repr, silent))} of {self.path.name}",
                        f"inputs {_list([i.name for i in self.inputs])}",
                        f"add {'it' if len(silent) == 1 else 'them'} to the card, or take "
                        f"{'it' if len(silent) == 1 else 'them'} out of the file",
                    )
                )
        if mismatches:
            raise _mismatch_error(mismatches, where, source)
        matched = [k for k in drives if k is not None]
        order = [self.free.index(c.name) for c in coordinates]
        self.free = [self.free[k] for k in order]
        self.coordinates = tuple(self.coordinates[k] for k in order)
        self.bodies = [replace(b, coordinate=order.index(b.coordinate)) for b in self.bodies]
        self.drives = [
            replace(self.drives[k], coordinate=order.index(self.drives[k].coordinate))
            for k in matched
        ]
        self.inputs = tuple(inputs)
        return self

    def _compare_coordinates(self, coordinates: Sequence[Coordinate]) -> list["_Mismatch"]:
        """Mismatches between the coordinates of a card and the joints that move."""
        names, file = [c.name for c in coordinates], self.path.name
        mismatches = []
        unknown = [name for name in names if name not in self.free]
        if missing := [name for name in self.free if name not in names]:
            meant = {name: near for name in missing if (near := _nearest(name, unknown))}
            also = f", and no joint '{unknown[0]}' there" if unknown else ""
            mismatches += [
                _Mismatch("", "", f"rename the coordinate '{b}' to '{a}'") for a, b in meant.items()
            ]
            absent = {name: 0.0 for name in missing if name not in meant}
            mismatches.append(
                _Mismatch(
                    f"no coordinate of {_joints(missing)} of {file}{also}",
                    f"coordinates {_list(self.free)}",
                    "add them to the card, or lock them" if absent else "",
                    {"locked": absent} if absent else {},
                )
            )
            unknown = [name for name in unknown[1:] if name not in meant.values()]
        for name in unknown:
            follows = name in {*self.moved_by, *self.locked}
            problem = "does not move by itself" if follows else "is not there"
            mismatches.append(
                _Mismatch(
                    f"coordinate '{name}': such a joint {problem} in {file}",
                    f"coordinates {_list(self.free)}",
                    "a coordinate of the card has the name of its joint",
                )
            )
        for c in coordinates:
            own = self.joints[c.name].kind if c.name in self.free else c.kind
            if c.kind != own:
                moves = "turns" if own == "angular" else "slides"
                mismatches.append(
                    _Mismatch(
                        f"coordinate '{c.name}' is {c.kind}, and the joint {moves}",
                        f'kind = "{own}"',
                        "the kind of a coordinate is that of its joint",
                    )
                )
        return mismatches

    def _find_drive(self, i: Input) -> int | None:
        """The index of the actuator that an input of a card is that of, None without one."""
        matching = [k for k, own in enumerate(self.inputs) if own.name == i.name]
        if not matching:
            # the longest name: `joint1` is part of `joint10_torque`
            holds = [k for k, d in enumerate(self.drives) if d.joint in i.name]
            matching = sorted(holds, key=lambda k: -len(self.drives[k].joint))[:1]
        return matching[0] if matching else None

    def _compare_input(
        self, i: Input, k: int | None, drives: Sequence[int | None]
    ) -> list["_Mismatch"]:
        """Mismatches between an input of a card and the actuator that it is that of."""
        if k is None:
            near = _nearest(i.name, [own.name for own in self.inputs])
            return [
                _Mismatch(
                    f"input '{i.name}': no such actuator in {self.path.name}",
                    f"inputs {_list([own.name for own in self.inputs])}",
                    f"rename the input '{i.name}' to '{near}'"
                    if near
                    else "the name of an actuator, or one that holds the name of the joint",
                )
            ]
        own, drive, mismatches = self.inputs[k], self.drives[k], []
        if drives.count(k) > 1:
            mismatches.append(_Mismatch(f"two inputs at '{own.name}'", "one", i.name))
        if own.unit != ANY_UNIT and not _is_same_unit(i.unit, own.unit):
            is_current = _is_same_unit(i.unit, "A")
            mismatches.append(
                _Mismatch(
                    f"input '{i.name}' in {i.unit}",
                    own.unit,
                    "a current needs a gain" if is_current else "convert it in the card by `scale`",
                    {"motor_constants": {drive.joint: ...}} if is_current else {},
                )
            )
        return mismatches

    def observe(self, records: Sequence[Experiment]) -> None:
        """Takes the largest forces and speeds of records for joints of which the file has none.

        They are rounded up to 1, 2 or 5 times a power of ten, so that parts of the records give one
        system.

        Args:
            records: records with the coordinates and inputs of the assembly.
        """
        constants = self.motor_constants
        for k, name in enumerate(self.free):
            force = 0.0
            for column, d in enumerate(self.drives):
                if d.coordinate == k and not (d.by_position or d.by_speed):
                    gain = abs(d.gain * d.ratio * constants.get(d.joint, 1.0))
                    force += gain * max(float(np.abs(e.u[:, column]).max()) for e in records)
            speed = max(
                float(np.quantile(np.abs(e.velocities()[:, k]), _USUAL_SPEED)) for e in records
            )
            self.recorded[name] = _RecordedMotion(_round_up(force), _round_up(speed))

    def _follow(self, name: str) -> Mimic:
        """The joint that moves another one in the end, itself if it follows none."""
        ratio, offset, visited = 1.0, 0.0, [name]
        while (mimic := self.joints[visited[-1]].mimic) is not None:
            place = f"{self.path}, joint '{visited[-1]}'"
            if mimic.joint not in self.joints or self.joints[mimic.joint].kind == "fixed":
                raise InputError(place, f"follows '{mimic.joint}', no joint that moves", "one")
            if mimic.joint in visited:
                raise InputError(place, f"follows '{mimic.joint}', which follows it", "no loop")
            offset += ratio * mimic.offset
            ratio *= mimic.ratio
            visited.append(mimic.joint)
        return Mimic(visited[-1], ratio, offset)

    def _assemble(self) -> None:
        """Joins the links that do not move against one another to bodies."""
        robot = self.robot
        links = {link.name: link for link in robot.links}
        carried = {joint.child for joint in robot.joints}
        base = next(name for name in links if name not in carried)
        # of each link the body that it belongs to, None for the base, and its frame in that
        places: dict[str, tuple[int | None, _Pose]] = {base: (None, _Pose(np.eye(3), np.zeros(3)))}
        self.bodies: list[Body] = []
        self.body_joints: list[RobotJoint] = []
        inertias: list[list[LinkInertia]] = []
        # by body, names and inertias of the links that are fixed to its own
        self.carried: list[list[tuple[str, LinkInertia]]] = []
        for joint in robot.joints:
            owner, pose = places[joint.parent]
            frame = pose @ _Pose(joint.rotation, joint.position)
            link = links[joint.child]
            if joint.name in self.moved_by:
                mover = self.moved_by[joint.name]
                owner, frame = (
                    self._add_body(joint, owner, frame, mover),
                    _Pose(np.eye(3), -joint.anchor),
                )
                inertias.append([])
                self.carried.append([])
            elif joint.name in self.locked:
                frame = frame @ _motion(joint, self.locked[joint.name])
            places[joint.child] = owner, frame
            if link.inertia is not None and owner is not None:
                inertias[owner].append(frame.place(link.inertia))
                if joint.name not in self.moved_by:
                    self.carried[owner].append((link.name, inertias[owner][-1]))
        self.owners = {name: owner for name, (owner, _) in places.items()}
        self.nominal: dict[str, float] = {}
        for i, parts in enumerate(inertias):
            body = self.bodies[i]
            if not parts:
                self.bodies[i] = replace(body, has_mass=False)
                continue
            whole, remarks = repair_inertia(join_inertias(parts), body.name, self.path)
            self.remarks += remarks
            values = inertial_parameters(
                whole.mass, whole.center + np.array(body.anchor), whole.tensor
            )
            self.nominal |= {f"{body.name}.{name}": x for name, x in values.items()}
        if not any(
            part.tensor.any() or part.center.any() or body.kind == "linear"
            for body, parts in zip(self.bodies, inertias, strict=True)
            for part in parts
        ):
            raise InputError(
                self.path,
                "links that move have no masses, or all their inertias and centres are 0",
                "mass, centre and inertia",
                "give them an <inertial> with these, or that of their shapes by `default_density=`",
            )

    def link_inertias(self, values: Mapping[str, float]) -> dict[str, LinkInertia | None]:
        """The inertias of links in their own frames, by the values of the bodies' parameters.

        Of a body of several links the others keep what they have by the file, as long as what is
        left for the link that moves is the inertia of a body; else this link has all of it and the
        others have none.
        """
        inertias: dict[str, LinkInertia | None] = {}
        for i, body in enumerate(self.bodies):
            if not body.has_mass:
                continue
            own = body_inertia(body, values)
            whole = _about_center(float(own.mass), np.asarray(own.moment), np.asarray(own.tensor))
            carried = [part for _, part in self.carried[i]]
            rest = _without(whole, carried) if carried else whole
            if rest is None:
                inertias |= {name: None for name, _ in self.carried[i]}
                rest = whole
            inertias[body.name] = replace(rest, center=rest.center + np.array(body.anchor))
        return inertias

    def joint_values(self, values: Mapping[str, float]) -> dict[str, JointValues]:
        """The values of joints; what joints that follow have by the file is taken off first."""
        values_by_joint = {}
        for name in self.free:
            followers = [
                (self.joints[other], abs(m.ratio))
                for other, m in self.moved_by.items()
                if m.joint == name and other != name
            ]
            less = {
                "viscous": sum(j.viscous * r**2 for j, r in followers),
                "coulomb": sum(j.coulomb * r for j, r in followers),
                "armature": sum(j.armature * r**2 for j, r in followers),
            }
            own = {kind: max(values[f"{name}.{kind}"] - x, 0.0) for kind, x in less.items()}
            values_by_joint[name] = JointValues(**own)
        for name in self.moved_by:
            if self.joints[name].stiffness:
                before = values_by_joint.get(name, JointValues())
                values_by_joint[name] = replace(before, stiffness=values[f"{name}.stiffness"])
        return values_by_joint

    def _add_body(self, joint: RobotJoint, parent: int | None, frame: _Pose, mover: Mimic) -> int:
        """Adds the body that a joint carries; its frame is at the joint."""
        if any(body.name == joint.child for body in self.bodies):
            raise InputError(self.path, f"two links '{joint.child}'", "names that differ")
        self.bodies.append(
            Body(
                joint.child,
                parent,
                "angular" if joint.kind == "angular" else "linear",
                _vector(joint.axis),
                _rows(frame.rotation),
                _vector(frame.position + frame.rotation @ joint.anchor),
                self.free.index(mover.joint),
                mover.ratio,
                mover.offset - joint.zero,
                _vector(joint.anchor),
            )
        )
        self.body_joints.append(joint)
        return len(self.bodies) - 1

    def _require_within_limits(self) -> None:
        """Raises unless the limits of joints are in order, and locked joints within theirs."""
        for name, joint in self.joints.items():
            low, high = joint.range or (-np.inf, np.inf)
            position = self.locked.get(name, low)
            if not low <= position <= high:
                raise InputError(
                    f"{self.path}, joint '{name}'",
                    f"position {position:g}, limits {low:g} to {high:g}",
                    "the smaller limit first, and a position between them where it is locked",
                )

    def system(self, source: RobotFile) -> LagrangianSystem:
        """The system with all that the file says.

        Args:
            source: the file, from which systems in another order are made.
        """
        # behind an elastic gear the motor moves by itself
        armatures = tuple(None if n in self.elastic else f"{n}.armature" for n in self.free)
        chain = Chain(tuple(self.bodies), self.robot.gravity, armatures)
        parameters = [
            parameter
            for i, body in enumerate(self.bodies)
            if body.has_mass
            for parameter in self._body_parameters(i)
        ]
        for k in range(len(self.free)):
            parameters += self._joint_parameters(k)
        parameters += [
            Parameter(
                f"{joint}.motor_constant",
                f"{_force_unit(self.joints[joint])}/A",
                value,
                value / _MASS,
                value * _MASS,
                fixed=True,
            )
            for joint, value in self.motor_constants.items()
        ]
        elastic, backlash, at_motor = (
            tuple(k for k, name in enumerate(self.free) if name in names)
            for names in (self.elastic, self.backlash, self.at_motor)
        )
        equations = RobotEquations(
            chain,
            tuple(self.free),
            tuple(self.drives),
            self._springs(),
            self._frictions(),
            elastic,
            backlash,
            at_motor,
            tuple(self.joints[n].effort or self._scale(k)[1] for k, n in enumerate(self.free)),
        )
        return LagrangianSystem(
            name=self.robot.name,
            coordinates=self.coordinates,
            inputs=self.inputs,
            parameters=_with_ranges(parameters, source),
            kinetic=equations.kinetic,
            potential=equations.potential,
            dissipation=equations.dissipation,
            input_map=equations.input_map,
            links=self._drawn_links(),
            inertia=equations.inertia,
            source=source,
            limits=tuple(self._limits(k) for k in range(len(self.free))),
            unmeasured=equations.unmeasured,
        )

    def _body_parameters(self, i: int) -> list[Parameter]:
        """The ten parameters of a body, with ranges about the file's values."""
        body = self.bodies[i]
        values = {name: self.nominal[f"{body.name}.{name}"] for name in INERTIAL}
        widest = max(values[name] for name in DIAGONAL)
        # how long the link is: to its centre, to the joints that it carries
        center = np.array([values[name] for name in CENTER]) - np.array(body.anchor)
        ends = [np.linalg.norm(b.position) for b in self.bodies if b.parent == i]
        size = float(max([np.linalg.norm(center), 2 * widest, _THINNEST, *ends]))
        parameters = []
        for name, value in values.items():
            unit, full, fixed = "m", f"{body.name}.{name}", False
            basis = f"1/{_MASS:g} to {_MASS:g} times the value in the file"
            if name == "mass" or name in DIAGONAL:
                lower, upper, prior = value / _MASS, value * _MASS, _SHARE * value
                unit, fixed = ("kg", False) if name == "mass" else ("m", value < _THINNEST)
            elif name in CENTER:
                lower, upper, prior = value - size, value + size, _SHARE * size
                basis = "the value in the file and the size of the link"
            else:
                most = _MASS * widest
                lower, upper, prior = value - most, value + most, _SHARE * widest
                basis = "the value in the file and the size of the link"
            group = None if fixed else self.per.get(body.name)
            if group is not None and name == "mass":
                prior = None  # nobody knows what is carried
            parameters.append(
                Parameter(full, unit, value, lower, upper, fixed, prior, group, basis=basis)
            )
        return parameters

    def _joint_parameters(self, k: int) -> list[Parameter]:
        """Armature, frictions and offset of a coordinate, and springs, with their ranges."""
        name = self.free[k]
        joint = self.joints[name]
        own = [
            (self.joints[other], abs(m.ratio))
            for other, m in self.moved_by.items()
            if m.joint == name
        ]
        inertia, force = self._scale(k)
        speed = joint.speed
        width = _SPEED if speed is None else _LARGEST_SPEED_SHARE * speed
        armature = sum(j.armature * ratio**2 for j, ratio in own)
        viscous = sum(j.viscous * ratio**2 for j, ratio in own)
        coulomb = sum(j.coulomb * ratio for j, ratio in own)
        effort, effort_basis = joint.effort or force, "the largest force of the joint in the file"
        if joint.effort is None:
            effort_basis = "the force of gravity on what it carries, as it has no largest force"
        if (motion := self.recorded.get(name)) is not None:
            if joint.effort is None and motion.force > effort:
                effort = motion.force
                effort_basis = "the largest force in the records, as the file has none"
            speed = speed or motion.speed
        largest_damping, damping_basis = max(
            (
                effort / speed if speed else 0.0,
                f"{effort:.3g} by the largest speed {speed or 0.0:.3g}, where {effort:.3g} is "
                + effort_basis,
            ),
            (_DAMPING * inertia, f"{_DAMPING:g} times the inertia that it moves by the file"),
            (_MASS * viscous, f"{_MASS:g} times the value in the file"),
        )
        alike = [i for i, c in enumerate(self.coordinates) if c.kind == joint.kind]
        # gears make the inertia of a small motor larger than that of the links that it moves
        heaviest = max(self._scale(i)[0] for i in alike)
        largest_armature = max(_GEARED * inertia, _GEARED_SHARE * heaviest, _MASS * armature)
        kind, per_speed = _force_unit(joint), "s/rad" if joint.kind == "angular" else "s/m"
        unit = "kg m^2" if joint.kind == "angular" else "kg"
        speed_unit = "rad/s" if joint.kind == "angular" else "m/s"
        parameters = [
            self._motor_inertia(name, unit, armature, largest_armature),
            _weak(
                f"{name}.viscous", f"{kind} {per_speed}", viscous, largest_damping, damping_basis
            ),
            _weak(f"{name}.coulomb", kind, coulomb, max(effort, _MASS * coulomb), effort_basis),
            Parameter(
                f"{name}.coulomb_speed", speed_unit, width, width / 100, 100 * width, fixed=True
            ),
            Parameter(
                f"{name}.offset",
                kind,
                0.0,
                -effort,
                effort,
                prior=_SHARE * effort,
                basis=effort_basis,
            ),
        ]
        if "stribeck" in self.friction:
            slow = _STRIBECK * width
            parameters += [
                _weak(f"{name}.breakaway", kind, 0.0, max(effort, _MASS * coulomb)),
                Parameter(
                    f"{name}.stribeck_speed",
                    speed_unit,
                    slow,
                    slow / _STRIBECK_RANGE,
                    slow * _STRIBECK_RANGE,
                    prior=slow,
                ),
            ]
        if "load" in self.friction:
            parameters.append(_weak(f"{name}.load_friction", "1", 0.0, LARGEST_LOAD_SHARE))
        if "curve" in self.friction:
            parameters += [
                Parameter(weight, kind, 0.0, -effort, effort, prior=_SHARE * effort)
                for weight in self._place(LAWS["curve"], k).brought
            ]
        if (stiffness := self.elastic.get(name)) is not None:
            damping = _LIGHTLY * float(np.sqrt(stiffness * parameters[0].nominal))
            parameters += [
                Parameter(
                    f"{name}.gear_stiffness",
                    _stiffness_unit(joint),
                    stiffness,
                    stiffness / _GEAR,
                    stiffness * _GEAR,
                ),
                Parameter(
                    f"{name}.gear_damping",
                    f"{kind} {per_speed}",
                    damping,
                    0.0,
                    10 * damping / _LIGHTLY,
                ),
            ]
        if (gap := self.backlash.get(name)) is not None:
            parameters.append(
                Parameter(
                    f"{name}.backlash",
                    "rad" if joint.kind == "angular" else "m",
                    gap,
                    0.0,
                    _GEAR * gap,
                )
            )
        for j, _ in own:
            if j.stiffness:
                parameters.append(
                    Parameter(
                        f"{j.name}.stiffness",
                        _stiffness_unit(j),
                        j.stiffness,
                        j.stiffness / _MASS,
                        j.stiffness * _MASS,
                        prior=_SHARE * j.stiffness,
                    )
                )
        return parameters

    def _motor_inertia(self, name: str, unit: str, armature: float, largest: float) -> Parameter:
        """The armature of a joint; behind an elastic gear it moves by itself, so it is not 0."""
        if name not in self.elastic:
            return _weak(
                f"{name}.armature",
                unit,
                armature,
                largest,
                "some times the inertia that it moves by the file",
            )
        nominal = armature or _SHARE * largest / _GEARED
        # no prior holds it, and with a bound that is too low stiffnesses make up for it
        most = max(_GEAR * largest, 2 * nominal)
        basis = f"up to {most / nominal:.3g} times the first value"
        return Parameter(f"{name}.armature", unit, nominal, nominal / 100, most, basis=basis)

    def _limits(self, k: int) -> MotionLimits:
        """The limits of a coordinate: of its joint, of those that follow it, of its actuators."""
        position, velocity = (-np.inf, np.inf), np.inf
        for name, mover in self.moved_by.items():
            joint = self.joints[name]
            if mover.joint != self.free[k] or mover.ratio == 0:
                continue
            if joint.range is not None:
                low, high = sorted((end - mover.offset) / mover.ratio for end in joint.range)
                position = max(position[0], low), min(position[1], high)
            velocity = min(velocity, (joint.speed or np.inf) / abs(mover.ratio))
        forces = [
            abs(d.ratio) * (self.joints[d.joint].effort or d.largest_force or np.inf)
            for d in self.drives
            if d.coordinate == k
        ]
        has_range = np.isfinite(position).all() and position[0] < position[1]
        return MotionLimits(
            (float(position[0]), float(position[1])) if has_range else None,
            float(velocity) if np.isfinite(velocity) else None,
            force=float(sum(forces)) if forces and np.isfinite(forces).all() else None,
        )

    def _scale(self, k: int) -> tuple[float, float]:
        """Largest inertia and force of gravity that a coordinate sees, the robot stretched out."""
        inertia = force = 0.0
        reach: dict[int, float] = {}
        for i, body in enumerate(self.bodies):
            if body.coordinate == k and (body.parent is None or body.parent not in reach):
                reach[i] = 0.0
            elif body.parent in reach:
                reach[i] = reach[body.parent] + float(np.linalg.norm(body.position))
            if i not in reach or not body.has_mass:
                continue
            mass, *numbers = (self.nominal[f"{body.name}.{name}"] for name in INERTIAL)
            center, spread = np.array(numbers[:3]) - np.array(body.anchor), np.array(numbers[3:6])
            lever = reach[i] + float(np.linalg.norm(center))
            is_linear = self.coordinates[k].kind == "linear"
            inertia += mass if is_linear else mass * (lever**2 + float(spread @ spread))
            force += mass * _G * (1.0 if is_linear else lever + float(spread.max()))
        if not inertia:  # nothing with a mass moves, but what the motor turns
            inertia = self.joints[self.free[k]].armature
            force = _G * inertia
        return inertia, force

    def _frictions(self) -> tuple[PlacedForce, ...]:
        """Frictions of the chosen laws at every coordinate, beside its own Coulomb friction."""
        return tuple(
            self._place(LAWS[name], k) for name in self.friction for k in range(len(self.free))
        )

    def _place(self, law: Law, k: int) -> PlacedForce:
        """A friction at a coordinate."""
        own = (f"{self.free[k]}.coulomb", f"{self.free[k]}.coulomb_speed")
        return place_force(law, self.free[k], k, own)

    def _springs(self) -> tuple[Spring, ...]:
        return tuple(
            Spring(name, self.free.index(m.joint), m.ratio, m.offset, self.joints[name].spring_rest)
            for name, m in self.moved_by.items()
            if self.joints[name].stiffness
        )

    def _drives(self) -> tuple[tuple[Input, ...], list[Drive]]:
        """The inputs, and how each acts; without actuators in the file a force at each joint."""
        inputs, drives = [], []
        if self.robot.actuators is None:
            actuators = [(None, name) for name in self.free]
        else:
            actuators = [(a, a.joint) for a in self.robot.actuators if a.joint in self.moved_by]
        for actuator, name in actuators:
            joint, mover = self.joints[name], self.moved_by[name]
            unit, gain = _force_unit(joint), 1.0
            terms, largest = (0.0, 0.0, 0.0), None
            if actuator is not None:
                gain = actuator.gain
                terms = actuator.by_position, actuator.by_speed, actuator.bias
                largest = actuator.largest_force
                if gain != 1.0 or any(terms):
                    unit = ANY_UNIT
            if has_motor := name in self.motor_constants:
                unit = "A"
            inputs.append(Input(actuator.name if actuator else force_name(joint), unit))
            constant = f"{name}.motor_constant" if has_motor else None
            drives.append(
                Drive(
                    name,
                    self.free.index(mover.joint),
                    mover.ratio,
                    mover.offset,
                    constant,
                    gain,
                    *terms,
                    largest,
                )
            )
        for name in self.motor_constants:
            if name not in [joint for _, joint in actuators]:
                raise InputError(
                    self.path,
                    f"motor_constants: the joint '{name}' has no actuator",
                    f"one of {_list([joint for _, joint in actuators])}",
                )
        return tuple(inputs), drives

    def _drawn_links(self) -> tuple[Link, ...]:
        """The links of the drawing: of each coordinate the body that its own joint carries.

        None where a joint that follows another one carries some of them.
        """
        links = []
        for i, body in enumerate(self.bodies):
            name = self.free[body.coordinate]
            if self.body_joints[i].name != name:
                continue  # a mimic joint has no coordinate of its own
            ends = [np.array(b.position) for b in self.bodies if b.parent == i]
            ends = [end for end in ends if np.linalg.norm(end) > 1e-3]
            if ends:
                reach = max(ends, key=lambda end: float(np.linalg.norm(end)))
            elif body.has_mass:
                center = np.array([self.nominal[f"{body.name}.{c}"] for c in CENTER])
                reach = 2 * (center - np.array(body.anchor))
            else:
                reach = np.zeros(3)
            parent = BASE if body.parent is None else self.free[self.bodies[body.parent].coordinate]
            links.append((name, body, parent, reach))
        is_on_mimic = any(
            body.parent is not None and self.body_joints[body.parent].name not in self.free
            for body in self.bodies
        )
        return () if is_on_mimic else _unrotated(links)


def _unrotated(
    drawn: Sequence[tuple[str, Body, str, np.ndarray]],
) -> tuple[Link, ...]:
    """Links for the drawing, whose frames have the axes of the base where all coordinates are 0.

    A `Link` has no rotation between its frame and that of its parent, so each is turned.
    """
    turns, links = {BASE: np.eye(3)}, []
    for name, body, parent, reach in drawn:
        axis, at, turn = (np.array(x) for x in (body.axis, body.position, body.rotation))
        if body.kind == "angular":
            turn = turn @ rotation_about(axis, body.offset)
        else:
            at = at + body.offset * turn @ axis
        at, turn = turns[parent] @ at, turns[parent] @ turn
        turns[name] = turn
        links.append(Link(name, _vector(turn @ axis), _vector(turn @ reach), parent, _vector(at)))
    return tuple(links)


def _weak(name: str, unit: str, value: float, largest: float, basis: str = "") -> Parameter:
    """A parameter from 0 on, of which a file often says nothing."""
    return Parameter(name, unit, value, 0.0, largest, prior=_SHARE * largest, basis=basis)


def _mismatch_error(
    mismatches: Sequence[_Mismatch], where: object, source: RobotFile
) -> InputError:
    """The error about all mismatches, with one line of a system file for all remedies in it."""
    problems, expected = (
        separator.join(dict.fromkeys(filter(None, parts)))
        for separator, parts in (
            ("; ", [m.problem for m in mismatches]),
            (", and ", [m.expected for m in mismatches]),
        )
    )
    in_order = sorted(mismatches, key=lambda m: bool(m.options))  # those of the system file last
    remedy = "; ".join(dict.fromkeys(m.remedy for m in in_order if m.remedy))
    options: dict[str, dict[str, object]] = {}
    for m in mismatches:
        for name, values in m.options.items():
            options.setdefault(name, {}).update(values)
    if options:
        line = source.call(**options).replace("Ellipsis", "...")
        remedy += f", in a system file: {line}"
    return InputError(where, problems, expected, remedy)


def _with_ranges(parameters: Sequence[Parameter], source: RobotFile) -> tuple[Parameter, ...]:
    """Parameters with the ranges that the user gave.

    Raises:
        InputError: a range of no free parameter, or one in which its value makes no sense.
    """
    ranges = dict(source.ranges)
    free = {p.name: p for p in parameters if not p.fixed}
    for name, (lower, _) in ranges.items():
        place = f"{source.path}, ranges"
        if name not in free:
            near = difflib.get_close_matches(name, free, 3, 0.3)
            is_fixed = any(p.name == name for p in parameters)
            raise InputError(
                place,
                f"the parameter '{name}' is fixed" if is_fixed else f"no parameter '{name}'",
                "a parameter that is searched for" + (f", as {', '.join(near)}" if near else ""),
            )
        if free[name].lower > 0 >= lower:
            raise InputError(place, f"'{name}' from {lower:g} on", "a range above 0")
    return tuple(
        replace(p, lower=ranges[p.name][0], upper=ranges[p.name][1], basis="`ranges` of load_robot")
        if p.name in ranges
        else p
        for p in parameters
    )


def _about_center(mass: float, moment: np.ndarray, tensor: np.ndarray) -> LinkInertia:
    """An inertia whose tensor and moment were about the origin of the frame."""
    center = moment / mass
    return LinkInertia(
        mass, center, tensor - mass * (center @ center * np.eye(3) - np.outer(center, center))
    )


def _without(whole: LinkInertia, parts: Sequence[LinkInertia]) -> LinkInertia | None:
    """Rest of an inertia without some parts of it; None where no body has that."""
    mass, moment, tensor = whole.mass, whole.mass * whole.center, whole.tensor
    for part, sign in ((whole, 1.0), *((part, -1.0) for part in parts)):
        r, shift = part.center, sign * part.mass
        tensor = tensor + shift * (r @ r * np.eye(3) - np.outer(r, r))
        if sign < 0:
            mass, moment, tensor = mass - part.mass, moment - part.mass * r, tensor - part.tensor
    if mass <= 0:
        return None
    rest = _about_center(mass, moment, tensor)
    try:
        inertial_parameters(rest.mass, rest.center, rest.tensor)
    except (ValueError, np.linalg.LinAlgError):
        return None
    return rest


def _motion(joint: RobotJoint, position: float) -> _Pose:
    """The motion of a joint from its zero to a position."""
    travel = position - joint.zero
    if joint.kind == "linear":
        return _Pose(np.eye(3), travel * joint.axis)
    rotation = rotation_about(joint.axis, travel)
    return _Pose(rotation, joint.anchor - rotation @ joint.anchor)


def _require_numbers(
    path: object, option: str, values: Mapping[str, float] | None, *, is_positive: bool = True
) -> tuple[tuple[str, float], ...]:
    """An option's numbers by name, in the order of the names.

    Raises:
        InputError: a value that is no finite number, or not positive where it has to be.
    """
    expected = "a positive number" if is_positive else "a number"
    for name, value in (values or {}).items():
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        if not is_number or not np.isfinite(value) or (is_positive and value <= 0):
            raise InputError(path, f"{option}: {value!r} for '{name}'", expected)
    return tuple(sorted((name, float(x)) for name, x in (values or {}).items()))


def _require_ranges(
    path: object, ranges: Mapping[str, tuple[float, float]] | None
) -> tuple[tuple[str, tuple[float, float]], ...]:
    """Smallest and largest values of parameters, in the order of the names.

    Raises:
        InputError: an entry that is not two finite numbers, the smaller one first.
    """
    checked = []
    for name, ends in (ranges or {}).items():
        numbers: Any = ends
        try:
            lower, upper = (float(x) for x in numbers)
        except (TypeError, ValueError):
            lower = upper = np.nan
        if not (np.isfinite([lower, upper]).all() and lower < upper):
            raise InputError(
                path,
                f"ranges: {ends!r} for '{name}'",
                "two numbers, the smaller one first",
                f"ranges={{'{name}': (0.0, 1.0)}}",
            )
        checked.append((name, (lower, upper)))
    return tuple(sorted(checked))


def _round_up(value: float) -> float:
    """The next of 1, 2 and 5 times a power of ten; 0 for 0."""
    if value <= 0:
        return 0.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(n * power for n in (1, 2, 5, 10) if value <= n * power * (1 + 1e-9)))


def _nearest(name: str, names: Sequence[str]) -> str:
    """The name that was probably meant: the same but for case, else a very similar one; or ""."""
    alike = [other for other in names if other.lower() == name.lower()]
    return (alike or difflib.get_close_matches(name, names, 1, 0.8) or [""])[0]


def _is_same_unit(a: str, b: str) -> bool:
    try:
        return convert_to_si(a) == convert_to_si(b)
    except ValueError:
        return a == b


def _joints(names: Sequence[str]) -> str:
    """The joints of some names, for messages."""
    quoted = ", ".join(f"'{name}'" for name in names)
    return f"the joint{'s' if len(names) > 1 else ''} {quoted}"


def _force_unit(joint: RobotJoint) -> str:
    return "N m" if joint.kind == "angular" else "N"


def _stiffness_unit(joint: RobotJoint) -> str:
    return "N m/rad" if joint.kind == "angular" else "N/m"


def _vector(numbers: np.ndarray) -> Vector3:
    x, y, z = (float(number) for number in numbers)
    return x, y, z


def _rows(matrix: np.ndarray) -> Rows3:
    a, b, c = (_vector(row) for row in matrix)
    return a, b, c


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"
