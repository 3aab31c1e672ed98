"""`tustinnet reproduce`: the paper's table and figures from the measured data."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tustinnet.cli.leave_report import Leaving
    from tustinnet.data.card import Card
    from tustinnet.data.experiment import Experiment
    from tustinnet.report.tables import Table
    from tustinnet.reproduce.table1 import Row


_TABLES = ("table1.json", "table1.md", "table1.tex")


class Keep(StrEnum):
    """What marks the best weights."""

    validation = "validation"
    validation_loss = "validation-loss"
    training = "training"


_Data = Annotated[
    str,
    typer.Option(
        metavar="DIR",
        help="Folder of the Qube-Servo 2 data. 'qube-servo2' looks in the folder TUSTINNET_DATA, "
        "then in the cache, then downloads.",
    ),
]
_Split = Annotated[
    str | None, typer.Option(metavar="NAME", help="test or validation. Default: test if present.")
]
_Seeds = Annotated[
    int, typer.Option(min=1, metavar="K", help="Number of seeds; all train together.")
]
_Experiment = Annotated[
    str | None, typer.Option(metavar="NAME", help="Record that the figures show.")
]
_Anew = Annotated[
    bool, typer.Option("--overwrite", help="Train again instead of continuing in --out.")
]
_Models = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAMES",
        help="authors, tustin-standard, tustin-transfer, tustin-text-standard, "
        "tustin-text-transfer, euler-lagrange, euler-lagrange-naive, best-tustin, best-grey, "
        "best-hybrid, gru, neural-ode, linear; separated by commas or repeated. Default: all "
        "but the two of the text and the last three.",
    ),
]
_Keep = Annotated[
    Keep | None,
    typer.Option(
        help="Keep the weights with the lowest RMSE of the validation free runs, validation loss, "
        "or training loss (as the paper's public code does). Default: as each recipe says.",
    ),
]


def reproduce(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for tables, figures, models.")],
    data: _Data = "qube-servo2",
    split: _Split = None,
    seeds: _Seeds = 1,
    models: _Models = None,
    keep: _Keep = None,
    experiment: _Experiment = None,
    overwrite: _Anew = False,
    device: options.Device = None,
    no_report: options.NoReport = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Reproduce Table 1 and the figures of the publication, with a report.

    Trainings that are already in --out are continued; finished ones are used as they are.
    """
    terminal.prepare_jax(device)
    from tustinnet.cli.leave_report import Leaving, require_left
    from tustinnet.data.loading import load_folder
    from tustinnet.report.progress import FitProgress
    from tustinnet.reproduce import figures, table1
    from tustinnet.store.files import lock_folder

    told = terminal.messages()
    folder, card = _located(data)
    records = load_folder(folder, card)
    scored = table1.choose_split(records, split)
    chosen, remark = table1.choose_models(models or (), folder)
    drawn = figures.choose_experiment(records, scored, experiment)
    runs = out / "runs"
    _require_room(out, folder, runs, overwrite=overwrite)
    told.print(f"data: {folder}; scoring the {scored} split, start '{table1.START}'")
    for line in _remarks(folder, remark, runs, overwrite=overwrite):
        told.print(line)
    kept = None if keep is None else keep.value
    ask = table1.Ask(chosen, scored, seeds, kept, overwrite)
    with (
        lock_folder(out),
        FitProgress(told, quiet=quiet) as progress,
        terminal.interruptible("the same command goes on"),
    ):
        rows = table1.build_rows(
            records, folder, ask, runs,
            lambda name: lambda prepared: progress.follow(prepared, name),
        )  # fmt: skip
    content, table = _write(rows, scored, out)
    if json:
        terminal.print_json(content)
    else:
        terminal.print_tables(table)
    written = figures.draw(records, rows, scored, drawn, out)
    page = _page(rows, list(records.split(scored)), out, Leaving(data, wanted=not no_report))
    files = f"table1.json, table1.md, table1.tex and {len(written)} figures{page or ''}"
    told.print(f"written to {out}: {files}")
    require_left(page)


def _require_room(out: Path, data: Path, runs: Path, *, overwrite: bool) -> None:
    """Raises where tables and report would replace what is no reproduction, or lie among data."""
    from tustinnet.cli.request import require_apart
    from tustinnet.reproduce.table1 import is_table
    from tustinnet.store.files import require_outputs
    from tustinnet.store.run import REPORT

    require_apart(out, data)
    if not runs.is_dir() and not is_table(out / _TABLES[0]):
        require_outputs([out / name for name in (*_TABLES, REPORT)], overwrite=overwrite)


def _located(data: str) -> "tuple[Path, Card]":
    """The folder of the Qube-Servo 2 data and its card."""
    from tustinnet.data.catalog import QUBE_SERVO2, locate
    from tustinnet.errors import InputError

    folder, card = locate(data)
    if not QUBE_SERVO2.is_in(folder):
        raise InputError(
            folder, "not the Qube-Servo 2 data", "a folder with train/fall1Velocity.csv, ...",
            "use `tustinnet fit` for your own records",
        )  # fmt: skip
    return folder, card


def _page(
    rows: "Sequence[Row]", records: "Sequence[Experiment]", out: Path, leaving: "Leaving"
) -> str | None:
    """Writes the report of the best models; returns where it is, as the last line says it."""
    from tustinnet.reproduce.page import report_of_rows, reported
    from tustinnet.store.run import REPORT

    best = reported(rows)
    given = {"--split": records[0].split, "--start": best[0].start}
    files = [row.file for row in best if row.file is not None]
    return leaving.report(
        files, out / REPORT,
        lambda command: report_of_rows(best, records, out / REPORT, command if files else ""),
        given,
    )  # fmt: skip


def _write(rows: "Sequence[Row]", scored: str, out: Path) -> "tuple[dict[str, Any], Table]":
    """Writes the table in three forms; returns it for programs and for people."""
    from tustinnet.reproduce import table1
    from tustinnet.store.files import to_json, write_into

    content, table = table1.as_json(rows, scored), table1.as_table(rows, scored)
    written = to_json(content), table.markdown(), table.latex()
    for name, text in zip(_TABLES, written, strict=True):
        write_into(out, name, text)
    return content, table


def _remarks(folder: Path, remark: str, runs: Path, *, overwrite: bool) -> list[str]:
    """What there is to say before the work begins."""
    from tustinnet.data.catalog import QUBE_SERVO2

    remarks, differing = [], QUBE_SERVO2.differing(folder)
    if differing:
        more = f" and {len(differing) - 1} more" if len(differing) > 1 else ""
        remarks.append(f"warning: not as published (checksums differ): {differing[0]}{more}")
    if remark:
        remarks.append(f"note: {remark}")
    if runs.is_dir() and not overwrite:
        remarks.append(f"note: going on with the trainings in {runs}; --overwrite trains anew")
    return remarks
