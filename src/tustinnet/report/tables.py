"""Tables for the terminal, for Markdown and for LaTeX."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

_LARGE = 1e6  # from here on numbers have an exponent
_GAP = 3  # blanks between columns; a table has one before and one behind them
_LATEX = {"&": r"\&", "%": r"\%", "#": r"\#", "_": r"\_", "$": r"\$"}


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes:
        columns: headings; the first column names the rows.
        rows: cells, as many in a row as there are columns.
        title: a line above, or empty.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""

    def print(self, console: Console, width: int | None = None) -> None:
        """Prints the table; one that is wider than `width` in parts, below each other."""
        # beyond the console's width no print goes; a table takes no more than it needs
        own_width, console.width = console.width, 10_000
        for part in [self] if width is None else self._parts(width):
            rich_table = RichTable(
                title=Text(part.title) if part.title else None,
                title_justify="left",
                title_style="bold",
                box=SIMPLE_HEAD,
                pad_edge=False,
                padding=(0, 1),
            )
            for i, column in enumerate(part.columns):
                justify = "left" if i == 0 else "right"
                rich_table.add_column(Text(column), justify=justify, no_wrap=True)
            for row in part.rows:
                rich_table.add_row(*map(Text, row))  # Text: a unit in brackets is not markup
            console.print(rich_table, crop=False, soft_wrap=True)
        console.width = own_width

    def _parts(self, width: int) -> list["Table"]:
        """Tables with some of the columns each, behind the first ones, which tell rows apart."""
        lines = [self.columns, *self.rows]
        sizes = [_GAP + max(map(len, cells)) for cells in zip(*lines, strict=True)]
        counts = range(1, len(sizes))
        first = next((n for n in counts if len({(*row[:n],) for row in lines}) == len(lines)), 1)
        room = width + 1 - sum(sizes[:first])
        parts: list[list[int]] = [[]]
        for i in range(first, len(sizes)):
            if parts[-1] and sum(sizes[j] for j in [*parts[-1], i]) > room:
                parts.append([])
            parts[-1].append(i)
        tables = [self._part(first, part) for part in parts] if len(parts) > 1 else [self]
        return [replace(table, title="") if i else table for i, table in enumerate(tables)]

    def _part(self, first: int, chosen: Sequence[int]) -> "Table":
        """A table of the first and of the chosen columns, without rows that have none of these."""
        columns = [*range(first), *chosen]
        rows = [row for row in self.rows if any(row[i] for i in chosen)]
        pick = [[line[i] for i in columns] for line in (self.columns, *rows)]
        return Table(pick[0], pick[1:], self.title)

    def markdown(self) -> str:
        """The table in Markdown."""
        rule = ["---", *["---:"] * (len(self.columns) - 1)]
        lines = ["| " + " | ".join(row) + " |" for row in (self.columns, rule, *self.rows)]
        return (f"{self.title}\n\n" if self.title else "") + "\n".join(lines) + "\n"

    def html(self) -> str:
        """The table in HTML."""

        def line(cells: Sequence[str], tag: str) -> str:
            return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

        caption = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        rows = "".join(line(row, "td") for row in self.rows)
        return f"<table>{caption}{line(self.columns, 'th')}{rows}</table>"

    def latex(self) -> str:
        """The table as a LaTeX tabular (package booktabs)."""

        def line(cells: Sequence[str]) -> str:
            escaped = ["".join(_LATEX.get(c, c) for c in cell) for cell in cells]
            return " & ".join(escaped) + r" \\"

        body = "\n".join(line(row) for row in self.rows)
        layout = "l" + "r" * (len(self.columns) - 1)
        return (
            f"\\begin{{tabular}}{{{layout}}}\n\\toprule\n{line(self.columns)}\n\\midrule\n"
            f"{body}\n\\bottomrule\n\\end{{tabular}}\n"
        )


def number(value: float | None, digits: int = 3, scale: float | None = None) -> str:
    """Text of a number in a table: fixed decimals; significant digits for small and large numbers.

    None and NaN become a dash, infinity the word "diverged".

    Args:
        value: the number.
        digits: number of decimals.
        scale: the largest number beside it; where that is below 1, `digits` significant digits of
            it are shown, and as many decimals of the others.
    """
    if value is None or math.isnan(value):
        return "–"
    if not math.isfinite(value):
        return "diverged"
    if scale is not None and 0 < scale < 1:
        return f"{value:.{digits - 1 - math.floor(math.log10(scale))}f}"
    is_fixed = value == 0 or 10.0 ** (1 - digits) <= abs(value) < _LARGE
    return f"{value:.{digits}f}" if is_fixed else f"{value:.{digits}g}"


def amounts(values: Mapping[str, float]) -> str:
    """Text of numbers of different units, given by unit: `0.0012 m and 0.0076 rad`."""
    return " and ".join(f"{number(value)} {unit}".strip() for unit, value in values.items())


def norm_words(unit: str) -> str:
    """Words for a title on numbers over coordinates of different units; empty for one unit.

    Args:
        unit: the units, as `Channels.unit` has them.
    """
    return f"; one norm over coordinates in {unit}" if " and " in unit else ""


def scale_of(values: Iterable[float | None]) -> float:
    """Largest magnitude of some numbers, as the `scale` of `number`; 0 where none is finite."""
    return max((abs(v) for v in values if v is not None and math.isfinite(v)), default=0.0)


def numbers(values: Sequence[float | None]) -> list[str]:
    """Texts of the numbers of a column, to three significant digits of the largest."""
    scale = scale_of(values)
    return [number(value, scale=scale) for value in values]
