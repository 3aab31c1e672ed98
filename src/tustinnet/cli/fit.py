"""`tustinnet fit`: a model from a folder of logs."""

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import about, completion, devices, options, terminal
from tustinnet.cli.automatic_report import AutomaticReport, after_model, require_report
from tustinnet.cli.fit_options import FitOptions, choose_recipe, make_members, require_cores
from tustinnet.cli.init import draft_into_run
from tustinnet.cli.models import (
    kept_system,
    read_origin,
    read_recipe_in,
    require_readable_robot,
    require_system_of_card,
)
from tustinnet.cli.records import load_records_to_fit, print_still_coordinates
from tustinnet.cli.select import read_options, select
from tustinnet.cli.verb import refuse_options
from tustinnet.data import catalog
from tustinnet.errors import InputError
from tustinnet.fits import request
from tustinnet.fits import run as runs
from tustinnet.fitting import listener as listeners
from tustinnet.fitting import recipe as recipes
from tustinnet.fitting import task as tasks
from tustinnet.fitting.gradient import windows
from tustinnet.report import drawing, summary
from tustinnet.report import figures as result_figures
from tustinnet.report import fits as fit_tables
from tustinnet.report import identification as identification_report
from tustinnet.report import progress as progress_bars
from tustinnet.report.page import fit_reports
from tustinnet.store import files as disk
from tustinnet.store import log, model_file, run_folder
from tustinnet.systems import files as system_files

_Plan = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        autocompletion=completion.plan,
        help="Without a recipe: the recipes that are tried, a TOML file. Default: usual.",
    ),
]


def fit(
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the model and all results.")],
    recipe: Annotated[
        str | None,
        options.recipe(
            "tries several (--plan); with --physics: best-hybrid; with --from: the model's"
        ),
    ] = None,
    system: options.System = None,
    changes: options.Set = None,
    budget: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Without a recipe: time limit, as 10min, or none. Default: 4min; with --plan or "
            "--cluster none.",
        ),
    ] = None,
    overwrite: options.Overwrite = False,
    seeds: options.Seeds = None,
    physics: options.Physics = None,
    origin: options.Origin = None,
    plan: _Plan = None,
    cluster: Annotated[str | None, options.cluster("Without a recipe: use")] = None,
    card: options.Card = None,
    leave_out_spoiled: options.LeaveOutSpoiled = False,
    device: options.Device = None,
    resume: options.Resume = False,
    no_report: options.NoReport = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Fit a model: try several recipes and keep the best, or fit one.

    For a folder without a data card, one is drafted into --out, as by `tustinnet init --yes`.
    """
    start_time = time.perf_counter()
    require_cores(cluster, device)
    require_readable_robot(system)
    devices.prepare_jax(device)
    selects = recipe is None and physics is None and origin is None
    for option, model in (("--physics", physics), ("--from", origin)):
        if model is not None and out.resolve() in model.resolve().parents:
            raise InputError(out, f"the folder of {model}, which {option} names", "another folder")
    found_system = None if system is None else system_files.find_system(system)
    selection = None
    if selects:
        refuse_options(
            {"--set": changes, "--seeds": seeds},
            "without a recipe",
            "a recipe",
            "add --recipe NAME, or write a plan (--plan FILE)",
        )
        selection = read_options(
            plan,
            budget,
            found_system,
            on_cluster=cluster is not None,
            leave_out_spoiled=leave_out_spoiled,
        )
    else:
        of_selection = {"--plan": plan, "--budget": budget, "--cluster": cluster}
        refuse_options(
            of_selection,
            "to a single recipe",
            "neither a recipe nor a model",
            "omit --recipe, --physics and --from to try several; "
            "--set 'stages.*.epochs=100' limits a training",
        )
    if resume and overwrite:
        raise InputError("--resume, --overwrite", "both", "one of them")
    require_system_of_card(found_system, data, card)
    if card is None and catalog.lacks_card(data):
        card = draft_into_run(Path(data), out, keeps=resume, overwrite=overwrite)
    earlier: run_folder.Earlier = "resume" if resume else "discard" if overwrite else "refuse"
    fit_options = FitOptions(
        load=partial(load_records_to_fit, data, card, out),
        out=out,
        system=found_system,
        earlier=earlier,
        report=AutomaticReport(data, card, is_enabled=not no_report),
        json=json,
        quiet=quiet,
        leave_out_spoiled=leave_out_spoiled,
    )
    if selection is not None:
        select(fit_options, selection, cluster_address=cluster, says_budget=budget is None)
    else:
        _fit_recipe(
            fit_options,
            recipe_name=recipe,
            changes=changes,
            seeds=seeds,
            physics=physics,
            origin=origin,
            start_time=start_time,
        )


def _fit_recipe(
    fit_options: FitOptions,
    *,
    recipe_name: str | None,
    changes: Sequence[str] | None,
    seeds: str | None,
    physics: Path | None,
    origin: Path | None,
    start_time: float,
) -> None:
    """Fits one recipe, writes and prints the results, and the time since the start time."""
    system, console = fit_options.system, terminal.messages()
    stored_recipe = None if origin is None or recipe_name is not None else read_recipe_in(origin)
    recipe = choose_recipe(stored_recipe or recipe_name, changes, system=system, physics=physics)
    members = make_members(seeds, recipe)
    initial_model = None if origin is None else read_origin(origin, system, changes)
    if system is None and (file := physics or origin) is not None:
        system = kept_system(file)
    physics_model = None if physics is None else tn.load_model(physics, system)
    records = fit_options.load()
    if "validation" not in records.splits:
        console.print("note: no validation split; the scores below are of the training records")
    task_system = system
    if origin is not None and "system" in recipe.family.needs:
        task_system = system or model_file.read_system_name(origin) or None
    elif physics is not None or origin is not None:
        task_system = None  # it is that of the physics
    system_file = None if isinstance(system, str) else system
    fit_request = request.FitRequest(
        records,
        recipe,
        members,
        physics=physics_model,
        system=task_system,
        origin=initial_model,
        leaves_out_spoiled=fit_options.leave_out_spoiled,
    )
    preparation_start = time.perf_counter()
    printer = terminal.make_printer(quiet=fit_options.quiet)
    prepared = request.prepare(fit_request, listeners.Listener(on_message=printer))
    preparation_seconds = time.perf_counter() - preparation_start
    task = prepared.task
    print_still_coordinates(task.folds[0].roles.train)
    if not fit_options.quiet:
        _print_windows(task)
    remedy = (
        "--resume continues from the checkpoint"
        if recipe.family.resumable
        else "only a training can be resumed; start it again, if necessary with --overwrite"
    )
    with (
        progress_bars.FitProgress(console, quiet=fit_options.quiet) as progress,
        terminal.interruptible(remedy),
    ):
        run = runs.run_fit(
            prepared,
            fit_options.out,
            fit_options.earlier,
            progress.listener(),
            system_file,
        )
    # the folder is let go only when figures and report, which are of this model, are there
    with after_model(run.folder / run_folder.MODEL), disk.lock_folder(run.folder):
        if system_file is not None:
            terminal.remember_trust(system_file)
        if fit_options.json:
            terminal.print_json(run.summary())
        else:
            _print_run(run, fit_options.report.data_words)
        _draw_run(run, prepared.records.data)
        report = _write_report(run, fit_options)
    if not fit_options.json:
        figures = run.folder / "figures"
        terminal.echo(f"model: {run.folder / run_folder.MODEL}   figures: {figures}{report or ''}")
        if not fit_options.quiet:
            seconds = time.perf_counter() - start_time
            terminal.echo(summary.time_sentence(seconds, run.seconds, preparation_seconds))
    unfinished = [m.result for m in run.members if not m.result.finished]
    for result in unfinished:
        member = f"{result.member.name}: " if result.recipe.family.has_seeds else ""
        kind = "warning" if _is_usable(result) else "error"
        console.print(f"{kind}: {member}{result.failure}")
    if not any(_is_usable(m.result) for m in run.members):
        raise typer.Exit(1)
    require_report(report)


def _is_usable(result: "tn.FitResult") -> bool:
    """Whether a fit is finished, or a search that ended early with a model that simulates."""
    search = result.identification
    if search is None or search.reversed_signs:
        return result.finished
    return not search.outcome.startswith("diverged")


def _print_windows(task: "tasks.Task") -> None:
    """Prints how the windows of each training stage were chosen."""
    if isinstance(task.recipe, recipes.TrainingRecipe):
        for stage in task.recipe.stages:
            account = windows.describe_windows(task.folds[0].roles.train, stage.windows)
            terminal.messages().print(f"{stage.name}: {account}")


def _write_report(run: "runs.Run", fit_options: FitOptions) -> str | None:
    """Writes the report of the best model; see `AutomaticReport.write`."""
    score, folder = run.best.scores[0], run.folder
    split = run.judging_split if run.roles.ranking[0].split else None
    return fit_options.report.write(
        [folder],
        folder / run_folder.REPORT,
        lambda command: fit_reports.write_run_report(run, command),
        {"--split": split, "--start": score.start, "--horizon": score.horizon},
    )


def _print_run(run: "runs.Run", data: str) -> None:
    """Prints members of a training or parameters of an identification, errors, and a summary."""
    identification = run.best.result.identification
    if identification is None:
        terminal.print_tables(fit_tables.members_table(run), fit_tables.training_table(run))
        results = [member.result for member in run.members]
        common = [f for f in results[0].findings if all(f in r.findings for r in results)]
        for finding in common:
            terminal.echo(f"* {finding}")
        for result in results:
            for finding in result.findings:
                if finding not in common:
                    terminal.echo(f"* {result.member.name}: {finding}")
    else:
        terminal.print_tables(
            fit_tables.parameter_table(identification),
            fit_tables.training_table(run),
            fit_tables.validation_table(run),
        )
        for finding in identification.findings:
            terminal.echo(f"* {finding}")
        if identification.base_parameters:
            terminal.echo(
                "* base parameters, with values and intervals: "
                f"{run.folder / run_folder.BASE_PARAMETERS}"
            )
        terminal.echo(
            f"initial states: {identification.initial}; "
            f"condition {identification.condition:.3g}; "
            f"{identification.substeps} Runge-Kutta steps a period"
        )
        # of a search that ended early, a warning at the end gives the outcome
        is_warned = _is_usable(run.best.result) and not run.best.result.finished
        outcome = "" if is_warned else f"{identification.outcome}; "
        terminal.echo(f"{outcome}{identification.seconds:.1f} s")
    for sentence in summary.fit_summary(run):
        terminal.echo(sentence)
    steps = about.next_steps(
        run.folder / run_folder.MODEL,
        data,
        run.best.result.model,
        follows=run.follows,
        by_forces=run.best.result.recipe.is_by_forces,
    )
    terminal.echo(f"next: {steps}")


def _draw_run(run: "runs.Run", data: "tn.DataSet") -> None:
    """Draws training curves or error correlations, and the free runs of the best model."""
    best = run.best
    histories = {m.result.member.name: log.read_log(m.folder) for m in run.members}
    if all(histories.values()):
        drawing.write_figure(
            result_figures.training_figure(histories), run.folder, "figures/training.png"
        )
    if best.result.identification is not None:
        drawing.write_figure(
            identification_report.correlation_figure(best.result.identification),
            run.folder,
            "figures/correlation.png",
        )
    label = best.result.recipe.name
    label += f", {best.result.member.name}" if len(run.members) > 1 else ""
    for score in best.scores:
        figure = result_figures.free_run_figure(data[score.experiment], {label: score})
        drawing.write_figure(figure, run.folder, f"figures/{score.experiment}.png")
