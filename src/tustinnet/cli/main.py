"""The verbs of the command, and errors as one line."""

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from tustinnet.cli import about, options, terminal
from tustinnet.cli.control import control
from tustinnet.cli.cross_validate import cross_validate
from tustinnet.cli.demo import demo
from tustinnet.cli.evaluate import evaluate
from tustinnet.cli.export import export
from tustinnet.cli.fit import fit
from tustinnet.cli.init import init
from tustinnet.cli.inspect import inspect
from tustinnet.cli.report import report
from tustinnet.cli.reproduce import reproduce
from tustinnet.cli.show import show
from tustinnet.cli.simulate import simulate
from tustinnet.cli.verb import Verb
from tustinnet.errors import InputError
from tustinnet.old_names import VERBS


class _Verbs(TyperGroup):
    """The verbs; of one of before it says what to write instead."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The verb that was typed.

        Raises:
            InputError: a verb of before.
        """
        if args and (instead := VERBS.get(args[0])):
            raise InputError(f"'{args[0]}'", "a verb of an earlier version", instead)
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="tustinnet",
    cls=_Verbs,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # loading rich would double the time that --help takes
)
_VERBS = (
    demo,
    init,
    inspect,
    fit,
    cross_validate,
    simulate,
    evaluate,
    control,
    export,
    show,
    report,
    reproduce,
)
for verb in _VERBS:
    app.command(cls=Verb)(terminal.interruptible()(verb))


@app.callback(invoke_without_command=True)
def tustinnet(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose", help="With --version: also versions of dependencies, and devices."
        ),
    ] = False,
) -> None:
    """From logs of a mechanical system to a model that simulates it.

    Exit codes: 0 success, 1 failure (one line says why), 2 wrong usage, 129, 130 or 143 stopped by
    SIGHUP, Ctrl-C or SIGTERM (a line says whether the model is there), 141 no reader of the output.
    fit without a recipe ends with its best model and 0 at the first Ctrl-C, with 130 at the second.
    """
    if verbose and not version:
        raise InputError("--verbose", "not applicable without --version", "--version --verbose")
    if version:
        for line in about.versions() if verbose else (about.version(),):
            typer.echo(line)
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(about.STEPS, nl=False)


def run(arguments: list[str] | None = None) -> None:
    """Runs the command; bad input ends as one line on standard error and exit code 1."""
    try:
        try:
            app(arguments, prog_name=app.info.name)  # also as python -m tustinnet
        finally:
            sys.stdout.flush()  # an error of which is said
    except InputError as error:
        sys.stderr.write(f"error: {options.with_options(str(error))}\n")
        sys.exit(terminal.exit_code(1))
    except SystemExit as ended:
        sys.exit(terminal.exit_code(ended.code))
