"""`tustinnet demo`: all steps on simulated records, offline."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import devices, options, terminal
from tustinnet.cli.automatic_report import AutomaticReport, require_report
from tustinnet.cli.inspect import time_table
from tustinnet.cli.select import draw_choice, print_choice, print_files
from tustinnet.control import design as controller_design
from tustinnet.control import trial as trials
from tustinnet.evaluate import scores as scoring
from tustinnet.models import physical_values
from tustinnet.report import comparison, control, drawing, plain_fit
from tustinnet.report import figures as result_figures
from tustinnet.report import progress as progress_bars
from tustinnet.report.page import fit_reports, reported_model
from tustinnet.simulate import range as training_ranges
from tustinnet.store import data_set_folder, run_folder
from tustinnet.store import files as disk
from tustinnet.systems import qube_servo2_twin
from tustinnet.wording import counted

# the plan, with a system that lacks the cable's relaxation and dry friction; its time limit
_PLAN, _SYSTEM, _SECONDS = "quick", "qube-servo2", 105.0
_CHOICE = "twin_choice"
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
    devices.prepare_jax(device)
    console = terminal.messages()
    table_file, logs = out / "twin_table.md", out / "twin"
    page = out / "twin_report.html"
    figures = [out / f"{name}.png" for name in ("twin_records", *_DRAWN)] + [out / _SWING_UP]
    folders = [logs, out / _CHOICE, out / _CONTROLLER]
    files = [table_file, table_file.with_suffix(".json"), *folders, *figures]
    disk.require_outputs([*files, *([] if no_report else [page])], overwrite=overwrite)

    def print_step(line: str) -> None:
        if not quiet:
            console.print(line)

    with disk.lock_folder(out):
        print_step(f"1/6 twin of the Qube-Servo 2, simulated and logged: {logs}")
        twin = qube_servo2_twin.twin(seed)
        data_set_folder.write_data_set(
            twin, logs, "Simulated twin of the Qube-Servo 2", overwrite=overwrite
        )
        data = tn.load(logs)
        print_step(f"2/6 looking at the {counted(len(data), 'record')}: {out / 'twin_records.png'}")
        training = list(data.split("train"))
        reports = [tn.inspect_experiment(e) for e in training]
        if not json:
            terminal.print_tables(time_table(reports))

        drawing.write_figure(
            result_figures.inspection_figure(training, reports), out, "twin_records.png"
        )
        print_step(f"3/6 choosing a model in at most {_SECONDS:.0f} s: {out / _CHOICE}")
        earlier = "discard" if overwrite else "refuse"
        models = _select_and_score(data, out, quiet=quiet, json=json, earlier=earlier)
        scores = {model.label: model.scores for model in models}
        tests, start = list(data.split("test")), models[0].scores[0].start
        print_step(f"4/6 free runs of the {len(tests)} test records")
        content = {
            "data": data.name,
            "split": "test",
            "start": start,
            "units": data.channels.unit,
            "models": {
                label: {
                    "mean": tn.mean_rmse(model_scores),
                    "rmse": scoring.rmse_by_record(model_scores),
                }
                for label, model_scores in scores.items()
            },
        }
        table = comparison.comparison_table(tests, scores, start)
        table = replace(table, title=f"Twin (simulated, favours Lagrangian models). {table.title}")
        disk.write_into(out, "twin_table.md", table.markdown())
        disk.write_into(out, "twin_table.json", disk.to_json(content))
        if json:
            terminal.print_json(content)
        else:
            terminal.print_tables(table)
        for name in _DRAWN:
            runs = {
                label: next(s for s in model_scores if s.experiment == name)
                for label, model_scores in scores.items()
            }
            drawing.write_figure(
                result_figures.free_run_figure(data[name], runs, recorded="twin"),
                out,
                f"{name}.png",
            )
        if not no_report:
            print_step(f"5/6 the report, motion and playground in one page: {page}")
        reported = models[:_REPORTED]
        report = AutomaticReport(str(logs), is_enabled=not no_report).write(
            [model.file for model in reported if model.file is not None],
            page,
            lambda command: fit_reports.write_scored_report(reported, tests, page, command),
            {"--split": "test"},
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
    data: "tn.DataSet",
    out: Path,
    *,
    quiet: bool,
    json: bool,
    earlier: "run_folder.Earlier",
) -> "list[reported_model.ReportedModel]":
    """Chooses a model without the test records, and scores it and the others on these."""
    selection = tn.SelectionOptions(_PLAN, _SYSTEM, _SECONDS)
    with progress_bars.FitProgress(terminal.messages(), quiet=quiet) as progress:
        reporter = plain_fit.make_reporter(progress, terminal.make_printer(quiet=quiet))
        choice = tn.select_model(data, out / _CHOICE, selection, earlier, reporter)
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
        (reported,) = reported_model.read_reported_models(
            [choice.context.folder / choice.file(name)], [model]
        )
        label = f"{name} (chosen)" if is_chosen else name
        models.append(replace(reported, label=label, scores=tn.evaluate(model, tests)))
    return models


def _swing_up(
    models: "Sequence[reported_model.ReportedModel]",
    records: "Sequence[tn.Experiment]",
    out: Path,
    *,
    overwrite: bool,
) -> str:
    """Designs a controller on a model, plays it on the twin, writes it as C; returns the result.

    The model is the best one with equations of motion, which say what the voltage does upright.
    """
    physical = [m for m in models if physical_values.equations_in(m.model) is not None]
    if not physical:
        return "no swing-up: no model with equations of motion was fitted in time"
    model, header, file = physical[0].model, physical[0].header, physical[0].file
    task = controller_design.ControlTask(
        _UPRIGHT,
        controller_design.find_rest(model, _UPRIGHT, _VOLTAGE),
        limits=_VOLTAGE,
        trust_beyond=True,
    )
    design = controller_design.design_controller(
        model, task, range=training_ranges.Range.from_header(dict(header), model), records=records
    )
    trial = trials.try_design(
        design, header, plants={"twin": tn.control.qube_twin()}, variants=False, count=_RUNS
    )
    tn.control.export_controller(
        model,
        design.gains,
        design.noise,
        out / _CONTROLLER,
        deviations=design.deviations,
        within=design.task.within,
        file=file,
        overwrite=overwrite,
    )
    drawing.write_figure(control.closed_loop_figure(design, trial.main_runs), out, _SWING_UP)
    (row,) = trial.robustness.rows
    return (
        f"swing-up of the twin, through its encoders: {row.successes} of {len(row.outcomes)} runs "
        f"reach upright and hold it for {design.goal.hold:.0f} s"
    )
