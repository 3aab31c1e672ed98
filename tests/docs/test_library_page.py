"""The page of the library has every system as it is: coordinates, parameters, a picture."""

import re
from importlib import import_module

import pytest
from documented import DOCS, anchor

from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.registry import SYSTEMS

PACKAGE = "tustinnet.systems.library."
PLACES = {
    name: place
    for name, place in SYSTEMS.places.items()
    if isinstance(place, str) and place.startswith(PACKAGE)
}
PAGE = (DOCS / "reference" / "library.md").read_text(encoding="utf-8")
ROWS = [line.strip("| ").split(" | ") for line in PAGE.splitlines() if line.startswith("| ")]


def load(name: str) -> LagrangianSystem:
    module, _, attribute = PLACES[name].partition(":")
    return getattr(import_module(module), attribute)


@pytest.mark.parametrize("name", PLACES)
def test_a_system_is_listed_with_its_coordinates_and_inputs(name):
    system = load(name)
    (row,) = [row for row in ROWS if f"`{name}`" in row[0] and len(row) == 4]
    units = {"m": " [m]", "rad": ""}
    for coordinate in system.coordinates:
        assert f"`{coordinate.name}`{units[coordinate.unit]}" in row[1]
    assert row[2] == f"`{system.inputs[0].name}` [{system.inputs[0].unit}]"


@pytest.mark.parametrize("module", sorted({p.partition(":")[0] for p in PLACES.values()}))
def test_a_section_has_the_parameters_and_the_picture_of_a_file(module):
    file = module.removeprefix(PACKAGE)
    picture = DOCS / "images" / "library" / f"{file}.png"
    assert picture.stat().st_size < 10_000
    (section,) = [s for s in PAGE.split("\n## ") if f"(../images/library/{picture.name})" in s]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line[:3] == "| `"]
    described = [(row[0].strip("`"), *row[2:5]) for row in rows]
    system = import_module(module).TWIN.system
    assert described == [
        (p.name, p.unit, f"{p.nominal:g}", "fixed" if p.fixed else f"{p.lower:g} to {p.upper:g}")
        for p in system.parameters
    ]
    assert "Not modelled: " in section


def test_links_of_the_table_lead_to_sections():
    headings = {anchor(heading) for heading in re.findall(r"^## (.+)$", PAGE, flags=re.M)}
    linked = re.findall(r"\(#([\w-]+)\)", PAGE)
    assert len(linked) == 9
    assert set(linked) <= headings
