"""Values of coordinates and inputs as people write them: numbers, with or without a unit."""

import re
from collections.abc import Callable, Mapping

from tustinnet.channels import Channels, ColumnUnit
from tustinnet.data.units import convert
from tustinnet.errors import InputError

_NUMBER = re.compile(
    r"([-+]?(?:(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|inf))\s*(.*)", re.IGNORECASE | re.ASCII
)
_RELATED = {
    "{}": "",
    "der_{}": "/s",  # as states are called
    "{}_dot": "/s",  # as columns are called
    "{}_ddot": "/s^2",
    "integral_{}": "*s",
}


class ValueReader:
    """Reads values of coordinates and inputs, and says how it has understood them.

    A number alone is in the unit of the data card's column, a unit may follow: `180`, `3.14 rad`.
    Velocities, accelerations and integrals of coordinates are in units derived from that.

    Attributes:
        units: units of named values: that of models, and the column's.

    Args:
        channels: the channels of a model.
        columns: the units of the columns of coordinates, by name; those of the model where one is
            missing.
        on_message: receives a line about what was read.
    """

    def __init__(
        self,
        channels: Channels,
        columns: Mapping[str, ColumnUnit],
        on_message: Callable[[str], None],
    ) -> None:
        self._on_message = on_message
        self.units: dict[str, tuple[str, ColumnUnit]] = {}
        for c in channels.coordinates:
            column = columns.get(c.name, ColumnUnit(c.unit, 1.0))
            for name, per in _RELATED.items():
                of_column = ColumnUnit(column.name + per, column.factor)
                self.units[name.format(c.name)] = c.unit + per, of_column
        for i in channels.inputs:
            self.units[i.name] = i.unit, ColumnUnit(i.unit, 1.0)
        for loop in channels.controller.loops if channels.controller else ():
            # set points are written as what they set
            self.units[loop.position] = self.units[loop.coordinate]
            self.units[loop.velocity] = self.units[f"der_{loop.coordinate}"]

    def read(
        self, where: str, texts: Mapping[str, str | float], count: int = 1
    ) -> dict[str, tuple[float, ...]]:
        """The values of texts by name, in the units of models.

        Args:
            where: where they are written, for messages.
            texts: a number for each name, or numbers separated by colons, as `-10:10V`. A unit
                applies to all numbers that have none.
            count: how many numbers each text has; several must ascend.

        Raises:
            InputError: a text of another form, or a unit that does not fit.
        """
        read, descriptions = {}, []
        for name, text in texts.items():
            unit, column = self.units.get(name, ("", ColumnUnit("", 1.0)))
            try:
                numbers, shown = _parse(str(text), unit, column)
                if len(numbers) != count or sorted(set(numbers)) != numbers:
                    raise ValueError("it is not understood")
            except ValueError as error:
                raise InputError(
                    f"{where}, {name}={text}",
                    str(error),
                    "LOW:HIGH, the smaller number first" if count > 1 else "a number",
                    f"a number without a unit is in {column.name}" if column.name else "",
                ) from None
            values = tuple(number * shown.factor for number in numbers)
            description = f"{name} = {':'.join(f'{x:g}' for x in numbers)} {shown.name}".rstrip()
            if shown.name != unit:
                description += f" ({':'.join(f'{x:.4g}' for x in values)} {unit})"
            descriptions.append(description)
            read[name] = values
        if read:
            self._on_message(f"{where}: {', '.join(descriptions)}")
        return read


def _parse(text: str, unit: str, column: ColumnUnit) -> tuple[list[float], ColumnUnit]:
    """The numbers of a text, and the unit in which they are.

    Raises:
        ValueError: no numbers, or a unit that is unknown or of another quantity than `unit`.
    """
    matches = [_NUMBER.fullmatch(part.strip()) for part in text.split(":")]
    parts = [match.groups() for match in matches if match]
    names = {name for _, name in parts if name}
    if len(parts) < len(matches) or len(names) > 1:
        raise ValueError("it is not understood")
    for name in names - {column.name}:
        column = ColumnUnit(name, convert(name, unit))
    return [float(number) for number, _ in parts], column
