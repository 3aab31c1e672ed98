"""MAT files, up to version 7 and 7.3: their arrays of numbers by name, those inside of others too.

A field of a struct is `log.q`, the third element of a cell array `logs{3}`, that of a struct array
`logs(3)`. It is used in the process of `binary_files` only.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.errors import InputError, convert_errors

Array = np.ndarray
Shape = tuple[int, ...]

_REAL = "fiub"  # kinds of numpy's types
_NUMBERS = "c" + _REAL
_HDF5 = b"\x89HDF\r\n\x1a\n"
_DEEPEST = 20  # structs and cells in one another
_OBJECT = 3  # what `MATLAB_object_decode` says of objects
_UNNAMED = "None"  # how scipy calls objects
OBJECT = "a MATLAB object (timeseries, timetable, table, ...)"
OBJECT_REMEDY = "save it as numbers: s = struct(ts), or t = ts.Time, x = ts.Data"


class Found(NamedTuple):
    """What is in a file under a name.

    Attributes:
        name: as MATLAB says it.
        shape: of an array of numbers that can be columns, else None.
        load: reads the array.
        other: what it is, where it is no such array.
    """

    name: str
    shape: Shape | None
    load: Callable[[], Array] = lambda: np.empty(0)
    other: str = ""


def mat_contents(path: Path) -> tuple[list[tuple[str, Shape]], dict[str, str]]:
    """Names and shapes of the arrays of numbers, and what everything else is."""
    found = list(_walk(path, None))
    arrays = [(f.name, f.shape) for f in found if f.shape is not None]
    return arrays, {f.name: f.other for f in found if f.shape is None}


def mat_arrays(path: Path, names: set[str]) -> dict[str, Array]:
    """Some arrays."""
    return {f.name: f.load() for f in _walk(path, names) if f.name in names}


def _walk(path: Path, names: set[str] | None) -> Iterator[Found]:
    """Everything in a file; of `names` only what it takes to read these."""
    if not _is_hdf5(path):
        yield from _oriented(_mat5(path, names))
        return
    import h5py

    with h5py.File(path, "r") as file:
        yield from _oriented(
            found
            for name, item in _children(file)
            if not name.startswith("#")  # what references point to, and objects
            for found in _hdf5(path, name, item, 0)
        )


def _is_hdf5(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(512 + len(_HDF5))
    return head.startswith(_HDF5) or head[512:] == _HDF5


def _numbers(name: str, shape: Shape, load: Callable[[], Array]) -> Found:
    """An array of numbers: columns, where it has at least two numbers in one or two dimensions."""
    size, squeezed = math.prod(shape), tuple(n for n in shape if n != 1)
    if size < 2:
        return Found(name, None, other="empty" if size == 0 else "a single number")
    if len(squeezed) > 2:
        return Found(name, None, other=f"an array of {len(squeezed)} dimensions")
    return Found(name, squeezed, lambda: load().reshape(squeezed))


def _oriented(found: Iterable[Found]) -> Iterator[Found]:
    """Samples first: a timeseries may have `Data` of channels by samples, for its `Time`."""
    listed = list(found)
    shapes = {f.name: f.shape for f in listed}
    for f in listed:
        times = (
            shapes.get(f"{f.name.removesuffix('Data')}Time") if f.name.endswith(".Data") else None
        )
        if times and f.shape and len(f.shape) == 2 and f.shape[0] != times[0] == f.shape[1]:
            yield Found(f.name, f.shape[::-1], lambda load=f.load: load().T)
        else:
            yield f


# --- up to version 7 ---


def _mat5(path: Path, names: set[str] | None) -> Iterator[Found]:
    import scipy.io

    wanted = None if names is None else {_variable(name) for name in names}
    try:
        listed = scipy.io.whosmat(path)
    except TypeError:  # it stumbles over objects, which have no size
        for name, value in _mat5_content(path, None if wanted is None else [*wanted]).items():
            yield from _objects(value) if name == _UNNAMED else _mat5_value(name, value)
        return
    for name, shape, kind in listed:
        if wanted is not None and name not in wanted:
            continue
        if kind in ("struct", "cell"):
            value = _mat5_variable(path, name)
            # scipy takes the only element out of its cell
            single = kind == "cell" and math.prod(shape) == 1
            yield from _mat5_value(
                f"{name}{{1}}" if single else name, value, "{}" * (kind == "cell")
            )
        elif kind == "char":
            yield Found(name, None, other="text")
        elif kind in ("object", "function", "unknown"):
            yield Found(name, None, other=OBJECT)
        elif kind == "sparse":
            yield Found(name, None, other="a sparse matrix")
        else:
            read = lambda name=name: np.asarray(_mat5_variable(path, name))  # noqa: E731
            yield _numbers(name, shape, read)


def _objects(value: Any) -> Iterator[Found]:
    """The objects of a file: scipy calls them all the same, and keeps the last one."""
    yield Found("", None, other=OBJECT)
    names = np.atleast_1d(value)["s0"] if getattr(value, "dtype", np.dtype(int)).names else ()
    for name in names:
        if isinstance(name, bytes):
            yield Found(name.decode("latin1"), None, other=OBJECT)


def _variable(name: str) -> str:
    return min((name.partition(mark)[0] for mark in ".({"), key=len)


def _mat5_variable(path: Path, name: str) -> Any:
    with convert_errors(f"{path}, {name}", "the variable is cut short or damaged", "a whole file"):
        return _mat5_content(path, [name])[name]


def _mat5_content(path: Path, names: list[str] | None) -> dict[str, Any]:
    import scipy.io

    found = scipy.io.loadmat(path, variable_names=names, squeeze_me=True, struct_as_record=False)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _mat5_value(name: str, value: Any, brackets: str = "") -> Iterator[Found]:
    """What is in a struct, a cell array (`brackets`) or a struct array, as scipy gives it."""
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    if isinstance(value, MatlabOpaque | MatlabObject | MatlabFunction):
        yield Found(name, None, other=OBJECT)
    elif hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _mat5_value(f"{name}.{field}", getattr(value, field))
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        elements = value.ravel(order="F")
        structs = all(hasattr(element, "_fieldnames") for element in elements)
        left, right = brackets or ("()" if structs else "{}")
        for k, element in enumerate(elements, 1):
            yield from _mat5_value(f"{name}{left}{k}{right}", element)
    else:
        array = np.asarray(value)
        if array.dtype.kind in _NUMBERS:
            yield _numbers(name, array.shape, lambda: array)
        else:
            yield Found(name, None, other="text" if array.dtype.kind == "U" else "no numbers")


# --- version 7.3 ---


def _children(group: Any) -> Iterator[tuple[str, Any]]:
    """What is in a group itself: a link may lead into another file, or back."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, group[name]


def _hdf5(path: Path, name: str, item: Any, depth: int) -> Iterator[Found]:
    import h5py

    if depth > _DEEPEST:
        raise InputError(path, f"'{name}' is nested deeper than {_DEEPEST}", "a few structs")
    kind = item.attrs.get("MATLAB_class", b"")
    if item.attrs.get("MATLAB_object_decode") == _OBJECT:
        yield Found(name, None, other=OBJECT)
    elif isinstance(item, h5py.Group):
        for field, inner in _children(item):
            if _refers(inner) and not inner.attrs.get("MATLAB_class"):  # a struct array
                yield from _elements(path, (f"{name}(", f").{field}"), inner, depth)
            else:
                yield from _hdf5(path, f"{name}.{field}", inner, depth + 1)
    elif not isinstance(item, h5py.Dataset):
        return
    elif _refers(item):
        yield from _elements(path, (f"{name}{{", "}"), item, depth)
    elif kind == b"char" or item.dtype.kind in "SO":
        yield Found(name, None, other="text")
    elif item.attrs.get("MATLAB_empty"):
        yield Found(name, None, other="empty")
    elif item.dtype.kind in _REAL:
        if item.external or item.is_virtual:
            raise InputError(path, f"the numbers of '{name}' are in another file", "in this file")
        # MATLAB stores matrices column-major: what h5py sees is the transpose
        yield _numbers(name, (item.shape or ())[::-1], lambda: item[()].T)
    else:
        yield Found(name, None, other="no real numbers")


def _refers(item: Any) -> bool:
    import h5py

    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is not None


def _elements(path: Path, around: tuple[str, str], item: Any, depth: int) -> Iterator[Found]:
    """What the references of a cell array, or of a field of a struct array, point to."""
    for k, reference in enumerate(item[()].reshape(-1), 1):
        yield from _hdf5(path, f"{around[0]}{k}{around[1]}", item.file[reference], depth + 1)
