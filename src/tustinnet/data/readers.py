"""Files of columns: CSV, Parquet, MAT (v5 and 7.3), NPZ."""

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError

Column = Float[np.ndarray, " n"]

_TEXT = (".csv", ".txt", ".tsv", ".dat")
NUMBERED = "column "  # how the columns of a file without header are called: "column 1", ...


class Columns:
    """The columns of a file by name, in the file's order, turned into numbers when asked for.

    A column of text that nobody asks for does no harm; one that is asked for is an `InputError`.

    Attributes:
        names: what the columns are called.
    """

    def __init__(
        self,
        names: Sequence[str],
        convert: Callable[[str], Column],
        rows: Sequence[int] | None = None,
    ) -> None:
        self.names, self._convert, self._rows = tuple(names), convert, rows

    def place(self, sample: int) -> str:
        """Where a sample stands: the row of a text file, else its number."""
        return (
            f"sample {sample} (counted from 0)"
            if self._rows is None
            else (f"row {self._rows[sample]}")
        )

    def __getitem__(self, name: str) -> Column:
        return self._convert(name)


def read_columns(path: Path, *, header: bool = True, delimiter: str | None = None) -> Columns:
    """Reads the columns of a file, by its ending.

    Args:
        path: a .csv, .txt, .tsv, .dat, .parquet, .mat or .npz file.
        header: whether the first row of a text file names the columns.
        delimiter: what separates the columns of a text file; a tab in .tsv, else a comma, by
            default.

    Returns:
        Columns by name. Without a header they are called `column 1`, ... The columns of a matrix
        `x` in a MAT or NPZ file are called `x[1]`, `x[2]`, ...

    Raises:
        InputError: the file is missing, empty or damaged; text where numbers belong (when the
            column is asked for).
    """
    readers: dict[str, Callable[[Path], Columns]] = {
        ".parquet": _read_parquet,
        ".mat": _read_mat,
        ".npz": _read_npz,
    }
    if not path.is_file():
        raise InputError(path, "no such file", "", "check the name in the card and the folder")
    if path.stat().st_size == 0:
        raise InputError(path, "the file is empty", "rows of samples")
    suffix = path.suffix.lower()
    if suffix in _TEXT:
        return _read_text(path, header, delimiter or ("\t" if suffix == ".tsv" else ","))
    if suffix not in readers:
        known = ", ".join((*_TEXT, *readers))
        raise InputError(path, f"ending '{suffix}'", f"one of {known}")
    try:
        columns = readers[suffix](path)
    except InputError:
        raise
    except Exception as error:  # the libraries below raise many kinds for a damaged file
        raise InputError(
            path, f"cannot be read as {suffix} ({error})", "a whole file of that format"
        ) from error
    if not columns.names:
        raise InputError(path, "the file holds no samples", "columns of numbers")
    return columns


def frame_columns(frame: Any, where: object = "frame") -> Columns:
    """The columns of a pandas or polars data frame; `where` names it in errors."""
    import polars as pl

    if not isinstance(frame, pl.DataFrame):
        if not hasattr(frame, "columns") or not hasattr(frame, "to_numpy"):
            raise InputError(where, f"a {type(frame).__name__}", "a pandas or polars data frame")
        arrays = {str(name): frame[name].to_numpy() for name in frame.columns}
        frame = pl.DataFrame(
            {name: a.astype(str) if a.dtype.kind == "O" else a for name, a in arrays.items()}
        )
    if not len(frame):
        raise InputError(where, "no samples", "rows of numbers")

    def convert(name: str) -> Column:
        # an empty cell becomes NaN, which the checks then name by row
        numbers = frame[name].cast(pl.Float64, strict=False)
        lost = np.flatnonzero((numbers.is_null() & frame[name].is_not_null()).to_numpy())
        if len(lost):
            raise InputError(
                f"{where}, sample {lost[0]} (counted from 0), {name}",
                f"'{str(frame[name][int(lost[0])])[:40]}'",
                "a number",
            )
        return numbers.fill_null(float("nan")).to_numpy()

    return Columns(frame.columns, convert)


def _read_text(path: Path, header: bool, delimiter: str) -> Columns:
    import polars as pl

    # blank lines and comments go, but errors name the rows of the file as it is
    kept = [
        (row, line)
        for row, line in enumerate(path.read_text("utf-8-sig", "replace").splitlines(), start=1)
        if line.strip() and not line.startswith("#")
    ]
    if len(kept) <= header:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    text = "\n".join(line for _, line in kept).encode()
    try:
        table = pl.read_csv(text, has_header=header, separator=delimiter, infer_schema=False)
    except pl.exceptions.PolarsError as error:
        raise InputError(
            path,
            _ragged(kept, delimiter) or f"cannot be read as text ({error})",
            f"rows of equal length separated by '{delimiter}'",
        ) from error
    if header:
        names = [name.strip() for name in table.columns]
    else:
        names = [f"{NUMBERED}{number}" for number in range(1, table.width + 1)]
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise InputError(path, f"two columns are called '{doubled[0]}'", "different names")
    rows = [row for row, _ in kept[header:]]

    def convert(name: str) -> Column:
        cells = table[:, names.index(name)].str.strip_chars()
        numbers = cells.cast(pl.Float64, strict=False)
        bad = np.flatnonzero(numbers.is_null().to_numpy())
        if len(bad):
            first = int(bad[0])
            hint = "correct or remove the row"
            if first == 0 and not header:
                hint = "if the first row names the columns, set `header = true`"
            raise InputError(
                f"{path} row {rows[first]}, {name}",
                f"the text '{cells[first][:40]}'" if cells[first] else "an empty cell",
                "a number",
                hint,
            )
        return numbers.to_numpy()

    return Columns(names, convert, rows)


def _ragged(lines: list[tuple[int, str]], delimiter: str) -> str | None:
    """Says which row has another number of cells than the first."""
    wanted = lines[0][1].count(delimiter)
    for row, line in lines:
        if line.count(delimiter) != wanted:
            cells = line.count(delimiter) + 1
            return f"row {row} has {cells} cells, row {lines[0][0]} has {wanted + 1}"
    return None


def _read_parquet(path: Path) -> Columns:
    import polars as pl

    return frame_columns(pl.read_parquet(path), path)


def _read_npz(path: Path) -> Columns:
    if not zipfile.is_zipfile(path):
        raise InputError(path, "not an NPZ file (or cut short)", "a file written by numpy.savez")
    with np.load(path, allow_pickle=False) as archive:
        return _held({name: archive[name] for name in archive.files})


def _read_mat(path: Path) -> Columns:
    import scipy.io

    try:
        content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:  # how scipy says that the file is version 7.3, which is HDF5
        return _read_mat73(path)
    return _held({k: v for k, v in content.items() if not k.startswith("__")})


def _read_mat73(path: Path) -> Columns:
    import h5py

    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub":
            # MATLAB stores matrices column-major: what h5py sees is the transpose
            found[name.replace("/", ".")] = np.asarray(item[()]).T

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return _held({k: v for k, v in found.items() if not k.startswith("#refs#")})


def _held(content: dict[str, Any]) -> Columns:
    columns = _flatten(content)
    return Columns(tuple(columns), columns.__getitem__)


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
