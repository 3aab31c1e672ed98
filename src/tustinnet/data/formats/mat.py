"""MAT files, up to version 7 and 7.3: their arrays of numbers by name, those inside of others too.

A field of a struct is `log.q`, the third element of a cell array `logs{3}`, that of a struct array
`logs(3)`.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.formats.hdf5 import members, require_all_inside
from tustinnet.data.formats.mat_objects import can_read_objects, object_arrays, object_names
from tustinnet.data.formats.reader import DEEPEST, REAL, Array, Contents, Reader, Shape
from tustinnet.errors import InputError, convert_errors

_NUMBERS = "c" + REAL
_HDF5 = b"\x89HDF\r\n\x1a\n"
_OBJECT = 3  # `MATLAB_object_decode` of objects
_UNNAMED = "None"  # the name that scipy gives objects
OBJECT = "a MATLAB object (timeseries, timetable, table, ...)"
_LABELS = ("name", "label", "signalname", "title")  # fields of a struct with what `Data` is
_UNITS = ("unit", "units", "DataInfo.units")
_DESCRIBED = ("data", "values")
_TEXT_FIELDS = {*_LABELS, "unit", "units"}
_LONGEST_TEXT = 200  # characters of a name or a unit
_NAMELESS = "unnamed"  # what MATLAB calls a timeseries that was given no name
_REMEDY = "save it as numbers: s = struct(ts), or t = ts.Time, x = ts.Data"


class MatVariable(NamedTuple):
    """A variable of a file, or a part of one.

    Attributes:
        name: its name in MATLAB.
        shape: shape of an array of numbers that can be columns, else None.
        load: function that reads the array.
        other: description of a variable that is no such array.
        clock: name of the variable of its times, where it has times of its own.
        label: what a text beside it calls it, as exports of dSPACE and Simulink have it.
        unit: its unit, where a text beside it says it.
        text: content of a short text, which may be such a label or unit.
    """

    name: str
    shape: Shape | None
    load: Callable[[], Array] = lambda: np.empty(0)
    other: str = ""
    clock: str = ""
    label: str = ""
    unit: str = ""
    text: str = ""


def object_remedy() -> str:
    """The way to numbers that are in an object of MATLAB."""
    pip = "" if can_read_objects() else ", or pip install 'tustinnet[matlab]'"
    return _REMEDY + pip


def _contents(path: Path) -> Contents:
    variables = list(_walk(path, None))
    objects = {v.name for v in variables if v.other == OBJECT}
    inner = _in_objects(path, objects) if objects and can_read_objects() else []
    # scipy may not know the name of an object
    opened = {o for o in objects if any(_is_in(v.name, o) for v in inner)} | (
        {""} if inner else set()
    )
    variables = _described([v for v in variables if v.name not in opened] + inner)
    variables = _without_name_of_file(path, variables)
    return Contents(
        [(v.name, v.shape) for v in variables if v.shape is not None],
        {v.name: v.other for v in variables if v.shape is None},
        {v.name: v.clock for v in variables if v.clock},
        {v.name: v.unit for v in variables if v.unit},
        {v.name: v.label for v in variables if v.label},
    )


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    arrays = {v.name: v.load() for v in _walk(path, names) if v.name in names}
    inside = {f"{path.stem}.{name}": name for name in names - {*arrays}}
    of_file = _walk(path, {*inside}) if inside else ()
    arrays |= {inside[v.name]: v.load() for v in of_file if v.name in inside}
    missing = names - {*arrays}
    inner = _in_objects(path, {_owner(name) for name in missing}) if missing else []
    return arrays | {v.name: v.load() for v in inner if v.name in missing}


def _without_name_of_file(path: Path, variables: list[MatVariable]) -> list[MatVariable]:
    """The fields of a struct by their own names, where it is called like the file and alone.

    So the files of dSPACE have the same names.
    """
    own = f"{path.stem}."
    if not all(v.name.startswith(own) for v in variables):
        return variables
    return [
        v._replace(name=v.name.removeprefix(own), clock=v.clock.removeprefix(own))
        for v in variables
    ]


def _in_objects(path: Path, objects: set[str]) -> list[MatVariable]:
    """The arrays in objects of these names, none where they cannot be read."""
    try:
        if "" in objects:
            objects = objects | {*object_names(path)}
        owners = sorted({_owner(name) for name in objects if name})
        arrays = list(object_arrays(path, owners)) if owners else []
    except Exception:  # objects that the library does not know, or damaged ones
        return []
    inner = [a for a in arrays if any(_is_in(a.name, name) for name in objects)]
    return list(
        _oriented(
            MatVariable(a.name, None, other="text", text=a.text[:_LONGEST_TEXT])
            if a.text
            else _numbers(a.name, a.values.shape, lambda a=a: a.values)._replace(clock=a.clock)
            for a in inner
        )
    )


def _described(variables: Sequence[MatVariable]) -> list[MatVariable]:
    """Variables with what the texts beside `Data` or `Values` call them, and with their units.

    A signal of a Simulink data set has its name beside the timeseries `Values`, which may have
    none.
    """
    texts = {_in_small_field(v.name): v.text for v in variables if v.text and v.text != _NAMELESS}

    def find(owner: str, fields: Sequence[str]) -> str:
        found = (texts.get(f"{owner}.{field}", "") for field in fields)
        return next((text for text in found if text), "")

    described: list[MatVariable] = []
    for v in variables:
        owner, _, field = v.name.rpartition(".")
        if v.shape is None or field.lower() not in _DESCRIBED or not texts:
            described.append(v)
            continue
        label = find(owner, _LABELS)
        if not label and owner.endswith(".Values"):
            label = find(owner.removesuffix(".Values"), _LABELS)
        described.append(v._replace(label=label, unit=find(owner, _UNITS)))
    return described


def _in_small_field(name: str) -> str:
    """A name whose last part is in small letters; variables `U` and `u` stay two."""
    owner, _, field = name.rpartition(".")
    return f"{owner}.{field.lower()}"


def _owner(name: str) -> str:
    """The variable that a part belongs to: `log` of `log.runs{3}.q`."""
    return re.split(r"[.({]", name)[0]


def _is_in(name: str, owner: str) -> bool:
    return bool(owner) and (
        name == owner or name.startswith((f"{owner}.", f"{owner}(", f"{owner}{{"))
    )


def _walk(path: Path, names: set[str] | None) -> Iterator[MatVariable]:
    """All variables of a file; with `names` only those from which these are read."""
    with path.open("rb") as file:
        head = file.read(512 + len(_HDF5))
    if not (head.startswith(_HDF5) or head[512:] == _HDF5):
        yield from _oriented(_mat5(path, names))
        return
    import h5py

    with h5py.File(path, "r") as file:
        require_all_inside(path, file)
        yield from _oriented(
            variable
            for name, item in members(file)
            if not name.startswith("#")  # targets of references, and objects
            for variable in _hdf5(path, name, item, 0)
        )


def _numbers(name: str, shape: Shape, load: Callable[[], Array]) -> MatVariable:
    """An array of numbers: columns, where it has at least two numbers in one or two dimensions."""
    size, squeezed = math.prod(shape), tuple(n for n in shape if n != 1)
    if size < 2:
        other = f"the number {load().item():.6g}" if size else "empty"
        return MatVariable(name, None, other=other)
    if len(squeezed) > 2:
        return MatVariable(name, None, other=f"an array of {len(squeezed)} dimensions")
    return MatVariable(name, squeezed, lambda: load().reshape(squeezed))


def _has_signals_in_rows(shape: Shape) -> bool:
    """Whether a matrix is as `To File` of Simulink writes it: a signal a row, many samples each."""
    # at most 64 signals
    return shape[0] <= 64 and shape[1] >= max(200, 20 * shape[0])


def _oriented(variables: Iterable[MatVariable]) -> Iterator[MatVariable]:
    """Variables with samples first; a timeseries may have `Data` of channels by samples."""
    variables = list(variables)
    shapes = {v.name: v.shape for v in variables}
    for v in variables:
        times = (
            shapes.get(f"{v.name.removesuffix('Data')}Time") if v.name.endswith(".Data") else None
        )
        is_turned = False
        if v.shape is not None and len(v.shape) == 2:
            rows, columns = v.shape
            is_turned = rows != times[0] == columns if times else _has_signals_in_rows(v.shape)
        if v.shape is not None and is_turned:
            yield v._replace(shape=v.shape[::-1], load=lambda load=v.load: load().T)
        else:
            yield v


# --- up to version 7 ---


def _mat5(path: Path, names: set[str] | None) -> Iterator[MatVariable]:
    import scipy.io

    variables = None if names is None else {_owner(name) for name in names}
    try:
        contents = scipy.io.whosmat(path)
    except TypeError:  # it fails on objects, which have no size
        for name, value in _mat5_content(path, None if variables is None else [*variables]).items():
            if name != _UNNAMED:
                yield from _mat5_value(name, value)
                continue
            # scipy gives all objects one name, and keeps the last one
            yield MatVariable("", None, other=OBJECT)
            has_names = getattr(value, "dtype", np.dtype(int)).names
            for text in np.atleast_1d(value)["s0"] if has_names else ():
                if isinstance(text, bytes):
                    yield MatVariable(text.decode("latin1"), None, other=OBJECT)
        return
    for name, shape, kind in contents:
        if variables is not None and name not in variables:
            continue
        if kind in ("struct", "cell"):
            value = _mat5_variable(path, name)
            # scipy takes the only element out of its cell
            single = kind == "cell" and math.prod(shape) == 1
            yield from _mat5_value(
                f"{name}{{1}}" if single else name, value, "{}" * (kind == "cell")
            )
        elif kind == "char":
            yield MatVariable(name, None, other="text")
        elif kind in ("object", "function", "unknown"):
            yield MatVariable(name, None, other=OBJECT)
        elif kind == "sparse":
            yield MatVariable(name, None, other="a sparse matrix")
        else:
            read = lambda name=name: np.asarray(_mat5_variable(path, name))  # noqa: E731
            yield _numbers(name, shape, read)


def _mat5_variable(path: Path, name: str) -> Any:
    with convert_errors(f"{path}, {name}", "the variable is cut short or damaged", "a whole file"):
        return _mat5_content(path, [name])[name]


def _mat5_content(path: Path, names: list[str] | None) -> dict[str, Any]:
    import scipy.io

    content = scipy.io.loadmat(path, variable_names=names, squeeze_me=True, struct_as_record=False)
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _mat5_value(name: str, value: Any, brackets: str = "") -> Iterator[MatVariable]:
    """The contents of a struct, a cell array (`brackets`) or a struct array from scipy."""
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    if isinstance(value, MatlabOpaque | MatlabObject | MatlabFunction):
        yield MatVariable(name, None, other=OBJECT)
    elif hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _mat5_value(f"{name}.{field}", getattr(value, field))
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        elements = value.ravel(order="F")
        structs = all(hasattr(element, "_fieldnames") for element in elements)
        opening, closing = brackets or ("()" if structs else "{}")
        for k, element in enumerate(elements, 1):
            yield from _mat5_value(f"{name}{opening}{k}{closing}", element)
    else:
        array = np.asarray(value)
        if array.dtype.kind in _NUMBERS:
            yield _numbers(name, array.shape, lambda: array)
        elif array.dtype.kind == "U":
            text = value.strip()[:_LONGEST_TEXT] if isinstance(value, str) else ""
            yield MatVariable(name, None, other="text", text=text)
        else:
            yield MatVariable(name, None, other="no numbers")


# --- version 7.3 ---


def _hdf5(path: Path, name: str, item: Any, depth: int) -> Iterator[MatVariable]:
    import h5py

    if depth > DEEPEST:
        raise InputError(path, f"'{name}' is nested deeper than {DEEPEST}", "a few structs")
    kind = item.attrs.get("MATLAB_class", b"")
    if item.attrs.get("MATLAB_object_decode") == _OBJECT:
        yield MatVariable(name, None, other=OBJECT)
    elif isinstance(item, h5py.Group):
        for field, inner in members(item):
            if _has_references(inner) and not inner.attrs.get("MATLAB_class"):  # a struct array
                yield from _elements(path, f"{name}(", f").{field}", inner, depth)
            else:
                yield from _hdf5(path, f"{name}.{field}", inner, depth + 1)
    elif not isinstance(item, h5py.Dataset):
        return
    elif _has_references(item):
        yield from _elements(path, f"{name}{{", "}", item, depth)
    elif kind == b"char" or item.dtype.kind in "SO":
        yield MatVariable(name, None, other="text", text=_hdf5_text(name, item))
    elif item.attrs.get("MATLAB_empty"):
        yield MatVariable(name, None, other="empty")
    elif item.dtype.kind in REAL:
        # MATLAB stores matrices column-major: h5py sees the transpose
        yield _numbers(name, (item.shape or ())[::-1], lambda: item[()].T)
    else:
        yield MatVariable(name, None, other="no real numbers")


def _hdf5_text(name: str, item: Any) -> str:
    """The content of a short text that may be a label or a unit: codes of its characters."""
    is_telling = name.rpartition(".")[2].lower() in _TEXT_FIELDS
    is_row = item.dtype.kind == "u" and item.size == max(item.shape or (0,)) <= _LONGEST_TEXT
    if not is_telling or not is_row or item.attrs.get("MATLAB_empty"):
        return ""
    codes = item[()].reshape(-1).astype("<u2")
    return codes.tobytes().decode("utf-16-le", "replace").strip("\0 ")


def _has_references(item: Any) -> bool:
    import h5py

    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is not None


def _elements(path: Path, before: str, after: str, item: Any, depth: int) -> Iterator[MatVariable]:
    """The elements of a cell array, or of a field of a struct array, by its references."""
    for k, reference in enumerate(item[()].reshape(-1), 1):
        yield from _hdf5(path, f"{before}{k}{after}", item.file[reference], depth + 1)


READER = Reader("scipy.io", _contents, _arrays)
