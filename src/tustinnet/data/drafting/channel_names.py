"""Names of channels, from those of their columns."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from tustinnet.data.drafting.names import NameReading
from tustinnet.errors import InputError, require_name


def name_channels(
    positions: Sequence[str], inputs: Sequence[str], readings: Mapping[str, NameReading]
) -> dict[str, str]:
    """Names of channels by column, as short as they stay different: the last parts of paths."""
    columns = [*positions, *inputs]
    names: dict[str, str] = {}
    for length in (1, 2, 3, 99):
        for is_short in (True, False):
            remaining = [c for c in columns if c not in names]
            named = {c: _part_of_name(c, length, readings[c], is_short) for c in remaining}
            counts = Counter(named.values())
            for column, name in named.items():
                if _is_name(name) and counts[name] == 1 and name not in names.values():
                    names[column] = name
    for number, column in enumerate(columns, start=1):
        names.setdefault(column, f"channel_{number}")
    return names


def _is_name(text: str) -> bool:
    """Whether a text can be a channel's name."""
    try:
        require_name(text, "")
    except InputError:
        return False
    return True


def _part_of_name(column: str, length: int, reading: NameReading, is_short: bool) -> str:
    """The last parts of a column's name as a channel's name, without its unit if `is_short`."""
    name = (reading.name or column).replace('"', "")  # quotes would need escapes in commands
    name = _without_unit(name, reading) if is_short else name
    parts = [part for part in re.split(r"[/.]", name) if part.strip()]
    return re.sub(r"[\s\\]+", "_", "_".join(parts[-length:]).strip())


def _without_unit(name: str, reading: NameReading) -> str:
    """A channel's name without the unit in it."""
    if not reading.unit:
        return name
    if reading.in_brackets:
        shorter = re.sub(r"[\W_]*[\[({<][^\[\](){}<>]*[\])}>]", "", name)
        return re.sub(r"(?i)(_in_\S+|\s*/\s+\S+)$", "", shorter) if shorter == name else shorter
    return (
        re.sub(r"([\W_]*(per|[^\W\d_]{1,6}))?[\W_]*[^\W\d_]+\d*[\W_]*$", "", name)
        if (reading.unit.endswith("/s") and not re.search(r"(?i)(rpm|dps|mps|rads)\d*$", name))
        else re.sub(r"[\W_]*[^\W\d_]+\d*[\W_]*$", "", name)
    )
