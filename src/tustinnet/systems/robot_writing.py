"""Identified values in the text of a robot's file: only numbers change, comments and order stay.

An XML library would write the whole text anew. Here the places of the elements are those that
Python's own parser (expat) reports, and attributes are replaced in the text.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np

from tustinnet.errors import InputError
from tustinnet.systems.robot import LinkInertia

_TAG_END = re.compile(rb"""(?:[^"'>]|"[^"]*"|'[^']*')*>""")  # quoted texts may have a >
_DIGITS = 14  # of written numbers: 0.55, where sums and products make 0.55000000000000004 of it
# other ways in which MuJoCo's format says where the axes of an inertia are
_ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler", "diaginertia")


@dataclass(frozen=True)
class JointValues:
    """Identified values of a joint; None where it is as the file says.

    Attributes:
        viscous: viscous friction [N m s/rad or N s/m].
        coulomb: Coulomb friction [N m or N].
        armature: inertia beside those of the links [kg m^2 or kg].
        stiffness: stiffness of a spring [N m/rad or N/m].
    """

    viscous: float | None = None
    coulomb: float | None = None
    armature: float | None = None
    stiffness: float | None = None


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


def numbers_text(values: Sequence[float] | np.ndarray | float) -> str:
    """Numbers of one attribute, in digits that the rounding of sums and products leaves true."""
    return " ".join(_digits(values))


def _digits(values: Sequence[float] | np.ndarray | float) -> list[str]:
    """The text of each number of a vector or a tensor, to 14 digits of the largest one."""
    numbers = np.ravel(values).astype(float)
    largest = np.abs(numbers).max()
    places = _DIGITS - 1 - int(np.floor(np.log10(largest))) if largest else 0
    rounded = [round(float(x), places) + 0.0 for x in numbers]
    return [repr(int(x)) if x.is_integer() and abs(x) < 1e6 else repr(x) for x in rounded]


def inertial_attributes(inertia: LinkInertia) -> dict[str, str]:
    """The attributes of an <inertial> in MuJoCo's format."""
    t = inertia.tensor
    return {
        "pos": numbers_text(inertia.center),
        "mass": numbers_text(inertia.mass),
        "fullinertia": numbers_text([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]]),
    }


def joint_attributes(values: JointValues) -> dict[str, str]:
    """The attributes of a <joint> in MuJoCo's format, of the values that are known."""
    given = {
        "damping": values.viscous,
        "frictionloss": values.coulomb,
        "armature": values.armature,
        "stiffness": values.stiffness,
    }
    return {key: numbers_text(x) for key, x in given.items() if x is not None}


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
        moments = dict(zip(axes, _digits(tensor[np.triu_indices(3)]), strict=True))
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
        friction = {"damping": values.viscous, "friction": values.coulomb}
        known = {key: numbers_text(x) for key, x in friction.items() if x is not None}
        if not known:
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
) -> str:
    """The text of a file in MuJoCo's format with other inertias, frictions and armatures.

    Args:
        text: the file's text.
        links: inertias by body, in the frame of the body; None for one that is to have none.
        joints: values by joint.
        where: the file, for messages.

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
    return written.written()


def no_rest_error(where: object, what: str) -> InputError:
    """The error about a body that is to have no inertia, in a format in which each has one."""
    return InputError(
        f"{where}, {what}",
        "what it is fixed to weighs less than both by the file",
        "bodies that weigh less",
        "give it its true inertia, and identify again",
    )


def _tag(name: str, values: Mapping[str, str]) -> str:
    attributes = "".join(f' {key}="{value}"' for key, value in values.items())
    return f"<{name}{attributes}/>"
