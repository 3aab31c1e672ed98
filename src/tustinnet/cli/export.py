"""`tustinnet export`: a model in other formats."""

from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import completion, devices, options, terminal
from tustinnet.cli.models import load_model
from tustinnet.cli.values import OptionReader, parse_pairs
from tustinnet.errors import InputError
from tustinnet.registry import TARGETS
from tustinnet.report import tables
from tustinnet.store import exported
from tustinnet.wording import join_words


def export(
    model: options.Model,
    to: Annotated[
        list[str],
        typer.Option(
            metavar="TARGET,..",
            autocompletion=completion.target,
            help=f"{join_words(TARGETS.places, 'or')}; several, separated by commas or "
            "repeated, or all that fit any model. Several targets get a folder each.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    group: options.Group = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE,..",
            help="For mat: operating point of the linearisation, e.g. alpha=0.1. Default: 0.",
        ),
    ] = None,
    system: options.System = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Write a model as C, FMU, CasADi, ONNX, JavaScript, StableHLO, matrices, URDF or MJCF."""
    devices.prepare_jax()
    groups = parse_pairs("--group", group)
    if system is not None and out.resolve() in Path(system).resolve().parents:
        raise InputError(out, f"the folder of {system}, which the command reads", "another folder")
    loaded = load_model(model, system)
    values = OptionReader(loaded.channels, tn.read_header(model))
    point = values.read("--at", at)
    exports = tn.export_model(
        loaded,
        exported.find_targets(",".join(to), point),
        out,
        file=model,
        groups=groups,
        overwrite=overwrite,
    )
    if json:
        terminal.print_json(
            [
                {
                    "target": e.target,
                    "folder": str(e.folder),
                    "files": e.files,
                    "notes": e.notes,
                    "steps": e.checked.steps,
                    "difference": e.checked.difference,
                    "note": e.checked.note,
                }
                for e in exports
            ]
        )
        return
    rows = [
        [e.target, str(e.folder), ", ".join(e.files), f"{e.checked.difference:.1e}"]
        for e in exports
    ]
    title = (
        "Exports, and how far a step is from the model's, but for what notes say is left out, "
        "relative to 1 + the state"
    )
    terminal.print_tables(
        tables.Table(["target", "folder", "files", "difference"], rows, title=title)
    )
    notes = [note for e in exports for note in e.notes]
    notes += [f"{e.target}: {e.checked.note}" for e in exports if e.checked.note]
    for note in dict.fromkeys(notes):
        terminal.messages().print(f"note: {note}")
