"""Inertias of the links of a robot by their shapes, where its file has none."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np

from tustinnet.errors import InputError
from tustinnet.systems.files import SystemFile
from tustinnet.systems.robot import LinkInertia, Remarks, join_inertias, parse_xml
from tustinnet.systems.robot_writing import write_urdf
from tustinnet.systems.urdf import read_link, read_numbers, read_origin

_SHAPES = ("box", "cylinder", "sphere", "capsule")
_DENSEST = 3e4  # kg/m^3; osmium has 2.3e4


def with_inertias(file: SystemFile, density: float) -> SystemFile:
    """A URDF in which every link with shapes has an inertia.

    Links that have one keep it. Others get that of their <collision> shapes, without these of
    their <visual> ones, as if they were solid. Shapes that overlap count twice.

    Args:
        file: the file.
        density: density [kg/m^3].

    Raises:
        InputError: no URDF, a density out of range, or a link whose shape is a mesh.
    """
    where = file.path
    if where.suffix != ".urdf":
        raise InputError(
            "default density",
            f"not applicable to {where.name}",
            "a URDF file",
            'in MuJoCo\'s format shapes have a density of their own: <geom density="..."/>',
        )
    if not 0 < density <= _DENSEST:
        raise InputError(
            "default density", f"{density:g} kg/m^3", f"above 0 and at most {_DENSEST:g}"
        )
    root = parse_xml(file.text, where, "a URDF file")
    carried = {end.get("link") for end in root.iterfind("joint/child")}
    inertias: dict[str, LinkInertia | None] = {}
    for link in root.findall("link"):
        own = read_link(link, where, Remarks())
        if own.name in carried and own.inertia is None and not own.is_frame:
            shapes = link.findall("collision") or link.findall("visual")
            place = f"{where}, link '{own.name}'"
            inertias[own.name] = join_inertias([_inertia_of(s, density, place) for s in shapes])
    if not inertias:
        raise InputError(
            "default density",
            f"not applicable to {where.name}",
            "a link that a joint carries, with a shape and without an inertia",
            "leave it out: every link has its inertia",
        )
    return replace(file, text=write_urdf(file.text, inertias, {}))


def _inertia_of(element: ET.Element, density: float, place: str) -> LinkInertia:
    """The inertia of a solid shape in the frame of its link."""
    geometry = element.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None or shape.tag not in _SHAPES:
        what = "no shape" if shape is None else f"the shape is a <{shape.tag}>, which is not read"
        raise InputError(
            place,
            f"no inertia, and {what}",
            f"one of {', '.join(_SHAPES)}",
            "give it an <inertial>, or a <collision> of such a shape",
        )
    volume, moments = _solid(shape, place)
    rotation, center = read_origin(element, place)
    mass = density * volume
    return LinkInertia(mass, center, mass * rotation @ np.diag(moments) @ rotation.T)


def _solid(shape: ET.Element, place: str) -> tuple[float, np.ndarray]:
    """Volume [m^3], and principal inertias by mass about the centre, (3,) [m^2]."""
    key, count = ("size", 3) if shape.tag == "box" else ("radius", 1)
    sizes = list(read_numbers(shape, key, "", count, place))
    if shape.tag in ("cylinder", "capsule"):
        sizes += list(read_numbers(shape, "length", "", 1, place))
    if min(sizes) <= 0:
        raise InputError(place, f"a <{shape.tag}> of size {min(sizes):g}", "positive sizes")
    if shape.tag == "box":
        a, b, c = (x**2 / 12 for x in sizes)
        return float(np.prod(sizes)), np.array([b + c, a + c, a + b])
    radius = sizes[0]
    ball = 4 / 3 * np.pi * radius**3
    if shape.tag == "sphere":
        return ball, np.full(3, 2 / 5 * radius**2)
    length, tube = sizes[1], np.pi * radius**2 * sizes[1]
    along, across = radius**2 / 2, radius**2 / 4 + length**2 / 12
    if shape.tag == "cylinder":
        return tube, np.array([across, across, along])
    # a tube and two half balls, whose centres are 3/8 of the radius beyond its ends
    whole = tube + ball
    shift = length**2 / 4 + 3 / 8 * length * radius
    across = (tube * across + ball * (2 / 5 * radius**2 + shift)) / whole
    along = (tube * along + ball * 2 / 5 * radius**2) / whole
    return whole, np.array([across, across, along])
