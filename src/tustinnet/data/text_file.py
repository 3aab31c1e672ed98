"""Text files of columns."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tustinnet.data.columns import NUMBERED, Column, Columns, require_different
from tustinnet.data.text_dialect import (
    BLANKS,
    NUMBER,
    Dialect,
    Header,
    Lines,
    comment_text,
    decode,
    find_dialect,
    is_comment,
    read_header,
)
from tustinnet.errors import InputError, describe_error

if TYPE_CHECKING:
    import polars as pl

_HEADER_ROWS = 4  # first rows that may be names, names, units and a sample


def read_text(
    path: Path,
    *,
    header: bool | int | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
) -> Columns:
    """Reads the columns of a text file; see `read_columns`.

    Blank lines and comments are no rows. Every other line is one: a quote that would make one row
    of several lines is refused. Errors name the rows of the file as it is.
    """
    text, remark = decode(path, encoding)
    lines, comment = _lines(text)
    if header is not None and not isinstance(header, bool):
        lines = [(row, line) for row, line in lines if row >= header]
        header, comment = True, ""
    if not lines:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    prefers_tabs = path.suffix.lower() == ".tsv"
    dialect = find_dialect(lines, delimiter, decimal, prefers_tabs=prefers_tabs, where=path)
    if dialect.delimiter != "\t":  # empty cells between tabs are a row
        lines = [(row, line) for row, line in lines if line.strip()]
    if not lines:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    skipped = 0 if header is False else _preamble(lines, dialect)
    lines = lines[skipped:]
    table = _cells(path, lines, dialect)
    first = _texts(table, 0)
    is_sample = any(first) and all(dialect.is_number(cell) for cell in first if cell)
    if header and is_sample:
        raise InputError(
            f"{path} row {lines[0][0]}",
            "only numbers where the names of the columns should be",
            "a header, as `header = true` says",
            "if the file has none, set `header = false` under [format], or leave it out",
        )
    numbered = [f"{NUMBERED}{number}" for number in range(1, table.width + 1)]
    found = Header(numbered, {}, 0)
    if (not is_sample) if header is None else header:
        rows = [_texts(table, k) for k in range(min(_HEADER_ROWS, len(table)))]
        found = read_header(rows, dialect)
    elif header is None and (names := _names_in(comment, dialect, table.width)):
        found = Header(names, {}, 0)
    if len(lines) <= found.rows:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    names = [a or b for a, b in zip(found.names, numbered, strict=True)]
    require_different(names, path)
    index = {name: column for column, name in enumerate(names)}
    rows, table = [row for row, _ in lines[found.rows :]], table.slice(found.rows)

    def read(requested: list[str]) -> list[Column]:
        doubtful = next((name for name in requested if NUMBER.fullmatch(name)), None)
        if header is None and doubtful is not None:  # names beside numbers, some of them used
            raise InputError(
                f"{path} row {lines[0][0]}",
                f"names of columns and the number {doubtful}",
                "names or numbers only",
                "set `header = true` (names) or `header = false` (a sample) under [format]",
            )
        return [
            _numbers(
                table.to_series(index[name]), dialect, f"{path} row {{}}, {name}", rows,
                has_header=found.rows > 0,
            )
            for name in requested
        ]  # fmt: skip

    described = (
        dialect if delimiter is None else Dialect(",", dialect.decimal, dialect.thousands)
    ).describe()
    is_bare = header is None and is_sample and names == numbered
    notes = [
        *([remark] if remark else []),
        *([described] if described and not prefers_tabs else []),
        *([f"{skipped} rows before the header skipped"] if skipped else []),
        *([f"names and units in {found.rows} rows"] if found.rows > 1 else []),
        *(["names of the columns in a comment"] if is_sample and found.names != numbered else []),
        *(["no header: the first row is a sample"] if is_bare else []),
    ]
    return Columns(names, read, rows, tuple(notes), units=found.units)


def _lines(text: str) -> tuple[Lines, str]:
    """The lines of a file that are no comments nor blank, and the last comment before them."""
    lines: Lines = []
    comment = ""
    for row, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        if is_comment(line):
            comment = comment if lines else comment_text(line)
        elif line.strip() or "\t" in line:
            lines.append((row, line))
    return lines, comment


def _texts(table: "pl.DataFrame", row: int) -> list[str]:
    return [(cell or "").strip() for cell in table.row(row)]


def _names_in(comment: str, dialect: Dialect, width: int) -> list[str] | None:
    """The names of the columns in a comment above the first sample, None where it has none."""
    names = dialect.split(comment)
    is_header = len(names) == width > 1 and all(names) and len({*names}) == width
    return names if is_header and not any(dialect.is_number(name) for name in names) else None


def _preamble(lines: Lines, dialect: Dialect) -> int:
    """The number of lines before a header that are shorter or longer than the rows of the table."""
    tail = [len(dialect.split(line)) for _, line in lines[-5:]]
    width = max({*tail}, key=tail.count)
    first = next((k for k, (_, line) in enumerate(lines) if len(dialect.split(line)) == width), 0)
    cells = dialect.split(lines[first][1])
    is_header = width > 1 and not any(dialect.is_number(cell) for cell in cells)
    return first if is_header else 0


def _cells(path: Path, lines: Lines, dialect: Dialect) -> "pl.DataFrame":
    """The cells as text, a row for every line."""
    import polars as pl

    delimiter = dialect.delimiter
    if delimiter == BLANKS:
        lines, delimiter = [(row, "\t".join(line.split())) for row, line in lines], "\t"
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
    raise InputError(path, defect, f"rows of equal length separated by '{dialect.delimiter}'")


def _numbers(
    cells: "pl.Series", dialect: Dialect, where: str, rows: list[int], *, has_header: bool
) -> Column:
    """The numbers of some cells; `where` has {} in place of the row, for the message."""
    import polars as pl

    is_plain = dialect.decimal == "." and not dialect.thousands
    numbers = cells.cast(pl.Float64, strict=False) if is_plain else pl.Series([None])
    if numbers.null_count():
        numbers = _plain(cells.str.strip_chars(), dialect).cast(pl.Float64, strict=False)
    if numbers.null_count():
        sample = int(np.flatnonzero(numbers.is_null().to_numpy())[0])
        text = (cells[sample] or "").strip()
        remedy = "correct or remove the row"
        if not (has_header or sample):
            remedy = "if the first row names the columns, set `header = true`"
        elif "," in text and not text.strip("+-0123456789.,"):
            remedy += ', or set `decimal = ","` or `"."` under [format]'
        raise InputError(
            where.format(rows[sample]), f"the text '{text[:40]}'" if text else "an empty cell",
            "a number", remedy,
        )  # fmt: skip
    return numbers.to_numpy()


def _plain(cells: "pl.Series", dialect: Dialect) -> "pl.Series":
    """Numbers as Python writes them: a decimal point, exponents by e, nothing between thousands."""
    import polars as pl

    if dialect.thousands:
        grouped = cells.str.contains(dialect.thousands, literal=True)
        wrong = grouped & ~cells.str.contains(f"^(?:{dialect.grouped().pattern})$")
        cells = cells.str.replace_all(dialect.thousands, "", literal=True)
        cells = cells.set(wrong, None)
    if dialect.decimal != ".":
        wrong = cells.str.contains(".", literal=True)
        cells = cells.str.replace_all(dialect.decimal, ".", literal=True).set(wrong, None)
    cells = cells.str.replace("^\u2212", "-")  # the minus sign of typography
    return cells.str.replace("(?i)^([-+]?[0-9.]+)d([-+]?[0-9]+)$", "${1}e${2}").cast(pl.String)
