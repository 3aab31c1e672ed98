"""Files of columns: text, and the binary formats of the registry `READERS`."""

import re
import stat
from functools import partial
from pathlib import Path

from tustinnet.data import binary_files, reading_process
from tustinnet.data.columns import Columns
from tustinnet.data.formats.mat import OBJECT, object_remedy
from tustinnet.data.formats.reader import Reader
from tustinnet.data.text_file import read_text
from tustinnet.errors import InputError, convert_errors, require_package
from tustinnet.registry import READERS

_TEXT = (".csv", ".txt", ".tsv", ".dat", ".lvm", ".log")
_PROSE = re.compile(r"(?i)(read[-_ ]?me|licen[cs]e|copying|notes$|change[-_ ]?log)(?![a-z])")


def read_columns(
    path: Path,
    *,
    header: bool | int | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    skips_damaged: bool = False,
) -> Columns:
    """Reads the columns of a file, by its ending.

    Args:
        path: a file with one of the endings .csv, .txt, .tsv, .dat, .lvm, .log or of the registry
            `READERS`.
        header: whether the first row of a text file names the columns; by default it does unless
            it holds nothing but numbers. Or the row of the file, from 1 on, that names them.
        delimiter: the mark between the columns of a text file, a blank for any number of blanks;
            found by default.
        decimal: the mark before the decimals in a text file, `.` or `,`; found by default.
        encoding: the encoding of a text file; UTF-8, UTF-16 or Latin-1, as found, by default.
        skips_damaged: whether rows of a text file that are no samples are left out instead of
            refused.

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
        endings = ", ".join((*_TEXT, *READERS.names()))
        raise InputError(path, f"ending '{suffix}'", f"one of {endings}")
    with convert_errors(path, f"cannot be read as {suffix}", "a whole file of that format"):
        if suffix in _TEXT:
            return read_text(
                path,
                header=header,
                delimiter=delimiter,
                decimal=decimal,
                encoding=encoding,
                skips_damaged=skips_damaged,
            )
        reader: Reader = READERS[suffix]
        if reader.extra:
            require_package(reader.library.partition(".")[0], reader.extra, path)
        place = READERS.place(suffix)
        if isinstance(place, str):
            contents = reading_process.list_columns(path, place, reader)
            read = partial(reading_process.read, path, place, reader)
        else:  # one that a program registered: another process does not know it
            contents = binary_files.list_columns(path, reader)
            read = partial(binary_files.read, path, reader)
    if not contents.arrays:
        others = contents.others
        example = "".join(f", only {name or 'it'!r}: {x}" for name, x in [*others.items()][:1])
        remedy = object_remedy() if OBJECT in others.values() else ""
        raise InputError(path, f"the file holds no samples{example}", "columns of numbers", remedy)
    return Columns.from_contents(contents, read)


def is_readable(path: Path) -> bool:
    """Whether a path has the ending of a file that `read_columns` reads."""
    suffix = path.suffix.lower()
    return suffix in _TEXT or suffix in READERS


def is_text(path: Path) -> bool:
    """Whether a path has the ending of a text file."""
    return path.suffix.lower() in _TEXT


def is_log(path: Path) -> bool:
    """Whether a path is probably a log: a file that can be read, not hidden and no README.txt."""
    is_prose = path.suffix.lower() == ".txt" and _PROSE.match(path.stem)
    return is_readable(path) and not path.name.startswith(".") and not is_prose
