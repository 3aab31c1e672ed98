"""The command's entry: verbs, and errors as one line."""

import sys
from typing import Annotated

import typer

from tustinnet.cli import terminal
from tustinnet.cli.calibrate import calibrate
from tustinnet.cli.committee import committee
from tustinnet.cli.compare import compare
from tustinnet.cli.cross_validate import cross_validate
from tustinnet.cli.demo import demo
from tustinnet.cli.evaluate import evaluate
from tustinnet.cli.export import export
from tustinnet.cli.fit import fit
from tustinnet.cli.inspect import inspect
from tustinnet.cli.learning_curve import learning_curve
from tustinnet.cli.next_record import next_record
from tustinnet.cli.report import report
from tustinnet.cli.reproduce import reproduce
from tustinnet.cli.residuals import residuals
from tustinnet.cli.show import show
from tustinnet.cli.simulate import simulate
from tustinnet.errors import InputError

app = typer.Typer(
    name="tustinnet",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # loading rich would double the time that --help takes
)
_VERBS = (
    demo, inspect, fit, cross_validate, learning_curve, next_record, simulate, evaluate,
    compare, residuals, committee, calibrate, export, show, report, reproduce,
)  # fmt: skip
for verb in _VERBS:
    app.command()(terminal.interruptible()(verb))


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"tustinnet {version('tustinnet')}")
        raise typer.Exit


@app.callback()
def tustinnet(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """From logs of a mechanical system to a model that simulates it.

    Exit codes: 0 done, 1 failed (one line says why), 2 wrong usage.
    """


def run(arguments: list[str] | None = None) -> None:
    """Runs the command; bad input ends as one line on standard error and exit code 1."""
    try:
        app(arguments)
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(1)
