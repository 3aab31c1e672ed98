"""Lines of a data card that mend a finding, as texts with the table that they belong to."""

from collections.abc import Sequence

import numpy as np

from tustinnet.check.levels import LEVELS
from tustinnet.data.card import CoordinateCard
from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import FEWEST_SAMPLES, card_entry

WHICH_COLUMN = "correct `column`, or leave the block out"


def top_line(entry: str) -> str:
    """A line above the tables of the card."""
    return f"at the top: {entry}"


def time_line(entry: str) -> str:
    """A line of the table of times."""
    return f"under [time]: {entry}"


def coordinate_line(name: str, entry: str) -> str:
    """A line in the block of a coordinate."""
    return f"under [[coordinates]] {name}: {entry}"


def unit_key(block: CoordinateCard, factor: float) -> str:
    """The unit of an angle as a key that changes its samples by a factor; "" where none does."""
    for unit, other in (("deg", np.pi / 180), ("rad", 180 / np.pi)):
        if block.kind == "angular" and abs(factor / other - 1) < LEVELS.same_unit:
            return f'unit = "{unit}"'
    return ""


def input_line(name: str, entry: str) -> str:
    """A line in the block of an input."""
    return f"under [[inputs]] {name}: {entry}"


def file_line(e: Experiment, entry: str) -> str:
    """An entry of a record's file in its split; "" of a record from arrays, which has no card."""
    if not e.source:
        return ""
    return f"under [splits] {e.split or 'train'}: {entry or 'no entry: correct the file'}"


def file_parts(e: Experiment, left_out: Sequence[tuple[int, int]]) -> str:
    """Entries of a record's parts between stretches of samples, of which a cut is an empty one."""
    edges = [0, *(k for stretch in left_out for k in stretch), len(e)]
    parts = zip(edges[::2], edges[1::2], strict=True)
    entries = [card_entry(e, a, b) for a, b in parts if b - a >= FEWEST_SAMPLES]
    return file_line(e, ", ".join(filter(None, entries)))


def without_record(e: Experiment) -> str:
    """The advice to leave a record out of its split."""
    where = f"under [splits] {e.split or 'train'}: " if e.source else ""
    return f'{where}leave out "{e.source or e.name}"'
