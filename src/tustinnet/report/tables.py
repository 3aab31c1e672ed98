"""Tables for the terminal, for Markdown and for LaTeX."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

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

    def print(self, console: Console) -> None:
        """Prints the table on a terminal."""
        drawn = RichTable(
            title=Text(self.title) if self.title else None,
            title_justify="left",
            title_style="bold",
            box=SIMPLE_HEAD,
            pad_edge=False,
            padding=(0, 1),
        )
        for i, column in enumerate(self.columns):
            drawn.add_column(Text(column), justify="left" if i == 0 else "right", no_wrap=True)
        for row in self.rows:
            drawn.add_row(*map(Text, row))  # Text: a unit in brackets is not markup
        # a terminal may wrap a line that is too long; a table must not cut what it says
        needed = Measurement.get(console, console.options.update(max_width=10_000), drawn).maximum
        console.print(drawn, width=max(console.width, needed), crop=False, soft_wrap=True)

    def markdown(self) -> str:
        """The table in Markdown."""
        rule = ["---", *["---:"] * (len(self.columns) - 1)]
        lines = ["| " + " | ".join(row) + " |" for row in (self.columns, rule, *self.rows)]
        return (f"{self.title}\n\n" if self.title else "") + "\n".join(lines) + "\n"

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


def number(value: float | None, digits: int = 3) -> str:
    """A number for a table: fixed digits, or as many significant ones where it is smaller.

    A dash for None and NaN, a word for infinity.
    """
    if value is None or math.isnan(value):
        return "–"
    if not math.isfinite(value):
        return "diverged"
    small = 0 < abs(value) < 10.0 ** (1 - digits)
    return f"{value:.{digits}g}" if small else f"{value:.{digits}f}"
