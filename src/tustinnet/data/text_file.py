"""Text files of columns."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tustinnet.data.columns import NUMBERED, Column, Columns, require_different
from tustinnet.errors import InputError, describe_error

if TYPE_CHECKING:
    import polars as pl

_NUMBER = re.compile(r"[-+]?((\d+\.?\d*|\.\d+)(e[-+]?\d+)?|nan|inf|infinity)", re.IGNORECASE)

Lines = list[tuple[int, str]]  # rows of the file, counted from 1, and their text


def read_text(path: Path, header: bool | None, delimiter: str) -> Columns:
    """Reads the columns of a text file; see `read_columns`.

    Blank lines and lines that begin with `#` are no rows. Every other line is one: a quote that
    would make one row of several lines is refused. Errors name the rows of the file as it is.
    Where the rows begin with a sample, the last line before them that begins with `#` is the
    header if it has a name for every column.
    """
    lines, comment = _lines(path, delimiter)
    table = _cells(path, lines, delimiter)
    first = [(cell or "").strip() for cell in table.row(0)]
    texts = [cell for cell in first if cell]
    is_sample = bool(texts) and all(_NUMBER.fullmatch(text) for text in texts)
    commented = (
        _names_in(comment, delimiter, len(first)) if is_sample and header is not False else []
    )
    if commented:
        lines.insert(0, (lines[0][0], comment))
        first = commented
    if header and is_sample and not commented:
        raise InputError(
            f"{path} row {lines[0][0]}",
            "only numbers where the names of the columns should be",
            "a header, as `header = true` says",
            "if the file has none, set `header = false` under [format], or leave it out",
        )
    has_header = bool(commented) or (not is_sample if header is None else header)
    if len(lines) <= has_header:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    numbered = [f"{NUMBERED}{number}" for number in range(1, table.width + 1)]
    names = [a or b for a, b in zip(first, numbered, strict=True)] if has_header else numbered
    require_different(names, path)
    index = {name: column for column, name in enumerate(names)}
    rows = [row for row, _ in lines[has_header:]]
    table = table.slice(int(has_header and not commented))

    def read(requested: list[str]) -> list[Column]:
        doubtful = next((name for name in requested if _NUMBER.fullmatch(name)), None)
        if header is None and doubtful is not None:  # names beside numbers, some of them used
            raise InputError(
                f"{path} row {lines[0][0]}",
                f"names of columns and the number {doubtful}",
                "names or numbers only",
                "set `header = true` (names) or `header = false` (a sample) under [format]",
            )
        return [
            _numbers(table.to_series(index[name]), f"{path} row {{}}, {name}", rows, has_header)
            for name in requested
        ]

    notes = ()
    if header is None and is_sample:
        notes = (
            ("the header is the line of names that begins with #",) if commented
            else ("no header: the first row is a sample",)
        )  # fmt: skip
    return Columns(names, read, rows, notes)


def _lines(path: Path, delimiter: str) -> tuple[Lines, str]:
    """The rows of a file, and the last line before them that begins with `#`, without that."""
    content = path.read_bytes()
    if b"\0" in content or content.startswith((b"\xff\xfe", b"\xfe\xff")):  # zeros or UTF-16
        raise InputError(
            path, "not a text file in UTF-8", "rows of numbers as text", "save it as UTF-8"
        )
    text = content.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\r", "\n")
    lines: Lines = []
    comment = ""
    for row, line in enumerate(text.split("\n"), start=1):
        if line.startswith("#"):
            comment = comment if lines else line.lstrip("#")
        # empty cells between tabs are a row
        elif line.strip() or (delimiter == "\t" and "\t" in line):
            lines.append((row, line))
    if not lines:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    return lines, comment


def _names_in(comment: str, delimiter: str, width: int) -> list[str]:
    """The names of all columns in a comment, none where it is something else."""
    cells = [cell.strip().strip('"') for cell in comment.strip().split(delimiter)]
    is_header = len(cells) == width and all(cells) and len(set(cells)) == width
    return cells if is_header and not any(map(_NUMBER.fullmatch, cells)) else []


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


def _numbers(cells: "pl.Series", where: str, rows: list[int], has_header: bool) -> Column:
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
