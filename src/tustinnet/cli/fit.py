"""`tustinnet fit`: a model from a folder of logs, as a recipe says."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import completion, options, terminal

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.cli.leave_report import Leaving
    from tustinnet.data.dataset import DataSet
    from tustinnet.fitting.recipe import Recipe
    from tustinnet.fitting.task import Task
    from tustinnet.store.run import Earlier, Run
    from tustinnet.systems.files import SystemFile


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
    changes: options.Set = None,
    seeds: options.Seeds = None,
    physics: options.Physics = None,
    origin: options.Origin = None,
    system: options.System = None,
    plan: _Plan = None,
    budget: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Without a recipe: time limit, as 10min. Default: none."),
    ] = None,
    cluster: Annotated[str | None, options.cluster("Without a recipe: use")] = None,
    card: options.Card = None,
    strict: options.Strict = False,
    device: options.Device = None,
    resume: options.Resume = False,
    overwrite: options.Overwrite = False,
    no_report: options.NoReport = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Fit a model: try several recipes and keep the best, or fit one."""
    from tustinnet.cli.request import loaded, require_cores

    require_cores(cluster, device)
    terminal.prepare_jax(device)
    from tustinnet.cli.leave_report import Leaving
    from tustinnet.cli.select import select
    from tustinnet.systems.files import find_system

    selects = recipe is None and physics is None and origin is None
    for option, model in (("--physics", physics), ("--from", origin)):
        _require_apart(out, option, model)
    by_plan = {"--plan": plan, "--budget": budget, "--cluster": cluster}
    _require_meaning(selects, {"--set": changes, "--seeds": seeds}, by_plan)
    earlier = _earlier(resume=resume, overwrite=overwrite)
    given = None if system is None else find_system(system)
    load = partial(loaded, data, card, out, terminal.messages(), strict=strict)
    leaving = Leaving(data, card, wanted=not no_report)
    if selects:
        asked = plan, budget, cluster
        select(load, out, asked, given, earlier, leaving, json=json, quiet=quiet)
        return
    what = recipe, changes, seeds, physics, origin
    _fit_recipe(load, out, what, given, earlier, leaving, json=json, quiet=quiet)


def _fit_recipe(
    load: "Callable[[], DataSet]",
    out: Path,
    asked: tuple[str | None, list[str] | None, str | None, Path | None, Path | None],
    given: "SystemFile | str | None",
    earlier: "Earlier",
    leaving: "Leaving",
    *,
    json: bool,
    quiet: bool,
) -> None:
    """Fits one recipe: `asked` has its name, changes, seeds, physics to correct, origin."""
    from tustinnet.cli.leave_report import require_left
    from tustinnet.cli.request import (
        begun_with,
        kept_system,
        members_of,
        recipe_of,
        recipe_within,
        tell_still,
    )  # fmt: skip
    from tustinnet.fitting.task import make_task
    from tustinnet.report.progress import FitProgress
    from tustinnet.store.model_file import load_model, read_system_name
    from tustinnet.store.run import run_task

    recipe, changes, seeds, physics, origin = asked
    within = None if origin is None or recipe is not None else recipe_within(origin)
    chosen = recipe_of(within or recipe, changes, system=given, physics=physics)
    members = members_of(seeds, chosen)
    begun = None if origin is None else begun_with(origin, given, changes)
    if given is None and (kept := physics or origin) is not None:
        given = kept_system(kept)
    known = None if physics is None else load_model(physics, given)
    told = terminal.messages()
    records = load()
    if "validation" not in records.splits:
        told.print("note: no validation split; the scores below are of the training records")
    of = given
    if origin is not None and "system" in chosen.family.needs:
        of = given or read_system_name(origin) or None
    elif physics is not None or origin is not None:
        of = None  # it is that of the physics
    file = None if isinstance(given, str) else given
    task = make_task(records, chosen, members, physics=known, system=of, origin=begun)
    tell_still(task.folds[0].roles.train, told)
    if not quiet:
        _tell_windows(task, told)
    with FitProgress(told, quiet=quiet) as progress, terminal.interruptible(_remedy(chosen)):
        run = run_task(task, records.name, out, earlier, progress.follow, file)
    if file is not None:
        terminal.remember_trust(file)
    page = _leave(run, records, leaving, json=json)
    _tell_unfinished(run, told)
    require_left(page)


def _leave(run: "Run", records: "DataSet", leaving: "Leaving", *, json: bool) -> str | None:
    """Prints what came out; then draws it and writes the report, and returns where that is."""
    from tustinnet.store.run import MODEL

    if json:
        terminal.print_json(run.summary())
    else:
        _print(run, leaving.data)
    _draw(run, records)
    page = _page(run, leaving)
    if not json:
        typer.echo(f"model: {run.folder / MODEL}   figures: {run.folder / 'figures'}{page or ''}")
    return page


def _require_meaning(
    selects: bool, by_recipe: Mapping[str, object], by_plan: Mapping[str, object]
) -> None:
    """Raises where an option is given that means nothing here."""
    from tustinnet.errors import InputError

    for name, value in (by_recipe if selects else by_plan).items():
        if value is not None and selects:
            raise InputError(name, "means nothing where no recipe is named", "a recipe",
                             "add --recipe NAME, or write a plan (--plan FILE)")  # fmt: skip
        if value is not None:
            raise InputError(name, "means nothing to a single recipe", "no recipe, no model",
                             "leave --recipe, --physics and --from out to try several")  # fmt: skip


def _require_apart(out: Path, option: str, model: Path | None) -> None:
    """Raises where a run would be written over a model that it is made from."""
    from tustinnet.errors import InputError

    if model is not None and out.resolve() in model.resolve().parents:
        raise InputError(out, f"the folder of {model}, which {option} names", "another folder")


def _tell_unfinished(run: "Run", told: "Console") -> None:
    """What went wrong; ends with exit code 1 where nothing else came out."""
    unfinished = [of.result for of in run.members if not of.result.finished]
    for result in unfinished:
        who = f"{result.member.name}: " if result.recipe.family.trains else ""
        told.print(f"error: {who}{result.failure}")
    if len(unfinished) == len(run.members):
        raise typer.Exit(1)


def _tell_windows(task: "Task", told: "Console") -> None:
    """What the windows of a training's stages were chosen by."""
    from tustinnet.fitting.gradient.material import window_account
    from tustinnet.fitting.recipe import TrainingRecipe

    if isinstance(task.recipe, TrainingRecipe):
        train = task.folds[0].roles.train
        for stage in task.recipe.stages:
            account = window_account(train, stage.windows)
            told.print(f"{stage.name}: {account}", highlight=False, soft_wrap=True)


def _remedy(recipe: "Recipe") -> str:
    """What to do after an interruption."""
    if recipe.family.trains:
        return "--resume goes on from the checkpoint"
    return "an identification begins anew, with --overwrite where it left files"


def _earlier(*, resume: bool, overwrite: bool) -> "Earlier":
    from tustinnet.errors import InputError

    if resume and overwrite:
        raise InputError("--resume, --overwrite", "both", "one of them")
    return "resume" if resume else "discard" if overwrite else "refuse"


def _page(run: "Run", leaving: "Leaving") -> str | None:
    """Writes the report of the best model; returns where it is, as the line of files says it."""
    from tustinnet.report.page.fitted import report_of_run
    from tustinnet.store.run import REPORT

    score, folder = run.best.scores[0], run.folder
    split = run.judging_split if run.roles.judging[0].split else None
    given = {"--split": split, "--start": score.start, "--horizon": score.horizon}
    return leaving.report(
        [folder], folder / REPORT, lambda command: report_of_run(run, command), given
    )


def _print(run: "Run", data: str) -> None:
    """Tables and sentences: members of a training, parameters of an identification."""
    from tustinnet.report.fits import fitted_table, judged_table, members_table, parameter_table
    from tustinnet.report.summary import fit_summary

    found = run.best.result.identification
    if found is None:
        terminal.print_tables(members_table(run), fitted_table(run))
        for of in run.members:
            for finding in of.result.findings:
                typer.echo(f"* {of.result.member.name}: {finding}")
    else:
        terminal.print_tables(parameter_table(found), fitted_table(run), judged_table(run))
        for finding in found.findings:
            typer.echo(f"* {finding}")
        typer.echo(
            f"initial states: {found.initial}; condition {found.condition:.3g}; "
            f"{found.substeps} Runge-Kutta steps a period"
        )
        typer.echo(f"{found.outcome}; {found.seconds:.1f} s")
    for sentence in fit_summary(run, data):
        typer.echo(sentence)


def _draw(run: "Run", data: "DataSet") -> None:
    from tustinnet.report.figures import free_run_figure, training_figure, write_figure
    from tustinnet.report.identification import correlation_figure
    from tustinnet.store.log import read_log

    best = run.best
    histories = {of.result.member.name: read_log(of.folder) for of in run.members}
    if all(histories.values()):
        write_figure(training_figure(histories), run.folder, "figures/training.png")
    if best.result.identification is not None:
        write_figure(
            correlation_figure(best.result.identification), run.folder, "figures/correlation.png"
        )
    label = best.result.recipe.name
    label += f", {best.result.member.name}" if len(run.members) > 1 else ""
    for score in best.scores:
        picture = free_run_figure(data[score.experiment], {label: score})
        write_figure(picture, run.folder, f"figures/{score.experiment}.png")
