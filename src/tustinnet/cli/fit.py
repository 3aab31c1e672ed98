"""`tustinnet fit`: a model from a folder of logs, trained or identified."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from tustinnet.artifact.run import Runs
    from tustinnet.data.dataset import DataSet
    from tustinnet.report.tables import Table


class Family(StrEnum):
    """What kind of model."""

    tustin_net = "tustin-net"
    euler_lagrange = "euler-lagrange"


class Loss(StrEnum):
    """What is compared."""

    positions = "positions"
    state = "state"


class Part(StrEnum):
    """Which part of the records."""

    whole = "whole"
    transients = "transients"


class Times(StrEnum):
    """Which time base."""

    recorded = "recorded"
    nominal = "nominal"


class Method(StrEnum):
    """Which search."""

    levenberg_marquardt = "levenberg-marquardt"
    l_bfgs = "l-bfgs"


def fit(
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the run is kept.")],
    model: Annotated[
        Family | None,
        typer.Option(help="A network (the default), or equations of motion."),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="A packaged recipe, or a TOML file. tustin-net: default standard, with --physics "
            "best-hybrid. euler-lagrange: best-grey, or none.",
        ),
    ] = None,
    seeds: options.Seeds = 1,
    seed: Annotated[int, typer.Option(min=0, help="tustin-net: the first seed.")] = 0,
    rates: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,...",
            help="tustin-net: factors of the recipe's rates; every seed is trained with each.",
        ),
    ] = None,
    physics: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="tustin-net: an identified model whose accelerations the network corrects.",
        ),
    ] = None,
    system: options.System = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE]", help="euler-lagrange: hold a parameter; may be repeated."
        ),
    ] = None,
    begin: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="euler-lagrange: where a parameter starts; repeatable."
        ),
    ] = None,
    iterations: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="euler-lagrange: allowed in the last stage; default 50."
        ),
    ] = None,
    initial: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="euler-lagrange: initial states while identifying: anchored (searched for, "
            "positions within the encoders' error), free, choose (the better of both on the "
            "validation records), or held at a start (file, derived-6). Default: choose.",
        ),
    ] = None,
    part: Annotated[
        Part | None,
        typer.Option(help="euler-lagrange: whole records (the default), or up to k_bar."),
    ] = None,
    loss: Annotated[
        Loss | None,
        typer.Option(help="euler-lagrange: compare positions (the default), or velocities too."),
    ] = None,
    periodic: Annotated[
        bool | None,
        typer.Option(
            "--periodic/--no-periodic",
            help="euler-lagrange: periodic distance of angles, or not.",
            show_default=False,
        ),
    ] = None,
    times: Annotated[
        Times | None,
        typer.Option(help="euler-lagrange: step by timestamps (the default) or by the period."),
    ] = None,
    method: Annotated[
        Method | None,
        typer.Option(
            help="euler-lagrange: levenberg-marquardt (the default); l-bfgs is for many parameters."
        ),
    ] = None,
    card: options.Card = None,
    device: options.Device = None,
    resume: options.Resume = False,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Train a Tustin-Net, or identify the parameters of a system; keeps everything in --out."""
    terminal.prepare_jax(device)
    from tustinnet.artifact.model_file import load_model
    from tustinnet.artifact.run import summary, train_runs
    from tustinnet.cli.inspect import suspicions
    from tustinnet.data.catalog import locate
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.data.loading import load_folder
    from tustinnet.errors import InputError
    from tustinnet.identification.recipe import (
        identification_recipes,
        read_identification_recipe,
    )
    from tustinnet.identification.search import DEFAULT_SETTINGS
    from tustinnet.report.progress import TrainingProgress
    from tustinnet.simulation.integrators import Discretised
    from tustinnet.training.recipe import packaged_recipes, read_recipe

    family = model or (
        Family.euler_lagrange if recipe in identification_recipes() else Family.tustin_net
    )
    training = seeds > 1 or resume or rates is not None or physics is not None
    # a model that is corrected may be of a system of one's own
    corrected = physics is not None and family is Family.tustin_net
    _require_fitting_options(family, None if corrected else system, fix, training=training)
    other = {
        Family.tustin_net: identification_recipes(), Family.euler_lagrange: packaged_recipes(),
    }[family]  # fmt: skip
    if recipe in other:
        raise InputError(
            "--recipe", f"'{recipe}' is not for --model {family.value}", "one that is",
            "leave --model out, or see docs/training.md",
        )  # fmt: skip
    factors = _factors(rates)
    asked = {
        "initial": initial, "part": part, "loss": loss, "times": times, "periodic": periodic,
        "method": method, "most": iterations,
    }  # fmt: skip
    settings = DEFAULT_SETTINGS
    if family is Family.euler_lagrange:
        settings = read_identification_recipe(recipe).settings if recipe else settings
        given = {k: getattr(v, "value", v) for k, v in asked.items() if v is not None}
        settings = replace(settings, **given)
        recipe = None
    chosen = read_recipe(recipe or ("best-hybrid" if corrected else "standard"))
    known = None if physics is None else load_model(physics, system)
    if known is not None and not isinstance(known, Discretised):
        raise InputError(
            physics, "a model that is trained already", "one from --model euler-lagrange"
        )
    folder, declared = locate(data, card)
    if out.resolve() == folder.resolve():
        raise InputError(out, "the folder of the data", "another folder for the run")
    loaded = load_folder(folder, declared)
    told = terminal.messages()
    if "validation" not in loaded.splits:
        told.print("note: no validation split; the scores below are of the training records")
    for line in suspicions(map(inspect_experiment, loaded)):
        told.print(line)
    if family is Family.euler_lagrange:
        from tustinnet.cli.fit_grey_box import fit_grey_box

        fit_grey_box(
            loaded, str(system), settings, fix or [], begin or [], out,
            overwrite=overwrite, json=json, quiet=quiet,
        )  # fmt: skip
        return
    with TrainingProgress(told, quiet=quiet) as progress, terminal.resumable(told, "--resume"):
        runs = train_runs(
            loaded, chosen, range(seed, seed + seeds), out, rates=factors, physics=known,
            resume=resume, overwrite=overwrite, tell=progress.follow,
        )  # fmt: skip
    _draw(runs, loaded)
    if json:
        terminal.print_json(summary(runs))
    else:
        terminal.print_tables(_table(runs))
        typer.echo(f"model: {out / 'model.safetensors'}   figures: {out / 'figures'}")
    unfinished = [run.result for run in runs.seeds if not run.result.finished]
    for result in unfinished:
        told.print(f"{result.member.name}: {result.outcome}")
    if len(unfinished) == len(runs.seeds):
        raise typer.Exit(1)


def _factors(rates: str | None) -> list[float]:
    from tustinnet.errors import InputError

    try:
        factors = [float(x) for x in rates.split(",")] if rates is not None else [1.0]
    except ValueError:
        factors = []
    if (
        not factors
        or not all(0 < x < float("inf") for x in factors)
        or len(set(factors)) < len(factors)
    ):
        raise InputError(
            "--rates", f"'{rates}'", "different numbers above 0, separated by commas",
            "for instance --rates 0.3,1,3",
        )  # fmt: skip
    return factors


def _require_fitting_options(
    model: Family,
    system: str | None,
    fix: list[str] | None,
    *,
    training: bool,
) -> None:
    from tustinnet.errors import InputError

    if model is Family.euler_lagrange and system is None:
        raise InputError(
            "--model euler-lagrange", "no system", "--system NAME or --system FILE.py",
            "for the rotary pendulum say --system qube-servo2",
        )  # fmt: skip
    if model is Family.euler_lagrange and training:
        raise InputError(
            "--seeds, --rates, --resume, --physics", "options of a training", "--model tustin-net",
            "an identification has no seeds and is not resumed",
        )  # fmt: skip
    if model is Family.tustin_net and (system is not None or fix):
        raise InputError(
            "--system" if system is not None else "--fix", "an option of equations of motion",
            "--model euler-lagrange", "add it, or leave the option out",
        )  # fmt: skip


def _table(runs: "Runs") -> "Table":
    from tustinnet.data.experiment import position_unit
    from tustinnet.report.tables import Table, number

    unit = position_unit(runs.seeds[0].result.model.coordinates)
    rows = [
        [
            run.result.member.name.removeprefix("seed-"),
            number(run.mean),
            " + ".join(map(str, run.result.windows)),
            " + ".join(map(str, run.result.epochs)),
            str(run.result.kept_epoch),
            f"{run.result.train_seconds:.0f}",
            run.result.outcome.split(":")[0],
        ]
        for run in runs.seeds
    ]
    if len(rows) > 1:
        spread = runs.spread()
        low, high = number(spread["min"]), number(spread["max"])
        told = f"{number(spread['median'])} ({low}..{high})"
        rows.append(["median (range)", told, "", "", "", "", ""])
    return Table(
        ["seed", f"mean RMSE [{unit}]", "windows", "epochs", "kept", "seconds", "outcome"],
        rows,
        title=f"{runs.seeds[0].result.recipe.name}, {runs.judged} free runs, start '{runs.start}'",
    )


def _draw(runs: "Runs", data: "DataSet") -> None:
    from tustinnet.artifact.run import read_log
    from tustinnet.report.figures import free_run_figure, training_figure, write_figure

    folder = runs.folder / "figures"
    histories = {run.result.member.name: read_log(run.folder) for run in runs.seeds}
    write_figure(training_figure(histories), folder / "training.png")
    for score in runs.best.scores:
        label = runs.best.result.member.name
        picture = free_run_figure(data[score.experiment], {label: score})
        write_figure(picture, folder / f"{score.experiment}.png")
