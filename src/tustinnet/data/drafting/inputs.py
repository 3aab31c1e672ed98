"""Inputs with their units."""

from tustinnet.channels import Input
from tustinnet.data.drafting.findings import Choice, Findings, InputChoice, Question, range_text
from tustinnet.data.drafting.names import INPUTS, NameReading, Quantity
from tustinnet.data.drafting.positions import usual_unit
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
    # those of one quantity are in one unit: one question
    same = [
        n
        for n in findings.columns("input")
        if (other := findings.readings[n]).quantity == reading.quantity and not other.unit
    ] or [column]
    key = f"unit {same[0]}"
    answers = findings.answers
    unit = answers.get(f"unit {column}") or reading.unit or answers.get(key)
    leads = findings.verdicts[column].leads
    if not unit and leads is not None:
        followers = [c for c in choice.coordinates if c.column == leads]
        unit = findings.readings[leads].unit or next((c.unit for c in followers), "")
        assumed = tuple("unit" for c in followers if c.assumed)
    if not unit:  # a word says the quantity, but `torque` may be in percent of a drive's
        unit, assumed = _unit_of_quantity(reading) or "1", ("unit",)
        if reading.quantity == "duty":
            unit = "%" if 1.5 < numbers.largest <= 100 else "1"
        elif reading.kind and {*reading.quantities} == {"position"}:
            unit, _ = usual_unit(numbers, numbers.largest, reading.kind)
        doubts.append(f"the unit: {unit} is assumed")
        more = f" (and {', '.join(map(repr, same[1:]))})" if len(same) > 1 else ""
        text = f"unit of the input '{column}'{more} (range {range_text(numbers)})"
        choice.questions += [Question(key, text, unit)] if column == same[0] else []
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
    reading, numbers = findings.readings[column], findings.numbers[column]
    own = findings.answers.get(f"unit {column}") or reading.unit
    assumed = () if own else ("unit",)
    is_current = {*reading.quantities} == {"current"}  # as `i1`, which is no torque
    if not own and (is_current or reading.stated(_QUANTITY_UNITS)):
        own = _unit_of_quantity(reading)
    if channel.unit == "1":
        return InputChoice(column, channel.name, own or "1", assumed=assumed)
    if not own:
        doubt = f"the unit: {channel.unit} is assumed (range {range_text(numbers)})"
        return InputChoice(column, channel.name, channel.unit, doubts=(doubt,), assumed=("unit",))
    factor = input_factor(own, channel.unit)
    if factor is not None:
        return InputChoice(column, channel.name, channel.unit, scale=float(f"{factor:.12g}"))
    size, base = _to_si(own)
    doubt = f"the unit: the system takes {channel.unit}, and the column is in {own}"
    return InputChoice(column, channel.name, base, doubts=(doubt,), scale=size)


def _unit_of_quantity(reading: NameReading) -> str:
    """The usual unit of the input of which a name speaks most, "" of none."""
    strongest = max(INPUTS, key=lambda q: reading.quantities.get(q, 0.0))
    return _QUANTITY_UNITS.get(strongest, "") if strongest in reading.quantities else ""


def _to_si(unit: str) -> tuple[float, str]:
    """The factor to the SI unit of a unit, and its name; an unknown one as it is."""
    try:
        return convert_to_si(unit)
    except ValueError:
        return 1.0, unit
