"""HDF5 files: data sets in groups, as `run1/angle`; groups of one kind are records."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.formats.reader import (
    DEEPEST,
    REAL,
    Array,
    Contents,
    Reader,
    Shape,
    parts_of_groups,
)
from tustinnet.errors import InputError

_UNITS = ("units", "unit", "Units", "Unit")  # attributes


class _Item(NamedTuple):
    """A data set, or a field of one of compound type; `shape` is None where it has no columns."""

    name: str
    data: Any
    field: str | None
    shape: Shape | None
    other: str = ""


def members(group: Any) -> Iterator[tuple[str, Any]]:
    """The members of a group without links, which may lead into another file, or back."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, group[name]


def require_all_inside(path: Path, group: Any) -> None:
    """Raises unless all that a group leads to is in the file, for libraries that follow any link.

    Raises:
        InputError: a link to another file, or numbers that are in one.
    """
    import h5py

    def find_outside(name: str, link: Any) -> str | None:
        is_outside = isinstance(link, h5py.ExternalLink)
        if isinstance(link, h5py.HardLink) and isinstance(item := group[name], h5py.Dataset):
            is_outside = _is_elsewhere(item)
        return name if is_outside else None

    name = group.visititems_links(find_outside)
    if name is not None:
        raise _elsewhere_error(path, name)


def _is_elsewhere(data: Any) -> bool:
    """Whether the numbers of a data set are in another file."""
    return bool(data.external or data.is_virtual)


def _elsewhere_error(path: Path, name: str) -> InputError:
    return InputError(path, f"the numbers of '{name}' are in another file", "in this file")


def _contents(path: Path) -> Contents:
    import h5py

    arrays, others, units = [], {}, {}
    with h5py.File(path, "r") as file:
        for item in _walk(path, "", file, 0):
            if item.shape is None:
                others[item.name] = item.other
                continue
            arrays.append((item.name, item.shape))
            texts = (item.data.attrs.get(key) for key in _UNITS)
            unit = next((text for text in texts if isinstance(text, str | bytes)), "")
            units[item.name] = unit if isinstance(unit, str) else unit.decode("utf-8", "replace")
    return Contents(arrays, others, units=units, parts=parts_of_groups(arrays))


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    import h5py

    with h5py.File(path, "r") as file:
        return {
            item.name: np.asarray(
                item.data[()] if item.field is None else item.data[item.field]
            ).reshape(item.shape)
            for item in _walk(path, "", file, 0)
            if item.name in names and item.shape is not None
        }


def _walk(path: Path, prefix: str, group: Any, depth: int) -> Iterator[_Item]:
    import h5py

    if depth > DEEPEST:
        raise InputError(path, f"'{prefix}' is nested deeper than {DEEPEST}", "a few groups")
    for key, inner in members(group):
        name = f"{prefix}{key}"
        if isinstance(inner, h5py.Group):
            yield from _walk(path, f"{name}/", inner, depth + 1)
        elif isinstance(inner, h5py.Dataset):
            fields = inner.dtype.names
            for field in fields or (None,):
                dtype = inner.dtype if field is None else inner.dtype[field]
                full = name if field is None else f"{name}.{field}"
                shape = tuple(n for n in (*(inner.shape or ()), *dtype.shape) if n != 1)
                if dtype.base.kind not in REAL:
                    yield _Item(full, inner, field, None, "no real numbers")
                elif len(shape) not in (1, 2) or 0 in shape:
                    other = f"of shape {inner.shape}"
                    if not inner.shape and field is None and not _is_elsewhere(inner):
                        other = f"the number {inner[()]:.6g}"
                    yield _Item(full, inner, field, None, other)
                else:
                    if _is_elsewhere(inner):
                        raise _elsewhere_error(path, full)
                    yield _Item(full, inner, field, shape)


READER = Reader("h5py", _contents, _arrays)
