"""Units of columns, and the SI units in which records have them.

The usual units are in small tables. For any other one pint is asked, which takes a second to load.
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

# products of units with small powers: what else pint evaluates could take for ever
_TERM = r"(1|%|[^\W\d_]\w{0,30}((\^|\*\*)-?[1-9])?)"
_PRODUCT = re.compile(rf"{_TERM}( ?[*/·] ?{_TERM}| {_TERM})*")
_LONGEST = 60  # characters


def convert_to_si(unit: str) -> tuple[float, str]:
    """What a unit is in SI: a factor, and the SI unit, as `mV` is 0.001 of `V`.

    Args:
        unit: as people write it: `mm`, `deg`, `mV`, `inch`, `N*m`; `1` for none.

    Raises:
        ValueError: no unit that is known, or one with a zero of its own, as degC has.
    """
    for name, table in _TABLES:
        if unit in table:
            return table[unit], name
    found = _quantity(unit)
    name = _si_name(found.units)
    return float(found.to(name).magnitude), "1" if name == "dimensionless" else name


def velocity_in_si(unit: str, of: str) -> float:
    """SI units per second in one unit of a velocity.

    Args:
        unit: the velocity's unit: `deg/s`, `rpm`, `km/h`.
        of: the SI unit of the position.

    Raises:
        ValueError: another unit than one of the position per one of time.
    """
    if unit == "rpm" and of == "rad":
        return 2 * np.pi / 60
    length, _, per = unit.rpartition("/")
    if per in TIME and length:
        factor, name = convert_to_si(length)
        if name == of:
            return factor / TIME[per]
    found, wanted = _quantity(unit), _quantity(f"{of}/s")
    if found.to_base_units().units != wanted.to_base_units().units:
        raise ValueError(f"velocity unit '{unit}' of a position in {of}")
    return float(found.to(wanted.units).magnitude)


@functools.cache
def _registry() -> "pint.UnitRegistry[Any]":
    import pint

    return pint.UnitRegistry()


def _quantity(unit: str) -> Any:
    """One of a unit, as pint has it."""
    if len(unit) > _LONGEST or not _PRODUCT.fullmatch(unit):
        raise ValueError(f"unit '{unit[:_LONGEST]}' is none, e.g. mm, deg, mV, N*m, m/s^2")
    registry = _registry()
    try:
        found = registry.Quantity(1.0, registry.Unit(unit.replace("·", "*")))
        multiplies = found._is_multiplicative
    except Exception:  # pint raises errors of many kinds, also an AssertionError
        raise ValueError(f"unit '{unit}' is not known") from None
    if not multiplies:
        raise ValueError(f"unit '{unit}' has a zero or a scale of its own; e.g. delta_degC, K, 1")
    return found


def _si_name(units: Any) -> str:
    """The SI unit of a unit, part by part, so that mN*m is N*m and not kg*m^2/s^2."""
    registry = _registry()
    named = {registry.Quantity(1, n).to_base_units().units: n for n in reversed(_NAMED) if n != "1"}
    parts = registry.Unit("dimensionless")
    for name, power in units._units.items():
        base = registry.Quantity(1, registry.Unit(name)).to_base_units().units
        parts *= registry.Unit(named.get(base, base)) ** power
    return f"{parts:~C}" or "dimensionless"
