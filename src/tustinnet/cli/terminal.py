"""What every verb does with the terminal: messages, results, precision."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.report.tables import Table

_PIPED_WIDTH = 200  # columns of a table that goes into a file or a pipe


def messages() -> "Console":
    """Where progress and remarks go: standard error, so that results can be piped."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, soft_wrap=True)


def print_json(content: Any) -> None:
    """A result as JSON on standard output."""
    from tustinnet.artifact.files import to_json

    sys.stdout.write(to_json(content))


def print_tables(*tables: "Table") -> None:
    """Results as tables on standard output."""
    from rich.console import Console

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_PIPED_WIDTH)
    for table in tables:
        table.print(console)


@contextmanager
def resumable(console: "Console", remedy: str) -> Iterator[None]:
    """Says how to go on when a training is interrupted; exit code 130 as is usual."""
    try:
        yield
    except KeyboardInterrupt:
        console.print(f"interrupted; {remedy} goes on from the checkpoint")
        raise SystemExit(130) from None


def use_float64() -> None:
    """Scores and simulations of the command are computed in double precision."""
    import jax

    jax.config.update("jax_enable_x64", True)
