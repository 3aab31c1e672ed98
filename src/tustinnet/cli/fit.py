"""`tustinnet fit`: train a model on a folder of logs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from tustinnet.artifact.run import Runs
    from tustinnet.data.dataset import DataSet
    from tustinnet.report.tables import Table


def fit(
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the run is kept.")],
    recipe: Annotated[
        str, typer.Option(metavar="NAME", help="A packaged recipe, or a TOML file.")
    ] = "standard",
    seeds: options.Seeds = 1,
    seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    card: options.Card = None,
    resume: options.Resume = False,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Train a Tustin-Net; keeps model, log, checkpoints and figures in --out."""
    terminal.use_float64()
    from tustinnet.artifact.run import summary, train_runs
    from tustinnet.cli.inspect import suspicions
    from tustinnet.data.catalog import locate
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.data.loading import load_folder
    from tustinnet.errors import InputError
    from tustinnet.report.progress import TrainingProgress
    from tustinnet.training.recipe import read_recipe

    chosen = read_recipe(recipe)
    folder, declared = locate(data, card)
    if out.resolve() == folder.resolve():
        raise InputError(out, "the folder of the data", "another folder for the run")
    loaded = load_folder(folder, declared)
    told = terminal.messages()
    if "validation" not in loaded.splits:
        told.print(
            "note: no validation split; the training loss chooses the best weights and the "
            "scores below are of the training records"
        )
    for line in suspicions(map(inspect_experiment, loaded)):
        told.print(line)
    with TrainingProgress(told, quiet=quiet) as progress, terminal.resumable(told, "--resume"):
        runs = train_runs(
            loaded, chosen, range(seed, seed + seeds), out,
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
        told.print(f"seed {result.seed}: {result.outcome}")
    if len(unfinished) == len(runs.seeds):
        raise typer.Exit(1)


def _table(runs: "Runs") -> "Table":
    from tustinnet.data.experiment import position_unit
    from tustinnet.report.tables import Table, number

    unit = position_unit(runs.seeds[0].result.model.coordinates)
    rows = [
        [
            str(run.result.seed),
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
    histories = {run.result.seed: read_log(run.folder) for run in runs.seeds}
    write_figure(training_figure(histories), folder / "training.png")
    for score in runs.best.scores:
        label = f"seed {runs.best.result.seed}"
        picture = free_run_figure(data[score.experiment], {label: score})
        write_figure(picture, folder / f"{score.experiment}.png")
