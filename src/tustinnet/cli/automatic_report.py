"""The report that a verb leaves beside what it has fitted."""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from tustinnet.cli import terminal


def report_command(
    models: Sequence[Path], data: str, out: Path, given: Mapping[str, object],
    systems: Sequence[str] = (),
) -> str:  # fmt: skip
    """How `tustinnet report` is typed; options that are None are left out."""
    words = ["tustinnet", "report", *map(str, models), data, "--out", str(out)]
    for name, value in given.items():
        words += [] if value is None else [name, str(value)]
    for name in systems:
        words += ["--system", name]
    return shlex.join(words)


@dataclass(frozen=True)
class Leaving:
    """Where reports are from, and whether there are any.

    Attributes:
        data: what the verb was given as DATA.
        card: its data card, if it was given one.
        wanted: whether there is to be a report.
    """

    data: str
    card: Path | None = None
    wanted: bool = True

    def report(
        self, models: Sequence[Path], out: Path, write: Callable[[str], Path],
        given: Mapping[str, object],
    ) -> str | None:  # fmt: skip
        """Writes the report of what was fitted. Whatever goes wrong then, the fit is not lost.

        Args:
            models: run folders or model files.
            out: the report's file.
            write: writes it, given the command that would write one of all the records.
            given: the options of that command; those that are None are left out.

        Returns:
            Where it is, for the line that names the files; empty where none is wanted, None where
            it could not be written: then the command ends with `require_report`.
        """
        from tustinnet.errors import reason

        if not self.wanted:
            return ""
        command = report_command(models, self.data, out, {**given, "--card": self.card})
        try:
            path = write(command)
        except Exception as error:
            terminal.messages().print(
                f"error: no report ({reason(error)}); all else is kept, try: {command}"
            )
            return None
        return f"   report: {path}"


def require_report(page: str | None) -> None:
    """Ends with exit code 1 where the report could not be written, when all else is done."""
    if page is None:
        raise typer.Exit(1)
