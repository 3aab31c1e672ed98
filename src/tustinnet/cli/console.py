"""Consoles of Rich: of messages, and of tables of results."""

import os
from typing import Any

from rich.console import Console

from tustinnet.cli.options import with_options
from tustinnet.report.tables import Table


class Messages(Console):
    """Console for progress and remarks: standard error, so that results can be piped."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, soft_wrap=True, markup=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """Prints texts, with the command's options in them."""
        texts = [with_options(o) if isinstance(o, str) else o for o in objects]
        super().print(*texts, **options)


def print_tables(*tables: Table) -> None:
    """Prints results as tables on standard output; in a file or a pipe they may be of any width."""
    console = Console(highlight=False)
    width = console.width if console.is_terminal or "COLUMNS" in os.environ else None
    for table in tables:
        table.print(console, width)
