"""The choice of inputs: what moves first in the chain of causes."""

from collections.abc import Mapping, Sequence

from tustinnet.channels import Input
from tustinnet.data.drafting.findings import Choice, Findings, InputChoice, Question, range_text
from tustinnet.data.drafting.names import Quantity
from tustinnet.data.drafting.relations import explained_acceleration, find_copy
from tustinnet.data.drafting.system_columns import input_factor
from tustinnet.data.units import convert_to_si

_TELLING, _IDLE = 0.3, 0.1  # share of an acceleration that tells, share of it that is nothing
_QUANTITY_UNITS: dict[Quantity, str] = {
    "voltage": "V",
    "current": "A",
    "torque": "N m",
    "force": "N",
    "pressure": "bar",
}
# of a voltage and the current that it drives, the voltage moves first and is the input
_RANKS: dict[Quantity, int] = {
    "voltage": 0,
    "duty": 0,
    "control": 0,
    "torque": 1,
    "force": 1,
    "current": 2,
    "pressure": 3,
}
_LAST = (9, 9)  # rank of an input of which nothing says what it is
_DISTURBANCES = {"disturbance", "stoerung", "wind", "stoermoment", "stoerkraft"}


def choose_inputs(findings: Findings, choice: Choice) -> list[str]:
    """The columns that move first: commands before measured values, voltages before currents."""
    candidates = findings.columns("input")
    set_points = findings.columns("set point")
    if not candidates and set_points:
        # a machine whose controller is part of what is modelled
        kept = [name for name in set_points if findings.readings[name].qualifier == "command"]
        chosen = kept or set_points
        by_follower: dict[str | None, str] = {}
        for name in chosen:  # of a position's and its speed's set point the first
            by_follower.setdefault(findings.verdicts[name].leads or name, name)
        positions = [n for n in by_follower.values() if _leads_position(n, findings)]
        return positions or list(by_follower.values())
    kept = []
    # of columns that are proportional the one that moves first stays
    for name in sorted(candidates, key=lambda name: _rank(name, findings) or _LAST):
        copy = next((o for o in kept if _is_copy(o, name, findings)), None)
        if copy is not None:
            choice.unused[name] = f"proportional to the input '{copy}'"
            continue
        kept.append(name)
    kept = [name for name in candidates if name in kept]
    ranked = {name: _rank(name, findings) for name in kept}
    joints = _joints(kept, findings)
    inputs: list[str] = []
    for name in kept:
        reading, rank = findings.readings[name], ranked[name]
        # a current at one joint is no effect of the force at another one
        chain = [n for n in kept if None in (joints[n], joints[name]) or joints[n] == joints[name]]
        best = _best_rank({n: ranked[n] for n in chain}, findings)
        is_disturbance = bool(_DISTURBANCES & {*reading.words})
        if best is None or rank == best or is_disturbance:
            inputs.append(name)
        elif rank is None:
            what = findings.verdicts[name].because
            choice.unused[name] = f"perhaps an input ({what}), beside columns that say so"
        else:
            causes = [n for n in chain if ranked[n] == best]
            alike = (n for n in causes if findings.readings[n].object == reading.object)
            first = next(alike, causes[0])
            is_later = rank > best
            choice.unused[name] = (
                f"an effect of '{first}', which moves first"
                if is_later
                else f"explains little of the motion, unlike '{first}'"
            )
    return inputs


def _joints(names: Sequence[str], findings: Findings) -> dict[str, frozenset[str] | None]:
    """By column the words that say at which of several joints it acts; None where none does.

    Words count that are the whole object of a position's name, as `elbow` of `elbow_angle`, or its
    number, as that of `q1`.
    """

    def joint(name: str) -> frozenset[str]:
        words = findings.readings[name].object
        return frozenset(word for word in words if word.isdigit()) or words

    joints = {joint(name) for name in findings.columns("position")} - {frozenset()}
    return {name: own if (own := joint(name)) in joints else None for name in names}


def _best_rank(
    ranked: Mapping[str, tuple[int, int] | None], findings: Findings
) -> tuple[int, int] | None:
    """The first rank in the chain of causes of which a column moves anything."""
    ranks = sorted({rank for rank in ranked.values() if rank is not None})
    if len(ranks) < 2:
        return next(iter(ranks), None)
    positions = findings.columns("position")
    shares = {
        rank: max(
            (
                explained_acceleration(findings.samples[name], findings.samples[p], findings.times)
                for name in ranked
                if ranked[name] == rank
                for p in positions
            ),
            default=0.0,
        )
        for rank in ranks
    }
    most = max(shares.values())
    # friction and loads hide what an input does; a column that explains nothing beside it is none
    return next(rank for rank in ranks if most < _TELLING or shares[rank] > _IDLE * most)


def _leads_position(name: str, findings: Findings) -> bool:
    """Whether a set point is that of a position."""
    leads = findings.verdicts[name].leads
    return leads is not None and findings.verdicts[leads].role == "position"


def _is_copy(first: str, second: str, findings: Findings) -> bool:
    return find_copy(findings.samples[first], findings.samples[second]) is not None


def _rank(name: str, findings: Findings) -> tuple[int, int] | None:
    """The place of an input in the chain of causes: by quantity, then commands before others."""
    reading = findings.readings[name]
    ranks = [
        (-weight, _RANKS[quantity])
        for quantity, weight in reading.quantities.items()
        if quantity in _RANKS
    ]
    if not ranks:
        return None if reading.qualifier != "command" else (0, 0)
    quantity_rank = min(ranks)[1]
    order = {"command": 0, None: 1, "measured": 2, "filtered": 3, "model": 4}[reading.qualifier]
    # a commanded current moves before a measured torque
    return (0 if order == 0 else 1 + quantity_rank, order)


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
        unit = findings.readings[leads].unit
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
    if verdict.rival in ("position", "set point"):
        doubts.append(f"an input, or a {verdict.rival}?")
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
