"""Binary files: the names of their columns, and the numbers in some of them.

`reading_process` has this done in a process of its own.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.columns import Column, require_different
from tustinnet.data.formats.reader import REAL, Contents, Reader, Shape, parts_of_matrices
from tustinnet.errors import InputError
from tustinnet.registry import load_place
from tustinnet.wording import counted

LARGEST = 2**30  # bytes: the requested columns of a file, as double precision
_MOST_LISTED = 100_000


def list_columns_by(path: Path, reader: str) -> tuple[dict[str, Any], list[Column]]:
    """`list_columns` by a reader as `module:attribute`, as plain values, and no numbers."""
    return dataclasses.asdict(list_columns(path, load_place(reader))), []


def read_by(path: Path, reader: str, names: list[str]) -> tuple[None, list[Column]]:
    """`read` by a reader as `module:attribute`."""
    return None, read(path, load_place(reader), names)


def list_columns(path: Path, reader: Reader) -> Contents:
    """The contents of a file, each column of a matrix as an array of its own."""
    contents = reader.contents(path)
    _latest.clear()
    _latest[_key(path, reader)] = contents
    places = _places(path, contents.arrays)
    return dataclasses.replace(
        contents,
        arrays=[
            (name, (int(p.shape[0] if p.number is not None else math.prod(p.shape)),))
            for name, p in places.items()
        ],
        clocks=_by_column(places, contents.clocks),
        units=_by_column(places, contents.units),
        labels=_numbered(places, contents.labels),
        parts=contents.parts or parts_of_matrices(contents.arrays),
    )


def read(path: Path, reader: Reader, names: list[str]) -> list[Column]:
    """Some columns of a file.

    Raises:
        InputError: more than `LARGEST` bytes; what is not real numbers.
    """
    # what was listed last is read next: some readers go through the whole file to list it
    contents = _latest.get(_key(path, reader)) or reader.contents(path)
    columns = _places(path, contents.arrays)
    shapes = {columns[name].array: columns[name].shape for name in names}
    size = 8 * sum(math.prod(shape) for shape in shapes.values())
    if size > LARGEST:
        raise InputError(
            path,
            f"the columns of the card take {size / 2**30:.1f} GiB",
            f"at most {LARGEST / 2**30:g} GiB",
            "cut the record, or leave out columns",
        )
    arrays = reader.arrays(path, set(shapes))
    numbers = []
    for name in names:
        place = columns[name]
        array = arrays[place.array]
        if array.dtype.kind not in REAL:
            raise InputError(f"{path}, {name}", f"numbers of type {array.dtype}", "real numbers")
        column = array.reshape(-1) if place.number is None else array[:, place.number]
        numbers.append(np.ascontiguousarray(column, np.float64))
    return numbers


_latest: dict[tuple[object, ...], Contents] = {}


def _key(path: Path, reader: Reader) -> tuple[object, ...]:
    status = path.stat()
    return path.absolute(), reader, status.st_mtime_ns, status.st_size


class _Place(NamedTuple):
    """Place of a column: an array, its shape, and the number of a column of a matrix from 0."""

    array: str
    shape: Shape
    number: int | None


def _places(path: Path, shapes: list[tuple[str, Shape]]) -> dict[str, _Place]:
    """Places of the columns of a file, in its order, by the names and shapes of its arrays."""
    vectors = [len(shape) == 1 or 1 in shape for _, shape in shapes]
    count = sum(1 if one else shape[1] for (_, shape), one in zip(shapes, vectors, strict=True))
    if count > _MOST_LISTED:
        raise InputError(path, counted(count, "column"), f"at most {_MOST_LISTED}")
    columns: list[tuple[str, _Place]] = []
    for (name, shape), one in zip(shapes, vectors, strict=True):
        numbers = [None] if one else range(shape[1])
        columns += [
            (name if j is None else f"{name}[{j + 1}]", _Place(name, shape, j)) for j in numbers
        ]
    require_different([name for name, _ in columns], path)
    return dict(columns)


def _by_column(places: Mapping[str, _Place], values: Mapping[str, str]) -> dict[str, str]:
    """Values by the name of a column, from those by the name of an array."""
    return {name: values[p.array] for name, p in places.items() if values.get(p.array)}


def _numbered(places: Mapping[str, _Place], labels: Mapping[str, str]) -> dict[str, str]:
    """Labels by the name of a column; those of the columns of a matrix are numbered as these."""
    return {
        name: label if (number := places[name].number) is None else f"{label}[{number + 1}]"
        for name, label in _by_column(places, labels).items()
    }
