"""Robots from URDF files: links, joints, mimic joints, transmissions.

Read with Python's own XML reader. The format has a dozen elements and has not changed for years;
nothing here needs the meshes, which libraries for URDF look for, nor a principal axis transform of
the inertias, by which values of the file are no longer exact.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np

from tustinnet.errors import InputError
from tustinnet.systems.robot import (
    JointKind,
    LinkInertia,
    Mimic,
    Robot,
    RobotActuator,
    RobotJoint,
    RobotLink,
    parse_xml,
    require_few_joints,
    rotation_about,
    without_rounding,
)

GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]; z is up in a URDF
_KINDS: dict[str, JointKind] = {
    "revolute": "angular",
    "continuous": "angular",
    "prismatic": "linear",
    "fixed": "fixed",
}
_EXPECTED = "a URDF file"
_LARGEST = 1e6  # numbers in a file, in SI units


def read_urdf(text: str, where: object) -> Robot:
    """The robot of a URDF file.

    Args:
        text: the file's text.
        where: the file, for messages.

    Raises:
        InputError: no URDF, joints that are no tree, a kind of joint without equations here, or a
            number that is none.
    """
    root = parse_xml(text, where, _EXPECTED)
    if root.tag != "robot":
        raise InputError(
            where,
            f"the root element <{root.tag}>",
            "<robot>",
            "a file in MuJoCo's format has the ending .xml"
            if root.tag == "mujoco"
            else "is it a URDF file?",
        )
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise InputError(where, "macros of xacro", _EXPECTED, f"run xacro {where} > arm.urdf")
    links: dict[str, RobotLink] = {}
    for element in root.findall("link"):
        link = read_link(element, where)
        if link.name in links:
            raise InputError(where, f"two links '{link.name}'", "names that differ")
        links[link.name] = link
    joints: dict[str, RobotJoint] = {}
    for element in root.findall("joint"):
        joint = _read_joint(element, where)
        if joint.name in joints:
            raise InputError(where, f"two joints '{joint.name}'", "names that differ")
        for end in (joint.parent, joint.child):
            if end not in links:
                raise InputError(
                    f"{where}, joint '{joint.name}'",
                    f"no link '{end}'",
                    f"one of {', '.join(links) or 'some links'}",
                )
        joints[joint.name] = joint
    require_few_joints(sum(joint.kind != "fixed" for joint in joints.values()), where)
    ordered = _sort_tree(links, joints.values(), where)
    return Robot(
        root.get("name") or "robot",
        tuple(links.values()),
        ordered,
        _read_transmissions(root, joints, where),
        GRAVITY,
    )


def _sort_tree(
    links: dict[str, RobotLink], joints: Iterable[RobotJoint], where: object
) -> tuple[RobotJoint, ...]:
    """The joints, each after those between its parent and the base.

    Raises:
        InputError: there are loops, or several roots.
    """
    by_child: dict[str, RobotJoint] = {}
    for joint in joints:
        if joint.child in by_child:
            raise InputError(
                where,
                f"a loop: the joints '{by_child[joint.child].name}' and '{joint.name}' both "
                f"carry the link '{joint.child}'",
                "a tree: one joint for each link",
                "write a closed chain down: docs/how-to/add-a-system.md",
            )
        by_child[joint.child] = joint
    roots = [name for name in links if name not in by_child]
    placed, ordered = set(roots[:1]), []
    remaining = list(by_child.values())
    while ready := [joint for joint in remaining if joint.parent in placed]:
        # one at a time, in the order of the file
        ordered.append(ready[0])
        placed.add(ready[0].child)
        remaining.remove(ready[0])
    if len(roots) > 1:
        names = ", ".join(f"'{name}'" for name in roots)
        raise InputError(
            where,
            f"links that no joint carries: {names}",
            "one, the base",
            "fix all but one to the base by joints",
        )
    if remaining or not roots:
        names = ", ".join(f"'{joint.name}'" for joint in remaining)
        problem = f"a loop: the joints {names} carry one another" if remaining else "no links"
        raise InputError(where, problem, "a tree of links that begins at the base")
    return tuple(ordered)


def read_link(element: ET.Element, where: object) -> RobotLink:
    """The link of an element of a URDF.

    Args:
        element: the element.
        where: the file, for messages.

    Raises:
        InputError: a link without a name, an inertia that is not whole, a number that is none.
    """
    name = _name(element, where)
    place, inertial = f"{where}, link '{name}'", element.find("inertial")
    is_frame = element.find("visual") is None and element.find("collision") is None
    if inertial is None:
        return RobotLink(name, None, is_frame)
    mass_element, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass_element is None or inertia is None:
        missing = "mass" if mass_element is None else "inertia"
        raise InputError(place, f"an <inertial> without <{missing}>", "mass and inertia")
    mass = _number(mass_element, "value", "", place)
    if mass == 0:
        return RobotLink(name, None, is_frame)
    if mass < 0:
        raise InputError(place, f"a mass of {mass:g} kg", "a positive mass")
    xx, xy, xz, yy, yz, zz = (
        _number(inertia, f"i{axes}", "0", place) for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    rotation, center = read_origin(inertial, place)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return RobotLink(name, LinkInertia(mass, center, rotation @ tensor @ rotation.T), is_frame)


def _read_joint(element: ET.Element, where: object) -> RobotJoint:
    name = _name(element, where)
    place, kind = f"{where}, joint '{name}'", element.get("type", "")
    if kind not in _KINDS:
        raise InputError(
            place,
            f"the type '{kind}'",
            f"one of {', '.join(_KINDS)}",
            "make it of several joints, or fix it",
        )
    ends = [
        end.get("link", "") if (end := element.find(tag)) is not None else ""
        for tag in ("parent", "child")
    ]
    if not all(ends):
        raise InputError(place, "no parent or no child", '<parent link="A"/> and <child link="B"/>')
    rotation, position = read_origin(element, place)
    axis = read_numbers(element.find("axis"), "xyz", "1 0 0", 3, place)
    if kind != "fixed" and not axis.any():
        raise InputError(place, "an axis of length 0", "a direction")
    dynamics, limit, mimic = (element.find(tag) for tag in ("dynamics", "limit", "mimic"))
    viscous, coulomb = (_number(dynamics, key, "0", place) for key in ("damping", "friction"))
    if viscous < 0 or coulomb < 0:
        raise InputError(place, "a negative friction", "damping and friction of at least 0")
    effort, speed, lower, upper = (
        _number(limit, key, "0", place) for key in ("effort", "velocity", "lower", "upper")
    )
    parent, child = ends
    return RobotJoint(
        name,
        _KINDS[kind],
        parent,
        child,
        rotation,
        position,
        axis / (np.linalg.norm(axis) or 1.0),
        np.zeros(3),
        mimic=None
        if mimic is None
        else Mimic(
            mimic.get("joint", ""),
            _number(mimic, "multiplier", "1", place),
            _number(mimic, "offset", "0", place),
        ),
        viscous=viscous,
        coulomb=coulomb,
        effort=effort if effort > 0 else None,
        speed=speed if speed > 0 else None,
        range=(lower, upper) if lower != upper and kind != "continuous" else None,
    )


def _read_transmissions(
    root: ET.Element, joints: dict[str, RobotJoint], where: object
) -> tuple[RobotActuator, ...] | None:
    """The actuators at joints that transmissions name; None without transmissions."""
    transmissions = root.findall("transmission")
    if not transmissions:
        return None
    actuators: list[RobotActuator] = []
    for element in transmissions:
        named, actuator = element.find("joint"), element.find("actuator")
        joint = "" if named is None else named.get("name", "")
        place = f"{where}, transmission '{element.get('name', '')}'"
        if not joint:
            raise InputError(
                place,
                "no joint that it drives",
                '<joint name="...">',
                "write one of several joints as one for each, or leave it out",
            )
        if joint not in joints:
            raise InputError(place, f"no joint '{joint}'", f"one of {', '.join(joints)}")
        name = ("" if actuator is None else actuator.get("name", "")) or joint
        if other := [own.joint for own in actuators if own.name == name]:
            raise InputError(
                place,
                f"the actuator '{name}' at '{joint}', which is at '{other[0]}' already",
                "a joint for each actuator",
                "leave out all but one of its transmissions",
            )
        actuators.append(RobotActuator(name, joint))
    return tuple(actuators)


def read_origin(element: ET.Element, place: str) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and position of an element's <origin>."""
    origin = element.find("origin")
    roll, pitch, yaw = read_numbers(origin, "rpy", "0 0 0", 3, place)
    x, y, z = np.eye(3)
    rotation = rotation_about(z, yaw) @ rotation_about(y, pitch) @ rotation_about(x, roll)
    return without_rounding(rotation), read_numbers(origin, "xyz", "0 0 0", 3, place)


def _name(element: ET.Element, where: object) -> str:
    name = element.get("name", "")
    if not name:
        raise InputError(where, f"a {element.tag} without a name", f'<{element.tag} name="...">')
    return name


def _number(element: ET.Element | None, key: str, default: str, place: str) -> float:
    """The number of an attribute; its default where the element or it is missing."""
    return float(read_numbers(element, key, default, 1, place)[0])


def read_numbers(
    element: ET.Element | None, key: str, default: str, count: int, place: str
) -> np.ndarray:
    """The numbers of an attribute, (count,); its default where the element or it is missing."""
    text = default if element is None else element.get(key, default)
    tag = "" if element is None else f"<{element.tag} {key}>"
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not (np.abs(numbers) <= _LARGEST).all():
        expected = "a number" if count == 1 else f"{count} numbers"
        raise InputError(place, f"{tag} '{text[:50]}'", f"{expected} of at most {_LARGEST:g}")
    return numbers
