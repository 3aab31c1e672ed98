"""`tustinnet report`: models on records as one page."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import completion, options, terminal

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
    split: options.Split = None,
    start: options.Start = None,
    horizon: options.Horizon = None,
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
    terminal.prepare_jax()
    from tustinnet.cli.leave_report import report_command
    from tustinnet.cli.request import files_of, judged_records, kept_system
    from tustinnet.report.page.subject import model_file, subjects_of
    from tustinnet.report.page.write import ENDINGS, Asked, written
    from tustinnet.store.files import require_outputs
    from tustinnet.store.model_file import load_models, read_system_name
    from tustinnet.systems.files import find_system, load_system

    files = [model_file(path) for path in models]
    read = files_of(data, card, *files, *(system or []))
    require_outputs([out], overwrite=overwrite, read=read, endings=ENDINGS)
    given = [find_system(which) for which in system or []]
    owned = {read_system_name(file) for file in files}
    named = [load_system(which).name in owned for which in given]
    loaded = load_models(files, [of for of, is_in in zip(given, named, strict=True) if is_in],
                         kept_system)  # fmt: skip
    drawing = [of for of, is_in in zip(given, named, strict=True) if not is_in]
    links = _links(drawing, loaded, loaded[0].coordinates)
    records, begin = judged_records(data, card, split, start, loaded)
    command = report_command(models, data, out, {
        "--split": split, "--start": start, "--horizon": horizon, "--card": card,
    }, system or [])  # fmt: skip
    asked = Asked(begin, horizon, links, command)
    path = written(subjects_of(files, loaded), records, out, asked)
    terminal.messages().print(f"report: {path} ({path.stat().st_size / 1000:.0f} kB)")


def _links(
    systems: "Sequence[SystemFile | str]", models: "Sequence[Model]",
    coordinates: "Sequence[Coordinate]",
) -> "tuple[Link, ...]":  # fmt: skip
    """The links of a system that is given to draw the mechanism of models that have none.

    Raises:
        InputError: several of them, one without links or of other coordinates, or models that have
            links of their own.
    """
    from tustinnet.errors import InputError
    from tustinnet.families.family import family_of
    from tustinnet.systems.files import load_system

    own = [family_of(model).equations(model) for model in models]
    drawn = any(of is not None and of.system.links for of in own)
    found = [load_system(which) for which in systems]
    for of in found:
        known = [(c.name, c.kind) for c in of.coordinates]
        fits = bool(of.links) and known == [(c.name, c.kind) for c in coordinates]
        if drawn or not fits or len(found) > 1:
            raise InputError(
                "--system", f"'{of.name}', which no model is of",
                "a model's system, or one system with links of the models' coordinates where no "
                "model has links",
            )  # fmt: skip
    return found[0].links if found else ()
