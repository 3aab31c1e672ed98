"""Inputs with their units."""

from tustinnet.channels import Input
from tustinnet.data.drafting.findings import Choice, Findings, InputChoice, Question, range_text
from tustinnet.data.drafting.names import Quantity
from tustinnet.data.drafting.system_columns import input_factor
from tustinnet.data.units import convert_to_si

_QUANTITY_UNITS: dict[Quantity, str] = {
    "voltage": "V",
    "current": "A",
    "torque": "N m",
    "force": "N",
    "pressure": "bar",
}


def describe_input(column: str, name: str, findings: Findings, choice: Choice) -> InputChoice:
    """An input with its unit: by its name, else by the quantity that its words say."""
    reading, numbers = findings.readings[column], findings.numbers[column]
    doubts: list[str] = []
    assumed: tuple[str, ...] = ()
    quantity = reading.quantity
    key = f"unit {column}"
    unit = _find_unit(column, findings)
    if not unit and quantity == "duty":
        unit = "%" if 1.5 < numbers.largest <= 100 else "1"
    leads = findings.verdicts[column].leads
    if not unit and leads is not None:
        followers = [c for c in choice.coordinates if c.column == leads]
        unit = findings.readings[leads].unit or next((c.unit for c in followers), "")
        assumed = tuple("unit" for c in followers if c.assumed)
    if not unit:
        units = (u for q, u in _QUANTITY_UNITS.items() if q in reading.quantities)
        unit, assumed = next(units, "1"), ("unit",)
        doubts.append(f"the unit: {unit} is assumed")
        choice.questions.append(
            Question(key, f"unit of the input '{column}' (range {range_text(numbers)})", unit)
        )
    verdict = findings.verdicts[column]
    if verdict.role == "set point":
        doubts.append("a set point: the model includes the controller")
    if verdict.is_open:
        doubts.append(f"an input, or {verdict.rival}?")
    return InputChoice(column, name, unit, verdict.reasons, tuple(doubts), assumed)


def describe_system_input(column: str, channel: Input, findings: Findings) -> InputChoice:
    """An input of a system, with the unit of the system where the column's is converted to it.

    Args:
        column: its column.
        channel: the input; a unit of `1` takes any.
        findings: what is known of the columns.
    """
    numbers, own = findings.numbers[column], _find_unit(column, findings)
    if channel.unit == "1":
        return InputChoice(column, channel.name, own or "1", assumed=() if own else ("unit",))
    if not own:
        doubt = f"the unit: {channel.unit} is assumed (range {range_text(numbers)})"
        return InputChoice(column, channel.name, channel.unit, doubts=(doubt,), assumed=("unit",))
    factor = input_factor(own, channel.unit)
    if factor is not None:
        return InputChoice(column, channel.name, channel.unit, scale=float(f"{factor:.12g}"))
    size, base = _to_si(own)
    doubt = f"the unit: the system takes {channel.unit}, and the column is in {own}"
    return InputChoice(column, channel.name, base, doubts=(doubt,), scale=size)


def _find_unit(column: str, findings: Findings) -> str:
    """The unit of an input: as answered, as named, or of the quantity that a word says; or ""."""
    reading = findings.readings[column]
    if unit := findings.answers.get(f"unit {column}") or reading.unit:
        return unit
    strongest = max(_QUANTITY_UNITS, key=lambda q: reading.quantities.get(q, 0.0))
    return _QUANTITY_UNITS[strongest] if reading.stated([strongest]) else ""


def _to_si(unit: str) -> tuple[float, str]:
    """The factor to the SI unit of a unit, and its name; an unknown one as it is."""
    try:
        return convert_to_si(unit)
    except ValueError:
        return 1.0, unit
