"""Coordinates and inputs of a robot: what its actuators are, and which a data card's names mean."""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tustinnet.channels import Coordinate, Input
from tustinnet.data.units import convert_to_si
from tustinnet.errors import InputError
from tustinnet.models.motion_limits import MotionLimits
from tustinnet.systems.robot import Range, RobotActuator
from tustinnet.systems.robot_equations import Drive
from tustinnet.systems.robot_options import RobotOptions
from tustinnet.systems.robot_tree import RobotTree

ANY_UNIT = "1"  # of an input with a gain of the file: whatever the card says


class _Mismatch(NamedTuple):
    """Mismatch between a card and a robot's file.

    Attributes:
        problem: what is wrong.
        expected: what the file has.
        remedy: what to do.
        options: options of `load_robot` that belong to the remedy.
    """

    problem: str = ""
    expected: str = ""
    remedy: str = ""
    options: Mapping[str, Mapping[str, object]] = {}


class RobotChannels:
    """The coordinates and inputs of a robot, by its file or as a data card has them.

    Args:
        tree: its bodies.
        options: how its file is used.

    Attributes:
        inputs: the inputs; without actuators in the file a force at each joint.
        drives: how each of them acts.
    """

    def __init__(self, tree: RobotTree, options: RobotOptions) -> None:
        self.tree, self.options = tree, options
        actuators = tree.robot.actuators
        if actuators is None:
            actuators = tuple(RobotActuator(name, name) for name in tree.free)
        actuators = [a for a in actuators if a.joint in tree.moved_by]
        driven = [a.joint for a in actuators if not a.gains]
        for name in options.motor_constants:
            if name not in driven:
                raise InputError(
                    tree.path,
                    f"motor_constants: the joint '{name}' has no motor",
                    f"one of {_list(driven)}",
                )
        self.inputs = tuple(
            Input(self._name(a), self._unit(a), limits=self._input_limits(a)) for a in actuators
        )
        servos = [a.joint for a in actuators if a.gains]
        self.drives = [self._drive(a, servos.count(a.joint) == 1) for a in actuators]

    def arrange(
        self, coordinates: Sequence[Coordinate], inputs: Sequence[Input], where: object
    ) -> None:
        """Takes the order and the names of a data card.

        An input may have the name of the actuator, or one that holds the name of its joint. A joint
        without an input is not driven.

        Args:
            coordinates: coordinates, each of the name of a joint.
            inputs: inputs.
            where: whose coordinates and inputs they are, for messages.

        Raises:
            InputError: all that does not agree, at once.
        """
        drives = [self._find_drive(i) for i in inputs]
        mismatches = [*self._compare_coordinates(coordinates)]
        for i, k in zip(inputs, drives, strict=True):
            mismatches += self._compare_input(i, k, drives)
        mismatches += self._find_silent(drives)
        if mismatches:
            raise self._error(mismatches, where)
        before = self.tree.arrange([c.name for c in coordinates])
        declared = [None if k is None else self.inputs[k].limits for k in drives]
        self.inputs = tuple(
            replace(i, limits=i.limits or own) for i, own in zip(inputs, declared, strict=True)
        )
        self.drives = [
            replace(d, coordinate=before.index(d.coordinate))
            for d in (self.drives[k] for k in drives if k is not None)
        ]

    def limits(self, k: int) -> MotionLimits:
        """The limits of a coordinate: of its joint, of those that follow it, of its actuators."""
        position, velocity = (-np.inf, np.inf), np.inf
        for joint, ratio, offset in self.tree.moved(k):
            if ratio == 0:
                continue
            if joint.range is not None:
                low, high = sorted((end - offset) / ratio for end in joint.range)
                position = max(position[0], low), min(position[1], high)
            velocity = min(velocity, (joint.speed or np.inf) / abs(ratio))
        forces = [
            abs(d.ratio) * (joint.effort or d.actuator.largest_force(joint) or np.inf)
            for d in self.drives
            for joint in [self.tree.joints[d.actuator.joint]]
            if d.coordinate == k
        ]
        has_range = np.isfinite(position).all() and position[0] < position[1]
        return MotionLimits(
            (float(position[0]), float(position[1])) if has_range else None,
            float(velocity) if np.isfinite(velocity) else None,
            force=float(sum(forces)) if forces and np.isfinite(forces).all() else None,
        )

    def _name(self, actuator: RobotActuator) -> str:
        """The name of an actuator's input, which differs from those of coordinates."""
        if actuator.name not in self.tree.free:
            return actuator.name
        is_torque = self.tree.joints[actuator.joint].kind == "angular"
        what = "goal" if actuator.goal else "torque" if is_torque else "force"
        return f"{actuator.name}_{what}"

    def _unit(self, actuator: RobotActuator) -> str:
        """The unit of an actuator's input."""
        units = self.tree.joints[actuator.joint].units
        if actuator.joint in self.options.motor_constants:
            return "A"
        if actuator.gear == 1.0 and actuator.goal is not None:
            is_position = actuator.goal == "kp" and not actuator.integrates
            return units.position if is_position else units.speed
        is_force = actuator.gear * actuator.gain == 1.0 and not (actuator.gains or actuator.bias)
        return units.force if is_force else ANY_UNIT

    def _input_limits(self, actuator: RobotActuator) -> Range | None:
        """The smallest and largest input of an actuator by the file, None where it says none.

        A current's are not known before its motor constant is.
        """
        joint = self.tree.joints[actuator.joint]
        is_force = not (
            actuator.gains or actuator.bias or joint.name in self.options.motor_constants
        )
        if actuator.input_range is not None or not (is_force and joint.effort):
            return actuator.input_range
        largest = joint.effort / abs(actuator.gear * actuator.gain)
        return -largest, largest

    def _drive(self, actuator: RobotActuator, is_only_servo: bool) -> Drive:
        """The way in which an actuator acts; of several servos at a joint, gains have its name."""
        name, tree = actuator.joint, self.tree
        mover = tree.moved_by[name]
        return Drive(
            actuator,
            tree.free.index(mover.joint),
            mover.ratio,
            mover.offset,
            name if is_only_servo else actuator.name,
            f"{name}.motor_constant" if name in self.options.motor_constants else None,
            tree.joints[name].actuator_range,
        )

    def _compare_coordinates(self, coordinates: Sequence[Coordinate]) -> Iterator[_Mismatch]:
        """Mismatches between the coordinates of a card and the joints that move."""
        names, file, free = [c.name for c in coordinates], self.tree.path.name, self.tree.free
        unknown = [name for name in names if name not in free]
        if missing := [name for name in free if name not in names]:
            meant = {name: near for name in missing if (near := _nearest(name, unknown))}
            also = f", and no joint '{unknown[0]}' there" if unknown else ""
            for a, b in meant.items():
                yield _Mismatch(remedy=f"rename the coordinate '{b}' to '{a}'")
            absent = {name: 0.0 for name in missing if name not in meant}
            quoted = ", ".join(f"'{name}'" for name in missing)
            yield _Mismatch(
                f"no coordinate of the joint{'s' * (len(missing) > 1)} {quoted} of {file}{also}",
                f"coordinates {_list(free)}",
                "add them to the card, or lock them" if absent else "",
                {"locked": absent} if absent else {},
            )
            unknown = [name for name in unknown[1:] if name not in meant.values()]
        for name in unknown:
            follows = name in {*self.tree.moved_by, *self.tree.locked}
            problem = "does not move by itself" if follows else "is not there"
            yield _Mismatch(
                f"coordinate '{name}': such a joint {problem} in {file}",
                f"coordinates {_list(free)}",
                "a coordinate of the card has the name of its joint",
            )
        for c in coordinates:
            own = self.tree.joints[c.name].kind if c.name in free else c.kind
            if c.kind != own:
                moves = "turns" if own == "angular" else "slides"
                yield _Mismatch(
                    f"coordinate '{c.name}' is {c.kind}, and the joint {moves}",
                    f'kind = "{own}"',
                    "the kind of a coordinate is that of its joint",
                )

    def _find_drive(self, i: Input) -> int | None:
        """The index of the actuator that an input of a card is that of, None without one."""
        names, joints = [own.name for own in self.inputs], [d.actuator.joint for d in self.drives]
        if i.name in names:
            return names.index(i.name)
        # the longest name: `joint1` is part of `joint10_torque`
        holds = [k for k, joint in enumerate(joints) if joint in i.name]
        return max(holds, key=lambda k: len(joints[k]), default=None)

    def _compare_input(
        self, i: Input, k: int | None, drives: Sequence[int | None]
    ) -> Iterator[_Mismatch]:
        """Mismatches between an input of a card and the actuator that it is that of."""
        if k is None:
            names = [own.name for own in self.inputs]
            near = _nearest(i.name, [name for j, name in enumerate(names) if j not in drives])
            yield _Mismatch(
                f"input '{i.name}': no such actuator in {self.tree.path.name}",
                f"inputs {_list(names)}",
                f"rename the input '{i.name}' to '{near}'"
                if near
                else "the name of an actuator, or one that holds the name of the joint",
            )
            return
        own, actuator = self.inputs[k], self.drives[k].actuator
        joint = self.tree.joints[actuator.joint]
        if drives.count(k) > 1:
            yield _Mismatch(f"two inputs at '{own.name}'", "one", i.name)
        if own.unit != ANY_UNIT and not _is_same_unit(i.unit, own.unit):
            is_current = _is_same_unit(i.unit, "A") and not actuator.gains
            remedy = "convert it in the card by `scale`"
            if actuator.goal and _is_same_unit(i.unit, joint.units.force):
                remedy = "where forces were logged, its actuator in the file is a <motor>"
            yield _Mismatch(
                f"input '{i.name}' in {i.unit}",
                own.unit,
                "a current needs a gain" if is_current else remedy,
                {"motor_constants": {joint.name: ...}} if is_current else {},
            )

    def _find_silent(self, drives: Sequence[int | None]) -> Iterator[_Mismatch]:
        """The actuators of the file that are no inputs of a card."""
        names = [own.name for own in self.inputs]
        silent = [name for k, name in enumerate(names) if k not in drives]
        if self.tree.robot.actuators is not None and silent:
            they = "it" if len(silent) == 1 else "them"
            yield _Mismatch(
                f"no input of the actuator{'s' * (len(silent) > 1)} "
                f"{', '.join(map(repr, silent))} of {self.tree.path.name}",
                f"inputs {_list(names)}",
                f"add {they} to the card, or take {they} out of the file",
            )

    def _error(self, mismatches: Sequence[_Mismatch], where: object) -> InputError:
        """The error about all mismatches, with one line of a system file for their remedies."""
        problems = _join("; ", [m.problem for m in mismatches])
        expected = _join(", and ", [m.expected for m in mismatches])
        in_order = sorted(
            mismatches, key=lambda m: bool(m.options)
        )  # those of the system file last
        remedy = _join("; ", [m.remedy for m in in_order])
        options: dict[str, dict[str, object]] = {}
        for m in mismatches:
            for name, values in m.options.items():
                options.setdefault(name, {}).update(values)
        if options:
            line = self.options.call(self.tree.path.name, options).replace("Ellipsis", "...")
            remedy += f", in a system file: {line}"
        return InputError(where, problems, expected, remedy)


def _join(separator: str, texts: Sequence[str]) -> str:
    return separator.join(dict.fromkeys(filter(None, texts)))


def _nearest(name: str, names: Sequence[str]) -> str:
    """The name that was probably meant: the same but for case, else a very similar one; or ""."""
    alike = [other for other in names if other.lower() == name.lower()]
    return (alike or difflib.get_close_matches(name, names, 1, 0.8) or [""])[0]


def _is_same_unit(a: str, b: str) -> bool:
    try:
        return convert_to_si(a) == convert_to_si(b)
    except ValueError:
        return a == b


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"
