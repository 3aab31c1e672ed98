"""`tustinnet export`: a model in other forms."""

from pathlib import Path
from typing import Annotated

import typer

from tustinnet.cli import completion, options, terminal


def export(
    model: options.Model,
    to: Annotated[
        str,
        typer.Option(
            metavar="TARGET,..",
            autocompletion=completion.target,
            help="c, fmu, casadi, onnx, js, stablehlo or mat; several, separated by commas, or "
            "all. Several targets get a folder each.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    group: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="For a model with values by group: the group to export, e.g. payload=1kg; may be "
            "repeated.",
        ),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=VALUE,..",
            help="For mat: operating point of the linearisation, e.g. alpha=0.1. Default: 0.",
        ),
    ] = None,
    system: options.System = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Write a model as C, FMU, CasADi, ONNX, JavaScript, StableHLO or matrices."""
    terminal.prepare_jax()
    from tustinnet.cli.request import model_of
    from tustinnet.report.tables import Table
    from tustinnet.store.exported import export_model, find_targets

    found = export_model(
        model_of(model, system), find_targets(to, _point(at)), out,
        file=model, groups=_groups(group or []), overwrite=overwrite,
    )  # fmt: skip
    if json:
        terminal.print_json([
            {"target": e.target, "folder": str(e.folder), "files": e.files, "notes": e.notes,
             "steps": e.checked.steps, "difference": e.checked.difference, "note": e.checked.note}
            for e in found
        ])  # fmt: skip
        return
    rows = [
        [e.target, str(e.folder), ", ".join(e.files), f"{e.checked.difference:.1e}"] for e in found
    ]
    title = "Exports, and how far a step is from the model's, relative to 1 + the state"
    terminal.print_tables(Table(["target", "folder", "files", "difference"], rows, title=title))
    told = [f"{e.target}: {e.checked.note}" for e in found if e.checked.note]
    for line in dict.fromkeys([*(note for e in found for note in e.notes), *told]):
        terminal.messages().print(f"note: {line}")


def _groups(given: list[str]) -> dict[str, str]:
    from tustinnet.errors import InputError

    found = dict(pair.split("=", 1) for pair in given if "=" in pair)
    if len(found) < len(given):
        raise InputError("--group", f"'{', '.join(given)}'", "NAME=VALUE, each name once")
    return found


def _point(given: str | None) -> dict[str, float]:
    from tustinnet.errors import InputError

    pairs = [] if given is None else [pair.partition("=") for pair in given.split(",")]
    try:
        found = {name.strip(): float(value) for name, _, value in pairs}
    except ValueError:
        found = {}
    if len(found) < len(pairs):
        raise InputError(
            "--at", f"'{given}'", "NAME=VALUE, separated by commas, each name once",
            "for instance --at theta=0.1,der_theta=0",
        )  # fmt: skip
    return found
