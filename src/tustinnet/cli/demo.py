"""`tustinnet demo`: the whole main job on simulated records, offline."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from tustinnet.cli.leave_report import Leaving
    from tustinnet.data.dataset import DataSet
    from tustinnet.data.experiment import Experiment
    from tustinnet.data.inspection import ExperimentReport
    from tustinnet.evaluate.scores import Score
    from tustinnet.report.page.subject import Subject
    from tustinnet.report.tables import Table

# what is tried, with a system that lacks the cable's relaxation and dry friction; at most so long
_PLAN, _SYSTEM, _SECONDS = "quick", "qube-servo2", 105.0
_CHOICE = "twin_choice"
_START = "derived-6"  # the twin moves when its records begin, and `file` would say it does not
_REPORTED = 2  # models: the chosen one and one beside it; each takes seconds
_DRAWN = ("twin_fall_test1", "twin_noise_test2")


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for records, models, figures.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated logs.")] = 0,
    overwrite: options.Overwrite = False,
    device: options.Device = None,
    no_report: options.NoReport = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Try it without data: simulate a pendulum, fit, compare, report.

    The logs are simulated from Lagrange's equations, which favours grey boxes: the table shows
    how the command works, not how accurate the models are on a real device.
    """
    terminal.prepare_jax(device)
    from tustinnet.cli.inspect import time_table
    from tustinnet.cli.leave_report import Leaving, require_left
    from tustinnet.data.catalog import load
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.store.data_set_folder import write_data_set
    from tustinnet.store.files import require_outputs, require_writable_folder
    from tustinnet.systems import qube_servo2_twin

    told = terminal.messages()
    table_file, logs = out / "twin_table.md", out / "twin"
    page = out / "twin_report.html"
    figures = [out / f"{name}.png" for name in ("twin_records", *_DRAWN)]
    files = [table_file, table_file.with_suffix(".json"), logs, out / _CHOICE, *figures]
    require_outputs([*files, *([] if no_report else [page])], overwrite=overwrite)
    require_writable_folder(out)
    _say(told, quiet, f"1/5 twin of the Qube-Servo 2, simulated and logged: {logs}")
    records = qube_servo2_twin.twin(seed)
    write_data_set(records, logs, "Simulated twin of the Qube-Servo 2", overwrite=overwrite)
    data = load(logs)
    _say(told, quiet, f"2/5 looking at the {len(data)} records: {out / 'twin_records.png'}")
    training = list(data.split("train"))
    reports = [inspect_experiment(e) for e in training]
    if not json:
        terminal.print_tables(time_table(reports))
    _draw_records(training, reports, out)
    _say(told, quiet, f"3/5 choosing a model in at most {_SECONDS:.0f} s: {out / _CHOICE}")
    earlier = "discard" if overwrite else "refuse"
    scored = _fitted(data, out, told, quiet=quiet, json=json, earlier=earlier)
    scores = {of.label: of.scores for of in scored}
    _say(told, quiet, f"4/5 free runs of the {len(data.split('test'))} test records")
    content = _write(data, scores, out)
    if json:
        terminal.print_json(content)
    else:
        terminal.print_tables(_table(scores))
    figures = _draw(data, scores, out)
    if not no_report:
        _say(told, quiet, f"5/5 the report, motion and playground in one page: {page}")
    report = _page(scored, data, page, Leaving(str(logs), wanted=not no_report))
    _say(told, quiet, f"written to {out}: {table_file.name}, {', '.join(figures)}{report or ''}")
    _say(told, quiet, f"look again: tustinnet inspect {logs}; tustinnet show {out / _CHOICE}/"
                      f"model.safetensors; {out / _CHOICE / 'figures'}")  # fmt: skip
    require_left(report)


def _say(told: "Console", quiet: bool, line: str) -> None:
    if not quiet:
        told.print(line)


def _fitted(
    data: "DataSet", out: Path, told: "Console", *, quiet: bool, json: bool, earlier: Any
) -> "list[Subject]":
    """Chooses a model, and scores it and those beside it; the test records took part in nothing."""
    from tustinnet.cli.select import draw_choice, make_reporter, print_choice, print_files
    from tustinnet.evaluate.scores import evaluate
    from tustinnet.report.page.subject import subjects_of
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.select import SelectionOptions, select_model

    asked = SelectionOptions(_PLAN, _SYSTEM, _SECONDS)
    with FitProgress(told, quiet=quiet) as progress:
        choice = select_model(
            data, out / _CHOICE, asked, earlier, make_reporter(progress, quiet=quiet)
        )
    if not json:
        print_choice(choice)
    draw_choice(choice)
    if not json:
        print_files(choice)
    tests = list(data.split("test"))
    found = []
    for name in [choice.best, *(name for name in choice.origins if name != choice.best)]:
        chosen = name == choice.best
        model = choice.model if chosen else choice.context.load_model(choice.file(name))
        (of,) = subjects_of([choice.context.folder / choice.file(name)], [model])
        label = f"{name} (chosen)" if chosen else name
        found.append(replace(of, label=label, scores=evaluate(model, tests, _START)))
    return found


def _page(scored: "list[Subject]", data: "DataSet", page: Path, leaving: "Leaving") -> str | None:
    """Writes the report of the chosen model and those beside it; returns where it is."""
    from tustinnet.report.page.fitted import report_of_scored

    some, tests = scored[:_REPORTED], list(data.split("test"))
    files = [of.file for of in some if of.file is not None]
    given = {"--split": "test", "--start": _START}
    return leaving.report(
        files, page, lambda command: report_of_scored(some, tests, page, command), given
    )


def _write(data: "DataSet", scores: "dict[str, Sequence[Score]]", out: Path) -> dict[str, Any]:
    from tustinnet.evaluate.scores import mean_rmse, rmse_by_record
    from tustinnet.store.files import to_json, write_into

    content = {
        "data": data.name, "split": "test", "start": _START, "units": data.channels.unit,
        "models": {
            label: {"mean": mean_rmse(found), "rmse": rmse_by_record(found)}
            for label, found in scores.items()
        },
    }  # fmt: skip
    write_into(out, "twin_table.md", _table(scores).markdown())
    write_into(out, "twin_table.json", to_json(content))
    return content


def _table(scores: "dict[str, Sequence[Score]]") -> "Table":
    from tustinnet.evaluate.scores import mean_rmse
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


def _draw_records(
    records: "Sequence[Experiment]", reports: "Sequence[ExperimentReport]", out: Path
) -> None:
    from tustinnet.report.figures import inspection_figure, write_figure

    write_figure(inspection_figure(records, reports), out, "twin_records.png")


def _draw(data: "DataSet", scores: "dict[str, Sequence[Score]]", out: Path) -> list[str]:
    from tustinnet.report.figures import free_run_figure, write_figure

    written = []
    for name in _DRAWN:
        runs = {
            label: next(s for s in found if s.experiment == name) for label, found in scores.items()
        }
        figure = free_run_figure(data[name], runs, recorded="twin")
        write_figure(figure, out, f"{name}.png")
        written.append(f"{name}.png")
    return written
