"""`tustinnet reproduce`: the paper's table and figures from the measured data."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tustinnet.cli import options, terminal


class Keep(StrEnum):
    """What marks the best weights."""

    validation = "validation"
    validation_loss = "validation-loss"
    training = "training"


def reproduce(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where tables, figures, models go.")],
    data: Annotated[
        str,
        typer.Option(
            metavar="DIR",
            help="Folder of the Qube-Servo 2 data; 'qube-servo2' looks in TUSTINNET_DATA, then in "
            "the cache, then downloads.",
        ),
    ] = "qube-servo2",
    split: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="test or validation. Default: test if present."),
    ] = None,
    seeds: options.Seeds = 1,
    models: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            help="authors, tustin-standard, tustin-transfer, tustin-text-standard, "
            "tustin-text-transfer, euler-lagrange, euler-lagrange-naive, best-tustin, best-grey, "
            "best-hybrid; separated by commas or repeated. Default: all but the two of the text.",
        ),
    ] = None,
    keep: Annotated[
        Keep | None,
        typer.Option(
            help="Which epoch's weights are kept: of the lowest validation free run (the default), "
            "validation loss, or training loss (as the paper's public code does).",
        ),
    ] = None,
    experiment: Annotated[
        str | None, typer.Option(metavar="NAME", help="Record of the figures.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Train anew instead of going on in --out.")
    ] = False,
    device: options.Device = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Reproduce Table 1 and the five figures of the paper.

    Trainings that are in --out already are gone on with, finished ones are taken as they are.
    """
    terminal.prepare_jax(device)
    from tustinnet.artifact.files import require_writable_folder, to_json, write_atomically
    from tustinnet.data.catalog import QUBE_SERVO2, locate
    from tustinnet.data.loading import load_folder
    from tustinnet.errors import InputError
    from tustinnet.paper import figures, table1
    from tustinnet.report.progress import IdentificationProgress, TrainingProgress

    told = terminal.messages()
    folder, card = locate(data)
    if not QUBE_SERVO2.is_in(folder):
        raise InputError(
            folder, "not the Qube-Servo 2 data", "a folder with train/fall1Velocity.csv, ...",
            "use `tustinnet fit` for your own records",
        )  # fmt: skip
    records = load_folder(folder, card)
    scored = table1.choose_split(records, split)
    wanted = [name.strip() for names in models or [] for name in names.split(",") if name.strip()]
    chosen, remark = table1.choose_models(wanted, folder)
    drawn = figures.choose_experiment(records, scored, experiment)
    require_writable_folder(out)
    told.print(f"data: {folder}; scoring the {scored} split, start '{table1.START}'")
    differing = QUBE_SERVO2.differing(folder)
    if differing:
        more = f" and {len(differing) - 1} more" if len(differing) > 1 else ""
        told.print(f"warning: not as published (checksums differ): {differing[0]}{more}")
    if remark:
        told.print(f"note: {remark}")
    if (out / "runs").is_dir() and not overwrite:
        told.print(f"note: going on with the trainings in {out / 'runs'}; --overwrite trains anew")
    with (
        TrainingProgress(told, quiet=quiet) as progress,
        terminal.resumable(told, "the same command"),
    ):
        rows = table1.build_rows(
            records, folder, chosen, scored, seeds, out / "runs", overwrite=overwrite,
            tell=lambda name: lambda plan: progress.follow(plan, name),
            tell_identification=lambda name: (
                IdentificationProgress(told, quiet=quiet, label=name).told
            ),
            keep=None if keep is None else keep.value,
        )  # fmt: skip
    content = table1.as_json(rows, scored)
    table = table1.as_table(rows, scored)
    write_atomically(out / "table1.json", to_json(content))
    write_atomically(out / "table1.md", table.markdown())
    write_atomically(out / "table1.tex", table.latex())
    written = figures.draw(records, rows, scored, drawn, out)
    if json:
        terminal.print_json(content)
    else:
        terminal.print_tables(table)
    told.print(f"written to {out}: table1.json, table1.md, table1.tex and {len(written)} figures")
