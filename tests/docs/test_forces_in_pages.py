"""The pages list the forces that can be added by name, as their entries have them."""

from documented import section

from tustinnet.channels import Coordinate, Input
from tustinnet.models.forces import LAWS, Law, Motion

MOTION = Motion(1.0, 1.0, 1.0, 1.0, ends=(-1.0, 1.0), dt=0.01, longest=8.0, drive=1.0)
THETA, VOLTAGE = Coordinate("theta", "angular"), Input("voltage", "V")


def row(law: Law) -> str:
    parameters = []
    for p in law.parameters:
        at_input = law.is_at_input
        made = p.for_input(VOLTAGE, MOTION) if at_input else p.for_coordinate(THETA, "N m", MOTION)
        fixed = ", fixed" if p.fixed else ""
        parameters.append(f"`{made.name}` ({p.symbol}) [{made.unit}]{fixed}")
    return f"| `{law.name}` | {law.help} | {'; '.join(parameters)} |"


def listed(laws: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in laws)


def test_the_table_has_a_row_for_every_force():
    page = section("Recipes", "reference/training.md").partition("### Forces that are missing")[2]
    rows = [line for line in page.splitlines() if line.startswith("| `")][: len(LAWS)]
    assert rows == [row(law) for law in LAWS.values()]
    limited = [law.name for law in LAWS.values() if law.needs_limited_travel]
    assert f"({listed(limited)}) is added" in " ".join(page.split())


def test_the_page_says_what_a_spring_brings():
    page = section("A mechanism nobody has written down", "reference/systems.md")
    *first, last = [law.name for law in LAWS.values() if law.joins_springs]
    brought = f"it brings three more: {listed(first)} and `{last}`"
    assert brought in " ".join(page.split())
