"""Text files of columns."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from tustinnet.data.columns import NUMBERED, Column, Columns, require_different
from tustinnet.errors import InputError, describe_error

if TYPE_CHECKING:
    import polars as pl

_NEWLINE, _BLANK = ord("\n"), ord(" ")
_AT_ONCE = 10**5  # lines that are checked at once
_NUMBER = re.compile(r"[-+]?((\d+\.?\d*|\.\d+)(e[-+]?\d+)?|nan|inf|infinity)", re.IGNORECASE)

Lines = list[tuple[int, str]]  # rows of the file, counted from 1, and their text


def read_text(path: Path, header: bool | None, delimiter: str) -> Columns:
    """Reads the columns of a text file; see `read_columns`.

    Blank lines and lines that begin with `#` are no rows. Every other line is one: a quote that
    would make one row of several lines is refused. Errors name the rows of the file as it is.
    """
    content = path.read_bytes()
    plain = _plain_rows(content, delimiter)
    lines = plain.first_line if plain else _lines(path, content, delimiter)
    table = _cells(path, lines, delimiter)
    all_rows = plain.rows if plain else [row for row, _ in lines]
    first_row, first = lines[0][0], [(cell or "").strip() for cell in table.row(0)]
    del content, lines
    texts = [cell for cell in first if cell]
    is_sample = bool(texts) and all(_NUMBER.fullmatch(text) for text in texts)
    if header and is_sample:
        raise InputError(
            f"{path} row {first_row}",
            "only numbers where the names of the columns should be",
            "a header, as `header = true` says",
            "if the file has none, set `header = false` under [format], or leave it out",
        )
    has_header = not is_sample if header is None else header
    if len(all_rows) <= has_header:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    numbered = [f"{NUMBERED}{number}" for number in range(1, table.width + 1)]
    names = [a or b for a, b in zip(first, numbered, strict=True)] if has_header else numbered
    require_different(names, path)
    index = {name: column for column, name in enumerate(names)}
    rows = all_rows[has_header:]

    def read(requested: list[str]) -> list[Column]:
        doubtful = next((name for name in requested if _NUMBER.fullmatch(name)), None)
        if header is None and doubtful is not None:  # names beside numbers, some of them used
            raise InputError(
                f"{path} row {first_row}",
                f"names of columns and the number {doubtful}",
                "names or numbers only",
                "set `header = true` (names) or `header = false` (a sample) under [format]",
            )
        cells = table
        if plain is not None:
            columns = [index[name] for name in requested]
            if (numbers := plain.numbers(columns, delimiter, skipped=int(has_header))) is not None:
                return numbers
            # the cell that is no number is looked for as in any other file
            cells = _cells(path, _lines(path, plain.text, delimiter), delimiter)
        cells = cells.slice(int(has_header))
        return [
            _numbers(cells.to_series(index[name]), f"{path} row {{}}, {name}", rows, has_header)
            for name in requested
        ]

    notes = ("no header: the first row is a sample",) if header is None and is_sample else ()
    return Columns(names, read, rows, notes)


@dataclass(frozen=True)
class _PlainRows:
    """The rows of a file that can be read as numbers at once, without a text for every cell.

    Attributes:
        text: the rows, without blank lines and comments.
        rows: their rows in the file, counted from 1.
    """

    text: bytes
    rows: Sequence[int] | Int[np.ndarray, " n"]

    @property
    def first_line(self) -> Lines:
        """The first row alone."""
        return [(int(self.rows[0]), self.text.partition(b"\n")[0].decode())]

    def numbers(self, columns: list[int], delimiter: str, *, skipped: int) -> list[Column] | None:
        """The numbers of some columns, without the rows that are skipped; None where one is none.

        Args:
            columns: indices of the columns.
            delimiter: the mark between cells.
            skipped: number of rows before the first sample.
        """
        import polars as pl

        width = self.first_line[0][1].count(delimiter) + 1
        schema = {str(i): pl.Float64 if i in columns else pl.String for i in range(width)}
        names = [str(column) for column in columns]
        try:
            lazy = pl.scan_csv(
                self.text, has_header=False, separator=delimiter, skip_rows=skipped, schema=schema
            )
            table = lazy.select(names).collect()
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
            return None
        if len(table) != len(self.rows) - skipped or any(table.null_count().row(0)):
            return None
        return [table[name].to_numpy() for name in names]


def _plain_rows(content: bytes, delimiter: str) -> _PlainRows | None:
    """The rows of a file in ASCII without quotes, each as long as the first; None of others."""
    content = content.replace(b"\r\n", b"\n")
    if not content.isascii() or any(mark in content for mark in (b'"', b"\r", b"\0")):
        return None
    marks = np.frombuffer(content, np.uint8)
    ends = np.flatnonzero(marks == _NEWLINE)
    if not content.endswith(b"\n"):
        ends = np.append(ends, len(content))
    starts = np.concatenate([[0], ends[:-1] + 1])
    first = marks[np.minimum(starts, len(marks) - 1)]
    is_row = (starts < ends) & (first != ord("#"))
    rows = np.flatnonzero(is_row)
    if not len(rows) or (first[rows] <= _BLANK).any():  # perhaps blank: a closer look is needed
        return None
    cells = content[starts[rows[0]] : ends[rows[0]]].count(delimiter.encode())
    for begin in range(0, len(starts), _AT_ONCE):
        some = slice(begin, begin + _AT_ONCE)
        origin, stop = starts[some][0], ends[some][-1] + 1
        is_mark = (marks[origin:stop] == ord(delimiter)).astype(np.uint32)
        if len(is_mark) == starts[some][-1] - origin:  # the last line is empty
            is_mark = np.append(is_mark, np.uint32(0))
        counts = np.add.reduceat(is_mark, starts[some] - origin)
        if (counts[is_row[some]] != cells).any():
            return None
    if not is_row.all():
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        content = b"\n".join(content[starts[run[0]] : ends[run[-1]]] for run in runs)
    is_run = rows[-1] - rows[0] + 1 == len(rows)
    numbered = range(int(rows[0]) + 1, int(rows[-1]) + 2) if is_run else rows + 1
    return _PlainRows(content, numbered)


def _lines(path: Path, content: bytes, delimiter: str) -> Lines:
    if b"\0" in content or content.startswith((b"\xff\xfe", b"\xfe\xff")):  # zeros or UTF-16
        raise InputError(
            path, "not a text file in UTF-8", "rows of numbers as text", "save it as UTF-8"
        )
    text = content.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\r", "\n")
    lines = [
        (row, line)
        for row, line in enumerate(text.split("\n"), start=1)
        # empty cells between tabs are a row
        if (line.strip() or (delimiter == "\t" and "\t" in line)) and not line.startswith("#")
    ]
    if not lines:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    return lines


def _cells(path: Path, lines: Lines, delimiter: str) -> "pl.DataFrame":
    """The cells as text, a row for every line."""
    import polars as pl

    text = "\n".join(line for _, line in lines).encode()
    try:
        table = pl.read_csv(text, has_header=False, separator=delimiter, infer_schema=False)
        defect = None if len(table) == len(lines) else f"{len(lines)} lines make {len(table)} rows"
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        table, defect = pl.DataFrame(), f"cannot be read as text ({describe_error(error)})"
    if defect is None:
        return table
    first_row, width = lines[0][0], lines[0][1].count(delimiter) + 1
    unclosed = next((row for row, line in lines if line.count('"') % 2), None)
    counts = [(row, line.count(delimiter) + 1) for row, line in lines]
    ragged = next(((row, cells) for row, cells in counts if cells != width), None)
    if unclosed is not None:
        defect = f'row {unclosed} has a quote (") that is not closed'
    elif ragged is not None:
        defect = f"row {ragged[0]} has {ragged[1]} cells, row {first_row} has {width}"
    raise InputError(path, defect, f"rows of equal length separated by '{delimiter}'")


def _numbers(
    cells: "pl.Series", where: str, rows: Sequence[int] | Int[np.ndarray, " n"], has_header: bool
) -> Column:
    """The numbers of some cells; `where` has {} in place of the row, for the message."""
    import polars as pl

    numbers = cells.cast(pl.Float64, strict=False)
    if numbers.null_count():
        numbers = cells.str.strip_chars().cast(pl.Float64, strict=False)
    if numbers.null_count():
        sample = int(np.flatnonzero(numbers.is_null().to_numpy())[0])
        text = (cells[sample] or "").strip()
        raise InputError(
            where.format(rows[sample]),
            f"the text '{text[:40]}'" if text else "an empty cell",
            "a number",
            "correct or remove the row"
            if has_header or sample
            else "if the first row names the columns, set `header = true`",
        )
    return numbers.to_numpy()
