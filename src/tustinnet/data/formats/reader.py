"""The interface of all readers of binary files."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Array = np.ndarray
Shape = tuple[int, ...]

DEEPEST = 20  # groups, structs, cells and objects in one another
REAL = "fiub"  # kinds of numpy's types


@dataclass(frozen=True)
class Part:
    """A record among several in one file: a range of all rows, or the arrays of one group.

    Attributes:
        prefix: beginning of the names of its arrays in the file, which they lack in the record.
        rows: first row, and the row after the last; None for all.
    """

    prefix: str = ""
    rows: tuple[int, int] | None = None


@dataclass(frozen=True)
class Contents:
    """The arrays of numbers in a file, and a description of everything else.

    Attributes:
        arrays: names and shapes, in the file's order. A matrix has samples by columns. A shape may
            be larger than the array where its length is known only when it is read.
        others: descriptions of all that is no array of real numbers, by name.
        clocks: for arrays whose samples have times of their own, the name of the array of these
            times [s], by name. An array of times is its own clock.
        units: units by the name of the array, where the file has them.
        labels: what a file calls an array in a text beside it, by its name, where it does.
        parts: records among several in the file, by the label that follows the file's name.
        notes: remarks on how the file is read.
    """

    arrays: list[tuple[str, Shape]]
    others: dict[str, str] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    parts: dict[str, Part] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reader:
    """Reader of a kind of file. Both functions may raise anything on a damaged file.

    Attributes:
        library: the module that it needs, imported only when such a file is read.
        contents: function that gives the contents of a file, without all of its numbers.
        arrays: function that reads the arrays of some names.
        extra: the extra of this package that installs the library; empty where it is always there.
        speed: bytes of the file that it reads in a second, at least.
    """

    library: str
    contents: Callable[[Path], Contents]
    arrays: Callable[[Path, set[str]], dict[str, Array]]
    extra: str = ""
    speed: float = 10e6


def parts_of_matrices(arrays: list[tuple[str, Shape]]) -> dict[str, Part]:
    """Matrices of as many columns and other numbers of rows, `run1[1]` and `run2[1]`: records."""
    rows, widths = {shape[0] for _, shape in arrays}, {shape[1:] for _, shape in arrays}
    is_record = len(rows) > 1 and len(widths) == 1 and len(widths.pop()) == 1
    return {name: Part(name) for name, _ in arrays} if is_record else {}


def parts_of_groups(arrays: list[tuple[str, Shape]]) -> dict[str, Part]:
    """Groups beside one another, `run1/` and `run2/`, with arrays of the same names: records.

    Where an array outside of them is as long as all of theirs, as times that they share, they are
    of one record, as `motor1/` and `motor2/`.

    Args:
        arrays: names and shapes.
    """
    inside: dict[str, set[str]] = {}
    for name, _ in arrays:
        pieces = name.split("/")
        for k in range(1, len(pieces)):
            inside.setdefault("/".join(pieces[:k]), set()).add("/".join(pieces[k:]))
    siblings: dict[str, list[str]] = {}
    for group in inside:
        siblings.setdefault(group.rpartition("/")[0], []).append(group)
    for groups in siblings.values():
        if len(groups) > 1 and all(inside[group] == inside[groups[0]] for group in groups):
            starts = tuple(f"{group}/" for group in groups)
            within, outside = (
                {shape[0] for name, shape in arrays if shape and name.startswith(starts) == is_in}
                for is_in in (True, False)
            )
            if len(within) == 1 and within <= outside:
                return {}
            return {group.rpartition("/")[2]: Part(f"{group}/") for group in groups}
    return {}
