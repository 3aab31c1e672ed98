"""Units of columns, and the SI units in which records have them.

Common units are in small tables. All others are converted by pint, which takes a second to load.
"""

import functools
import re
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pint

ANGLE = {"rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi, "mrad": 1e-3}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_NAMED = ("V", "A", "K", "1", "N", "Pa", "kg", "s", "J", "W", "Hz", "ohm", "C", "F", "H", "T")
_TABLES = (("rad", ANGLE), ("m", LENGTH), *((name, {name: 1.0}) for name in _NAMED))

# products of units with small powers; other expressions could keep pint busy for ever
_TERM = r"(1|%|[^\W\d_]\w{0,30}((\^|\*\*)-?[1-9])?)"
_PRODUCT = re.compile(rf"{_TERM}( ?[*/·] ?{_TERM}| {_TERM})*")
_LONGEST = 60  # characters


def convert_to_si(unit: str) -> tuple[float, str]:
    """The SI unit of a unit: the factor to it and its name, as 0.001 and `V` for `mV`.

    Args:
        unit: as people write it: `mm`, `deg`, `mV`, `inch`, `N*m`; `1` for none.

    Raises:
        ValueError: an unknown unit, or one with a zero of its own, as degC has.
    """
    for name, table in _TABLES:
        if unit in table:
            return table[unit], name
    quantity, registry = _quantity(unit), _registry()
    # part by part, so that mN*m is N*m and not kg*m^2/s^2
    named = {registry.Quantity(1, n).to_base_units().units: n for n in reversed(_NAMED) if n != "1"}
    parts = registry.Unit("dimensionless")
    for part, power in quantity.units._units.items():
        base = registry.Quantity(1, registry.Unit(part)).to_base_units().units
        parts *= registry.Unit(named.get(base, base)) ** power
    name = f"{parts:~C}" or "dimensionless"
    return float(quantity.to(name).magnitude), "1" if name == "dimensionless" else name


def convert(unit: str, to: str) -> float:
    """Factor from a unit to another of the same quantity.

    Raises:
        ValueError: an unknown unit, or one of another quantity.
    """
    (factor, si), (own_factor, own_si) = convert_to_si(unit), convert_to_si(to)
    if si != own_si:
        raise ValueError(f"'{unit}' is not a unit of a quantity in {to}")
    return factor / own_factor


def velocity_factor(unit: str, position_unit: str) -> float:
    """SI units per second in one unit of a velocity.

    Args:
        unit: the velocity's unit: `deg/s`, `rpm`, `km/h`.
        position_unit: the SI unit of the position.

    Raises:
        ValueError: another unit than one of the position per one of time.
    """
    if unit == "rpm" and position_unit == "rad":
        return 2 * np.pi / 60
    length, _, per = unit.rpartition("/")
    if per in TIME and length:
        factor, name = convert_to_si(length)
        if name == position_unit:
            return factor / TIME[per]
    return convert(unit, f"{position_unit}/s")


@functools.cache
def _registry() -> "pint.UnitRegistry[Any]":
    import pint

    return pint.UnitRegistry()


def _quantity(unit: str) -> Any:
    """The quantity of one unit, by pint."""
    if len(unit) > _LONGEST or not _PRODUCT.fullmatch(unit):
        raise ValueError(f"unit '{unit[:_LONGEST]}' is none, e.g. mm, deg, mV, N*m, m/s^2")
    registry = _registry()
    try:
        quantity = registry.Quantity(1.0, registry.Unit(unit.replace("·", "*")))
        is_multiplicative = quantity._is_multiplicative
    except Exception:  # pint raises errors of many kinds, also an AssertionError
        raise ValueError(f"unit '{unit}' is not known") from None
    if not is_multiplicative:
        raise ValueError(f"unit '{unit}' has a zero or a scale of its own; e.g. delta_degC, K, 1")
    return quantity
