"""Words and units in the name of a column, and what they say about it."""

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import cast

from tustinnet.channels import Kind
from tustinnet.data.drafting.vocabulary import (
    ANGULAR,
    AXES,
    CONTAINERS,
    LETTERS,
    LINEAR,
    POSITION_WORDS,
    QUALIFIERS,
    STRONG,
    UNITS,
    WEAK,
    Qualifier,
    Quantity,
)
from tustinnet.data.units import ANGLE, LENGTH

INPUTS: tuple[Quantity, ...] = (
    "voltage",
    "duty",
    "control",
    "torque",
    "force",
    "current",
    "pressure",
)

_LETTERS = str.maketrans({pair[0]: pair[2:] for pair in LETTERS.split()})
_RATES: tuple[Quantity, ...] = ("velocity", "acceleration")
_STATED = 3.0  # weight of a word that says a quantity, whatever else is in the name
_DECISIVE = 8.0  # of one that no other word or unit changes: `position error [mm]`, `battery [V]`
_ACCENTS = re.compile("[\u0300-\u036f]")
_PREFIXED = re.compile(r"(?<![A-Za-z])[mkuM](A|V|Nm|N|W|Pa|Hz)(?![A-Za-z])")  # one unit, not two
_DERIVED = re.compile(r"(?<=[a-z])D{1,2}(?![A-Za-z])")  # `angleD`: its rate
_BRACKETS = re.compile(r"[\[({<]([^\[\](){}<>]*)[\])}>]")
_BEHIND_STROKE = re.compile(r"^([^/]+?)\s*/\s*([^/]+)$")  # `phi / deg`, as DIN 1313 has it
_IN = re.compile(r"(?i)^(.+?)[\s_,]+in[\s_]+(\S+)$")  # `Winkel in Grad`

_PER_SECOND = ["/s", "/sec", "_s", "_sec", "_per_s", "_per_sec", "_per_second", "ps"]
_PER_SECOND += ["*s^-1", "s-1"]
_SQUARED = ["/s^2", "/s2", "/s/s", "/s**2", "_s2", "_per_s2", "ps2", "*s^-2"]


def _read_units() -> dict[str, tuple[str, Quantity]]:
    """The unit as cards have it and its quantity, by the spelling in lower case."""
    rows = [line.split(":") for line in UNITS.strip().splitlines()]
    units: dict[str, tuple[str, Quantity]] = {}
    for quantity, unit, spellings in rows:
        for spelling in (unit.lower(), *spellings.split()):
            units.setdefault(spelling, (unit, cast("Quantity", quantity)))
    for spelling, (unit, quantity) in [*units.items()]:
        if quantity == "position":
            for per in _PER_SECOND:
                units.setdefault(spelling + per, (f"{unit}/s", "velocity"))
            for per in _SQUARED:
                units.setdefault(spelling + per, (f"{unit}/s^2", "acceleration"))
    return units


_UNITS = _read_units()
_NO_ENDINGS = {"in", "inc", "turn", "steps", "step", "impulse", "raw", "bit", "hz"}
"""Units that are words at the end of a name."""
_UNITS_AS_NAMES = {
    *("deg", "degrees", "rad", "radians", "mm", "cm", "rpm", "dps", "counts", "ticks"),
    *("volt", "volts"),
}
"""Columns that are called by their unit alone."""
_DRIVEN = {"pos", "position", "vel", "velocity"}
"""What a drive controls, as it calls them."""
_BEFORE_AXES = {*"uefiwva"}
"""Letters that say the quantity of what is about an axis, as `u_roll`."""
_NO_UNITS = {"", "-", "1", "none", "au", "a.u", "bit", "raw"}

_FURTHER = re.compile(r"[,;(]|\b(?:of|to|from|relative)\b")  # behind what a column is
_SYMBOL = re.compile(
    r"(?P<before>d{0,2})(?P<symbol>theta|phi|psi|alpha|beta|gamma|th|q|x|y|z|s|pos|angle|ang)"
    r"(?P<behind>ddot|dot|pp|p|dd|d|punkt)?"
)
_PURE = POSITION_WORDS.union(
    *(STRONG[q] for q in ("time", "velocity", "acceleration", *INPUTS, "error")),
    *QUALIFIERS.values(),
    "uifmwvn",
    ["rpm"],
)
"""Words that say which quantity, but not of what."""
_MEANINGS: dict[str, list[tuple[Quantity, float]]] = {}
"""The quantities of which a word speaks, and its weight for each."""
for _quantity, _words in STRONG.items():
    for _word in _words:
        _weight = _DECISIVE if _quantity in ("error", "other") else _STATED
        _MEANINGS.setdefault(_word, []).append((_quantity, _weight))
for _quantity, _words in WEAK.items():
    for _word in _words:
        _MEANINGS.setdefault(_word, []).append((_quantity, 1.0))
_VOCABULARY = {w for ws in (*STRONG.values(), *QUALIFIERS.values()) for w in ws}
_LAST_PARTS = sorted(
    (
        w
        for ws in (
            *(STRONG[q] for q in ("position", "velocity", "acceleration", *INPUTS, "error")),
            *QUALIFIERS.values(),
        )
        for w in ws
        if len(w) >= 3
    ),
    key=len,
    reverse=True,
)
"""Words that are the last part of compounds, the longest first."""


@dataclass(frozen=True)
class NameReading:
    """The meaning of a column's name as far as its words say it.

    Attributes:
        name: the name.
        words: its words in lower case, numbers included.
        unit: the unit in it as cards spell it, empty without one.
        in_brackets: whether the unit stands apart, as in `angle [deg]`.
        quantities: weight of each quantity that its words or its unit speak for.
        word: the word that speaks for each quantity.
        qualifier: whether it is a command, a measured or a filtered value, None if unsaid.
        kind: angular or linear, None if unsaid.
        object: the words that say of what it is the quantity.
    """

    name: str
    words: tuple[str, ...]
    unit: str
    in_brackets: bool
    quantities: dict[Quantity, float]
    word: dict[Quantity, str]
    qualifier: Qualifier | None
    kind: Kind | None
    object: frozenset[str]

    @property
    def quantity(self) -> Quantity | None:
        """The quantity with the largest weight, None where no word says one."""
        return max(self.quantities, key=lambda q: self.quantities[q], default=None)

    def stated(self, quantities: Iterable[Quantity]) -> list[Quantity]:
        """The given quantities that a whole word of the name says, as `torque`, not a letter."""
        return [q for q in quantities if self.quantities.get(q, 0.0) >= _STATED]

    def with_description(self, text: str) -> "NameReading":
        """The reading, with the unit in a description; where the name says little, with all of it.

        Args:
            text: what is written of the column elsewhere. What it is says it first, as in
                `desired angle of the arm`.
        """
        described = read_name(text)
        qualifier = read_name(_FURTHER.split(text)[0]).qualifier or self.qualifier
        if described.quantities and not self.stated(self.quantities):
            return replace(described, name=self.name, qualifier=described.qualifier or qualifier)
        has_unit = described.unit and described.in_brackets and not self.unit
        reading = read_name(self.name, described.unit) if has_unit else self
        return replace(reading, qualifier=qualifier)


def read_name(name: str, file_unit: str = "") -> NameReading:
    """Reads the words and the unit in a column's name; a unit that the file says decides."""
    spelling = _look_up(file_unit) if file_unit else None
    if spelling is not None and spelling[0]:
        reading = read_name(f"{name} [{file_unit}]")
        if reading.unit == spelling[0]:
            return replace(reading, name=name)
    plain = unicodedata.normalize("NFC", name).translate(_LETTERS)
    plain = _ACCENTS.sub("", unicodedata.normalize("NFD", plain))
    plain = unicodedata.normalize("NFC", plain)
    plain, unit, unit_quantity, in_brackets = _take_unit(plain)
    words = _split_words(plain)
    if not in_brackets:
        words, unit, unit_quantity = _take_ending(words)
    quantities, word = _read_quantities(words)
    positions = {w for w in words if w in STRONG["position"]}
    is_input = any(quantities.get(q, 0.0) >= _STATED for q in INPUTS)
    is_about_axis = is_input or bool(_BEFORE_AXES & {*words[:1]})
    if is_about_axis and positions and positions <= AXES:
        # `yaw_torque`, `e_roll`: where an input acts; sensors of other positions give voltages
        del quantities["position"], word["position"]
    pairs = {*pairwise(words)}
    if {"action", "actions"} & {*words}:  # of robot learning: what was commanded
        quantities["control"], word["control"] = 8.0, "action"
    if unit_quantity == "position" and (rate := _stated_rate(quantities, word)):
        unit_quantity = rate  # `x_dot_cm` has the unit of its position, per second
        unit += "/s" if rate == "velocity" else "/s^2"
    # `excitation [mm]`: what it is for says more than its unit
    is_control = unit_quantity == "position" and quantities.get("control", 0.0) >= _STATED
    if unit_quantity is not None and not is_control:
        surely = in_brackets or unit_quantity in _RATES
        quantities[unit_quantity] = max(quantities.get(unit_quantity, 0.0), 6.0 if surely else 5.0)
        word[unit_quantity] = f"[{unit}]"
    qualifiers: list[Qualifier] = [mark for mark, texts in QUALIFIERS.items() if texts & {*words}]
    qualifier = qualifiers[0] if qualifiers else None
    if any(a in ("input", "control") and b in _DRIVEN for a, b in pairs):
        qualifier = "command"  # of a controller, as drives have it
        quantities.pop("control", None)
    if ("control", "effort") in pairs:  # what a controller gives, of any quantity
        del quantities["torque"], word["torque"]
    if qualifier is None and "d" in words[1:] and "position" in quantities and "dt" not in words:
        qualifier = "command"  # `q_d`, the desired position, as robots have it
    if qualifier == "measured" and not QUALIFIERS["measured"] - {"m", "sensor"} & {*words}:
        qualifier = None if words[-1:] != ["m"] or len(words) < 2 else qualifier
    return NameReading(
        name,
        tuple(words),
        unit,
        in_brackets,
        quantities,
        word,
        qualifier,
        _kind(words, unit),
        _object(words),
    )


def _read_quantities(
    words: Sequence[str],
) -> tuple[dict[Quantity, float], dict[Quantity, str]]:
    """The weight of each quantity that words speak for, and the word that does so."""
    quantities: dict[Quantity, float] = {}
    word: dict[Quantity, str] = {}

    def add(quantity: Quantity, weight: float, because: str) -> None:
        if weight > quantities.get(quantity, 0.0):
            quantities[quantity], word[quantity] = weight, because

    for before, text, noun in zip(["", *words], words, [*words[1:], ""], strict=False):
        if text == "current" and noun in STRONG["position"] | STRONG["velocity"]:
            continue  # an adjective
        if text in ("p", "pp") and _SYMBOL.fullmatch(before):
            text = before + text  # `theta_p`, as `thetap`
        for quantity, weight in _MEANINGS.get(text, ()):
            add(quantity, weight, text)
        symbol = _SYMBOL.fullmatch(text)
        if symbol and (symbol["before"] or symbol["behind"]):
            order = len(symbol["before"]) or _ORDERS.get(symbol["behind"], 1)
            surely = symbol["before"] or symbol["behind"] in ("dot", "ddot", "punkt")
            add("velocity" if order == 1 else "acceleration", 3.5 if surely else 1.5, text)
    if {"d", "dt"} <= {*words} or (words[:1] == ["d"] and "position" in quantities):
        add("velocity", 3.5, "d/dt")
    if {("dot", "dot"), ("d", "dot"), ("second", "derivative")} & {*pairwise(words)}:
        add("acceleration", 4.0, "dot dot")
        quantities.pop("velocity", None)
    if word.get("velocity") != "tacho" and any(quantities.get(q, 0.0) >= _STATED for q in _RATES):
        quantities.pop("position", None)  # `theta_dot`, `angle rate`: it is of that position
    return quantities, word


def _stated_rate(
    quantities: Mapping[Quantity, float], word: Mapping[Quantity, str]
) -> Quantity | None:
    """The derivative that a word says, as `speed` does; `dx` may be a displacement.

    `tacho_meters` is the way that a tachometer has counted.
    """
    rate = max(_RATES, key=lambda q: quantities.get(q, 0.0))
    symbol = _SYMBOL.fullmatch(word.get(rate, ""))
    may_be_way = (symbol and symbol["before"]) or word.get(rate) == "tacho"
    is_stated = quantities.get(rate, 0.0) >= _STATED and not may_be_way
    return rate if is_stated else None


_ORDERS = {"ddot": 2, "pp": 2, "dd": 2}  # of derivatives, by endings of symbols


def _kind(words: Sequence[str], unit: str) -> Kind | None:
    base = unit.split("/")[0]
    if base in ANGLE or unit in ("rpm", "N m", "mN m", "N cm"):
        return "angular"
    if base in LENGTH or unit in ("km/h", "g", "N", "kN"):
        return "linear"
    symbols = {m["symbol"] for w in words if (m := _SYMBOL.fullmatch(w))}
    texts = {*words} | symbols
    angular, linear = bool(texts & ANGULAR), bool(texts & LINEAR)
    # `cart`, `x` decide against `joint` and `encoder`, which both kinds have
    if linear and texts & ANGULAR <= {"joint", "encoder", "enc", "gelenk", "geber"}:
        return "linear"
    return "angular" if angular else "linear" if linear else None


def _object(words: Sequence[str]) -> frozenset[str]:
    """The words that say of what a column is the quantity: `theta` of `theta_dot_ref`."""
    symbols = [m["symbol"] if (m := _SYMBOL.fullmatch(w)) else w for w in words]
    return frozenset(w for w in symbols if w not in _PURE and w not in CONTAINERS and w != "d")


def _look_up(text: str) -> tuple[str, Quantity | None] | None:
    """The unit that a text spells and its quantity (None for no unit at all); None if unknown."""
    spelled = (
        text.strip()
        .lower()
        .removeprefix("in ")
        .replace("²", "^2")
        .replace("·", "*")
        .replace("°/", "deg/")
    )
    spelled = spelled.replace("⁻¹", "^-1").replace("\N{MICRO SIGN}", "u").rstrip(".")
    compact = spelled.replace(" ", "")
    for candidate in (spelled, compact):
        if candidate in _NO_UNITS:
            return "", None
        if candidate in _UNITS:
            return _UNITS[candidate]
    return None


def _take_unit(name: str) -> tuple[str, str, Quantity | None, bool]:
    """A name without a unit that stands apart, the unit, its quantity, whether there is one."""
    for match in _BRACKETS.finditer(name):
        unit = _look_up(match[1])
        if unit is not None and match[1].strip() and not match[1].strip().isdigit():
            return f"{name[: match.start()]} {name[match.end() :]}", *unit, True
    for pattern in (_BEHIND_STROKE, _IN):
        match = pattern.match(name.strip())
        if match and (unit := _look_up(match[2])) is not None and unit[1] is not None:
            return match[1], *unit, True
    return name, "", None, False


def _split_words(name: str) -> list[str]:
    """Words in lower case: `motorCnt 1` has motor, cnt and 1; `q1` has q and 1."""
    name = _PREFIXED.sub(lambda unit: unit[0].lower(), name)
    name = _DERIVED.sub(lambda d: "_dot" * len(d[0]), name)
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    spaced = re.sub(r"(?<=[^\W\d_])(?=\d)", "_", spaced)  # `q1`, but `s2` of `rad_s2` below
    words = [word for word in re.split(r"[\W_]+", spaced.lower()) if word]
    return [part for word in words for part in _split_compound(word)]


def _split_compound(word: str) -> list[str]:
    """The parts of a word of German: `istposition`, `seilwinkel`, `geschwindigkeitssollwert`."""
    if word in _VOCABULARY:
        return [word]
    end = next((w for w in _LAST_PARTS if word.endswith(w) and len(word) > len(w)), None)
    if end is None:
        return [word]
    rest = word.removesuffix(end)
    rest = rest[:-1] if rest[:-1] in _VOCABULARY else rest  # without the s that joins them
    # beside a part of a few letters there must be a word: `sollweg` has two, `kolben` is none
    is_known = rest in _VOCABULARY or rest in ("x", "y", "z") or rest.isdigit()  # `en1angle`
    is_part = is_known or min(len(rest), len(end) - 1) > 3
    return [rest, end] if is_part else [word]


def _take_ending(words: list[str]) -> tuple[list[str], str, Quantity | None]:
    """Words without the unit at their end, the unit, its quantity: `_rad_s`, `_mm`, `_deg1`."""
    number = words[-1:] if words and words[-1].isdigit() else []
    body = words[: len(words) - len(number)]
    alone = _look_up(body[0]) if len(body) == 1 and body[0] in _UNITS_AS_NAMES else None
    if alone is not None:
        return words, *alone
    for length in (4, 3, 2, 1):
        if len(body) < length + (length == 1):
            continue
        before, ending = body[:-length], body[-length:]
        texts = ["_".join(ending)]
        if number == ["2"] and ending[-1] == "s":  # `m_s2`: the power was split off
            texts.insert(0, "_".join(ending) + "2")
        for text in texts:
            unit = _look_up(text)
            if unit is None or not unit[0] or text in _NO_UNITS or not before:
                continue
            if length == 1 and not _is_unit(text, before):
                continue
            rest = [] if text.endswith("2") and number == ["2"] else number
            return [*before, *rest], *unit
    return words, "", None


def _is_unit(ending: str, before: Sequence[str]) -> bool:
    """Whether a last word is a unit: one letter may be a name's, as in `q_m`, `enc_a`, `gear_s`.

    It is a unit behind a word of its quantity, and one of an input or a length behind a word that
    states no other quantity, as in `motor_v`, `rail_m`.
    """
    symbol = next((word for word in reversed(before) if not word.isdigit()), "")  # `i2_A`
    if ending in STRONG["position"]:  # `u_psi` is at an angle, `p_psi` a pressure
        return _UNITS[ending][1] in dict(_MEANINGS.get(symbol, []))
    if len(ending) > 1:
        return ending not in _NO_ENDINGS
    if symbol in _UNITS:
        return False  # `Ink_M`, counts of a motor
    quantity, meanings = _UNITS[ending][1], dict(_MEANINGS.get(symbol, []))
    named_quantities = {*meanings}
    if quantity in named_quantities:
        return symbol not in ("q", *ANGULAR)
    is_motion = bool(named_quantities & {"position", *_RATES})
    is_other = any(meanings.get(q, 0.0) >= _STATED for q in ("torque", "force", "current"))
    if ending == "c":  # `Tcoil_C`
        return symbol.startswith("t") and not named_quantities
    is_input = quantity in INPUTS and not (is_motion or is_other)
    return (not named_quantities if ending == "m" else is_input) and len(symbol) > 1
