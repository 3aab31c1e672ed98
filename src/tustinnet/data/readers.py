"""Files of columns: CSV, Parquet, MAT (v5 and 7.3), NPZ."""

import re
import stat
from functools import partial
from pathlib import Path

from tustinnet.data import reading_process
from tustinnet.data.columns import Columns
from tustinnet.data.mat_file import OBJECT, OBJECT_REMEDY
from tustinnet.data.text_file import read_text
from tustinnet.errors import InputError, convert_errors

_TEXT = (".csv", ".txt", ".tsv", ".dat")
_BINARY = (".parquet", ".mat", ".npz")
_PROSE = re.compile(r"(?i)(read[-_ ]?me|licen[cs]e|copying|notes$|change[-_ ]?log)(?![a-z])")


def read_columns(
    path: Path, *, header: bool | None = None, delimiter: str | None = None
) -> Columns:
    """Reads the columns of a file, by its ending.

    Args:
        path: a .csv, .txt, .tsv, .dat, .parquet, .mat or .npz file.
        header: whether the first row of a text file names the columns; by default it does unless
            it holds nothing but numbers.
        delimiter: the mark between the columns of a text file; a tab in .tsv, else a comma, by
            default.

    Returns:
        Columns by name. Without a header they are called `column 1`, ... The columns of a matrix
        `x` in a MAT or NPZ file are called `x[1]`, `x[2]`, ..., those in a struct `s.x`, in a cell
        or struct array `c{1}.x`, `s(1).x`. Only requested columns of a binary file are
        loaded.

    Raises:
        InputError: the file is missing, empty, damaged or no file; two columns of one name; text
            where numbers belong, or more numbers than fit (when the column is read).
    """
    with convert_errors(path, "cannot be opened", "a file"):
        try:
            mode = path.stat().st_mode
        except FileNotFoundError:
            raise InputError(
                path, "no such file", "", "check the name in the card and the folder"
            ) from None
    if not stat.S_ISREG(mode):  # reading a pipe or a device may never end
        raise InputError(path, "a folder, pipe or device", "a file")
    if path.stat().st_size == 0:
        raise InputError(path, "the file is empty", "rows of samples")
    suffix = path.suffix.lower()
    if not is_readable(path):
        raise InputError(path, f"ending '{suffix}'", f"one of {', '.join((*_TEXT, *_BINARY))}")
    with convert_errors(path, f"cannot be read as {suffix}", "a whole file of that format"):
        if suffix in _TEXT:
            return read_text(path, header, delimiter or ("\t" if suffix == ".tsv" else ","))
        names, others = reading_process.column_names(path)
    if not names:
        example = "".join(f", only {name or 'it'!r}: {x}" for name, x in [*others.items()][:1])
        remedy = OBJECT_REMEDY if OBJECT in others.values() else ""
        raise InputError(path, f"the file holds no samples{example}", "columns of numbers", remedy)
    return Columns(names, partial(reading_process.read, path), others=others)


def is_readable(path: Path) -> bool:
    """Whether a path has the ending of a file that `read_columns` reads."""
    return path.suffix.lower() in (*_TEXT, *_BINARY)


def is_log(path: Path) -> bool:
    """Whether a path is probably a log: a file that can be read, not hidden and no README.txt."""
    is_prose = path.suffix.lower() == ".txt" and _PROSE.match(path.stem)
    return is_readable(path) and not path.name.startswith(".") and not is_prose
