"""`tustinnet report`: an HTML page about models on records."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import completion, devices, options, terminal
from tustinnet.cli.automatic_report import report_command
from tustinnet.cli.files import list_input_files
from tustinnet.cli.free_runs import choose_free_runs
from tustinnet.cli.models import kept_system
from tustinnet.cli.records import load_records
from tustinnet.errors import InputError
from tustinnet.families import family
from tustinnet.report.page import reported_model, write
from tustinnet.store import files as disk
from tustinnet.store import model_file
from tustinnet.systems import files as system_files


def report(
    models: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN|MODEL...",
            help="Run folders or model files (.safetensors); the report is about the first.",
        ),
    ],
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="File for the report.")],
    split: options.JudgedSplit = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    card: options.Card = None,
    system: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE.py",
            autocompletion=completion.system,
            help="System of some of the models, or a system whose links draw the mechanism; may be "
            "repeated.",
        ),
    ] = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Write an HTML page about a model: animation, scores, errors."""
    devices.prepare_jax()
    files = [reported_model.model_file(path) for path in models]
    inputs = list_input_files(data, card, *files, *(system or []))
    disk.require_outputs([out], overwrite=overwrite, read=inputs, endings=write.ENDINGS)
    systems = [system_files.find_system(name) for name in system or []]
    model_systems = {model_file.read_system_name(file) for file in files}
    # the system of a model restores it, another one draws the mechanism
    restoring: list[system_files.SystemFile | str] = []
    drawing: list[system_files.SystemFile | str] = []
    for file in systems:
        (restoring if tn.load_system(file).name in model_systems else drawing).append(file)
    loaded_models = model_file.load_models(files, restoring, kept_system)
    links = _choose_links(drawing, loaded_models, loaded_models[0].coordinates)
    by_file = dict(zip(files, loaded_models, strict=True))
    runs = choose_free_runs(load_records(data, card), by_file, split, start, horizon)
    command = report_command(
        models,
        data,
        out,
        {
            "--split": split,
            "--start": start,
            "--horizon": horizon,
            "--card": card,
        },
        system or [],
    )
    report_options = write.ReportOptions(runs.start, runs.horizon, links, command)
    reported = reported_model.read_reported_models(files, loaded_models)
    path = write.write_page(reported, runs.records, out, report_options)
    runs.print_notes()
    terminal.messages().print(f"report: {path} ({path.stat().st_size / 1000:.0f} kB)")


def _choose_links(
    systems: "Sequence[system_files.SystemFile | str]",
    models: "Sequence[tn.Model]",
    coordinates: "Sequence[tn.Coordinate]",
) -> "tuple[tn.Link, ...]":
    """The links of a system that is named only to draw the mechanism of models without links."""
    equations = [family.family_of(model).equations(model) for model in models]
    has_links = any(e is not None and e.system.links for e in equations)
    loaded_systems = [tn.load_system(system) for system in systems]
    needed = [(c.name, c.kind) for c in coordinates]
    for system in loaded_systems:
        is_fitting = system.links and [(c.name, c.kind) for c in system.coordinates] == needed
        if has_links or not is_fitting or len(loaded_systems) > 1:
            raise InputError(
                "--system",
                f"'{system.name}', which is the system of no model",
                "a model's system, or one system with links of the models' coordinates where no "
                "model has links",
            )
    return loaded_systems[0].links if loaded_systems else ()
