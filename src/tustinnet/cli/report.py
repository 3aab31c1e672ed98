"""`tustinnet report`: an HTML page about models on records."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import completion, options, terminal
from tustinnet.cli.files import list_input_files
from tustinnet.cli.free_runs import choose_free_runs
from tustinnet.cli.models import kept_system
from tustinnet.cli.records import load_records
from tustinnet.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tustinnet.channels import Coordinate
    from tustinnet.models.contract import Model
    from tustinnet.models.kinematics import Link
    from tustinnet.systems.files import SystemFile


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
    follow_links: options.FollowLinks = False,
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
    terminal.prepare_jax()
    from tustinnet.cli.automatic_report import report_command
    from tustinnet.report.page.reported_model import model_file, read_reported_models
    from tustinnet.report.page.write import ENDINGS, ReportOptions, write_page
    from tustinnet.store.files import require_outputs
    from tustinnet.store.model_file import load_models, read_system_name
    from tustinnet.systems.files import find_system
    from tustinnet.systems.loading import load_system

    files = [model_file(path) for path in models]
    inputs = list_input_files(data, card, *files, *(system or []))
    require_outputs([out], overwrite=overwrite, read=inputs, endings=ENDINGS)
    systems = [find_system(name) for name in system or []]
    model_systems = {read_system_name(file) for file in files}
    # the system of a model restores it, another one draws the mechanism
    restoring: list[SystemFile | str] = []
    drawing: list[SystemFile | str] = []
    for file in systems:
        (restoring if load_system(file).name in model_systems else drawing).append(file)
    loaded_models = load_models(files, restoring, kept_system)
    links = _choose_links(drawing, loaded_models, loaded_models[0].coordinates)
    by_file = dict(zip(files, loaded_models, strict=True))
    runs = choose_free_runs(
        load_records(data, card, follow_links=follow_links), by_file, split, start, horizon
    )
    command = report_command(
        models,
        data,
        out,
        {
            "--split": split,
            "--start": start,
            "--horizon": horizon,
            "--card": card,
            "--follow-links": follow_links or None,
        },
        system or [],
    )
    report_options = ReportOptions(runs.start, runs.horizon, links, command)
    reported = read_reported_models(files, loaded_models)
    path = write_page(reported, runs.records, out, report_options)
    runs.print_notes()
    terminal.messages().print(f"report: {path} ({path.stat().st_size / 1000:.0f} kB)")


def _choose_links(
    systems: "Sequence[SystemFile | str]",
    models: "Sequence[Model]",
    coordinates: "Sequence[Coordinate]",
) -> "tuple[Link, ...]":
    """The links of a system that is named only to draw the mechanism of models without links."""
    from tustinnet.families.family import family_of
    from tustinnet.systems.loading import load_system

    equations = [family_of(model).equations(model) for model in models]
    has_links = any(e is not None and e.system.links for e in equations)
    loaded_systems = [load_system(system) for system in systems]
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
