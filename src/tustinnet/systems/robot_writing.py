"""Identified values in the text of a robot's file: only numbers change, comments and order stay.

An XML library would write the whole text anew. Here the places of the elements are those that
Python's own parser (expat) reports, and attributes are replaced in the text.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from xml.parsers import expat

import numpy as np

from tustinnet.errors import InputError
from tustinnet.models.chains import INERTIAL, BodyInertia, body_inertia, inertial_parameters
from tustinnet.systems.mjcf_text import (
    JOINT_NAMES,
    JointValues,
    inertial_attributes,
    joint_attributes,
    mjcf_text,
    no_rest_error,
    numbers_text,
)
from tustinnet.systems.robot import LinkInertia, about_origin, join_inertias
from tustinnet.systems.robot_channels import RobotChannels
from tustinnet.systems.robot_equations import Drive
from tustinnet.systems.robot_tree import RobotTree, felt

_TAG_END = re.compile(rb"""(?:[^"'>]|"[^"]*"|'[^']*')*>""")  # quoted texts may have a >
# other ways in which MuJoCo's format says where the axes of an inertia are
_ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler", "diaginertia")


_URDF_NAMES = {"viscous": "damping", "coulomb": "friction"}  # of the parameters of a joint
_AT = ("joint", "jointinparent")  # by which an actuator without a name is known


@dataclass
class _Element:
    """An element of a text in bytes: its start tag from `start` to `stop`, its end tag at `end`."""

    tag: str
    attributes: dict[str, str]
    start: int
    stop: int = 0
    end: int | None = None  # None of an empty element, <a/>
    children: list["_Element"] = field(default_factory=list)

    def child(self, tag: str) -> "_Element | None":
        return next((c for c in self.children if c.tag == tag), None)


class _Text:
    """A text of XML whose attributes can be changed.

    Args:
        text: the text.
    """

    def __init__(self, text: str) -> None:
        self._text = text.lstrip().encode()
        self._edits: list[tuple[int, int, bytes]] = []
        self.elements: list[_Element] = []
        path: list[_Element] = []
        parser = expat.ParserCreate("utf-8")

        def begin(tag: str, attributes: dict[str, str]) -> None:
            element = _Element(tag, attributes, parser.CurrentByteIndex)
            found = _TAG_END.match(self._text, element.start)
            assert found is not None
            element.stop = found.end()
            if path:
                path[-1].children.append(element)
            self.elements.append(element)
            path.append(element)

        def end(tag: str) -> None:
            element = path.pop()
            if not self._text[element.start : element.stop].endswith(b"/>"):
                element.end = parser.CurrentByteIndex

        parser.StartElementHandler, parser.EndElementHandler = begin, end
        parser.Parse(self._text, True)

    def named(self, tag: str, name: str) -> _Element | None:
        """The first element with a tag and a name."""
        return next(
            (e for e in self.elements if e.tag == tag and e.attributes.get("name") == name), None
        )

    def set(self, element: _Element, values: Mapping[str, str], drop: tuple[str, ...] = ()) -> None:
        """Sets attributes of an element, and drops others."""
        tag = self._text[element.start : element.stop].decode()
        for key in drop:
            tag = re.sub(rf"""\s{key}\s*=\s*("[^"]*"|'[^']*')""", "", tag)
        for key, value in values.items():
            written = f'{key}="{value}"'
            tag, count = re.subn(
                rf"""(?<=\s){key}\s*=\s*("[^"]*"|'[^']*')""", written, tag, count=1
            )
            if not count:
                closing = "/>" if tag.endswith("/>") else ">"
                tag = f"{tag.removesuffix(closing).rstrip()} {written}{closing}"
        self._edits.append((element.start, element.stop, tag.encode()))

    def add(self, parent: _Element, content: str) -> None:
        """Adds an element as the first one in another, indented as its neighbours are."""
        line = self._text.rfind(b"\n", 0, parent.start) + 1
        indent = re.match(rb"[ \t]*", self._text[line : parent.start])
        space = "\n" + (indent[0].decode() if indent else "")
        tag = self._text[parent.start : parent.stop].decode()
        if parent.end is None:
            text = f"{tag.removesuffix('/>').rstrip()}>{space}  {content}{space}</{parent.tag}>"
            self._edits.append((parent.start, parent.stop, text.encode()))
        else:
            self._edits.append((parent.stop, parent.stop, f"{space}  {content}".encode()))

    def remove(self, element: _Element | None) -> None:
        """Takes an element out, with all that is in it."""
        if element is not None:
            # with the space before it, so that no empty line is left
            start, stop = len(self._text[: element.start].rstrip()), element.stop
            if element.end is not None:
                found = _TAG_END.match(self._text, element.end)
                assert found is not None
                stop = found.end()
            self._edits.append((start, stop, b""))

    def written(self) -> str:
        """The text with all changes."""
        text = self._text
        for start, stop, new in sorted(self._edits, key=lambda edit: edit[:2], reverse=True):
            text = text[:start] + new + text[stop:]
        return text.decode()


def write_values(
    text: str, channels: RobotChannels, values: Mapping[str, float], ending: str
) -> tuple[str, frozenset[str]]:
    """The text of a robot's file with values of parameters in it, and the names of these.

    Args:
        text: the file's text.
        channels: the bodies and actuators that were made of it.
        values: the parameters by name.
        ending: the ending of the file to write; a URDF is also written in MuJoCo's format.

    Raises:
        InputError: see `write_mjcf` and `mjcf_text`.
    """
    tree = channels.tree
    links, joints = _link_inertias(tree, values), _joint_values(tree, values)
    servos = [(d, {g: values[f"{d.label}.{g}"] for g in d.actuator.gains}) for d in channels.drives]
    names = _URDF_NAMES if ending == ".urdf" else JOINT_NAMES
    if ending == ".urdf":
        text = write_urdf(text, links, joints)
    elif tree.path.suffix == ".urdf":
        text = mjcf_text(tree.robot, links, joints, tree.path)
    else:
        text = write_mjcf(text, links, joints, tree.path, servos, channels.options.gravity)
    written = {f"{body}.{name}" for body in links for name in INERTIAL}
    written |= {f"{joint}.{kind}" for joint, own in joints.items() for kind in own if kind in names}
    written |= {f"{d.label}.{gain}" for d, gains in servos for gain in gains}
    return text, frozenset(written)


def _link_inertias(tree: RobotTree, values: Mapping[str, float]) -> dict[str, LinkInertia | None]:
    """The inertias of links in their own frames, by the values of the bodies' parameters.

    Of a body of several links the others keep what they have by the file, as long as what is left
    for the link that moves is the inertia of a body; else this link has all of it and the others
    have none.
    """
    inertias: dict[str, LinkInertia | None] = {}
    for body, parts in zip(tree.bodies, tree.parts, strict=True):
        if not body.has_mass:
            continue
        own = body_inertia(body, values)
        carried = {name: part for name, part in parts.items() if name != body.name}
        rest = _without(own, join_inertias([*carried.values()])) if carried else None
        if rest is None:
            inertias |= dict.fromkeys(carried)
            rest = _about_center(float(own.mass), np.asarray(own.moment), np.asarray(own.tensor))
        inertias[body.name] = replace(rest, center=rest.center + np.array(body.anchor))
    return inertias


def _joint_values(tree: RobotTree, values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """The values of joints; what joints that follow have by the file is taken off first."""
    by_joint: dict[str, dict[str, float]] = {name: {} for name in tree.moved_by}
    for k, name in enumerate(tree.free):
        followers = [m for m in tree.moved(k) if m.joint.name != name]
        for kind in ("viscous", "coulomb", "armature"):
            by_joint[name][kind] = max(values[f"{name}.{kind}"] - felt(followers, kind), 0.0)
    for name, own in by_joint.items():
        if tree.joints[name].stiffness:
            own["stiffness"] = values[f"{name}.stiffness"]
    return by_joint


def _about_center(mass: float, moment: np.ndarray, tensor: np.ndarray) -> LinkInertia:
    """An inertia whose tensor and moment were about the origin of the frame."""
    center = moment / mass
    return LinkInertia(mass, center, tensor - mass * about_origin(center))


def _without(own: BodyInertia, part: LinkInertia) -> LinkInertia | None:
    """Rest of an inertia without a part of it; None where no body has that."""
    if (mass := float(own.mass) - part.mass) <= 0:
        return None
    tensor = own.tensor - part.tensor - part.mass * about_origin(part.center)
    rest = _about_center(mass, np.asarray(own.moment) - part.mass * part.center, np.asarray(tensor))
    try:
        inertial_parameters(rest.mass, rest.center, rest.tensor)
    except (ValueError, np.linalg.LinAlgError):
        return None
    return rest


def write_urdf(
    text: str, links: Mapping[str, LinkInertia | None], joints: Mapping[str, JointValues]
) -> str:
    """The text of a URDF file with other inertias and frictions; it has no armatures or springs.

    Args:
        text: the file's text.
        links: inertias by link, in the frame of the link; None for a link that is to have none.
        joints: values by joint.
    """
    written = _Text(text)
    for name, inertia in links.items():
        element = written.named("link", name)
        assert element is not None
        if inertia is None:
            written.remove(element.child("inertial"))
            continue
        tensor = inertia.tensor
        origin = {"xyz": numbers_text(inertia.center), "rpy": "0 0 0"}
        mass = {"value": numbers_text(inertia.mass)}
        axes = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        moments = dict(zip(axes, numbers_text(tensor[np.triu_indices(3)]).split(), strict=True))
        parts = {"origin": origin, "mass": mass, "inertia": moments}
        if (inertial := element.child("inertial")) is None:
            inner = "".join(_tag(tag, values) for tag, values in parts.items())
            written.add(element, f"<inertial>{inner}</inertial>")
            continue
        for tag, values in parts.items():
            if (part := inertial.child(tag)) is None:
                written.add(inertial, _tag(tag, values))
            else:
                written.set(part, values)
    for name, values in joints.items():
        element = written.named("joint", name)
        assert element is not None
        if not (known := joint_attributes(values, _URDF_NAMES)):
            continue
        if (dynamics := element.child("dynamics")) is None:
            written.add(element, _tag("dynamics", known))
        else:
            written.set(dynamics, known)
    return written.written()


def write_mjcf(
    text: str,
    links: Mapping[str, LinkInertia | None],
    joints: Mapping[str, JointValues],
    where: object,
    servos: Sequence[tuple[Drive, Mapping[str, float]]] = (),
    gravity: Sequence[float] | None = None,
) -> str:
    """The text of a file in MuJoCo's format with other inertias, values of joints, and gains.

    Args:
        text: the file's text.
        links: inertias by body, in the frame of the body; None for one that is to have none.
        joints: values by joint.
        where: the file, for messages.
        servos: drives with the gains of their actuators.
        gravity: its acceleration, None for that of the text [m/s^2].

    Raises:
        InputError: the file takes inertias from shapes only, or a body is to have none.
    """
    written = _Text(text)
    for element in written.elements:
        if element.tag == "compiler" and element.attributes.get("inertiafromgeom") == "true":
            raise InputError(
                where,
                'inertiafromgeom="true": inertias in the file do not count',
                'inertiafromgeom="auto"',
                "change it there, or leave it out",
            )
    for name, inertia in links.items():
        element = written.named("body", name)
        assert element is not None
        if inertia is None:
            raise no_rest_error(where, f"body '{name}'")
        values = inertial_attributes(inertia)
        if (inertial := element.child("inertial")) is None:
            written.add(element, _tag("inertial", values))
        else:
            written.set(inertial, values, drop=_ORIENTATIONS)
    for name, joint in joints.items():
        element = written.named("joint", name)
        assert element is not None
        if known := joint_attributes(joint):
            written.set(element, known)
    actuators = [e for group in written.elements if group.tag == "actuator" for e in group.children]
    for drive, gains in servos:
        own = drive.actuator
        element = next(
            e for e in actuators if own.name in (e.attributes.get(k) for k in ("name", *_AT))
        )
        if element.tag == "general":
            gain = gains.get(own.goal or "gain", own.gain)
            feedback = (0.0 - gains.get(name, 0.0) for name in ("kp", "kv"))
            known = {"gainprm": numbers_text(gain), "biasprm": numbers_text([own.bias, *feedback])}
        else:
            known = {name: numbers_text(x) for name, x in gains.items()}
        written.set(element, known, drop=("dampratio",))
    if gravity is not None:
        known, own = {"gravity": numbers_text(gravity)}, [e.tag for e in written.elements]
        if "option" in own:  # of several the last counts
            written.set(written.elements[len(own) - 1 - own[::-1].index("option")], known)
        else:
            written.add(written.elements[0], _tag("option", known))
    return written.written()


def _tag(name: str, values: Mapping[str, str]) -> str:
    attributes = "".join(f' {key}="{value}"' for key, value in values.items())
    return f"<{name}{attributes}/>"
