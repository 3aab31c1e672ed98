"""`tustinnet learning-curve`: how many records are enough."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal
from tustinnet.cli.files import list_input_files
from tustinnet.cli.records import load_records_to_fit, print_still_coordinates
from tustinnet.cli.verb import refuse_options
from tustinnet.errors import InputError

if TYPE_CHECKING:
    from tustinnet.selection.cross_validation import CrossValidationOptions


class Values(StrEnum):
    """Parameter values of the simulated system that a network is pre-trained on."""

    identified = "identified"
    nominal = "nominal"


Network = Annotated[str | None, options.recipe("standard", "Recipe of the network.")]
Physics = Annotated[
    str | None, options.recipe("best-grey", "With --system: recipe of the grey box.")
]
Hybrid = Annotated[str | None, options.recipe("hybrid", "With --system: recipe of the hybrid.")]
Twin = Annotated[
    Values | None,
    typer.Option(
        help="With --system: a network is pre-trained on simulated records. This chooses the "
        "parameters of that simulation. Default: identified, from the same records."
    ),
]


Records = Annotated[
    str | None,
    typer.Option(metavar="A,B,..", help="Numbers of records to fit to. Default: 2,4,8,.. and all."),
]


def learning_curve(
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for table and figure.")],
    records: Records = None,
    draws: Annotated[
        int,
        typer.Option(min=2, max=100, metavar="K", help="Number of random draws of the records."),
    ] = 3,
    recipe: Network = None,
    system: options.System = None,
    physics: Physics = None,
    hybrid: Hybrid = None,
    twin: Twin = None,
    start: options.Start = None,
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
    strict: options.Strict = False,
    device: options.Device = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Find out how many records are enough.

    Models are fitted to more and more records and scored on records that were left out.
    """
    terminal.prepare_jax(device)
    from tustinnet.fitting.roles import records_without_test
    from tustinnet.report.learning import learning_figure, learning_table
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.learning import (
        draw_records,
        learning_curve,
        make_learning_curve_options,
    )
    from tustinnet.store.files import lock_folder, require_outputs, to_json, write_into

    system_options = _make_system_options(system, physics, hybrid, twin)
    try:
        sizes = [int(x) for x in (records or "").split(",") if x.strip()]
    except ValueError:
        raise InputError(
            "--records",
            f"'{records}'",
            "numbers, separated by commas",
            "for instance --records 2,4,8",
        ) from None
    curve_options = make_learning_curve_options(
        recipe or "standard",
        system_options,
        sizes,
        draws=draws,
        start=start,
        twin=(twin or Values.identified).value,
    )
    console = terminal.messages()
    names = [f"learning-curve.{ending}" for ending in ("json", "md", "png")]
    inputs = list_input_files(data, card, system)
    require_outputs([out / name for name in names], overwrite=overwrite, read=inputs)
    data_set = load_records_to_fit(
        data, card, out, console, strict=strict, follow_links=follow_links
    )
    print_still_coordinates(records_without_test(data_set), console)
    draw_records(data_set, curve_options)  # raises at once where there are too few records
    with lock_folder(out):
        with FitProgress(console, quiet=quiet) as progress:
            curve = learning_curve(
                data_set, curve_options, progress.follow, terminal.make_printer(quiet=quiet)
            )
        table, sentences = learning_table(curve), [curve.sentence(a) for a in curve.approaches]
        write_into(out, names[0], to_json(curve.as_plain()))
        write_into(out, names[1], table.markdown() + "".join(f"\n* {s}." for s in sentences) + "\n")
        if json:
            terminal.print_json(curve.as_plain())
        else:
            terminal.print_tables(table)
            for sentence in sentences:
                terminal.echo(f"* {sentence}")

        from tustinnet.report.drawing import write_figure

        write_figure(learning_figure(curve), out, names[2])
    console.print(f"written: {', '.join(str(out / name) for name in names)}")


def _make_system_options(
    system: str | None, physics: str | None, hybrid: str | None, twin: Values | None
) -> "CrossValidationOptions | None":
    """Options of the approaches that use a system; None without a system."""
    from tustinnet.fitting.recipe_reading import read_recipe
    from tustinnet.selection.cross_validation import make_cross_validation_options
    from tustinnet.systems.files import find_system

    if system is not None:
        recipe = read_recipe(hybrid or "hybrid")
        if "physics" not in recipe.family.needs:
            raise InputError(
                "--hybrid",
                f"a recipe of kind '{recipe.family.kind}'",
                "a recipe that corrects physics",
            )
        return make_cross_validation_options(recipe, system=find_system(system), physics=physics)
    needed = {"--physics": physics, "--hybrid": hybrid, "--twin": twin}
    refuse_options(needed, "without a system", "a system", "add --system NAME|FILE.py")
    return None
