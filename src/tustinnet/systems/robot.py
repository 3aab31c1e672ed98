"""A robot as its file describes it: links, joints and actuators, whatever the file's format."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from xml.parsers import expat

import numpy as np

from tustinnet.channels import Kind
from tustinnet.errors import InputError, describe_error

if TYPE_CHECKING:
    from tustinnet.models.chains import Vector3

MOST_JOINTS = 100  # that move; the time to make their equations grows with the cube
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
    center: np.ndarray
    tensor: np.ndarray


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
        speed: largest speed [rad/s or m/s], None if unknown.
        range: smallest and largest position [rad or m], None if unknown.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    rotation: np.ndarray
    position: np.ndarray
    axis: np.ndarray
    anchor: np.ndarray
    zero: float = 0.0
    mimic: Mimic | None = None
    armature: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0
    stiffness: float = 0.0
    spring_rest: float = 0.0
    effort: float | None = None
    speed: float | None = None
    range: tuple[float, float] | None = None

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
    """An actuator at a joint: `force = gain u + by_position q + by_speed v + bias`.

    Attributes:
        name: its name, that of the input.
        joint: name of the joint.
        gain: force by input [N m or N, by the input's unit].
        by_position: force by position [N m/rad or N/m].
        by_speed: force by speed [N m s/rad or N s/m].
        bias: force without input [N m or N].
        largest_force: largest force in both directions [N m or N], None if unknown.
    """

    name: str
    joint: str
    gain: float = 1.0
    by_position: float = 0.0
    by_speed: float = 0.0
    bias: float = 0.0
    largest_force: float | None = None

    @property
    def has_feedback(self) -> bool:
        """Whether its force depends on the motion of the joint, as that of a servo does."""
        return bool(self.by_position or self.by_speed)


@dataclass(frozen=True)
class Robot:
    """A robot on a fixed base: a tree of links.

    Attributes:
        name: its name.
        links: the links; each but the first is carried by a joint.
        joints: the joints, each after those between its parent and the base.
        actuators: the actuators; None where the file says nothing about them.
        gravity: acceleration of gravity in the frame of the base [m/s^2].
    """

    name: str
    links: tuple[RobotLink, ...]
    joints: tuple[RobotJoint, ...]
    actuators: tuple[RobotActuator, ...] | None
    gravity: "Vector3"


def restore_robot(plain: Mapping[str, Any]) -> Robot:
    """The robot of the plain values that `dataclasses.asdict` and JSON make of one."""

    def arrays(values: Mapping[str, Any], *names: str) -> dict[str, Any]:
        return {**values, **{name: np.array(values[name], np.float64) for name in names}}

    def inertia(values: Mapping[str, Any] | None) -> LinkInertia | None:
        return None if values is None else LinkInertia(**arrays(values, "center", "tensor"))

    def joint(values: Mapping[str, Any]) -> RobotJoint:
        plain = arrays(values, "rotation", "position", "axis", "anchor")
        mimic = None if values["mimic"] is None else Mimic(**values["mimic"])
        ends = None if values["range"] is None else tuple(values["range"])
        return RobotJoint(**{**plain, "mimic": mimic, "range": ends})

    links = [RobotLink(x["name"], inertia(x["inertia"]), x["is_frame"]) for x in plain["links"]]
    joints = [joint(values) for values in plain["joints"]]
    x, y, z = plain["gravity"]
    actuators = tuple(RobotActuator(**values) for values in plain["actuators"])
    return Robot(plain["name"], tuple(links), tuple(joints), actuators, (x, y, z))


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
        parser.Parse(text, True)
        return tree.close()
    except InputError:
        raise
    except Exception as error:
        raise InputError(where, f"no well-formed XML ({describe_error(error)})", expected) from None


def join_inertias(parts: Sequence[LinkInertia]) -> LinkInertia:
    """The inertia of several links that do not move against one another, in one frame."""
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.center for part in parts), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        r = part.center - center
        tensor = tensor + part.tensor + part.mass * about_origin(r)
    return LinkInertia(mass, center, tensor)


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
