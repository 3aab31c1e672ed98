"""The report that a verb writes after a fit."""

import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import typer

from tustinnet.cli import terminal
from tustinnet.cli.about import data_words
from tustinnet.errors import error_message


def report_command(
    models: Sequence[Path],
    data: str,
    out: Path,
    options: Mapping[str, object],
    systems: Sequence[str] = (),
) -> str:
    """Command line of `tustinnet report`; options that are None are omitted, True are flags."""
    words = ["tustinnet", "report", *map(str, models), data, "--out", str(out)]
    for name, value in options.items():
        words += [] if value is None else [name] if value is True else [name, str(value)]
    for name in systems:
        words += ["--system", name]
    return shlex.join(words)


@dataclass(frozen=True)
class AutomaticReport:
    """Settings of the report that a verb writes after a fit.

    Attributes:
        data: the argument DATA of the verb.
        card: its data card, if one was named.
        is_enabled: whether to write a report.
    """

    data: str
    card: Path | None = None
    is_enabled: bool = True

    @property
    def data_words(self) -> str:
        """The arguments by which other verbs find the records: DATA, and a card that was named."""
        return data_words(self.data, self.card)

    def write(
        self,
        models: Sequence[Path],
        out: Path,
        write_page: Callable[[str], Path],
        options: Mapping[str, object],
    ) -> str | None:
        """Writes the report; an error is printed, so that the fit is not lost.

        Args:
            models: run folders or model files.
            out: the file of the report.
            write_page: writes the file, given the command that would write a report of all records.
            options: the options of that command; those that are None are omitted.

        Returns:
            Text that names the file; empty if reports are disabled, None if it could not be
            written: then the verb should end with `require_report`.
        """
        if not self.is_enabled:
            return ""
        command = report_command(models, self.data, out, {**options, "--card": self.card})
        try:
            path = write_page(command)
        except Exception as error:
            terminal.messages().print(
                f"error: no report ({error_message(error)}); all else is kept, try: {command}"
            )
            return None
        return f"   report: {path}"


def after_model(model: Path) -> AbstractContextManager[None]:
    """Context of what comes after a model is written: an interruption says that it is there."""
    return terminal.interruptible(
        f"the model is complete: {model}; figures or the report may be missing"
    )


def require_report(text: str | None) -> None:
    """Ends the verb with exit code 1 if its report could not be written (`text` is None)."""
    if text is None:
        raise typer.Exit(1)
