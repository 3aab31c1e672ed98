"""A robot as its file describes it: links, joints and actuators, whatever the file's format."""

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple
from xml.parsers import expat

import numpy as np
from pydantic import PlainValidator

from tustinnet.channels import Kind
from tustinnet.errors import InputError, describe_error

_MOST_NAMES = 6  # in a sentence
_ROUNDING, _THIN = 1e-6, 1e-6  # of inertias, and thickness [m], by which a body is none yet
_MISSING = 0.01  # share of the largest inertia by which rounded ones of public files miss it
MOST_JOINTS = 100  # that move; the time to make their equations grows with the cube
Range = tuple[float, float]
# from lists of numbers, too, as JSON has them
Numbers = Annotated[np.ndarray, PlainValidator(lambda x: np.array(x, np.float64))]
JointKind = Literal["angular", "linear", "fixed"]


class JointUnits(NamedTuple):
    """The units of what belongs to a joint, by what they measure."""

    position: str
    speed: str
    force: str
    damping: str
    stiffness: str
    inertia: str


_TURNING = JointUnits("rad", "rad/s", "N m", "N m s/rad", "N m/rad", "kg m^2")
_SLIDING = JointUnits("m", "m/s", "N", "N s/m", "N/m", "kg")


@dataclass(frozen=True)
class LinkInertia:
    """The inertia of a link in its own frame.

    Attributes:
        mass: mass [kg].
        center: centre of mass, (3,) [m].
        tensor: rotational inertia about the centre, along the axes of the link's frame, (3, 3)
            [kg m^2].
    """

    mass: float
    center: Numbers
    tensor: Numbers


@dataclass(frozen=True)
class RobotLink:
    """A rigid link.

    Attributes:
        name: its name.
        inertia: its inertia, None where the file has none.
        is_frame: whether it is but a frame without a shape, which needs no inertia.
    """

    name: str
    inertia: LinkInertia | None
    is_frame: bool


@dataclass(frozen=True)
class Mimic:
    """The joint that another one follows: `travel = ratio travel_of_joint + offset`.

    Attributes:
        joint: name of the joint that is followed.
        ratio: its multiplier.
        offset: position where that joint is at 0 [rad or m].
    """

    joint: str
    ratio: float
    offset: float


@dataclass(frozen=True)
class RobotJoint:
    """A joint between two links.

    Attributes:
        name: its name.
        kind: whether it turns, slides or is fixed.
        parent: name of the link that carries it.
        child: name of the link that it carries.
        rotation: from the child's frame to the parent's where the joint is at `zero`, (3, 3).
        position: origin of the child's frame in the parent's there, (3,) [m].
        axis: unit vector of its axis in the child's frame, (3,).
        anchor: a point of its axis in the child's frame, (3,) [m].
        zero: position of the joint at which the frames are so [rad or m].
        mimic: the joint that it follows, None if it moves freely.
        armature: inertia that it sees beside those of the links [kg m^2 or kg].
        viscous: viscous friction [N m s/rad or N s/m].
        coulomb: Coulomb friction [N m or N].
        stiffness: stiffness of a spring at the joint [N m/rad or N/m].
        spring_rest: position at which that spring is at rest [rad or m].
        effort: largest force of its actuator [N m or N], None if unknown.
        actuator_range: smallest and largest force of all its actuators, that they are held within.
        speed: largest speed [rad/s or m/s], None if unknown.
        range: smallest and largest position [rad or m], None if unknown.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    rotation: Numbers
    position: Numbers
    axis: Numbers
    anchor: Numbers
    zero: float = 0.0
    mimic: Mimic | None = None
    armature: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0
    stiffness: float = 0.0
    spring_rest: float = 0.0
    effort: float | None = None
    actuator_range: Range | None = None
    speed: float | None = None
    range: Range | None = None

    @property
    def moves(self) -> Kind:
        """Whether it turns or slides, where it is not fixed."""
        return "angular" if self.kind == "angular" else "linear"

    @property
    def units(self) -> JointUnits:
        """The units of its motion and its forces."""
        return _TURNING if self.kind == "angular" else _SLIDING


@dataclass(frozen=True)
class RobotActuator:
    """An actuator at a joint: `gear f`, with `f = gain u - kp q - kv v + bias`.

    Its position q and speed v are `gear` times those of the joint. Both u and f have limits. Of one
    that integrates, the integral of the input is in the place of u.

    Attributes:
        name: its name, that of the input.
        joint: name of the joint.
        gear: force at the joint by its own.
        gain: its force by the input [N m or N, by the input's unit].
        kp: its force against position [N m/rad or N/m].
        kv: its force against speed [N m s/rad or N s/m].
        bias: its force without input [N m or N].
        input_range: smallest and largest input that counts, None without.
        force_range: smallest and largest force of its own [N m or N], None without.
        integrates: whether its input is the speed of its goal.
        goal_range: smallest and largest integral of the input, None without.
    """

    name: str
    joint: str
    gear: float = 1.0
    gain: float = 1.0
    kp: float = 0.0
    kv: float = 0.0
    bias: float = 0.0
    input_range: Range | None = None
    force_range: Range | None = None
    integrates: bool = False
    goal_range: Range | None = None

    @property
    def gains(self) -> dict[str, float]:
        """The gains of a servo by name: `kp`, `kv`, and `gain` where neither of both is that.

        A motor has none: its gain sets the scale of all masses.
        """
        gains = {"kp": self.kp, "kv": self.kv}
        if any(gains.values()) and self.goal is None:
            gains["gain"] = self.gain
        return {name: value for name, value in gains.items() if value}

    @property
    def goal(self) -> Literal["kp", "kv"] | None:
        """The gain of a servo by which its input counts: a goal for the position, or the speed."""
        if self.kp:
            return "kp" if self.gain == self.kp else None
        return "kv" if self.kv and self.gain == self.kv else None

    def largest_force(self, joint: RobotJoint) -> float | None:
        """Largest force at its joint in both directions [N m or N], None if unknown."""
        ranges = [(self.force_range, self.gear), (joint.actuator_range, 1.0)]
        if not self.gains:
            ranges.append((self.input_range, self.gear * self.gain))
        # a force that has one direction alone cannot move a joint to and fro
        return min(
            (
                abs(factor) * min(-ends[0], ends[1])
                for ends, factor in ranges
                if ends is not None and ends[0] < 0 < ends[1]
            ),
            default=None,
        )


@dataclass(frozen=True)
class Robot:
    """A robot on a fixed base: a tree of links.

    Attributes:
        name: its name.
        links: the links; each but the first is carried by a joint.
        joints: the joints, each after those between its parent and the base.
        actuators: the actuators; None where the file says nothing about them.
        gravity: acceleration of gravity in the frame of the base [m/s^2].
        remarks: sentences on what counts otherwise than the file says it.
    """

    name: str
    links: tuple[RobotLink, ...]
    joints: tuple[RobotJoint, ...]
    actuators: tuple[RobotActuator, ...] | None
    gravity: tuple[float, float, float]
    remarks: tuple[str, ...] = ()


class Remarks(defaultdict[str, list[str]]):
    """Names of joints, links and transmissions by what of them counts otherwise than it says."""

    def __init__(self) -> None:
        super().__init__(list)

    def sentences(self) -> tuple[str, ...]:
        """A sentence for each kind, with the first names."""
        return tuple(
            f"{', '.join(names[:_MOST_NAMES])}"
            + (f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else "")
            + f": {what}"
            for what, names in self.items()
        )


@dataclass(frozen=True)
class Lead:
    """How the joints of a robot that move do so with its coordinates: `ratios q + offsets`.

    Attributes:
        joints: names of the joints.
        ratios: of each by the coordinates, (n, n_q).
        offsets: where all coordinates are 0, (n,) [rad or m].
    """

    joints: tuple[str, ...]
    ratios: np.ndarray
    offsets: np.ndarray


def find_lead(
    robot: Robot, coordinates: Sequence[str], locked: Mapping[str, float] | None = None
) -> Lead:
    """The motion of all joints of a robot by its coordinates.

    Args:
        robot: the robot.
        coordinates: names of the joints that are coordinates.
        locked: positions of joints that do not move [rad or m].
    """
    joints = {joint.name: joint for joint in robot.joints if joint.kind != "fixed"}
    ratios, offsets = np.zeros((len(joints), len(coordinates))), np.zeros(len(joints))
    for k, name in enumerate(joints):
        ratio = 1.0
        while name not in (locked or {}) and (mimic := joints[name].mimic) is not None:
            offsets[k] += ratio * mimic.offset
            ratio, name = ratio * mimic.ratio, mimic.joint
        if locked and name in locked:
            offsets[k] += ratio * locked[name]
        else:
            ratios[k, coordinates.index(name)] = ratio
    return Lead(tuple(joints), ratios, offsets)


def require_few_joints(count: int, where: object) -> None:
    """Raises where a file has more joints that move than equations are made for.

    Raises:
        InputError: more than 100.
    """
    if count > MOST_JOINTS:
        raise InputError(
            where,
            f"{count} joints that move",
            f"at most {MOST_JOINTS}",
            "leave out what the logs do not show, or fix it in the file",
        )


def parse_xml(text: str, where: object, expected: str) -> ET.Element:
    """The root element of a text of XML without entities of its own.

    Prefixes of names stay as they are written (`drake:limit`), declared or not: programs that write
    robot files use them for what only they read.

    Args:
        text: the text.
        where: its file, for messages.
        expected: kind of file, for messages.

    Raises:
        InputError: it is not well formed, or declares a document type: entities are never read.
    """

    def refuse(*_: object) -> None:
        raise InputError(
            where,
            "a document type (<!DOCTYPE ...>), which may declare entities",
            f"{expected} without one",
            "entities are never read: write what they stand for",
        )

    parser, tree = expat.ParserCreate(), ET.TreeBuilder()
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = tree.start, tree.end
    parser.CharacterDataHandler = tree.data
    try:
        parser.Parse(text.lstrip(), True)  # a declaration is not always at the start
        return tree.close()
    except InputError:
        raise
    except Exception as error:
        raise InputError(where, f"no well-formed XML ({describe_error(error)})", expected) from None


def place_inertia(inertia: LinkInertia, rotation: np.ndarray, position: np.ndarray) -> LinkInertia:
    """An inertia of an inner frame in an outer one.

    Args:
        inertia: the inertia.
        rotation: from the inner frame to the outer one, (3, 3).
        position: origin of the inner frame in the outer one, (3,) [m].
    """
    center = position + rotation @ inertia.center
    return LinkInertia(inertia.mass, center, rotation @ inertia.tensor @ rotation.T)


def join_inertias(parts: Sequence[LinkInertia]) -> LinkInertia:
    """The inertia of several links that do not move against one another, in one frame."""
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.center for part in parts), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        r = part.center - center
        tensor = tensor + part.tensor + part.mass * about_origin(r)
    return LinkInertia(mass, center, tensor)


def repair_inertia(
    inertia: LinkInertia, name: str, where: object
) -> tuple[LinkInertia, tuple[str, ...]]:
    """An inertia that a body has, near to that of a file, and a sentence if it is another one.

    No principal inertia is above the sum of the others. Rounded numbers of a thin body miss that
    by up to a hundredth; both smaller ones then get half of what is missing.

    Args:
        inertia: the inertia.
        name: name of its link.
        where: the file, for messages.

    Raises:
        InputError: more is missing.
    """
    (a, b, c), axes = np.linalg.eigh(inertia.tensor)
    missing = c - a - b
    if missing <= max(_ROUNDING * c, 2 * _THIN**2 * inertia.mass):
        return inertia, ()
    if missing > _MISSING * c:
        raise InputError(
            f"{where}, link '{name}'",
            f"an inertia that no body has, {a:.3g}, {b:.3g}, {c:.3g} kg m^2",
            f"principal inertias of which none is above the sum of the others, as {c:.3g} "
            f"of at most {a + b:.3g}",
        )
    across = np.eye(3) - np.outer(axes[:, 2], axes[:, 2])
    sentence = (
        f"{name}: its largest inertia is {100 * missing / c:.2g} % above the sum of the others, "
        "which become so much larger"
    )
    return replace(inertia, tensor=inertia.tensor + missing / 2 * across), (sentence,)


def about_origin(r: np.ndarray) -> np.ndarray:
    """The rotational inertia about the origin of a mass of 1 kg at a position [m], (3, 3)."""
    return r @ r * np.eye(3) - np.outer(r, r)


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation about a unit vector by an angle [rad], (3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return without_rounding(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def without_rounding(rotation: np.ndarray) -> np.ndarray:
    """A rotation whose entries near 0, 1 and -1 are exactly that, so that programs leave them out.

    A right angle in radians has a cosine of 6e-17.
    """
    nearest = np.round(rotation)
    return np.where(np.abs(rotation - nearest) < 1e-15, nearest, rotation) + 0.0
