"""A robot in MuJoCo's format (MJCF) where its own file is a URDF, which has no armatures."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np

from tustinnet.errors import InputError
from tustinnet.systems.robot import (
    LinkInertia,
    Robot,
    RobotActuator,
    RobotJoint,
    join_inertias,
    place_inertia,
)

JointValues = Mapping[str, float]  # by the name of a parameter without that of the joint
# what this format calls the parameters of a joint
JOINT_NAMES = {
    "viscous": "damping",
    "coulomb": "frictionloss",
    "armature": "armature",
    "stiffness": "stiffness",
}
_WORLD = "world"  # MuJoCo's name of what everything stands on
_LEAST_MASS = 1e-12  # kg and kg m^2, of a link that moves and has no mass; MuJoCo refuses none


def mjcf_text(
    robot: Robot,
    links: Mapping[str, LinkInertia | None],
    joints: Mapping[str, JointValues],
    where: object,
) -> str:
    """The text of a file in MuJoCo's format, of links, joints and actuators.

    Links that are fixed to another one have their frames there, and it has their inertias.

    Args:
        robot: a robot of a URDF file.
        links: inertias by link in place of those of the robot, in the frame of the link; None for a
            link that is to have none.
        joints: values by joint in place of those of the robot.
        where: its file, for messages.

    Raises:
        InputError: a link that is to have none moves, as that of a locked joint does there.
    """
    inertias = _with_fixed_links(robot, links)
    root = ET.Element("mujoco", model=robot.name)
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(root, "option", gravity=numbers_text(robot.gravity))
    world = ET.SubElement(root, "worldbody")
    base = robot.joints[0].parent
    bodies = {base: world if base == _WORLD else ET.SubElement(world, "body", name=base)}
    followers = []
    for joint in robot.joints:
        attributes = {"name": joint.child, "pos": numbers_text(joint.position)}
        if (joint.rotation != np.eye(3)).any():
            attributes["xyaxes"] = numbers_text(joint.rotation.T[:2].ravel())
        body = bodies[joint.child] = ET.SubElement(bodies[joint.parent], "body", attributes)
        if joint.kind == "fixed":
            continue
        if joint.child in links and links[joint.child] is None:
            raise no_rest_error(where, f"link '{joint.child}'")
        inertia = inertias[joint.child] or LinkInertia(
            _LEAST_MASS, np.zeros(3), _LEAST_MASS * np.eye(3)
        )
        ET.SubElement(body, "inertial", inertial_attributes(inertia))
        ET.SubElement(body, "joint", _joint_attributes(joint, joints.get(joint.name)))
        if joint.mimic is not None:
            followers.append((joint.name, joint.mimic))
    if followers:
        equality = ET.SubElement(root, "equality")
        for name, mimic in followers:
            slope = f"{numbers_text([mimic.offset, mimic.ratio])} 0 0 0"
            ET.SubElement(equality, "joint", joint1=name, joint2=mimic.joint, polycoef=slope)
    motors = ET.SubElement(root, "actuator")
    for actuator in _actuators(robot):
        ET.SubElement(motors, "motor", name=actuator.name, joint=actuator.joint)
    ET.indent(root)
    return ET.tostring(root, "unicode") + "\n"


def _with_fixed_links(
    robot: Robot, links: Mapping[str, LinkInertia | None]
) -> dict[str, LinkInertia | None]:
    """The inertia of each link, with those of the links that are fixed to it."""
    inertias = {link.name: links.get(link.name, link.inertia) for link in robot.links}
    for joint in reversed(robot.joints):
        own, carried = inertias[joint.parent], inertias[joint.child]
        if joint.kind == "fixed" and carried is not None:
            carried = place_inertia(carried, joint.rotation, joint.position)
            inertias[joint.parent] = carried if own is None else join_inertias([own, carried])
    return inertias


def _actuators(robot: Robot) -> list[RobotActuator]:
    """The actuators of joints that move; without any in the file one at each that follows none."""
    moving = {joint.name: joint for joint in robot.joints if joint.kind != "fixed"}
    if robot.actuators is not None:
        return [actuator for actuator in robot.actuators if actuator.joint in moving]
    return [RobotActuator(name, name) for name, joint in moving.items() if joint.mimic is None]


def _joint_attributes(joint: RobotJoint, values: JointValues | None) -> dict[str, str]:
    """The attributes of a joint, with other values where there are some."""
    attributes = {
        "name": joint.name,
        "type": "slide" if joint.kind == "linear" else "hinge",
        "axis": numbers_text(joint.axis),
    }
    if joint.range is not None:
        attributes["range"] = numbers_text(joint.range)
    if joint.effort is not None:
        attributes["actuatorfrcrange"] = numbers_text([-joint.effort, joint.effort])
    own = {kind: getattr(joint, kind) for kind in JOINT_NAMES}
    numbers = joint_attributes({**own, **(values or {})})
    return attributes | {key: text for key, text in numbers.items() if text != "0"}


def joint_attributes(values: JointValues, names: Mapping[str, str] = JOINT_NAMES) -> dict[str, str]:
    """The attributes of a joint that a format has, of those values that it has a name for."""
    return {name: numbers_text(values[kind]) for kind, name in names.items() if kind in values}


def inertial_attributes(inertia: LinkInertia) -> dict[str, str]:
    """The attributes of an <inertial> in this format."""
    t = inertia.tensor
    return {
        "pos": numbers_text(inertia.center),
        "mass": numbers_text(inertia.mass),
        "fullinertia": numbers_text([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]]),
    }


def numbers_text(values: Sequence[float] | np.ndarray | float) -> str:
    """Numbers of a quantity, in digits that the rounding of sums and products leaves true."""
    numbers = np.ravel(values).astype(float)
    largest = np.abs(numbers).max()
    places = 14 - 1 - int(np.floor(np.log10(largest))) if largest else 0
    rounded = [round(float(x), places) + 0.0 for x in numbers]
    return " ".join(repr(int(x)) if x.is_integer() and abs(x) < 1e6 else repr(x) for x in rounded)


def no_rest_error(where: object, what: str) -> InputError:
    """The error about a body that is to have no inertia, in a format in which each has one."""
    return InputError(
        f"{where}, {what}",
        "what it is fixed to weighs less than both by the file",
        "bodies that weigh less",
        "give it its true inertia, and identify again",
    )
