"""MAT, NPZ and Parquet files: which columns they hold, and those that are wanted.

`serve` runs in a process of its own (`reading_process` starts it): on damaged files the libraries
used here can crash, hang or ask for any amount of memory.
"""

import importlib
import json
import math
import os
import re
import signal
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator
from io import BufferedWriter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.columns import Column, frame_columns, require_different
from tustinnet.errors import InputError, refusing

LARGEST = 2**30  # bytes: the wanted columns of a file, as double precision
_ADDRESS_SPACE = 6 * 2**30  # bytes: they, what they are made from, and the libraries
_MOST_COLUMNS = 100_000

Array = np.ndarray
Shape = tuple[int, ...]

_REAL = "fiub"  # kinds of numpy's types
_MAT_REAL = re.compile("double|single|logical|u?int(8|16|32|64)")
_HDF5 = b"\x89HDF\r\n\x1a\n"


class Format(NamedTuple):
    """How a kind of file is read.

    Attributes:
        library: what has to be imported.
        shapes: names and shapes of the arrays of numbers in a file, without reading them.
        arrays: some of them, by name.
    """

    library: str
    shapes: Callable[[Path], list[tuple[str, Shape]]]
    arrays: Callable[[Path, set[str]], dict[str, Array]]


def column_names(path: Path) -> list[str]:
    """What the columns of a file are called, in its order."""
    return list(_columns(path))


def read(path: Path, names: list[str]) -> list[Column]:
    """Some columns of a file.

    Raises:
        InputError: more than `LARGEST` bytes; what is not real numbers.
    """
    columns = _columns(path)
    wanted = {columns[name].array: columns[name].shape for name in names}
    size = 8 * sum(math.prod(shape) for shape in wanted.values())
    if size > LARGEST:
        raise InputError(
            path,
            f"the columns of the card take {size / 2**30:.1f} GiB",
            f"at most {LARGEST / 2**30:g} GiB",
            "cut the record, or leave out columns",
        )
    arrays = FORMATS[path.suffix.lower()].arrays(path, set(wanted))
    found = []
    for name in names:
        place = columns[name]
        array = arrays[place.array]
        if array.dtype.kind not in _REAL:
            raise InputError(f"{path}, {name}", f"numbers of type {array.dtype}", "real numbers")
        column = array.reshape(-1) if place.number is None else array[:, place.number]
        found.append(np.ascontiguousarray(column, np.float64))
    return found


class _Place(NamedTuple):
    """Where a column is: an array, its shape, and the number of a column of a matrix from 0."""

    array: str
    shape: Shape
    number: int | None


def _columns(path: Path) -> dict[str, _Place]:
    shapes = FORMATS[path.suffix.lower()].shapes(path)
    vectors = [len(shape) == 1 or 1 in shape for _, shape in shapes]
    count = sum(1 if one else shape[1] for (_, shape), one in zip(shapes, vectors, strict=True))
    if count > _MOST_COLUMNS:
        raise InputError(path, f"{count} columns", f"at most {_MOST_COLUMNS}")
    found: list[tuple[str, _Place]] = []
    for (name, shape), one in zip(shapes, vectors, strict=True):
        numbers = [None] if one else range(shape[1])
        found += [
            (name if j is None else f"{name}[{j + 1}]", _Place(name, shape, j)) for j in numbers
        ]
    require_different([name for name, _ in found], path)
    return dict(found)


def _is_table(shape: Shape) -> bool:
    return len(shape) in (1, 2) and math.prod(shape) >= 2


# --- NPZ ---


def _npz_shapes(path: Path) -> list[tuple[str, Shape]]:
    with zipfile.ZipFile(path) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
        heads = [(name.removesuffix(".npy"), *_npy_head(archive, name)) for name in members]
    return [(name, shape) for name, shape, kind in heads if kind in _REAL and _is_table(shape)]


def _npy_head(archive: zipfile.ZipFile, member: str) -> tuple[Shape, str]:
    form = np.lib.format
    with archive.open(member) as file:
        old = form.read_magic(file) == (1, 0)
        shape, _, dtype = (form.read_array_header_1_0 if old else form.read_array_header_2_0)(file)
    return shape, dtype.kind


def _npz_arrays(path: Path, names: set[str]) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in names}


# --- MAT, up to version 7 and 7.3 ---


def _is_hdf5(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(512 + len(_HDF5))
    return head.startswith(_HDF5) or head[512:] == _HDF5


def _mat_shapes(path: Path) -> list[tuple[str, Shape]]:
    import scipy.io

    if _is_hdf5(path):
        return [(name, shape) for name, shape, _ in _hdf5(path, None)]
    listed = scipy.io.whosmat(path)
    structs = _mat_content(path, [name for name, _, kind in listed if kind == "struct"])
    found: list[tuple[str, Shape]] = []
    for name, shape, kind in listed:
        if kind == "struct":
            found += [(field, array.shape) for field, array in _fields(name, structs[name])]
        elif _MAT_REAL.fullmatch(kind):
            found.append((name, tuple(n for n in shape if n != 1)))
    return [(name, shape) for name, shape in found if _is_table(shape)]


def _mat_arrays(path: Path, names: set[str]) -> dict[str, Array]:
    if _is_hdf5(path):
        return {name: array for name, _, array in _hdf5(path, names)}
    content = _mat_content(path, {name.partition(".")[0] for name in names})
    return dict(field for name, value in content.items() for field in _fields(name, value))


def _mat_content(path: Path, variables: Iterable[str]) -> dict[str, Any]:
    import scipy.io

    wanted = list(variables)
    if not wanted:
        return {}
    found = scipy.io.loadmat(path, variable_names=wanted, squeeze_me=True, struct_as_record=False)
    return {name: found[name] for name in wanted}


def _fields(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    """An array, or the arrays in a struct by dotted name."""
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _fields(f"{name}.{field}", getattr(value, field))
    else:
        array = np.asarray(value)
        if array.dtype.kind in "c" + _REAL:
            yield name, array


def _hdf5(path: Path, names: set[str] | None) -> list[tuple[str, Shape, Array]]:
    """Names, shapes and content of some data sets; of all, without their content, for None."""
    import h5py

    found: list[tuple[str, Shape, Array]] = []

    def visit(address: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in _REAL:
            return
        # MATLAB stores matrices column-major: what h5py sees is the transpose
        name, shape = address.replace("/", "."), (item.shape or ())[::-1]
        if address.startswith("#refs#") or not _is_table(shape):
            return
        if item.external or item.is_virtual:
            raise InputError(path, f"the numbers of '{name}' are in another file", "in this file")
        if names is None:
            found.append((name, shape, np.empty(0)))
        elif name in names:
            found.append((name, shape, item[()].T))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return found


# --- Parquet ---


def _parquet_shapes(path: Path) -> list[tuple[str, Shape]]:
    import polars as pl

    table = pl.scan_parquet(path, glob=False, hive_partitioning=False)
    rows = table.select(pl.len()).collect().item()
    return [(name, (rows,)) for name in table.collect_schema().names() if rows]


def _parquet_arrays(path: Path, names: set[str]) -> dict[str, Array]:
    import polars as pl

    frame = pl.read_parquet(path, columns=sorted(names), glob=False, hive_partitioning=False)
    columns = frame_columns(frame, path)
    return {name: columns[name] for name in names}


FORMATS = {
    ".parquet": Format("polars", _parquet_shapes, _parquet_arrays),
    ".mat": Format("scipy.io", _mat_shapes, _mat_arrays),
    ".npz": Format("numpy", _npz_shapes, _npz_arrays),
}


# --- the process ---


def serve() -> None:
    """Answers requests on stdin until it is closed.

    A request is a line of JSON: `path`, the `folder` where a relative one begins, `names` (wanted
    columns, or null for what there is) and `seconds` that it may take. With a null `path` it asks
    to import the library for the ending `suffix`. A reply is a line of JSON, too: `names`, or
    `lengths` with the numbers of the columns after it as bytes of float64, or why the request
    is `refused`.
    """
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print is no reply
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    _limit()
    for line in sys.stdin.buffer:
        _send(replies, *_answer(json.loads(line)))


def _send(replies: BufferedWriter, reply: dict[str, Any], columns: list[Column]) -> None:
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
        with refusing(
            path, f"cannot be read as {path.suffix.lower()}", "a whole file of that format"
        ):
            if names is None:
                return {"names": column_names(path)}, []
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


def _limit() -> None:
    if sys.platform == "linux":
        import resource

        for what, limit in ((resource.RLIMIT_AS, _ADDRESS_SPACE), (resource.RLIMIT_CORE, 0)):
            soft, hard = resource.getrlimit(what)
            if soft == resource.RLIM_INFINITY or soft > limit:
                resource.setrlimit(what, (limit, hard))
