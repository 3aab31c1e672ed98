"""`tustinnet fit` without a recipe: a selection among several recipes."""

import math
import re
import time
from statistics import fmean

import tustinnet as tn
from tustinnet.cli import about, terminal
from tustinnet.cli.automatic_report import after_model, require_report
from tustinnet.cli.completion import ALL
from tustinnet.cli.fit_options import FitOptions, open_cluster
from tustinnet.errors import InputError
from tustinnet.report import drawing, plain_fit
from tustinnet.report import figures as result_figures
from tustinnet.report import progress as progress_bars
from tustinnet.report import selection as selection_report
from tustinnet.report.page import fit_reports
from tustinnet.selection import choice as choices
from tustinnet.selection import plan as plans
from tustinnet.selection import select as selecting
from tustinnet.store import files as disk
from tustinnet.store import run_folder
from tustinnet.systems import files as system_files

_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_NO_BUDGET = "none"


def parse_seconds(budget: str) -> float | None:
    """Seconds of a time such as `90`, `90s`, `10min`, `1.5h`; None for `none`."""
    if budget.strip() == _NO_BUDGET:
        return None
    match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,3})?) ?(s|min|h|)", budget.strip())
    seconds = float(match[1]) * _SECONDS[match[2]] if match else math.nan
    if not seconds > 0:
        expected = "a time above 0, e.g. 90s, 10min, 1.5h, or none"
        raise InputError("--budget", f"'{budget}'", expected)
    return seconds


def read_options(
    plan: str | None,
    budget: str | None,
    system: "system_files.AnySystem | None",
    *,
    on_cluster: bool,
    leave_out_spoiled: bool,
) -> "tn.SelectionOptions":
    """The options of a selection from words of the command line; its budget counts from now on.

    Without a word on the budget a plan of the user's own, and one on a cluster, has no limit.
    """
    if budget is not None:
        seconds = parse_seconds(budget)
    else:
        seconds = selecting.USUAL_BUDGET if plan is None and not on_cluster else None
    start_time = time.monotonic()  # what is loaded from here on takes seconds
    return tn.SelectionOptions(
        plans.read_plan(plan or plans.USUAL),
        system,
        seconds,
        start_time,
        leave_out_spoiled,
    )


def select(
    fit_options: FitOptions,
    selection: "tn.SelectionOptions",
    *,
    cluster_address: str | None,
    says_budget: bool,
) -> None:
    """Fits the candidates of a plan and keeps the best as one model; prints and draws the results.

    Without a cluster this process is used. A budget that nobody named is said.
    """
    quiet, report = fit_options.quiet, fit_options.report
    records = fit_options.load()
    if says_budget and selection.budget is not None:
        terminal.make_printer(quiet=quiet)(
            f"takes {selection.budget / 60:g}min at most "
            "(--budget 10min: more; --budget none: no limit)"
        )
    with progress_bars.FitProgress(terminal.messages(), quiet=quiet) as progress:
        reporter = plain_fit.make_reporter(progress, terminal.make_printer(quiet=quiet))
        with (
            terminal.interruptible("--resume continues with what is done"),
            open_cluster(cluster_address) as executor,
        ):
            choice = tn.select_model(
                records, fit_options.out, selection, fit_options.earlier, reporter, executor
            )
    folder, start = choice.context.folder, choice.result(choice.best).start
    # the folder is let go only when figures and report, which are of this model, are there
    with after_model(folder / run_folder.MODEL), disk.lock_folder(folder):
        if choice.context.system_file is not None:
            terminal.remember_trust(choice.context.system_file)
        if fit_options.json:
            terminal.print_json(choice.as_plain())
        else:
            print_choice(choice, quiet=quiet)
        draw_choice(choice)
        page = report.write(
            [folder],
            folder / run_folder.REPORT,
            lambda command: fit_reports.write_choice_report(choice, command),
            {"--split": ALL, "--start": start, "--horizon": choice.context.scoring.horizon},
        )
    if not fit_options.json:
        print_files(choice, page or "")
        print_next_steps(choice, report.data_words)
    require_report(page)


def print_next_steps(choice: "choices.Choice", data: str) -> None:
    """Prints commands to go on with; those that use the model only where it is of use.

    Args:
        choice: the choice.
        data: the records as the user named them, in words of a shell.
    """
    context = choice.context
    # candidates are compared without the size of errors of lost records, which counts here
    mean = fmean(choice.result(choice.best).rmse().values())
    steps = about.next_steps(
        context.folder / run_folder.MODEL,
        data,
        choice.model,
        follows=choice.follows and mean < choice.reference.mean,
        by_forces=choice.candidates.plan.candidate(choice.best).content.is_by_forces,
    )
    terminal.echo(f"next: {steps}")


def draw_choice(choice: "choices.Choice") -> None:
    """Writes the table of candidates with findings, their figure, and some free runs."""
    folder = choice.context.folder
    selection_report.write_table(choice)
    drawing.write_figure(
        selection_report.candidates_figure(choice), folder, "figures/candidates.png"
    )
    for name, runs in selection_report.free_runs(choice).items():
        drawing.write_figure(
            result_figures.free_run_figure(choice.context.data[name], runs),
            folder,
            f"figures/{name}.png",
        )


def print_choice(choice: "choices.Choice", *, quiet: bool) -> None:
    """Prints the table of candidates, and findings on the choice.

    Args:
        choice: the choice.
        quiet: whether its notes were not printed while it was made.
    """
    terminal.print_tables(selection_report.candidates_table(choice))
    for finding in choice.findings:
        if quiet or finding not in choice.notes:
            terminal.echo(f"* {finding}")


def print_files(choice: "choices.Choice", report: str = "") -> None:
    """Prints the line that names the files, and the duration of the choice."""
    out = choice.context.folder
    terminal.echo(
        f"model: {out / run_folder.MODEL}   table: {out / run_folder.TABLE}   "
        f"figures: {out / run_folder.FIGURES}{report}   {choice.seconds:.0f} s"
    )
