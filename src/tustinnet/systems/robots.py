"""Robots as systems: the moving bodies of a file, their parameters, ranges and equations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from tustinnet.channels import Coordinate, Input
from tustinnet.data.units import convert_to_si
from tustinnet.errors import InputError
from tustinnet.models import forces
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
from tustinnet.models.kinematics import BASE, Link
from tustinnet.models.lagrangian import ChannelSource, LagrangianSystem, Parameter
from tustinnet.systems.files import ROBOT_ENDINGS, find_system
from tustinnet.systems.mjcf import read_mjcf
from tustinnet.systems.robot import LinkInertia, Mimic, Robot, RobotJoint, rotation_about
from tustinnet.systems.robot_writing import JointValues, write_mjcf, write_urdf
from tustinnet.systems.urdf import read_urdf

ANY_UNIT = "1"  # of an input with a gain of the file: whatever the card says
_G = 9.81  # [m/s^2], for ranges
_MASS = 5.0  # factor by which a mass or a spread may differ from the file's
_SHARE = 0.3  # of a value or a size: the standard deviation of what a file says
_THINNEST = 1e-4  # spread [m] below which a body counts as thin; its thickness is not searched for
_GEARED, _GEARED_SHARE = 3.0, 0.1  # largest armature by a joint's inertia, and by the largest one
_DAMPING = 10.0  # largest damping by inertia [1/s]
_SPEED = 0.02  # speed at which 76 % of the Coulomb friction are reached [rad/s or m/s]
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
        center = self.position + self.rotation @ inertia.center
        tensor = self.rotation @ inertia.tensor @ self.rotation.T
        return LinkInertia(inertia.mass, center, tensor)


def load_robot(
    path: str | Path,
    *,
    locked: Mapping[str, float] | None = None,
    motor_constants: Mapping[str, float] | None = None,
    per: Mapping[str, str] | None = None,
) -> LagrangianSystem:
    """A robot as a system, from a URDF file or one in MuJoCo's format.

    Args:
        path: the file, `arm.urdf` or `robot.xml`.
        locked: joints that do not move, with their positions [rad or m].
        motor_constants: joints whose input is the current of a motor, with the force or torque by
            current [N m/A or N/A].
        per: links whose mass, centre and inertia differ between groups of records, with the name of
            the group, `{"flange": "payload"}`.

    Raises:
        InputError: a file that cannot be read, or a robot without equations here.
    """
    file = find_system(path)
    if isinstance(file, str) or file.is_code:
        raise InputError(path, "no file of a robot", f"a file with {', '.join(ROBOT_ENDINGS)}")
    positions, constants = (tuple(sorted((x or {}).items())) for x in (locked, motor_constants))
    groups = tuple(sorted((per or {}).items()))
    return RobotFile(file.text, file.path, positions, constants, groups).load()


@dataclass(frozen=True)
class RobotFile(ChannelSource):
    """A robot file and how it is used, from which systems are made.

    Attributes:
        text: the file's text, without includes.
        path: the file.
        locked: joints that do not move, with their positions [rad or m].
        motor_constants: joints whose input is a current, with the force by current [N m/A or N/A].
        per: links that differ between groups of records, with the name of the group.
    """

    text: str
    path: Path
    locked: tuple[tuple[str, float], ...] = ()
    motor_constants: tuple[tuple[str, float], ...] = ()
    per: tuple[tuple[str, str], ...] = ()

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
        return self._assembly().arranged(coordinates, inputs, where).system(self)

    def with_values(self, values: Mapping[str, float]) -> tuple[str, tuple[str, ...]]:
        """The file's text with values of parameters in it, and the names of those that it lacks.

        Args:
            values: the parameters of the system by name.

        Raises:
            InputError: a file whose inertias do not count.
        """
        assembly = self._assembly()
        is_urdf = self.path.suffix == ".urdf"
        links = assembly.link_inertias(values)
        joints = assembly.joint_values(values)
        if is_urdf:
            text = write_urdf(self.text, links, joints)
        else:
            text = write_mjcf(self.text, links, joints, self.path)
        held = {f"{body}.{name}" for body in links for name in INERTIAL}
        kinds = ("viscous", "coulomb") if is_urdf else ("viscous", "coulomb", "armature")
        held |= {f"{joint}.{kind}" for joint in joints for kind in kinds}
        held |= {f"{joint}.stiffness" for joint, own in joints.items() if own.stiffness is not None}
        nominal = self.load().nominal()
        lacking = [n for n, x in values.items() if n not in held and x != nominal.get(n)]
        return text, tuple(lacking)

    def _assembly(self) -> "_Assembly":
        read = read_urdf if self.path.suffix == ".urdf" else read_mjcf
        constants, per = dict(self.motor_constants), dict(self.per)
        return _Assembly(read(self.text, self.path), self.path, dict(self.locked), constants, per)


class _Assembly:
    """The bodies, coordinates and actuators of a robot, of which a system is made.

    Args:
        robot: the robot.
        path: its file, for messages.
        locked: positions of locked joints.
        motor_constants: force or torque by current, by joint.
        per: groups of records between which links differ, by link.
    """

    def __init__(
        self,
        robot: Robot,
        path: Path,
        locked: dict[str, float],
        motor_constants: dict[str, float],
        per: dict[str, str],
    ) -> None:
        self.robot, self.path, self.per = robot, path, per
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
        self.free = [name for name in self.moved_by if self.moved_by[name].joint == name]
        if not self.free:
            raise InputError(path, "no joint that moves", "a joint that turns or slides")
        self.coordinates = tuple(
            Coordinate(name, "angular" if self.joints[name].kind == "angular" else "linear")
            for name in self.free
        )
        self._assemble()
        self.inputs, self.drives = self._drives()
        moved = [body.name for body in self.bodies if body.has_mass]
        for name in per:
            if name not in moved:
                raise InputError(
                    path, f"per: no link '{name}' that moves and has a mass",
                    f"one of {_list(moved)}",
                )  # fmt: skip

    def arranged(
        self, coordinates: Sequence[Coordinate], inputs: Sequence[Input], where: object
    ) -> "_Assembly":
        """Itself with coordinates and inputs in another order, see `RobotFile.for_channels`."""
        names = [c.name for c in coordinates]
        if missing := [name for name in self.free if name not in names]:
            raise InputError(
                where, f"no coordinate of {_joints(missing)} of {self.path.name}",
                f"coordinates {_list(self.free)}",
                "add them to the card, or lock them in a system file: SYSTEM = tn.load_robot("
                f"'{self.path.name}', locked={{'{missing[0]}': 0.0}})",
            )  # fmt: skip
        if unknown := [name for name in names if name not in self.free]:
            follows = {*self.moved_by, *self.locked} & {unknown[0]}
            problem = "does not move by itself" if follows else "is not there"
            raise InputError(
                where, f"coordinate '{unknown[0]}': such a joint {problem} in {self.path.name}",
                f"coordinates {_list(self.free)}",
                "a coordinate of the card has the name of its joint",
            )  # fmt: skip
        matched = [self._find_drive(i, where) for i in inputs]
        for k, i in zip(matched, inputs, strict=True):
            if matched.count(k) > 1:
                raise InputError(where, f"two inputs at '{self.inputs[k].name}'", "one", i.name)
        if self.robot.actuators is not None:
            silent = [x.name for k, x in enumerate(self.inputs) if k not in matched]
            if silent:
                raise InputError(
                    where, f"no input of the actuator '{silent[0]}' of {self.path.name}",
                    f"inputs {_list([i.name for i in self.inputs])}",
                    "add it to the card, or take it out of the file",
                )  # fmt: skip
        order = [self.free.index(name) for name in names]
        self.free = [self.free[k] for k in order]
        self.coordinates = tuple(self.coordinates[k] for k in order)
        self.bodies = [replace(b, coordinate=order.index(b.coordinate)) for b in self.bodies]
        self.drives = [
            replace(self.drives[k], coordinate=order.index(self.drives[k].coordinate))
            for k in matched
        ]
        self.inputs = tuple(inputs)
        return self

    def _find_drive(self, i: Input, where: object) -> int:
        """The index of the actuator that an input of a card is that of.

        Raises:
            InputError: no such actuator, or a unit without a gain.
        """
        found = [k for k, own in enumerate(self.inputs) if own.name == i.name]
        if not found:
            # the longest name: `joint1` is part of `joint10_torque`
            holds = [k for k, d in enumerate(self.drives) if d.joint in i.name]
            found = sorted(holds, key=lambda k: -len(self.drives[k].joint))[:1]
        if not found:
            raise InputError(
                where, f"input '{i.name}': no such actuator in {self.path.name}",
                f"inputs {_list([own.name for own in self.inputs])}",
                "the name of an actuator, or one that holds the name of the joint",
            )  # fmt: skip
        own, drive = self.inputs[found[0]], self.drives[found[0]]
        if own.unit != ANY_UNIT and not _is_same_unit(i.unit, own.unit):
            remedy = (
                "a current needs a gain, in a system file: SYSTEM = tn.load_robot("
                f"'{self.path.name}', motor_constants={{'{drive.joint}': ...}})"
                if _is_same_unit(i.unit, "A")
                else "convert it in the card by `scale`"
            )
            raise InputError(where, f"input '{i.name}' in {i.unit}", own.unit, remedy)
        return found[0]

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
                if link.inertia is None and not link.is_frame:
                    raise InputError(
                        f"{self.path}, link '{link.name}'", f"moves by the joint '{joint.name}' "
                        "and has no inertia", "mass, centre and inertia",
                        "give it an <inertial>; a CAD program computes one from the shape",
                    )  # fmt: skip
            elif joint.name in self.locked:
                frame = frame @ _motion(joint, self.locked[joint.name])
            places[joint.child] = owner, frame
            if link.inertia is not None and owner is not None:
                inertias[owner].append(frame.place(link.inertia))
                if joint.name not in self.moved_by:
                    self.carried[owner].append((link.name, inertias[owner][-1]))
        self.nominal: dict[str, float] = {}
        for i, parts in enumerate(inertias):
            body = self.bodies[i]
            if not parts:
                self._require_carried_mass(i, inertias)
                self.bodies[i] = replace(body, has_mass=False)
                continue
            whole = _joined(parts)
            try:
                values = inertial_parameters(
                    whole.mass, whole.center + np.array(body.anchor), whole.tensor
                )
            except ValueError as error:
                a, b, c = np.linalg.eigvalsh(whole.tensor)
                raise InputError(
                    f"{self.path}, link '{body.name}'",
                    f"an inertia that no body has: {error}; {a:.3g}, {b:.3g}, {c:.3g} kg m^2",
                    f"principal inertias of which none is above the sum of the others, as {c:.3g} "
                    f"of at most {a + b:.3g}",
                ) from None
            self.nominal |= {f"{body.name}.{name}": x for name, x in values.items()}

    def link_inertias(self, values: Mapping[str, float]) -> dict[str, LinkInertia | None]:
        """The inertias of links in their own frames, by the values of the bodies' parameters.

        Of a body of several links the others keep what they have by the file, as long as what is
        left for the link that moves is the inertia of a body; else this link has all of it and the
        others have none.
        """
        found: dict[str, LinkInertia | None] = {}
        for i, body in enumerate(self.bodies):
            if not body.has_mass:
                continue
            own = body_inertia(body, values)
            whole = _about_center(float(own.mass), np.asarray(own.moment), np.asarray(own.tensor))
            carried = [part for _, part in self.carried[i]]
            rest = _without(whole, carried) if carried else whole
            if rest is None:
                found |= {name: None for name, _ in self.carried[i]}
                rest = whole
            found[body.name] = replace(rest, center=rest.center + np.array(body.anchor))
        return found

    def joint_values(self, values: Mapping[str, float]) -> dict[str, JointValues]:
        """The values of joints; what joints that follow have by the file is taken off first."""
        found = {}
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
            found[name] = JointValues(**own)
        for name in self.moved_by:
            if self.joints[name].stiffness:
                known = found.get(name, JointValues())
                found[name] = replace(known, stiffness=values[f"{name}.stiffness"])
        return found

    def _add_body(self, joint: RobotJoint, parent: int | None, frame: _Pose, mover: Mimic) -> int:
        """Adds the body that a joint carries; its frame is at the joint."""
        if any(body.name == joint.child for body in self.bodies):
            raise InputError(self.path, f"two links '{joint.child}'", "names that differ")
        self.bodies.append(Body(
            joint.child, parent, "angular" if joint.kind == "angular" else "linear",
            _vector(joint.axis), _rows(frame.rotation),
            _vector(frame.position + frame.rotation @ joint.anchor),
            self.free.index(mover.joint), mover.ratio, mover.offset - joint.zero,
            _vector(joint.anchor),
        ))  # fmt: skip
        self.body_joints.append(joint)
        return len(self.bodies) - 1

    def _require_carried_mass(self, i: int, inertias: list[list[LinkInertia]]) -> None:
        """Raises unless some body that a body without mass carries has one."""
        carried = {i}
        for j, body in enumerate(self.bodies):
            if body.parent in carried:
                carried.add(j)
        if not any(inertias[j] for j in carried):
            raise InputError(
                f"{self.path}, link '{self.bodies[i].name}'", "moves, and neither it nor what it "
                "carries has an inertia", "mass, centre and inertia", "give it an <inertial>",
            )  # fmt: skip

    def system(self, source: RobotFile) -> LagrangianSystem:
        """The system with all that the file says.

        Args:
            source: the file, from which systems in another order are made.
        """
        chain = Chain(
            tuple(self.bodies), self.robot.gravity, tuple(f"{name}.armature" for name in self.free)
        )
        parameters = [
            parameter
            for i, body in enumerate(self.bodies)
            if body.has_mass
            for parameter in self._body_parameters(i)
        ]
        for k in range(len(self.free)):
            parameters += self._joint_parameters(k)
        parameters += [
            Parameter(f"{joint}.motor_constant", f"{_force_unit(self.joints[joint])}/A", value,
                      value / _MASS, value * _MASS, fixed=True)
            for joint, value in self.motor_constants.items()
        ]  # fmt: skip
        equations = RobotEquations(chain, tuple(self.free), tuple(self.drives), self._springs())
        return LagrangianSystem(
            name=self.robot.name,
            coordinates=self.coordinates,
            inputs=self.inputs,
            parameters=tuple(parameters),
            kinetic=chain.kinetic,
            potential=equations.potential,
            dissipation=equations.dissipation,
            input_map=equations.input_map,
            links=self._drawn_links(),
            inertia=chain.inertia,
            source=source,
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
            if name == "mass" or name in DIAGONAL:
                lower, upper, prior = value / _MASS, value * _MASS, _SHARE * value
                unit, fixed = ("kg", False) if name == "mass" else ("m", value < _THINNEST)
            elif name in CENTER:
                lower, upper, prior = value - size, value + size, _SHARE * size
            else:
                most = _MASS * widest
                lower, upper, prior = value - most, value + most, _SHARE * widest
            group = None if fixed else self.per.get(body.name)
            if group is not None and name == "mass":
                prior = None  # nobody knows what is carried
            parameters.append(Parameter(full, unit, value, lower, upper, fixed, prior, group))
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
        effort, speed = joint.effort or force, joint.speed
        width = _SPEED if speed is None else _LARGEST_SPEED_SHARE * speed
        armature = sum(j.armature * ratio**2 for j, ratio in own)
        viscous = sum(j.viscous * ratio**2 for j, ratio in own)
        coulomb = sum(j.coulomb * ratio for j, ratio in own)
        largest_damping = max(effort / speed if speed else 0.0, _DAMPING * inertia, _MASS * viscous)
        alike = [i for i, c in enumerate(self.coordinates) if c.kind == joint.kind]
        # gears make the inertia of a small motor larger than that of the links that it moves
        heaviest = max(self._scale(i)[0] for i in alike)
        largest_armature = max(_GEARED * inertia, _GEARED_SHARE * heaviest, _MASS * armature)
        kind, per_speed = _force_unit(joint), "s/rad" if joint.kind == "angular" else "s/m"
        unit = "kg m^2" if joint.kind == "angular" else "kg"
        parameters = [
            _weak(f"{name}.armature", unit, armature, largest_armature),
            _weak(f"{name}.viscous", f"{kind} {per_speed}", viscous, largest_damping),
            _weak(f"{name}.coulomb", kind, coulomb, max(effort, _MASS * coulomb)),
            Parameter(f"{name}.coulomb_speed", "rad/s" if joint.kind == "angular" else "m/s",
                      width, width / 100, 100 * width, fixed=True),
            Parameter(f"{name}.offset", kind, 0.0, -effort, effort, prior=_SHARE * effort),
        ]  # fmt: skip
        for j, _ in own:
            if j.stiffness:
                per = "N m/rad" if j.kind == "angular" else "N/m"
                parameters.append(Parameter(
                    f"{j.name}.stiffness", per, j.stiffness, j.stiffness / _MASS,
                    j.stiffness * _MASS, prior=_SHARE * j.stiffness,
                ))  # fmt: skip
        return parameters

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
        return inertia, force

    def _springs(self) -> tuple["Spring", ...]:
        return tuple(
            Spring(name, self.free.index(m.joint), m.ratio, m.offset, self.joints[name].spring_rest)
            for name, m in self.moved_by.items()
            if self.joints[name].stiffness
        )

    def _drives(self) -> tuple[tuple[Input, ...], list["Drive"]]:
        """The inputs, and how each acts; without actuators in the file a force at each joint."""
        inputs, drives = [], []
        if self.robot.actuators is None:
            actuators = [(None, name) for name in self.free]
        else:
            actuators = [(a, a.joint) for a in self.robot.actuators if a.joint in self.moved_by]
        for actuator, name in actuators:
            joint, mover = self.joints[name], self.moved_by[name]
            word = "torque" if joint.kind == "angular" else "force"
            unit, gain = _force_unit(joint), 1.0
            terms = (0.0, 0.0, 0.0)
            if actuator is not None:
                gain = actuator.gain
                terms = actuator.by_position, actuator.by_speed, actuator.bias
                if gain != 1.0 or any(terms):
                    unit = ANY_UNIT
            if has_motor := name in self.motor_constants:
                unit = "A"
            inputs.append(Input(actuator.name if actuator else f"{name}_{word}", unit))
            constant = f"{name}.motor_constant" if has_motor else None
            drives.append(Drive(name, self.free.index(mover.joint), mover.ratio, mover.offset,
                                constant, gain, *terms))  # fmt: skip
        for name in self.motor_constants:
            if name not in [joint for _, joint in actuators]:
                raise InputError(
                    self.path, f"motor_constants: the joint '{name}' has no actuator",
                    f"one of {_list([joint for _, joint in actuators])}",
                )  # fmt: skip
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


@dataclass(frozen=True)
class Drive:
    """The way in which an input acts on a coordinate.

    `force = gain u + by_position q + by_speed v + bias` at a joint that moves by `ratio` times the
    coordinate, plus `offset`.

    Attributes:
        joint: name of the joint.
        coordinate: index of the coordinate.
        ratio: travel of the joint by that of the coordinate.
        offset: position of the joint where the coordinate is at 0.
        motor_constant: parameter that multiplies the input, None without one.
        gain: force by input.
        by_position: force by position.
        by_speed: force by speed.
        bias: force without input.
    """

    joint: str
    coordinate: int
    ratio: float
    offset: float
    motor_constant: str | None
    gain: float
    by_position: float
    by_speed: float
    bias: float


@dataclass(frozen=True)
class Spring:
    """A linear spring at a joint that moves by `ratio` times a coordinate, plus `offset`.

    Attributes:
        joint: name of the joint, whose parameter `stiffness` is its own.
        coordinate: index of the coordinate.
        ratio: travel of the joint by that of the coordinate.
        offset: position of the joint where the coordinate is at 0.
        rest: position of the joint at which the spring is at rest.
    """

    joint: str
    coordinate: int
    ratio: float
    offset: float
    rest: float


@dataclass(frozen=True)
class RobotEquations:
    """Potential energy, friction and actuators of a robot.

    Attributes:
        chain: its bodies.
        joints: names of the joints of its coordinates.
        drives: how its inputs act.
        springs: springs at its joints.
    """

    chain: Chain
    joints: tuple[str, ...]
    drives: tuple[Drive, ...]
    springs: tuple[Spring, ...]

    def potential(self, q: Any, p: Any) -> Any:
        """Energy of gravity and springs [J]."""
        energy = self.chain.potential(q, p)
        for s in self.springs:
            stretch = s.ratio * q[s.coordinate] + s.offset - s.rest
            energy = energy + forces.linear_spring(stretch, p[f"{s.joint}.stiffness"])
        return energy

    def dissipation(self, q: Any, v: Any, p: Any) -> Any:
        """Viscous and Coulomb friction, and an offset, against the motion, (n_q,) [N m or N]."""
        return jnp.stack([
            forces.viscous(v[k], p[f"{name}.viscous"])
            + forces.coulomb(v[k], p[f"{name}.coulomb"], p[f"{name}.coulomb_speed"])
            + p[f"{name}.offset"]
            for k, name in enumerate(self.joints)
        ])  # fmt: skip

    def input_map(self, q: Any, v: Any, u: Any, p: Any) -> Any:
        """Forces of the actuators, (n_q,) [N m or N]."""
        total: list[Any] = [jnp.zeros_like(q[0])] * len(self.joints)
        for i, d in enumerate(self.drives):
            position, speed = d.ratio * q[d.coordinate] + d.offset, d.ratio * v[d.coordinate]
            constant = 1.0 if d.motor_constant is None else p[d.motor_constant]
            force = d.gain * constant * u[i] + d.by_position * position + d.by_speed * speed
            total[d.coordinate] = total[d.coordinate] + d.ratio * (force + d.bias)
        return jnp.stack(total)


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


def _weak(name: str, unit: str, value: float, largest: float) -> Parameter:
    """A parameter from 0 on, of which a file often says nothing."""
    return Parameter(name, unit, value, 0.0, largest, prior=_SHARE * largest)


def _joined(parts: Sequence[LinkInertia]) -> LinkInertia:
    """The inertia of several links that do not move against one another, in one frame."""
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.center for part in parts), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        r = part.center - center
        tensor = tensor + part.tensor + part.mass * (r @ r * np.eye(3) - np.outer(r, r))
    return LinkInertia(mass, center, tensor)


def _about_center(mass: float, moment: np.ndarray, tensor: np.ndarray) -> LinkInertia:
    """An inertia whose tensor and moment were about the origin of the frame."""
    center = moment / mass
    return LinkInertia(
        mass, center, tensor - mass * (center @ center * np.eye(3) - np.outer(center, center))
    )


def _without(whole: LinkInertia, parts: Sequence[LinkInertia]) -> LinkInertia | None:
    """What is left of an inertia without some parts of it; None where no body has that."""
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


def _vector(numbers: np.ndarray) -> Vector3:
    x, y, z = (float(number) for number in numbers)
    return x, y, z


def _rows(matrix: np.ndarray) -> Rows3:
    a, b, c = (_vector(row) for row in matrix)
    return a, b, c


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"
