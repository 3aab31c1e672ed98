"""`tustinnet fit` without a recipe: a selection among several recipes."""

import math
import re
import time
from typing import TYPE_CHECKING, Any

from tustinnet.cli import about, terminal
from tustinnet.cli.completion import ALL
from tustinnet.cli.fit_options import FitOptions, open_cluster
from tustinnet.errors import InputError

if TYPE_CHECKING:
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.choice import Choice
    from tustinnet.selection.jobs import Job
    from tustinnet.selection.select import Reporter, SelectionOptions
    from tustinnet.systems.files import AnySystem

_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_USUAL_BUDGET = "4min"  # a report five minutes after a folder of logs; it costs little accuracy
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
    system: "AnySystem | None",
    *,
    on_cluster: bool,
    leave_out_spoiled: bool,
) -> "SelectionOptions":
    """The options of a selection from words of the command line; its budget counts from now on.

    Without a word on the budget a plan of the user's own, and one on a cluster, has no limit.
    """
    if budget is None:
        budget = _USUAL_BUDGET if plan is None and not on_cluster else _NO_BUDGET
    start_time = time.monotonic()  # the imports and records from here on take seconds
    from tustinnet.selection.plan import USUAL, read_plan
    from tustinnet.selection.select import SelectionOptions

    return SelectionOptions(
        read_plan(plan or USUAL), system, parse_seconds(budget), start_time, leave_out_spoiled
    )


def select(
    fit_options: "FitOptions",
    selection: "SelectionOptions",
    *,
    cluster_address: str | None,
    says_budget: bool,
) -> None:
    """Fits the candidates of a plan and keeps the best as one model; prints and draws the results.

    Without a cluster this process is used. A budget that nobody named is said.
    """
    from tustinnet.cli.automatic_report import after_model, require_report
    from tustinnet.report.page.fit_reports import write_choice_report
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.select import select_model
    from tustinnet.store.files import lock_folder
    from tustinnet.store.run_folder import MODEL, REPORT

    quiet, report = fit_options.quiet, fit_options.report
    records = fit_options.load()
    if says_budget and selection.budget is not None:
        terminal.make_printer(quiet=quiet)(
            f"takes {_USUAL_BUDGET} at most (--budget 10min: more; --budget none: no limit)"
        )
    with FitProgress(terminal.messages(), quiet=quiet) as progress:
        reporter = make_reporter(progress, quiet=quiet)
        with (
            terminal.interruptible("--resume continues with what is done"),
            open_cluster(cluster_address) as executor,
        ):
            choice = select_model(
                records, fit_options.out, selection, fit_options.earlier, reporter, executor
            )
    folder, start = choice.context.folder, choice.result(choice.best).starts[0]
    # the folder is let go only when figures and report, which are of this model, are there
    with after_model(folder / MODEL), lock_folder(folder):
        if choice.context.system_file is not None:
            terminal.remember_trust(choice.context.system_file)
        if fit_options.json:
            terminal.print_json(choice.as_plain())
        else:
            print_choice(choice, quiet=quiet)
        draw_choice(choice)
        page = report.write(
            [folder],
            folder / REPORT,
            lambda command: write_choice_report(choice, command),
            {"--split": ALL, "--start": start, "--horizon": choice.context.scoring.horizon},
        )
    if not fit_options.json:
        print_files(choice, page or "")
        steps = about.next_steps(
            folder / MODEL,
            report.data_words,
            follows=choice.follows,
            has_inputs=bool(choice.context.data.channels.inputs),
        )
        terminal.echo(f"next: {steps}")
    require_report(page)


def make_reporter(progress: "FitProgress", *, quiet: bool) -> "Reporter":
    """Makes the reporter of a selection: bars or lines for fits, sentences for rounds."""
    from tustinnet.selection.select import Reporter

    def follow_job(job: "Job") -> Any:
        return lambda prepared: progress.follow(prepared, label=job.label)

    return Reporter(terminal.make_printer(quiet=quiet), follow_job)


def draw_choice(choice: "Choice") -> None:
    """Writes the table of candidates with findings, their figure, and some free runs."""
    from tustinnet.report.drawing import write_figure
    from tustinnet.report.figures import free_run_figure
    from tustinnet.report.selection import candidates_figure, candidates_table, free_runs
    from tustinnet.store.files import write_into
    from tustinnet.store.run_folder import TABLE

    folder = choice.context.folder
    findings = "".join(f"* {finding}\n" for finding in choice.findings)
    write_into(folder, TABLE, f"{candidates_table(choice).markdown()}\n{findings}")
    write_figure(candidates_figure(choice), folder, "figures/candidates.png")
    for name, runs in free_runs(choice).items():
        write_figure(
            free_run_figure(choice.context.data[name], runs), folder, f"figures/{name}.png"
        )


def print_choice(choice: "Choice", *, quiet: bool) -> None:
    """Prints the table of candidates, and findings on the choice.

    Args:
        choice: the choice.
        quiet: whether its notes were not printed while it was made.
    """
    from tustinnet.report.selection import candidates_table

    terminal.print_tables(candidates_table(choice))
    for finding in choice.findings:
        if quiet or finding not in choice.notes:
            terminal.echo(f"* {finding}")


def print_files(choice: "Choice", report: str = "") -> None:
    """Prints the line that names the files, and the duration of the choice."""
    from tustinnet.store.run_folder import FIGURES, MODEL, TABLE

    out = choice.context.folder
    terminal.echo(
        f"model: {out / MODEL}   table: {out / TABLE}   figures: {out / FIGURES}{report}   "
        f"{choice.seconds:.0f} s"
    )
