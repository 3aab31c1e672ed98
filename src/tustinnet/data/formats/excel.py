"""Excel workbooks: the columns of each sheet, as `Sheet1/angle` where several have some."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tustinnet.data.formats.reader import Array, Contents, Reader
from tustinnet.data.text_dialect import HEADER_ROWS, LAST_ROWS, Dialect, find_table, read_header

if TYPE_CHECKING:
    import polars as pl

_DIALECT = Dialect(",")  # of numbers that are cells of text


class _Column(NamedTuple):
    """The cells of a column, and its unit."""

    cells: "pl.Series"
    unit: str


def _contents(path: Path) -> Contents:
    import polars as pl

    arrays, others, units = [], {}, {}
    for name, (cells, unit) in _columns(path).items():
        if cells.cast(pl.Float64, strict=False).null_count() == len(cells):
            others[name] = "text"
            continue
        arrays.append((name, (len(cells),)))
        units[name] = unit
    return Contents(arrays, others, units=units)


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    import polars as pl

    from tustinnet.data.columns import frame_columns

    found = _columns(path)
    return {
        name: frame_columns(pl.DataFrame({name: found[name].cells}), path)[name] for name in names
    }


def _columns(path: Path) -> dict[str, _Column]:
    """Every column of all sheets, by name."""
    import fastexcel

    book = fastexcel.read_excel(path)
    tables = {
        name: book.load_sheet(name, header_row=None, dtypes="string").to_polars()
        for name in book.sheet_names
    }
    sheets = {name: columns for name, table in tables.items() if (columns := _sheet(table))}
    return {
        (label if len(sheets) == 1 else f"{name}/{label}"): column
        for name, sheet in sheets.items()
        for label, column in sheet.items()
    }


def _sheet(table: "pl.DataFrame") -> dict[str, _Column]:
    """The columns of a sheet below its first row that has several cells, none of an empty one."""
    import polars as pl

    table = table.filter(~pl.all_horizontal(pl.all().is_null()))

    def cells_of(rows: range) -> list[list[str]]:
        return [[(cell or "").strip() for cell in table.row(k)] for k in rows]

    if not len(table):
        return {}
    shape = find_table(cells_of(range(len(table))[-LAST_ROWS:]), _DIALECT)
    # rows of titles and remarks
    top = cells_of(range(len(table))[:50])
    first = shape.count_rows_above(top)
    usual = min(2, table.width)
    first = next((k for k in range(first, len(top)) if sum(map(bool, top[k])) >= usual), None)
    if first is None:
        return {}
    rows = top[first : first + HEADER_ROWS]
    numbered = [f"column {k}" for k in range(1, table.width + 1)]
    names, units, count = numbered, {}, 0
    if not all(_DIALECT.is_number(cell) for cell in rows[0] if cell):
        header = read_header(rows, _DIALECT)
        names = [a or b for a, b in zip(header.names, numbered, strict=True)]
        units, count = header.units, header.rows
    table = table.slice(first + count)
    columns: dict[str, _Column] = {}
    for name, cells in zip(names, table.iter_columns(), strict=True):
        # a second column of one name is called by its number, an empty one is none
        if cells.null_count() < len(cells):
            label = name if name not in columns else f"{name}[{len(columns) + 1}]"
            columns[label] = _Column(cells, units.get(label, ""))
    return columns


READER = Reader("fastexcel", _contents, _arrays, "excel")
