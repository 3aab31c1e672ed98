"""Files of columns: CSV, Parquet, MAT (v5 and 7.3), NPZ."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError

Column = Float[np.ndarray, " n"]

NUMBERED = "column "  # how the columns of a file without header are called: "column 1", ...


def read_columns(path: Path, *, header: bool = True, delimiter: str = ",") -> dict[str, Column]:
    """Reads the numeric columns of a file, by its ending.

    Args:
        path: a .csv, .txt, .tsv, .parquet, .mat or .npz file.
        header: whether the first row of a text file names the columns.
        delimiter: what separates the columns of a text file.

    Returns:
        Columns by name, in the file's order. Without a header they are called `column 1`, ...
        The columns of a matrix `x` in a MAT or NPZ file are called `x[1]`, `x[2]`, ...

    Raises:
        InputError: the file is missing, empty, damaged, or holds text where numbers belong.
    """
    readers: dict[str, Callable[[Path], dict[str, Column]]] = {
        ".parquet": _read_parquet,
        ".mat": _read_mat,
        ".npz": _read_npz,
    }
    if not path.is_file():
        raise InputError(path, "no such file", "", "check the name in the card and the folder")
    if path.stat().st_size == 0:
        raise InputError(path, "the file is empty", "rows of samples")
    suffix = path.suffix.lower()
    if suffix in (".csv", ".txt", ".tsv", ".dat"):
        columns = _read_text(path, header, delimiter)
    elif suffix in readers:
        try:
            columns = readers[suffix](path)
        except InputError:
            raise
        except Exception as error:  # the libraries below raise many kinds for a damaged file
            raise InputError(
                path, f"cannot be read as {suffix} ({error})", "a whole file of that format"
            ) from error
    else:
        raise InputError(
            path, f"ending '{suffix}'", ".csv, .txt, .tsv, .dat, .parquet, .mat or .npz"
        )
    if not columns or not len(next(iter(columns.values()))):
        raise InputError(path, "the file holds no samples", "rows of numbers")
    return columns


def frame_columns(frame: Any, where: object = "frame") -> dict[str, Column]:
    """The numeric columns of a pandas or polars data frame."""
    import polars as pl

    if not isinstance(frame, pl.DataFrame):
        if not hasattr(frame, "columns") or not hasattr(frame, "to_numpy"):
            raise InputError(where, f"a {type(frame).__name__}", "a pandas or polars data frame")
        frame = pl.DataFrame({str(name): np.asarray(frame[name]) for name in frame.columns})
    columns = {}
    for name in frame.columns:
        if frame[name].dtype.is_numeric():
            # an empty cell becomes NaN, which the checks then name by row
            columns[name] = frame[name].cast(pl.Float64).fill_null(float("nan")).to_numpy()
    return columns


def _read_text(path: Path, header: bool, delimiter: str) -> dict[str, Column]:
    import polars as pl

    try:
        table = pl.read_csv(
            path, has_header=header, separator=delimiter, infer_schema=False, comment_prefix="#"
        )
    except pl.exceptions.PolarsError as error:
        raise InputError(
            path,
            _ragged(path, delimiter) or f"cannot be read as text ({error})",
            f"rows of equal length separated by '{delimiter}'",
        ) from error
    columns = {}
    first_row = 2 if header else 1
    for number, name in enumerate(table.columns, start=1):
        called = name.strip() if header else f"{NUMBERED}{number}"
        text = table[name].str.strip_chars()
        numbers = text.cast(pl.Float64, strict=False)
        bad = np.flatnonzero(numbers.is_null().to_numpy())
        if len(bad):
            found = text[int(bad[0])]
            hint = (
                "if the first row names the columns, set `header = true`"
                if not header and bad[0] == 0
                else "correct or remove the row"
            )
            raise InputError(
                f"{path} row {bad[0] + first_row}, {called}",
                "an empty cell" if not found else f"the text '{found[:40]}'",
                "a number",
                hint,
            )
        columns[called] = numbers.to_numpy()
    return columns


def _ragged(path: Path, delimiter: str) -> str | None:
    """Says which row of a text file has another number of cells than the first."""
    with path.open(encoding="utf-8", errors="replace") as file:
        wanted = None
        for row, line in enumerate(file, start=1):
            if line.startswith("#") or not line.strip():
                continue
            cells = line.count(delimiter) + 1
            wanted = wanted or cells
            if cells != wanted:
                return f"row {row} has {cells} cells, the first row {wanted}"
    return None


def _read_parquet(path: Path) -> dict[str, Column]:
    import polars as pl

    return frame_columns(pl.read_parquet(path), path)


def _read_npz(path: Path) -> dict[str, Column]:
    if not zipfile.is_zipfile(path):
        raise InputError(path, "not an NPZ file (or cut short)", "a file written by numpy.savez")
    with np.load(path, allow_pickle=False) as archive:
        return _flatten({name: archive[name] for name in archive.files})


def _read_mat(path: Path) -> dict[str, Column]:
    import scipy.io

    try:
        content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:  # how scipy says that the file is version 7.3, which is HDF5
        return _read_mat73(path)
    return _flatten({k: v for k, v in content.items() if not k.startswith("__")})


def _read_mat73(path: Path) -> dict[str, Column]:
    import h5py

    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub":
            # MATLAB stores matrices column-major: what h5py sees is the transpose
            found[name.replace("/", ".")] = np.asarray(item[()]).T

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return _flatten({k: v for k, v in found.items() if not k.startswith("#refs#")})


def _flatten(content: dict[str, Any]) -> dict[str, Column]:
    """Numeric vectors, the columns of matrices, and the fields of structs, by dotted name."""
    columns: dict[str, Column] = {}
    for name, value in content.items():
        if hasattr(value, "_fieldnames"):
            fields = {f: getattr(value, f) for f in value._fieldnames}
            columns |= {f"{name}.{k}": v for k, v in _flatten(fields).items()}
            continue
        array = np.asarray(value)
        if array.dtype.kind not in "fiub" or array.size < 2:
            continue
        array = array.astype(np.float64)
        if array.ndim == 1 or (array.ndim == 2 and 1 in array.shape):
            columns[name] = array.reshape(-1)
        elif array.ndim == 2:
            columns |= {f"{name}[{j}]": array[:, j - 1] for j in range(1, array.shape[1] + 1)}
    return columns
