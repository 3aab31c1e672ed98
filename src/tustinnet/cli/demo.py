"""`tustinnet demo`: all steps on simulated records, offline."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal
from tustinnet.wording import counted

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.data.dataset import DataSet
    from tustinnet.data.experiment import Experiment
    from tustinnet.evaluate.scores import Score
    from tustinnet.report.page.reported_model import ReportedModel
    from tustinnet.report.tables import Table
    from tustinnet.store.run_folder import Earlier

# the plan, with a system that lacks the cable's relaxation and dry friction; its time limit
_PLAN, _SYSTEM, _SECONDS = "quick", "qube-servo2", 105.0
_CHOICE = "twin_choice"
_START = "derived-6"  # the twin moves when its records begin, and `file` would say it does not
_REPORTED = 2  # models: the chosen one and one beside it; each takes seconds
_DRAWN = ("twin_fall_test1", "twin_noise_test2")
# the controller: on the identified equations, for a swing-up of the twin that they do not know
_CONTROLLER, _SWING_UP = "twin_controller", "twin_swing_up.png"
_UPRIGHT, _VOLTAGE, _RUNS = {"alpha": 0.0}, {"voltage": (-10.0, 10.0)}, 20


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for records, models, figures.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated logs.")] = 0,
    overwrite: options.Overwrite = False,
    device: options.Device = None,
    no_report: options.NoReport = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Try it without data: simulate a pendulum, fit, compare, report, swing up.

    The logs are simulated from Lagrange's equations, which favours grey boxes: the table shows
    how the command works, not how accurate the models are on a real device.
    """
    terminal.prepare_jax(device)
    from tustinnet.check.report import inspect_experiment
    from tustinnet.cli.automatic_report import AutomaticReport, require_report
    from tustinnet.cli.inspect import time_table
    from tustinnet.data.catalog import load
    from tustinnet.evaluate.scores import mean_rmse, rmse_by_record
    from tustinnet.report.page.fit_reports import write_scored_report
    from tustinnet.store.data_set_folder import write_data_set
    from tustinnet.store.files import (
        lock_folder,
        require_outputs,
        to_json,
        write_into,
    )
    from tustinnet.systems import qube_servo2_twin

    console = terminal.messages()
    table_file, logs = out / "twin_table.md", out / "twin"
    page = out / "twin_report.html"
    figures = [out / f"{name}.png" for name in ("twin_records", *_DRAWN)] + [out / _SWING_UP]
    folders = [logs, out / _CHOICE, out / _CONTROLLER]
    files = [table_file, table_file.with_suffix(".json"), *folders, *figures]
    require_outputs([*files, *([] if no_report else [page])], overwrite=overwrite)

    def print_step(line: str) -> None:
        if not quiet:
            console.print(line)

    with lock_folder(out):
        print_step(f"1/6 twin of the Qube-Servo 2, simulated and logged: {logs}")
        twin = qube_servo2_twin.twin(seed)
        write_data_set(twin, logs, "Simulated twin of the Qube-Servo 2", overwrite=overwrite)
        data = load(logs)
        print_step(f"2/6 looking at the {counted(len(data), 'record')}: {out / 'twin_records.png'}")
        training = list(data.split("train"))
        reports = [inspect_experiment(e) for e in training]
        if not json:
            terminal.print_tables(time_table(reports))

        from tustinnet.report.drawing import write_figure
        from tustinnet.report.figures import free_run_figure, inspection_figure

        write_figure(inspection_figure(training, reports), out, "twin_records.png")
        print_step(f"3/6 choosing a model in at most {_SECONDS:.0f} s: {out / _CHOICE}")
        earlier = "discard" if overwrite else "refuse"
        models = _select_and_score(data, out, console, quiet=quiet, json=json, earlier=earlier)
        scores = {model.label: model.scores for model in models}
        tests = list(data.split("test"))
        print_step(f"4/6 free runs of the {len(tests)} test records")
        content = {
            "data": data.name,
            "split": "test",
            "start": _START,
            "units": data.channels.unit,
            "models": {
                label: {"mean": mean_rmse(model_scores), "rmse": rmse_by_record(model_scores)}
                for label, model_scores in scores.items()
            },
        }
        write_into(out, "twin_table.md", _scores_table(scores).markdown())
        write_into(out, "twin_table.json", to_json(content))
        if json:
            terminal.print_json(content)
        else:
            terminal.print_tables(_scores_table(scores))
        for name in _DRAWN:
            runs = {
                label: next(s for s in model_scores if s.experiment == name)
                for label, model_scores in scores.items()
            }
            write_figure(free_run_figure(data[name], runs, recorded="twin"), out, f"{name}.png")
        if not no_report:
            print_step(f"5/6 the report, motion and playground in one page: {page}")
        reported = models[:_REPORTED]
        report = AutomaticReport(str(logs), is_enabled=not no_report).write(
            [model.file for model in reported if model.file is not None],
            page,
            lambda command: write_scored_report(reported, tests, page, command),
            {"--split": "test", "--start": _START},
        )
        print_step(f"6/6 a controller that swings the twin up: {out / _CONTROLLER}")
        swing_up = _swing_up(models, list(data.split("train")), out, overwrite=overwrite)
        if not json:
            terminal.echo(swing_up)
    file_names = [table_file.name, *[f"{name}.png" for name in _DRAWN], _SWING_UP]
    print_step(f"written to {out}: {', '.join(file_names)}{report or ''}")
    print_step(
        f"look again: tustinnet inspect {logs}; tustinnet show {out / _CHOICE}/"
        f"model.safetensors; {out / _CHOICE / 'figures'}"
    )
    require_report(report)


def _select_and_score(
    data: "DataSet", out: Path, console: "Console", *, quiet: bool, json: bool, earlier: "Earlier"
) -> "list[ReportedModel]":
    """Chooses a model without the test records, and scores it and the others on these."""
    from tustinnet.cli.select import draw_choice, make_reporter, print_choice, print_files
    from tustinnet.evaluate.scores import evaluate
    from tustinnet.report.page.reported_model import read_reported_models
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.select import SelectionOptions, select_model

    selection = SelectionOptions(_PLAN, _SYSTEM, _SECONDS)
    with FitProgress(console, quiet=quiet) as progress:
        reporter = make_reporter(progress, quiet=quiet)
        choice = select_model(data, out / _CHOICE, selection, earlier, reporter)
    if not json:
        print_choice(choice, quiet=quiet)
    draw_choice(choice)
    if not json:
        print_files(choice)
    tests = list(data.split("test"))
    models = []
    for name in [choice.best, *(name for name in choice.origins if name != choice.best)]:
        is_chosen = name == choice.best
        model = choice.model if is_chosen else choice.context.load_model(choice.file(name))
        (reported,) = read_reported_models([choice.context.folder / choice.file(name)], [model])
        label = f"{name} (chosen)" if is_chosen else name
        models.append(replace(reported, label=label, scores=evaluate(model, tests, _START)))
    return models


def _swing_up(
    models: "Sequence[ReportedModel]",
    records: "Sequence[Experiment]",
    out: Path,
    *,
    overwrite: bool,
) -> str:
    """Designs a controller on a model, plays it on the twin, writes it as C; returns the result.

    The model is the best one with equations of motion, which say what the voltage does upright.
    """
    from tustinnet.control.design import ControlTask, design_controller, find_rest
    from tustinnet.control.export.write import export_controller
    from tustinnet.control.plants import qube_twin
    from tustinnet.control.trial import try_design
    from tustinnet.models.physical_values import equations_in
    from tustinnet.report.control import closed_loop_figure
    from tustinnet.report.drawing import write_figure
    from tustinnet.simulate.range import Range

    physical = [m for m in models if equations_in(m.model) is not None]
    if not physical:
        return "no swing-up: no model with equations of motion was fitted in time"
    model, header, file = physical[0].model, physical[0].header, physical[0].file
    task = ControlTask(
        _UPRIGHT, find_rest(model, _UPRIGHT, _VOLTAGE), limits=_VOLTAGE, trust_beyond=True
    )
    design = design_controller(
        model, task, range=Range.from_header(dict(header), model), records=records
    )
    trial = try_design(design, header, plants={"twin": qube_twin()}, variants=False, count=_RUNS)
    export_controller(
        model,
        design.gains,
        design.noise,
        out / _CONTROLLER,
        deviations=design.deviations,
        within=design.task.within,
        file=file,
        overwrite=overwrite,
    )
    write_figure(closed_loop_figure(design, trial.main_runs), out, _SWING_UP)
    (row,) = trial.robustness.rows
    return (
        f"swing-up of the twin, through its encoders: {row.successes} of {len(row.outcomes)} runs "
        f"reach upright and hold it for {design.goal.hold:.0f} s"
    )


def _scores_table(scores: "Mapping[str, Sequence[Score]]") -> "Table":
    """Table of the test records, with a row for each model."""
    from tustinnet.evaluate.scores import mean_rmse
    from tustinnet.report.tables import Table, number

    names = [s.experiment.removeprefix("twin_") for s in next(iter(scores.values()))]
    rows = [
        [label, *[number(s.rmse) for s in model_scores], number(mean_rmse(model_scores))]
        for label, model_scores in scores.items()
    ]
    title = (
        f"Twin (simulated, favours Lagrangian models): free-run RMSE [rad], test, start '{_START}'"
    )
    return Table(["model", *names, "mean"], rows, title=title)
