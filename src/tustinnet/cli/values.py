"""Values of options that are written as NAME=VALUE."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import tustinnet as tn
from tustinnet.cli import terminal
from tustinnet.control import dynamics
from tustinnet.data import quantities
from tustinnet.errors import InputError
from tustinnet.simulate import range as training_ranges
from tustinnet.store import header as file_header


def parse_pairs(option: str, pairs: Sequence[str] | None) -> dict[str, str]:
    """Texts by name, each written as `NAME=VALUE`; empty without the option."""
    parts = [pair.partition("=") for pair in pairs or ()]
    texts = {name.strip(): value.strip() for name, _, value in parts}
    if len(texts) < len(parts) or not all(name and value for name, value in texts.items()):
        raise InputError(option, f"'{', '.join(pairs or ())}'", "NAME=VALUE, each name once")
    return texts


def _parse_texts(option: str, texts: Sequence[str] | None) -> dict[str, str]:
    """Texts by name, of an option that is repeated or lists several, separated by commas."""
    return parse_pairs(option, [pair for text in texts or () for pair in text.split(",")])


class OptionReader:
    """Reads options with values of coordinates and inputs, and prints what was understood.

    Args:
        channels: the channels of the model or system.
        header: the header of the model's file, which knows the columns; None without a file.
    """

    def __init__(self, channels: "tn.Channels", header: Mapping[str, Any] | None) -> None:

        self._coordinates = channels.coordinates
        columns = file_header.columns_in_header(header or {})
        self.values = quantities.ValueReader(channels, columns, terminal.messages().print)

    def read(self, option: str, texts: Sequence[str] | None) -> dict[str, float]:
        """Values by name, each written as `NAME=VALUE` with or without a unit."""
        read = self.values.read(option, _parse_texts(option, texts))
        return {name: value for name, (value,) in read.items()}

    def read_limits(self, option: str, texts: Sequence[str] | None) -> dict[str, Any]:
        """Lower and upper limits by name, each written as `NAME=LOW:HIGH`."""
        return self.values.read(option, _parse_texts(option, texts), 2)

    def read_point(
        self,
        option: str,
        texts: Sequence[str] | None,
        training_range: "training_ranges.Range | None" = None,
    ) -> dict[str, float]:
        """Positions by name; raises an error for other names, or far from the records.

        That is by more than the recorded span or, of an angle, half a turn: all its directions are
        within that of a recorded one.

        Args:
            option: the option.
            texts: its values, None without the option.
            training_range: range of the training records; None to take any positions.
        """
        names = [c.name for c in self._coordinates]
        dynamics.require_known(_parse_texts(option, texts), names, option, "coordinates")
        point = self.read(option, texts)
        ends = () if training_range is None else training_range.states
        for c, (low, high) in zip(self._coordinates, ends, strict=False):
            reach = max(high - low, math.pi if c.kind == "angular" else 0.0)
            if not low - reach <= point.get(c.name, low) <= high + reach:
                unit, factor = self.values.units[c.name][1]
                raise InputError(
                    f"{option} {c.name} = {point[c.name] / factor:.6g} {unit}",
                    "far outside of the recorded motion",
                    f"about {low / factor:.4g} to {high / factor:.4g} {unit}, as recorded",
                    "check the unit, or add --trust-beyond",
                )
        return point
