"""`tustinnet demo`: the whole main job on simulated records, offline."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.data.dataset import DataSet
    from tustinnet.evaluation.free_run import Score
    from tustinnet.report.tables import Table

_SYSTEMS = {
    "Euler-Lagrange, no spring": "qube-servo2-naive",
    "Euler-Lagrange": "qube-servo2",
}
_RECIPES = {"Tustin-Net, standard": "standard", "Tustin-Net, transfer": "transfer"}
_START = "derived-6"  # the twin moves when its records begin, and `file` would say it does not
_DRAWN = ("twin_fall_test1", "twin_noise_test2")


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where records, models, figures go.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the twin and of the networks.")] = 0,
    overwrite: options.Overwrite = False,
    device: options.Device = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Make a twin of a rotary pendulum, log it, fit four models, compare their free runs.

    The twin is simulated from Lagrange's equations, so it favours Lagrangian models: the table
    shows how the command works, not how accurate the models are on an apparatus.
    """
    terminal.prepare_jax(device)
    from tustinnet.artifact.data_set_folder import write_data_set
    from tustinnet.artifact.files import (
        require_new,
        require_writable_folder,
        to_json,
        write_atomically,
    )
    from tustinnet.cli.inspect import time_table
    from tustinnet.data.catalog import load
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.evaluation.free_run import mean_rmse
    from tustinnet.report.figures import inspection_figure, write_figure
    from tustinnet.systems import qube_servo2_twin

    told = terminal.messages()
    table_file, logs = out / "twin_table.md", out / "twin"
    require_new([table_file, logs], overwrite=overwrite)
    require_writable_folder(out)
    _say(told, quiet, f"1/4 twin of the Qube-Servo 2, simulated and logged: {logs}")
    records = qube_servo2_twin.twin(seed)
    write_data_set(records, logs, "Simulated twin of the Qube-Servo 2", overwrite=overwrite)
    data = load(logs)
    _say(told, quiet, f"2/4 looking at the {len(data)} records: {out / 'twin_records.png'}")
    training = list(data.split("train"))
    reports = [inspect_experiment(e) for e in training]
    write_figure(inspection_figure(training, reports), out / "twin_records.png")
    if not json:
        terminal.print_tables(time_table(reports))
    _say(told, quiet, "3/4 fitting four models on the training records")
    judged = list(data.split("test"))
    # what is fitted and what chooses between fits must not see the records that judge
    material = type(data)(data.name, tuple(e for e in data if e.split != "test"))
    scores = {
        **_identified(material, judged, out, told, quiet=quiet, overwrite=overwrite),
        **_trained(material, judged, out, seed, told, quiet=quiet, overwrite=overwrite),
    }
    _say(told, quiet, f"4/4 free runs of the {len(judged)} test records")
    table = _table(scores)
    write_atomically(table_file, table.markdown())
    content = {
        "data": data.name, "split": "test", "start": _START, "units": "rad",
        "models": {
            label: {"mean": mean_rmse(s), "rmse": {x.experiment: x.rmse for x in s}}
            for label, s in scores.items()
        },
    }  # fmt: skip
    write_atomically(out / "twin_table.json", to_json(content))
    figures = _draw(data, scores, out)
    if json:
        terminal.print_json(content)
    else:
        terminal.print_tables(table)
    _say(told, quiet, f"written to {out}: {table_file.name}, {', '.join(figures)}")
    _say(told, quiet, f"look again: tustinnet inspect {logs}; tustinnet compare {out}/twin_*/"
                      f"model.safetensors {logs} --split test")  # fmt: skip


def _say(told: "Console", quiet: bool, line: str) -> None:
    if not quiet:
        told.print(line)


def _folder(out: Path, label: str) -> Path:
    return out / f"twin_{label.lower().replace(', ', '_').replace(' ', '_').replace('-', '_')}"


def _identified(
    data: "DataSet",
    judged: Sequence[Any],
    out: Path,
    told: "Console",
    *,
    quiet: bool,
    overwrite: bool,
) -> "dict[str, list[Score]]":
    from tustinnet.artifact.identification import require_free_folder, write_identification
    from tustinnet.evaluation.free_run import evaluate
    from tustinnet.identification.identify import identify
    from tustinnet.report.progress import IdentificationProgress
    from tustinnet.systems.registry import load_system

    scores = {}
    for label, name in _SYSTEMS.items():
        require_free_folder(_folder(out, label), overwrite=overwrite)
        with IdentificationProgress(told, quiet=quiet, label=label) as progress:
            result = identify(data, load_system(name), told=progress.told)
        chosen_by = evaluate(result.model, list(data.split("validation")), _START)
        write_identification(_folder(out, label), data, result, "validation", _START, chosen_by)
        scores[label] = evaluate(result.model, judged, _START)
        _say(told, quiet, f"{label}: {result.outcome}, {result.seconds:.0f} s")
    return scores


def _trained(
    data: "DataSet", judged: Sequence[Any], out: Path, seed: int, told: "Console",
    *, quiet: bool, overwrite: bool,
) -> "dict[str, list[Score]]":  # fmt: skip
    from tustinnet.artifact.run import train_runs
    from tustinnet.evaluation.free_run import evaluate
    from tustinnet.report.progress import TrainingProgress
    from tustinnet.training.recipe import read_recipe

    scores = {}
    with TrainingProgress(told, quiet=quiet) as progress:
        for label, recipe in _RECIPES.items():
            runs = train_runs(
                data, read_recipe(recipe), [seed], _folder(out, label), overwrite=overwrite,
                tell=lambda plan, label=label: progress.follow(plan, label),
            )  # fmt: skip
            scores[label] = evaluate(runs.best.result.model, judged, _START)
    return scores


def _table(scores: "dict[str, list[Score]]") -> "Table":
    from tustinnet.evaluation.free_run import mean_rmse
    from tustinnet.report.tables import Table, number

    names = [s.experiment.removeprefix("twin_") for s in next(iter(scores.values()))]
    rows = [
        [label, *[number(s.rmse) for s in found], number(mean_rmse(found))]
        for label, found in scores.items()
    ]
    title = (
        f"Twin (simulated, favours Lagrangian models): free-run RMSE [rad], test, start '{_START}'"
    )
    return Table(["model", *names, "mean"], rows, title=title)


def _draw(data: "DataSet", scores: "dict[str, list[Score]]", out: Path) -> list[str]:
    from tustinnet.report.figures import free_run_figure, write_figure

    written = []
    for name in _DRAWN:
        runs = {
            label: next(s for s in found if s.experiment == name) for label, found in scores.items()
        }
        figure = free_run_figure(data[name], runs, recorded="twin")
        write_figure(figure, out / f"{name}.png")
        written.append(f"{name}.png")
    return written
