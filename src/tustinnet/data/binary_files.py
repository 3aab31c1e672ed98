"""Binary files: the names of their columns, and the numbers in some of them.

`serve` runs in a process of its own (`reading_process` starts it): on damaged files the libraries
of the readers can crash, hang or ask for any amount of memory.
"""

import dataclasses
import importlib
import json
import math
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.columns import Column, Listing, require_different
from tustinnet.data.formats.reader import REAL, Contents, Reader, Shape
from tustinnet.errors import InputError, convert_errors
from tustinnet.registry import load_place
from tustinnet.wording import counted

LARGEST = 2**30  # bytes: the requested columns of a file, as double precision
_ADDRESS_SPACE = 6 * 2**30  # bytes: these columns, their sources, and the libraries
_MOST_COLUMNS = 100_000


def list_columns(path: Path, reader: Reader) -> Listing:
    """The names of the columns of a file, and what else is known of them."""
    contents = reader.contents(path)
    _latest.clear()
    _latest[_key(path, reader)] = contents
    places = _places(path, contents.arrays)
    return Listing(
        list(places), dict(contents.others), _by_column(places, contents.clocks),
        _by_column(places, contents.units), _numbered(places, contents.labels),
        dict(contents.parts), list(contents.notes),
    )  # fmt: skip


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
    if count > _MOST_COLUMNS:
        raise InputError(path, counted(count, "column"), f"at most {_MOST_COLUMNS}")
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


# --- the process ---


def serve() -> None:
    """Answers requests on stdin until it is closed.

    A request is a line of JSON: `path`, the `folder` where a relative one begins, `names` (columns
    to read, or null to list them), the `reader` as `module:attribute`, and `seconds` that it may
    take. With a null `path` it requests the import of the reader's library. A reply is a line of
    JSON, too: the `listing`, or `lengths`, followed by the numbers of the columns as bytes of
    float64, or the message with which the request is `refused`.
    """
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print there, which is no reply
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    if sys.platform == "linux":
        import resource

        for kind, limit in ((resource.RLIMIT_AS, _ADDRESS_SPACE), (resource.RLIMIT_CORE, 0)):
            soft, hard = resource.getrlimit(kind)
            if soft == resource.RLIM_INFINITY or soft > limit:
                resource.setrlimit(kind, (limit, hard))
    for line in sys.stdin.buffer:
        reply, columns = _answer(json.loads(line))
        replies.write(json.dumps(reply).encode() + b"\n")
        for column in columns:
            replies.write(column.data.cast("B"))
        replies.flush()


def _answer(request: dict[str, Any]) -> tuple[dict[str, Any], list[Column]]:
    _alarm(request["seconds"])
    try:
        reader: Reader = load_place(request["reader"])
        if request["path"] is None:
            importlib.import_module(reader.library)
            return {}, []
        path, names = Path(request["path"]), request["names"]
        if request["folder"] is not None:
            os.chdir(request["folder"])
        with convert_errors(
            path, f"cannot be read as {path.suffix.lower()}", "a whole file of that format"
        ):
            if names is None:
                return {"listing": dataclasses.asdict(list_columns(path, reader))}, []
            columns = read(path, reader, names)
            return {"lengths": [len(column) for column in columns]}, columns
    except InputError as error:
        return {"refused": str(error)}, []
    finally:
        _alarm(0)


def _alarm(seconds: float) -> None:
    """Ends this process after some seconds, also where the parent cannot any more."""
    if sys.platform != "win32":
        signal.alarm(math.ceil(seconds))


def _numbered(places: Mapping[str, _Place], labels: Mapping[str, str]) -> dict[str, str]:
    """Labels by the name of a column; those of the columns of a matrix are numbered as these."""
    return {
        name: label if (number := places[name].number) is None else f"{label}[{number + 1}]"
        for name, label in _by_column(places, labels).items()
    }
