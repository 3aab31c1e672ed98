"""Robots from URDF files: links, joints, mimic joints, transmissions.

Read with Python's own XML reader. The format has a dozen elements and has not changed for years;
nothing here needs the meshes, which libraries for URDF look for, nor a principal axis transform of
the inertias, by which values of the file are no longer exact.

Files as they are in the world have links without a mass, bases on wheels and transmissions of
several joints. What has a plain meaning for the equations is read, and told as a remark.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from tustinnet.errors import InputError
from tustinnet.systems.robot import (
    JointKind,
    LinkInertia,
    Mimic,
    Remarks,
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
_FREE = ("floating", "planar")  # joints of a base that moves
_EXPECTED = "a URDF file"
_LARGEST_LIMIT = 1e6  # numbers in a file, in SI units; larger limits are none
_POINT_MASS = 1e-12  # kg, of a link with a rotational inertia and no mass
_ARMATURE = 1e-3  # kg m^2 or kg, of a joint that moves nothing with a mass
_UNITY = {"1", "1.0"}  # reductions that are none
_DRIVEN = ("joint", "gap_joint", "flexJoint", "rollJoint")  # in transmissions; the others of PR2


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
    remarks = Remarks()
    links: dict[str, RobotLink] = {}
    for element in root.findall("link"):
        link = read_link(element, where, remarks)
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
    _require_base(ordered, root, where, remarks)
    ordered = _with_armatures(_with_leaders(ordered, remarks), links, remarks)
    return Robot(
        root.get("name") or "robot",
        tuple(links.values()),
        ordered,
        _read_transmissions(root, joints, remarks),
        GRAVITY,
        remarks.sentences(),
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


def _require_base(
    joints: tuple[RobotJoint, ...], root: ET.Element, where: object, remarks: Remarks
) -> None:
    """Raises where a joint of a base that moves is not between the base and the world.

    Args:
        joints: the joints, sorted; those of a base that moves are fixed ones.
        root: the root element.
        where: the file, for messages.
        remarks: gets them.

    Raises:
        InputError: such a joint is carried by one that moves.
    """
    standing = {joint.parent for joint in joints[:1]}
    free = {e.get("name"): e.get("type") for e in root.findall("joint") if e.get("type") in _FREE}
    for joint in joints:
        is_standing = joint.parent in standing
        if is_standing and joint.kind == "fixed":
            standing.add(joint.child)
        if joint.name in free and not is_standing:
            raise _kind_error(where, joint.name, str(free[joint.name]))
    if free:
        remarks["does not move: the base stands"] += map(str, free)


def _with_leaders(joints: tuple[RobotJoint, ...], remarks: Remarks) -> tuple[RobotJoint, ...]:
    """The joints, of which those move by themselves that follow none that moves."""
    moving = {joint.name for joint in joints if joint.kind != "fixed"}
    alone = [j.name for j in joints if j.name in moving and j.mimic and j.mimic.joint not in moving]
    if alone:
        remarks["moves by itself, as no joint moves that it is to follow"] += alone
    return tuple(replace(joint, mimic=None) if joint.name in alone else joint for joint in joints)


def _with_armatures(
    joints: tuple[RobotJoint, ...], links: dict[str, RobotLink], remarks: Remarks
) -> tuple[RobotJoint, ...]:
    """The joints, with armatures of those by which nothing moves that has a mass.

    Nothing else would say how fast such a joint moves by a torque; a fit finds the true value.
    """
    leaders = {joint.name: joint.mimic.joint for joint in joints if joint.mimic}
    heavy = {name for name, link in links.items() if link.inertia is not None}
    moving_mass: set[str] = set()
    for joint in reversed(joints):
        if joint.child not in heavy:
            continue
        heavy.add(joint.parent)
        name = joint.name
        while name not in moving_mass:
            moving_mass.add(name)
            name = leaders.get(name, name)
    completed = []
    for joint in joints:
        link = links[joint.child]
        if joint.kind != "fixed" and link.inertia is None and not link.is_frame:
            remarks["a shape without a mass, which a default density would give it"].append(
                link.name
            )
        if joint.kind != "fixed" and joint.mimic is None and joint.name not in moving_mass:
            what = f"nothing with a mass moves by it: armature {_ARMATURE:g} to begin with"
            remarks[what].append(joint.name)
            joint = replace(joint, armature=_ARMATURE)
        completed.append(joint)
    return tuple(completed)


def read_link(element: ET.Element, where: object, remarks: Remarks) -> RobotLink:
    """The link of an element of a URDF.

    Args:
        element: the element.
        where: the file, for messages.
        remarks: gets what its inertia lacks.

    Raises:
        InputError: a link without a name or a mass, a number that is none.
    """
    name = _name(element, where)
    place, inertial = f"{where}, link '{name}'", element.find("inertial")
    is_frame = element.find("visual") is None and element.find("collision") is None
    if inertial is None:
        return RobotLink(name, None, is_frame)
    mass_element, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass_element is None:
        raise InputError(place, "an <inertial> without <mass>", "mass and inertia")
    mass = _number(mass_element, "value", "", place)
    if mass < 0:
        raise InputError(place, f"a mass of {mass:g} kg", "a positive mass")
    xx, xy, xz, yy, yz, zz = (
        _number(inertia, f"i{axes}", "0", place) for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    rotation, center = read_origin(inertial, place)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass == 0:
        if not tensor.any():
            return RobotLink(name, None, is_frame)
        mass = _POINT_MASS
        remarks[f"an inertia without a mass, which is {mass:g} kg to begin with"].append(name)
    elif inertia is None:
        remarks["a mass without an inertia, so a point"].append(name)
    return RobotLink(name, LinkInertia(mass, center, rotation @ tensor @ rotation.T), is_frame)


def _read_joint(element: ET.Element, where: object) -> RobotJoint:
    name = _name(element, where)
    place, kind = f"{where}, joint '{name}'", element.get("type", "")
    if kind not in (*_KINDS, *_FREE):
        raise _kind_error(where, name, kind)
    ends = [
        end.get("link", "") if (end := element.find(tag)) is not None else ""
        for tag in ("parent", "child")
    ]
    if not all(ends):
        raise InputError(place, "no parent or no child", '<parent link="A"/> and <child link="B"/>')
    rotation, position = read_origin(element, place)
    axis = read_numbers(element.find("axis"), "xyz", "1 0 0", 3, place)
    if kind in _KINDS and kind != "fixed" and not axis.any():
        raise InputError(place, "an axis of length 0", "a direction")
    dynamics, limit, mimic = (element.find(tag) for tag in ("dynamics", "limit", "mimic"))
    viscous, coulomb = (_number(dynamics, key, "0", place) for key in ("damping", "friction"))
    if viscous < 0 or coulomb < 0:
        raise InputError(place, "a negative friction", "damping and friction of at least 0")
    effort, speed, lower, upper = (
        _number(limit, key, "0", place, np.inf) for key in ("effort", "velocity", "lower", "upper")
    )
    has_range = lower != upper and max(abs(lower), abs(upper)) <= _LARGEST_LIMIT
    parent, child = ends
    return RobotJoint(
        name,
        _KINDS.get(kind, "fixed"),
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
        effort=effort if 0 < effort <= _LARGEST_LIMIT else None,
        speed=speed if 0 < speed <= _LARGEST_LIMIT else None,
        range=(lower, upper) if has_range and kind != "continuous" else None,
    )


def _kind_error(where: object, name: str, kind: str) -> InputError:
    """The error about a joint of a kind without equations here."""
    return InputError(
        f"{where}, joint '{name}'",
        f"the type '{kind}'",
        f"one of {', '.join(_KINDS)}",
        "make it of several joints, or fix it",
    )


def _read_transmissions(
    root: ET.Element, joints: dict[str, RobotJoint], remarks: Remarks
) -> tuple[RobotActuator, ...] | None:
    """The actuators at joints that transmissions name; None without such transmissions.

    An actuator has the name that its transmission says, where that is of one actuator at one joint,
    else that of the joint.
    """
    actuators: dict[str, RobotActuator] = {}
    for element in root.findall("transmission"):
        transmission = element.get("name", "")
        driven = [e.get("name", "") for e in element if e.tag in _DRIVEN]
        driven = [joint for joint in driven if joint in joints]
        if not driven:
            remarks["left out, as none of its joints is there"].append(transmission)
        names = [e.get("name", "") for e in element.findall("actuator")]
        is_simple = len(driven) == len(names) == 1 and names[0] not in actuators
        if driven and not is_simple:
            remarks["not one actuator at one joint, so an input at each joint"].append(transmission)
        for joint in driven:
            name = (is_simple and names[0]) or joint
            actuators[name] = RobotActuator(name, joint)
        if {(e.text or "").strip() for e in element.iter("mechanicalReduction")} - _UNITY:
            what = "its reduction does not count, as inputs are torques and forces at joints"
            remarks[what].append(transmission)
    return tuple(actuators.values()) or None


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


def _number(
    element: ET.Element | None, key: str, default: str, place: str, largest: float = _LARGEST_LIMIT
) -> float:
    """The number of an attribute; its default where the element or it is missing."""
    return float(read_numbers(element, key, default, 1, place, largest)[0])


def read_numbers(
    element: ET.Element | None,
    key: str,
    default: str,
    count: int,
    place: str,
    largest: float = _LARGEST_LIMIT,
) -> np.ndarray:
    """The numbers of an attribute, (count,); its default where the element or it is missing.

    A comma may stand after a number.
    """
    text = default if element is None else element.get(key, default)
    tag = "" if element is None else f"<{element.tag} {key}>"
    try:
        numbers = np.array([float(word) for word in text.replace(", ", " ").split()])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not (np.abs(numbers) <= largest).all():
        expected = "a number" if count == 1 else f"{count} numbers"
        raise InputError(place, f"{tag} '{text[:50]}'", f"{expected} of at most {_LARGEST_LIMIT:g}")
    return numbers
