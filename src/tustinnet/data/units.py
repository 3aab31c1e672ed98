"""Units of columns, and the SI units in which records have them."""

import re
from collections import Counter
from collections.abc import Mapping

import numpy as np

ANGLE = {"rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi, "mrad": 1e-3}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

# SI units by their words, what they are in others, and prefixes of both
_SI = {
    "m": "meter",
    "s": "second",
    "g": "gram",
    "A": "ampere",
    "K": "kelvin",
    "mol": "mole",
    "cd": "candela",
    "rad": "radian",
    "N": "newton",
    "Pa": "pascal",
    "J": "joule",
    "W": "watt",
    "Hz": "hertz",
    "V": "volt",
    "ohm": "ohm",
    "C": "coulomb",
    "F": "farad",
    "H": "henry",
    "T": "tesla",
    "S": "siemens",
    "Wb": "weber",
}
_PREFIXES = {
    "": ("", 1.0),
    "p": ("pico", 1e-12),
    "n": ("nano", 1e-9),
    "u": ("micro", 1e-6),
    "m": ("milli", 1e-3),
    "c": ("centi", 1e-2),
    "d": ("deci", 1e-1),
    "h": ("hecto", 1e2),
    "k": ("kilo", 1e3),
    "M": ("mega", 1e6),
    "G": ("giga", 1e9),
}
_OTHERS = {
    "rad": {
        ("deg", "degree", "degrees"): np.pi / 180,
        ("rev", "revolution", "revolutions", "turn", "turns", "cycle", "cycles"): 2 * np.pi,
        ("arcmin",): np.pi / 180 / 60,
        ("arcsec",): np.pi / 180 / 3600,
        ("grad", "gon"): np.pi / 200,
    },
    "rad/s": {("rpm",): 2 * np.pi / 60},
    "m": {
        ("in", "inch", "inches"): 0.0254,
        ("ft", "foot", "feet"): 0.3048,
        ("yd", "yard", "yards"): 0.9144,
        ("mi", "mile", "miles"): 1609.344,
        ("micron", "microns"): 1e-6,
        ("metre", "metres"): 1.0,
        ("millimetre", "millimetres"): 1e-3,
    },
    "m^3": {("l", "L", "liter", "litre"): 1e-3, ("ml", "mL"): 1e-6},
    "m/s": {("mph",): 0.44704, ("kph",): 1 / 3.6, ("kn", "knot", "knots"): 1852 / 3600},
    "m/s^2": {("g_0", "standard_gravity"): 9.80665},
    "s": {("min", "minute"): 60.0, ("h", "hr", "hour"): 3600.0, ("d", "day"): 86400.0},
    "kg": {("t", "tonne"): 1e3, ("lb", "lbs", "pound"): 0.45359237, ("oz",): 0.45359237 / 16},
    "N": {("kgf",): 9.80665, ("lbf",): 0.45359237 * 9.80665},
    "Pa": {
        ("bar",): 1e5,
        ("mbar",): 1e2,
        ("atm",): 101325.0,
        ("psi",): 0.45359237 * 9.80665 / 0.0254**2,
    },
    "J": {("Wh",): 3.6e3, ("kWh",): 3.6e6, ("cal",): 4.184, ("eV",): 1.602176634e-19},
    "W": {("hp",): 550 * 0.45359237 * 9.80665 * 0.3048},
    "K": {("delta_degC",): 1.0, ("delta_degF",): 5 / 9},
    "N*m": {("Nm",): 1.0, ("mNm",): 1e-3, ("kNm",): 1e3, ("Ncm",): 1e-2},
    "1": {("%", "percent"): 1e-2, ("ppm",): 1e-6},
    "count": {("count", "counts"): 1.0},
    "pixel": {("pixel", "pixels"): 1.0},
}
_WITH_ZERO = {"degC", "degF", "celsius", "fahrenheit", "dB", "dBm"}

# products of units with small powers
_TERM = r"(1|%|[^\W\d_]\w{0,30}((\^|\*\*)-?[1-9])?)"
_PRODUCT = re.compile(rf"{_TERM}( ?[*/·] ?{_TERM}| {_TERM})*")
_FACTOR = re.compile(r"([*/·]?) ?(1|%|[^\W\d_]\w*)(?:(?:\^|\*\*)(-?[1-9]))?")
_LONGEST_UNIT = 60  # characters

Powers = Mapping[str, int]


def convert_to_si(unit: str) -> tuple[float, str]:
    """The SI unit of a unit: the factor to it and its name, as 0.001 and `V` for `mV`.

    Args:
        unit: as people write it: `mm`, `deg`, `mV`, `inch`, `N*m`; `1` for none.

    Raises:
        ValueError: an unknown unit, or one with a zero of its own, as degC has.
    """
    if unit in _WITH_ZERO:
        raise ValueError(f"unit '{unit}' has a zero or a scale of its own; e.g. delta_degC, K, 1")
    if len(unit) > _LONGEST_UNIT or not _PRODUCT.fullmatch(unit):
        raise ValueError(f"unit '{unit[:_LONGEST_UNIT]}' is none, e.g. mm, deg, mV, N*m, m/s^2")
    factor, powers = _multiply(unit, _UNITS)
    # mN*m is N*m and not kg*m^2/s^2
    names = sorted((name for name in powers if powers[name]), key=str.lower)
    above, below = (
        [f"{n}**{k}" if (k := sign * powers[n]) > 1 else n for n in names if sign * powers[n] > 0]
        for sign in (1, -1)
    )
    return factor, "/".join(["*".join(above) or "1", *below])


def _multiply(unit: str, units: Mapping[str, tuple[float, Powers]]) -> tuple[float, Powers]:
    """The factor of a product of units, and the powers of the SI units in it."""
    factor, powers = 1.0, Counter[str]()
    for mark, name, power in _FACTOR.findall(unit):
        if name not in units:
            raise ValueError(f"unit '{unit}' is not known, e.g. mm, µm, deg, mV, N*m, m/s^2")
        size, parts = units[name]
        exponent = int(power or 1) * (-1 if mark == "/" else 1)
        factor = factor * size**exponent if exponent > 0 else factor / size**-exponent
        for part, own in parts.items():
            powers[part] += own * exponent
    return factor, powers


def _list_units() -> dict[str, tuple[float, Powers]]:
    """All units by name: factor, and powers of SI units."""
    units: dict[str, tuple[float, Powers]] = {"1": (1.0, {}), "count": (1.0, {"count": 1})}
    units["pixel"] = 1.0, {"pixel": 1}
    for symbol, word in _SI.items():
        name, own = ("kg", 1e-3) if symbol == "g" else (symbol, 1.0)
        for short, (long, size) in _PREFIXES.items():
            for text in (short + symbol, long + word, f"{long}{word}s"):
                units[text] = size * own, {name: 1}
    for letter in "µμ":
        units |= {letter + symbol: units[f"u{symbol}"] for symbol in _SI}
    units |= {f"{short}Ω": units[f"{short}ohm"] for short in _PREFIXES}
    for si, others in _OTHERS.items():
        _, powers = _multiply(si, units)
        units |= {name: (size, powers) for names, size in others.items() for name in names}
    return units


_UNITS = _list_units()


def convert(unit: str, to: str) -> float:
    """Factor from a unit to another of the same quantity.

    Raises:
        ValueError: an unknown unit, or one of another quantity.
    """
    (factor, si), (own_factor, own_si) = convert_to_si(unit), convert_to_si(to)
    if si != own_si:
        raise ValueError(f"'{unit}' is not a unit of a quantity in {to}")
    return factor / own_factor
