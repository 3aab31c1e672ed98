"""The tree of bodies of a robot: links that do not move against one another are one body.

Which joints move by themselves, follow others or are locked is decided here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tustinnet.channels import Coordinate
from tustinnet.errors import InputError
from tustinnet.models.chains import CENTER, INERTIAL, Body, Rows3, Vector3, inertial_parameters
from tustinnet.models.kinematics import BASE, Link
from tustinnet.systems.robot import (
    LinkInertia,
    Mimic,
    Robot,
    RobotJoint,
    join_inertias,
    place_inertia,
    repair_inertia,
    rotation_about,
)

_G = 9.81  # [m/s^2], for ranges


@dataclass(frozen=True)
class _Pose:
    """A frame in another one: rotation (3, 3), and origin (3,) [m]."""

    rotation: np.ndarray
    position: np.ndarray

    def __matmul__(self, other: "_Pose") -> "_Pose":
        rotation = self.rotation @ other.rotation
        return _Pose(rotation, self.position + self.rotation @ other.position)


class JointMotion(NamedTuple):
    """The way in which a coordinate moves a joint.

    Attributes:
        joint: the joint.
        ratio: its travel by that of the coordinate.
        offset: its position where the coordinate is at 0 [rad or m].
    """

    joint: RobotJoint
    ratio: float
    offset: float


class RobotTree:
    """The bodies of a robot that move, and the coordinates that move them.

    Args:
        robot: the robot.
        path: its file, for messages.
        locked: positions of joints that do not move [rad or m].

    Attributes:
        joints: all joints by name.
        locked: positions of locked joints, and of those that follow them.
        moved_by: of each joint that moves, the joint of its coordinate and the ratio to it.
        free: joints of the coordinates, in their order.
        bodies: the bodies.
        parts: of each, the inertias of its links by name: its own, and those fixed to that.
        owners: of each link the body that it belongs to, None for the base.
        nominal: parameters of the bodies by the file.
        remarks: sentences on what counts otherwise than the file says it.
    """

    def __init__(self, robot: Robot, path: Path, locked: Mapping[str, float]) -> None:
        self.robot, self.path = robot, path
        self.joints = {joint.name: joint for joint in robot.joints}
        self.locked: dict[str, float] = {}
        self.moved_by: dict[str, Mimic] = {}
        for name in self.moving:
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
        self.bodies: list[Body] = []
        self.parts: list[dict[str, LinkInertia]] = []
        self.owners: dict[str, int | None] = {}
        self.nominal: dict[str, float] = {}
        self.remarks = robot.remarks
        self._join_links()
        self._weigh()

    @property
    def moving(self) -> list[str]:
        """The joints that are not fixed, locked ones among them."""
        return [joint.name for joint in self.robot.joints if joint.kind != "fixed"]

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates, by the names of their joints."""
        return tuple(Coordinate(name, self.joints[name].moves) for name in self.free)

    def arrange(self, names: Sequence[str]) -> list[int]:
        """Puts the coordinates into another order; returns the place that each had before."""
        before = [self.free.index(name) for name in names]
        self.free = [*names]
        self.bodies = [replace(b, coordinate=before.index(b.coordinate)) for b in self.bodies]
        return before

    def moved(self, k: int) -> list[JointMotion]:
        """The joints that a coordinate moves: its own, and those that follow that."""
        return [
            JointMotion(self.joints[name], mover.ratio, mover.offset)
            for name, mover in self.moved_by.items()
            if mover.joint == self.free[k]
        ]

    def require_moving_links(self, per: Mapping[str, str]) -> None:
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
            expected = f"a link that moves and has a mass: {', '.join(moved) or 'none'}"
            raise InputError(self.path, f"per: {problem}", expected, remedy)

    def largest_load(self, k: int) -> tuple[float, float]:
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
            is_linear = self.joints[self.free[k]].kind == "linear"
            inertia += mass if is_linear else mass * (lever**2 + float(spread @ spread))
            force += mass * _G * (1.0 if is_linear else lever + float(spread.max()))
        if not inertia:  # nothing with a mass moves, but what the motor turns
            inertia = self.joints[self.free[k]].armature
            force = _G * inertia
        return inertia, force

    def drawn_links(self) -> tuple[Link, ...]:
        """The links of the drawing: of each coordinate the body that its own joint carries.

        None where a joint that follows another one carries some of them. A `Link` has no rotation
        between its frame and that of its parent: frames have the axes of the base where all
        coordinates are 0.
        """
        leading = [self.joints[name].child for name in self.free]
        turns, links = {BASE: np.eye(3)}, []
        for i, body in enumerate(self.bodies):
            carrier = None if body.parent is None else self.bodies[body.parent]
            if carrier is not None and carrier.name not in leading:
                return ()
            if body.name not in leading:
                continue  # a mimic joint has no coordinate of its own
            ends = [np.array(b.position) for b in self.bodies if b.parent == i]
            ends = [end for end in ends if np.linalg.norm(end) > 1e-3]
            reach = np.zeros(3)
            if ends:
                reach = max(ends, key=lambda end: float(np.linalg.norm(end)))
            elif body.has_mass:
                center = np.array([self.nominal[f"{body.name}.{c}"] for c in CENTER])
                reach = 2 * (center - np.array(body.anchor))
            axis, at, turn = (np.array(x) for x in (body.axis, body.position, body.rotation))
            if body.kind == "angular":
                turn = turn @ rotation_about(axis, body.offset)
            else:
                at = at + body.offset * turn @ axis
            name = self.free[body.coordinate]
            parent = BASE if carrier is None else self.free[carrier.coordinate]
            at, turn = turns[parent] @ at, turns[parent] @ turn
            turns[name] = turn
            along, end, origin = map(_vector, (turn @ axis, turn @ reach, at))
            links.append(Link(name, along, end, parent, origin))
        return tuple(links)

    def _follow(self, name: str) -> Mimic:
        """The joint that moves another one in the end, itself if it follows none."""
        ratio, offset, visited = 1.0, 0.0, [name]
        while (mimic := self.joints[visited[-1]].mimic) is not None:
            place = f"{self.path}, joint '{visited[-1]}'"
            if mimic.joint in visited:
                raise InputError(place, f"follows '{mimic.joint}', which follows it", "no loop")
            offset += ratio * mimic.offset
            ratio *= mimic.ratio
            visited.append(mimic.joint)
        return Mimic(visited[-1], ratio, offset)

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

    def _join_links(self) -> None:
        """Joins links that do not move against one another to bodies."""
        links = {link.name: link for link in self.robot.links}
        children = {joint.child for joint in self.robot.joints}
        base = next(name for name in links if name not in children)
        self.owners[base], frames = None, {base: _Pose(np.eye(3), np.zeros(3))}
        for joint in self.robot.joints:
            owner = self.owners[joint.parent]
            frame = frames[joint.parent] @ _Pose(joint.rotation, joint.position)
            link = links[joint.child]
            if joint.name in self.moved_by:
                self._add_body(joint, owner, frame)
                owner, frame = len(self.parts), _Pose(np.eye(3), -joint.anchor)
                self.parts.append({})
            elif joint.name in self.locked:
                frame = frame @ _motion(joint, self.locked[joint.name])
            self.owners[joint.child], frames[joint.child] = owner, frame
            if link.inertia is not None and owner is not None:
                placed = place_inertia(link.inertia, frame.rotation, frame.position)
                self.parts[owner][link.name] = placed

    def _add_body(self, joint: RobotJoint, parent: int | None, frame: _Pose) -> None:
        """Adds the body that a joint carries; its frame is at the joint."""
        if any(body.name == joint.child for body in self.bodies):
            raise InputError(self.path, f"two links '{joint.child}'", "names that differ")
        mover = self.moved_by[joint.name]
        self.bodies.append(
            Body(
                joint.child,
                parent,
                joint.moves,
                _vector(joint.axis),
                _rows(frame.rotation),
                _vector(frame.position + frame.rotation @ joint.anchor),
                self.free.index(mover.joint),
                mover.ratio,
                mover.offset - joint.zero,
                _vector(joint.anchor),
            )
        )

    def _weigh(self) -> None:
        """Takes the parameters of bodies from the inertias of their links."""
        for i, parts in enumerate(self.parts):
            body = self.bodies[i]
            if not parts:
                self.bodies[i] = replace(body, has_mass=False)
                continue
            whole, remarks = repair_inertia(join_inertias([*parts.values()]), body.name, self.path)
            self.remarks += remarks
            values = inertial_parameters(
                whole.mass, whole.center + np.array(body.anchor), whole.tensor
            )
            self.nominal |= {f"{body.name}.{name}": x for name, x in values.items()}
        if not any(
            part.tensor.any() or part.center.any() or body.kind == "linear"
            for body, parts in zip(self.bodies, self.parts, strict=True)
            for part in parts.values()
        ):
            raise InputError(
                self.path,
                "links that move have no masses, or all their inertias and centres are 0",
                "mass, centre and inertia",
                "give them an <inertial> with these, or that of their shapes: a system file with "
                "SYSTEM = tn.load_robot(FILE, default_density=2700.0)",
            )


def felt(motions: Sequence[JointMotion], kind: str) -> float:
    """The armature, viscous or Coulomb friction of joints as a coordinate feels it.

    Args:
        motions: how it moves the joints.
        kind: `armature`, `viscous` or `coulomb`.
    """
    power = 1 if kind == "coulomb" else 2
    return sum((getattr(m.joint, kind) * abs(m.ratio) ** power for m in motions), 0.0)


def _motion(joint: RobotJoint, position: float) -> _Pose:
    """The motion of a joint from its zero to a position."""
    travel = position - joint.zero
    if joint.kind == "linear":
        return _Pose(np.eye(3), travel * joint.axis)
    rotation = rotation_about(joint.axis, travel)
    return _Pose(rotation, joint.anchor - rotation @ joint.anchor)


def _vector(numbers: np.ndarray) -> Vector3:
    x, y, z = map(float, numbers)
    return x, y, z


def _rows(matrix: np.ndarray) -> Rows3:
    a, b, c = map(_vector, matrix)
    return a, b, c
