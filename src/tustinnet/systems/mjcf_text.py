"""A robot in MuJoCo's format (MJCF) where its own file is a URDF, which has no armatures."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from tustinnet.systems.robot import (
    LinkInertia,
    Robot,
    RobotActuator,
    RobotJoint,
    force_name,
    join_inertias,
    place_inertia,
)
from tustinnet.systems.robot_writing import (
    JointValues,
    inertial_attributes,
    joint_attributes,
    no_rest_error,
    numbers_text,
)

_WORLD = "world"  # MuJoCo's name of what everything stands on
_LEAST = 1e-12  # kg and kg m^2, of a link that moves and has no mass; MuJoCo refuses none


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
        inertia = inertias[joint.child] or LinkInertia(_LEAST, np.zeros(3), _LEAST * np.eye(3))
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
    free = [joint for joint in moving.values() if joint.mimic is None]
    return [RobotActuator(force_name(joint), joint.name) for joint in free]


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
    own = JointValues(joint.viscous, joint.coulomb, joint.armature)
    numbers = joint_attributes(own) | joint_attributes(values or own)
    return attributes | {key: text for key, text in numbers.items() if text != "0"}
