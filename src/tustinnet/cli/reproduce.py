"""`tustinnet reproduce`: the paper's table and figures from the measured data."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tustinnet.cli import devices, options, terminal
from tustinnet.cli.automatic_report import AutomaticReport, require_report
from tustinnet.cli.files import require_apart
from tustinnet.data import catalog, loading
from tustinnet.errors import InputError
from tustinnet.report import progress as progress_bars
from tustinnet.reproduce import figures, table1
from tustinnet.reproduce import page as publication_page
from tustinnet.reproduce.entries import ALL_MODELS, EXTRA_MODELS
from tustinnet.store import files as disk
from tustinnet.store import run_folder
from tustinnet.wording import join_words

_TABLES = ("table1.json", "table1.md", "table1.tex")


class Keep(StrEnum):
    """Criteria of the best weights."""

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
        help=f"{', '.join(ALL_MODELS)}; separated by commas or repeated. Default: all but "
        f"{join_words(EXTRA_MODELS)}.",
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
    devices.prepare_jax(device)
    console = terminal.messages()
    folder, card = catalog.locate(data)
    if not catalog.QUBE_SERVO2.is_in(folder):
        raise InputError(
            folder,
            "not the Qube-Servo 2 data",
            "a folder with train/fall1Velocity.csv, ...",
            "use `tustinnet fit` for your own records",
        )
    records = loading.load_folder(folder, card)
    scored_split = table1.choose_split(records, split)
    model_names, remark = table1.choose_models(models or (), folder)
    figure_record = figures.choose_experiment(records, scored_split, experiment)
    runs = out / "runs"
    require_apart(out, folder)
    if not runs.is_dir() and not table1.is_table(out / _TABLES[0]):
        disk.require_outputs(
            [out / name for name in (*_TABLES, run_folder.REPORT)], overwrite=overwrite
        )
    console.print(f"data: {folder}; scoring the {scored_split} split, start '{table1.START}'")
    if changed := catalog.QUBE_SERVO2.changed_files(folder):
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        console.print(f"warning: not as published (checksums differ): {changed[0]}{more}")
    if remark:
        console.print(f"note: {remark}")
    if runs.is_dir() and not overwrite:
        console.print(f"note: continuing the trainings in {runs}; --overwrite trains anew")
    table_options = table1.ReproductionOptions(
        model_names, scored_split, seeds, None if keep is None else keep.value, overwrite
    )
    with disk.lock_folder(out):
        with (
            progress_bars.FitProgress(console, quiet=quiet) as progress,
            terminal.interruptible("the same command continues"),
        ):
            rows = table1.build_rows(
                records,
                folder,
                table_options,
                runs,
                progress.listener,
            )
        content, table = table1.as_json(rows, scored_split), table1.as_table(rows, scored_split)
        texts = disk.to_json(content), table.markdown(), table.latex()
        for name, text in zip(_TABLES, texts, strict=True):
            disk.write_into(out, name, text)
        if json:
            terminal.print_json(content)
        else:
            terminal.print_tables(table)
        figure_files = figures.draw(records, rows, scored_split, figure_record, out)
        report = AutomaticReport(data, is_enabled=not no_report)
        best, scored = (
            publication_page.choose_reported_rows(rows),
            list(records.split(scored_split)),
        )
        model_files = [row.file for row in best if row.file is not None]
        page = report.write(
            model_files,
            out / run_folder.REPORT,
            lambda command: publication_page.write_rows_report(
                best, scored, out / run_folder.REPORT, command if model_files else ""
            ),
            {"--split": scored_split, "--start": best[0].start},
        )
        files = f"{', '.join(_TABLES)} and {len(figure_files)} figures{page or ''}"
    console.print(f"written to {out}: {files}")
    require_report(page)
