"""MAT, NPZ and Parquet files: the names of their columns, and the numbers in some of them.

`serve` runs in a process of its own (`reading_process` starts it): on damaged files the libraries
used here can crash, hang or ask for any amount of memory.
"""

import importlib
import json
import math
import os
import signal
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.columns import Column, frame_columns, require_different
from tustinnet.data.mat_file import REAL, Array, Shape, mat_arrays, mat_contents
from tustinnet.errors import InputError, convert_errors

LARGEST = 2**30  # bytes: the requested columns of a file, as double precision
_ADDRESS_SPACE = 6 * 2**30  # bytes: these columns, their sources, and the libraries
_MOST_COLUMNS = 100_000

Contents = tuple[list[tuple[str, Shape]], dict[str, str]]


class Format(NamedTuple):
    """Reader of a kind of file.

    Attributes:
        library: the library to import.
        contents: function that gives names and shapes of the arrays of numbers in a file, and a
            description of everything else, by name.
        arrays: function that reads some of the arrays, by name.
    """

    library: str
    contents: Callable[[Path], Contents]
    arrays: Callable[[Path, set[str]], dict[str, Array]]


def read(path: Path, names: list[str]) -> list[Column]:
    """Some columns of a file.

    Raises:
        InputError: more than `LARGEST` bytes; what is not real numbers.
    """
    columns, _ = _columns(path)
    shapes = {columns[name].array: columns[name].shape for name in names}
    size = 8 * sum(math.prod(shape) for shape in shapes.values())
    if size > LARGEST:
        raise InputError(
            path,
            f"the columns of the card take {size / 2**30:.1f} GiB",
            f"at most {LARGEST / 2**30:g} GiB",
            "cut the record, or leave out columns",
        )
    arrays = FORMATS[path.suffix.lower()].arrays(path, set(shapes))
    numbers = []
    for name in names:
        place = columns[name]
        array = arrays[place.array]
        if array.dtype.kind not in REAL:
            raise InputError(f"{path}, {name}", f"numbers of type {array.dtype}", "real numbers")
        column = array.reshape(-1) if place.number is None else array[:, place.number]
        numbers.append(np.ascontiguousarray(column, np.float64))
    return numbers


class _Place(NamedTuple):
    """Place of a column: an array, its shape, and the number of a column of a matrix from 0."""

    array: str
    shape: Shape
    number: int | None


def _columns(path: Path) -> tuple[dict[str, _Place], dict[str, str]]:
    """Places of the columns of a file, in its order, and a description of everything else."""
    shapes, others = FORMATS[path.suffix.lower()].contents(path)
    vectors = [len(shape) == 1 or 1 in shape for _, shape in shapes]
    count = sum(1 if one else shape[1] for (_, shape), one in zip(shapes, vectors, strict=True))
    if count > _MOST_COLUMNS:
        raise InputError(path, f"{count} columns", f"at most {_MOST_COLUMNS}")
    columns: list[tuple[str, _Place]] = []
    for (name, shape), one in zip(shapes, vectors, strict=True):
        numbers = [None] if one else range(shape[1])
        columns += [
            (name if j is None else f"{name}[{j + 1}]", _Place(name, shape, j)) for j in numbers
        ]
    require_different([name for name, _ in columns], path)
    return dict(columns), others


# --- NPZ ---


def _npz_contents(path: Path) -> Contents:
    with zipfile.ZipFile(path) as archive:
        tables, others = [], {}
        for member in archive.namelist():
            if not member.endswith(".npy"):
                continue
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                read_header = (
                    np.lib.format.read_array_header_1_0
                    if version == (1, 0)
                    else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = read_header(file)
            name = member.removesuffix(".npy")
            if dtype.kind not in REAL:
                others[name] = "text or objects"
            elif len(shape) in (1, 2) and math.prod(shape) >= 2:
                tables.append((name, shape))
            else:
                others[name] = f"of shape {shape}"
    return tables, others


def _npz_arrays(path: Path, names: set[str]) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in names}


# --- Parquet ---


def _parquet_contents(path: Path) -> Contents:
    import polars as pl

    table = pl.scan_parquet(path, glob=False, hive_partitioning=False)
    rows = table.select(pl.len()).collect().item()
    return [(name, (rows,)) for name in table.collect_schema().names() if rows], {}


def _parquet_arrays(path: Path, names: set[str]) -> dict[str, Array]:
    import polars as pl

    frame = pl.read_parquet(path, columns=sorted(names), glob=False, hive_partitioning=False)
    columns = frame_columns(frame, path)
    return {name: columns[name] for name in names}


FORMATS = {
    ".parquet": Format("polars", _parquet_contents, _parquet_arrays),
    ".mat": Format("scipy.io", mat_contents, mat_arrays),
    ".npz": Format("numpy", _npz_contents, _npz_arrays),
}


# --- the process ---


def serve() -> None:
    """Answers requests on stdin until it is closed.

    A request is a line of JSON: `path`, the `folder` where a relative one begins, `names` (columns
    to read, or null to list them) and `seconds` that it may take. With a null `path` it requests
    the import of the library for the ending `suffix`. A reply is a line of JSON, too: `names` and
    `others` (descriptions of all that is no column, by name), or `lengths`, followed by the numbers
    of the columns as bytes of float64, or the message with which the request is `refused`.
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
        if request["path"] is None:
            importlib.import_module(FORMATS[request["suffix"]].library)
            return {}, []
        path, names = Path(request["path"]), request["names"]
        if request["folder"] is not None:
            os.chdir(request["folder"])
        with convert_errors(
            path, f"cannot be read as {path.suffix.lower()}", "a whole file of that format"
        ):
            if names is None:
                places, others = _columns(path)
                return {"names": list(places), "others": others}, []
            columns = read(path, names)
            return {"lengths": [len(column) for column in columns]}, columns
    except InputError as error:
        return {"refused": str(error)}, []
    finally:
        _alarm(0)


def _alarm(seconds: float) -> None:
    """Ends this process after some seconds, also where the parent cannot any more."""
    if sys.platform != "win32":
        signal.alarm(math.ceil(seconds))
