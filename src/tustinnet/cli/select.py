"""`tustinnet fit` without a recipe: the best model that the records allow."""

import math
import re
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from tustinnet.cli import terminal

if TYPE_CHECKING:
    from tustinnet.cli.leave_report import Leaving
    from tustinnet.data.dataset import DataSet
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.choice import Choice
    from tustinnet.selection.jobs import Job
    from tustinnet.selection.select import Reporter
    from tustinnet.store.run import Earlier
    from tustinnet.systems.files import SystemFile

_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}


def seconds_of(budget: str | None) -> float | None:
    """A time as people write it, in seconds: `90`, `90s`, `10min`, `1.5h`."""
    from tustinnet.errors import InputError

    if budget is None:
        return None
    found = re.fullmatch(r"(\d{1,6}(?:\.\d{1,3})?) ?(s|min|h|)", budget.strip())
    seconds = float(found[1]) * _SECONDS[found[2]] if found else math.nan
    if not seconds > 0:
        raise InputError("--budget", f"'{budget}'", "a time above 0, e.g. 90s, 10min, 1.5h")
    return seconds


def select(
    load: "Callable[[], DataSet]",
    out: Path,
    asked: tuple[str | None, str | None, str | None],
    system: "SystemFile | str | None",
    earlier: "Earlier",
    leaving: "Leaving",
    *,
    json: bool,
    quiet: bool,
) -> None:
    """Tries the candidates of a plan and keeps the best as one model.

    `asked` has the plan, the budget, and the cluster whose machines do the jobs.
    """
    begun = time.monotonic()  # what is loaded from here on takes seconds
    from tustinnet.cli.leave_report import require_left
    from tustinnet.report.progress import FitProgress
    from tustinnet.report.summary import next_steps
    from tustinnet.selection.cluster import cluster
    from tustinnet.selection.plan import USUAL, read_plan
    from tustinnet.selection.select import SelectionOptions, select_model
    from tustinnet.store.run import MODEL

    plan, budget, machines = asked
    wanted = SelectionOptions(read_plan(plan or USUAL), system, seconds_of(budget), begun)
    records = load()
    with FitProgress(terminal.messages(), quiet=quiet) as progress:
        reporter = make_reporter(progress, quiet=quiet)
        with (
            terminal.interruptible("--resume goes on with what is done"),
            nullcontext()
            if machines is None
            else cluster(machines, reporter.on_message) as executor,
        ):
            choice = select_model(records, out, wanted, earlier, reporter, executor)
    if choice.context.system_file is not None:
        terminal.remember_trust(choice.context.system_file)
    if json:
        terminal.print_json(choice.as_plain())
    else:
        print_choice(choice)
    draw_choice(choice)
    page = _page(choice, leaving)
    if not json:
        print_files(choice, page or "")
        typer.echo(f"next: {next_steps(choice.context.folder / MODEL, leaving.data)}")
    require_left(page)


def _page(choice: "Choice", leaving: "Leaving") -> str | None:
    """Writes the report of the chosen model; returns where it is, as the line of files says it."""
    from tustinnet.report.page.fitted import report_of_choice
    from tustinnet.store.run import REPORT

    folder, start = choice.context.folder, choice.result(choice.best).starts[0]
    given = {"--start": start, "--horizon": choice.context.scoring.horizon}
    return leaving.report(
        [folder], folder / REPORT, lambda command: report_of_choice(choice, command), given
    )


def make_reporter(progress: "FitProgress", *, quiet: bool) -> "Reporter":
    """Who is told while a selection goes on: bars or lines for fits, sentences for rounds."""
    from tustinnet.selection.select import Reporter

    def tell(job: "Job") -> Any:
        label = f"{job.candidate}, fold {job.fold}"
        return lambda prepared: progress.follow(prepared, label=label)

    return Reporter(terminal.teller(quiet=quiet), tell)


def draw_choice(choice: "Choice") -> None:
    """Writes table and figures: of candidates, of free runs of models that did not see a record."""
    from tustinnet.report.figures import free_run_figure, write_figure
    from tustinnet.report.selection import candidates_figure, candidates_table, free_runs
    from tustinnet.selection.select import TABLE
    from tustinnet.store.files import write_into

    folder = choice.context.folder
    write_into(folder, TABLE, candidates_table(choice).markdown())
    write_figure(candidates_figure(choice), folder, "figures/candidates.png")
    for name, runs in free_runs(choice).items():
        write_figure(
            free_run_figure(choice.context.data[name], runs), folder, f"figures/{name}.png"
        )


def print_choice(choice: "Choice") -> None:
    """The table of candidates, and what there is to say of the choice."""
    from tustinnet.report.selection import candidates_table

    terminal.print_tables(candidates_table(choice))
    for sentence in choice.sentences:
        typer.echo(f"* {sentence}")


def print_files(choice: "Choice", page: str = "") -> None:
    """The line that names the files, and says how long the choice took."""
    out = choice.context.folder
    typer.echo(
        f"model: {out / 'model.safetensors'}   table: {out / 'candidates.md'}   "
        f"figures: {out / 'figures'}{page}   {choice.seconds:.0f} s"
    )
