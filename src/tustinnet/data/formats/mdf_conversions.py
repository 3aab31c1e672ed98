"""Conversions of channels of MDF files from raw numbers, but for formulas, which are Python code.

They are those of ASAM MDF 4.1, section 6.17, and of version 3: lines, fractions, tables, names of
values, and what refers to these.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from tustinnet.data.formats.reader import Array

_MOST_CONVERSIONS = 8  # conversions that refer to others
# kinds by their numbers in version 3, also of 2, and in version 4
_KINDS = {
    3: {
        0: "line",
        1: "interpolated",
        2: "nearest",
        9: "fraction",
        10: "formula",
        11: "names of values",
        12: "names of ranges",
        65535: "none",
    },
    4: {
        0: "none",
        1: "line",
        2: "fraction",
        3: "formula",
        4: "interpolated",
        5: "nearest",
        6: "ranges",
        7: "names of values",
        8: "names of ranges",
    },
}


def reason_to_refuse(conversion: Any, version: int, depth: int = 0) -> str:
    """The reason why a conversion is not applied, empty where it is.

    Args:
        conversion: the conversion as asammdf read it, None for none.
        version: of the format, 3 or 4.
        depth: how many conversions refer to it.
    """
    kind = _kind(conversion, version)
    if depth > _MOST_CONVERSIONS:
        return f"converted by more than {_MOST_CONVERSIONS} conversions that refer to one another"
    if kind == "formula":
        return "converted by a formula, which is not evaluated"
    if not kind:
        return f"converted by a rule of type {conversion.conversion_type}, which is not known here"
    if not kind.startswith("names"):
        return ""
    inner = (reason_to_refuse(c, version, depth + 1) for c in _referenced(conversion))
    return next(filter(None, inner), "")


def convert(conversion: Any, version: int, raw: Array) -> Array:
    """Numbers from raw ones, (n,).

    A name of a value says nothing of its number: values that have one stay raw, but where the
    others are converted; there they are no numbers, as "sensor not available" is none.

    Args:
        conversion: the conversion as asammdf read it, None for none.
        version: of the format, 3 or 4.
        raw: the raw numbers, (n,).
    """
    match _kind(conversion, version):
        case "line":
            return raw * conversion.a + conversion.b
        case "fraction":
            return _fraction(
                [getattr(conversion, f"P{k}") for k in range(1, 7)], raw.astype(np.float64)
            )
        case "interpolated":
            return np.interp(raw, _list(conversion, "raw"), _list(conversion, "phys"))
        case "nearest":
            points = _list(conversion, "raw")
            middles = (points[1:] + points[:-1]) / 2
            return _list(conversion, "phys")[np.searchsorted(middles, raw)]
        case "ranges":
            values = np.full(len(raw), float(conversion.default))
            for mask, value in zip(_masks(conversion, raw), _list(conversion, "phys"), strict=True):
                values[mask] = value
            return values
        case "names of values" | "names of ranges" if _referenced(conversion):
            return _convert_by_value(conversion, version, raw)
    return raw


def _kind(conversion: Any, version: int) -> str:
    """The kind of a conversion, empty where it is not known."""
    if conversion is None:
        return "none"
    return _KINDS[version].get(conversion.conversion_type, "")


def _fraction(parameters: list[float], x: Array) -> Array:
    p1, p2, p3, p4, p5, p6 = parameters
    if not (p2 or p3 or p4 or p6):  # also where x is 0
        return x * (p1 / p5)
    return (p1 * x**2 + p2 * x + p3) / (p4 * x**2 + p5 * x + p6)


def _list(conversion: Any, name: str) -> Array:
    """The numbers of a table of a conversion, `raw_0`, `raw_1`, ..."""
    numbers = []
    while (number := getattr(conversion, f"{name}_{len(numbers)}", None)) is not None:
        numbers.append(float(number))
    return np.array(numbers)


def _masks(conversion: Any, raw: Array) -> Iterator[Array]:
    """Which samples are in each of the ranges of a conversion, or have each of its values."""
    values = [*_list(conversion, "val"), *_list(conversion, "param_val")]
    yield from (raw == value for value in values)
    for low, high in zip(_list(conversion, "lower"), _list(conversion, "upper"), strict=True):
        yield (low <= raw) & (raw < high if raw.dtype.kind == "f" else raw <= high)


def _referenced(conversion: Any) -> list[Any]:
    """The conversions to which one refers, not the texts."""
    return [c for c in (conversion.referenced_blocks or {}).values() if _is_conversion(c)]


def _is_conversion(block: Any) -> bool:
    """Whether a conversion refers to another one, not to a text."""
    return hasattr(block, "formula")


def _convert_by_value(conversion: Any, version: int, raw: Array) -> Array:
    """Numbers whose conversion depends on their value; NaN where it has a name instead."""
    blocks = conversion.referenced_blocks
    values, rest = np.full(len(raw), np.nan), np.ones(len(raw), bool)
    cases = [(mask, blocks.get(f"text_{k}")) for k, mask in enumerate(_masks(conversion, raw))]
    for mask, block in [*cases, (rest, blocks.get("default_addr"))]:
        chosen = rest & mask
        if _is_conversion(block):
            values[chosen] = convert(block, version, raw[chosen])
        rest = rest & ~mask
    return values
