"""Consoles of Rich: of messages, and of tables of results."""

from typing import Any

from rich.console import Console

from tustinnet.cli.options import with_options
from tustinnet.report.tables import Table

_PIPED_WIDTH = 200  # columns of a table that goes into a file or a pipe


class Messages(Console):
    """Console for progress and remarks: standard error, so that results can be piped."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, soft_wrap=True, markup=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """Prints texts, with the command's options in them."""
        texts = [with_options(o) if isinstance(o, str) else o for o in objects]
        super().print(*texts, **options)


def print_tables(*tables: Table) -> None:
    """Prints results as tables on standard output."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_PIPED_WIDTH)
    for table in tables:
        table.print(console)
