"""`tustinnet cross-validate`: scores of a recipe on records that its models were not fitted to."""

from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import completion, devices, options, terminal
from tustinnet.cli.files import list_input_files
from tustinnet.cli.fit_options import choose_recipe, open_cluster, parse_seeds, require_cores
from tustinnet.cli.records import load_records_to_fit, print_still_coordinates
from tustinnet.cli.verb import refuse_options
from tustinnet.errors import InputError
from tustinnet.fitting import roles
from tustinnet.report import drawing, fits
from tustinnet.report import learning as learning_report
from tustinnet.report import progress as progress_bars
from tustinnet.selection import cross_validation, learning
from tustinnet.store import files as disk
from tustinnet.systems import files as system_files

_FILE, _TABLE = "folds.json", "folds.md"
_CURVE_FILES = [f"learning-curve.{ending}" for ending in ("json", "md", "png")]
_ALL = "all"

_Physics = Annotated[
    str | None,
    typer.Option(
        metavar="RECIPE",
        autocompletion=completion.recipe,
        help="For a hybrid: recipe that identifies the physics, again in every fold. Default: "
        "best-grey.",
    ),
]


_Records = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,..|all",
        help="A learning curve: fit to so many records, drawn at random. all: 2,4,8,.. and all.",
    ),
]


_Draws = Annotated[
    int | None,
    typer.Option(
        min=2,
        max=100,
        metavar="K",
        help="With --records: number of random draws of the records. Default: 3.",
    ),
]


_Starts = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        autocompletion=completion.start,
        help="Initial states of the free runs, as for evaluate; may be repeated. Default: the "
        "usual start (see evaluate).",
    ),
]


def cross_validate(
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the scores.")],
    recipe: Annotated[
        str | None,
        options.recipe("standard; with --system: grey; with --physics: best-hybrid"),
    ] = None,
    system: options.System = None,
    changes: options.Set = None,
    folds: Annotated[
        int | None,
        typer.Option(
            min=3, metavar="N", help="Number of folds. Default: 5, or as many as there are records."
        ),
    ] = None,
    records: _Records = None,
    physics: _Physics = None,
    draws: _Draws = None,
    seeds: options.Seeds = None,
    start: _Starts = None,
    cluster: Annotated[str | None, options.cluster("Fit each fold as a job of its own on")] = None,
    card: options.Card = None,
    device: options.Device = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Score a recipe by cross-validation over the records.

    Every record is scored by models that were fitted without it. Records of the split test are
    left out. With --records: how many records are enough.
    """
    if records is None:
        refuse_options({"--draws": draws}, "without --records", "--records", "add --records all")
    else:
        needless = {"--seeds": seeds, "--cluster": cluster, "--start": (start or [])[1:] or None}
        refuse_options(needless, "to a learning curve", "one start, a seed for each draw")
    sizes = _read_sizes(records)
    require_cores(cluster, device)
    devices.prepare_jax(device)
    validation = tn.make_cross_validation_options(
        choose_recipe(recipe, changes, system=system, physics=physics),
        system=system,
        physics=physics,
        folds=folds,
        seeds=None if seeds is None else parse_seeds(seeds),
        starts=start or (),
    )
    console = terminal.messages()
    inputs = list_input_files(data, card, system)
    names = [_FILE, _TABLE] if sizes is None else _CURVE_FILES
    disk.require_outputs([out / name for name in names], overwrite=overwrite, read=inputs)
    data_set = load_records_to_fit(data, card, out)
    print_still_coordinates(roles.records_without_test(data_set))
    remedy = "the same command, without --overwrite, continues with the folds that are done"
    with (
        terminal.interruptible("" if cluster is None else remedy),
        open_cluster(cluster) as executor,
        disk.lock_folder(out),
        progress_bars.FitProgress(console, quiet=quiet) as progress,
    ):
        if executor is not None:
            cross_validation.remove_results(out, names, jobs=overwrite)
        if sizes is not None:
            curve = learning.learning_curve(
                data_set,
                validation,
                sizes,
                learning.DRAWS if draws is None else draws,
                progress.listener(),
            )
            table, plain = learning_report.learning_table(curve), curve.as_plain()
            sentences = [curve.sentence(approach) for approach in curve.approaches]
            drawing.write_figure(learning_report.learning_figure(curve), out, names[2])
        else:
            result = tn.cross_validate(
                data_set,
                validation,
                progress.listener(),
                folder=out,
                executor=executor,
                system=system and system_files.find_system(system),
            )
            table, plain, sentences = fits.folds_table(result), result.as_plain(), []
        lines = "".join(f"\n* {sentence}." for sentence in sentences)
        disk.write_into(out, names[0], disk.to_json(plain))
        disk.write_into(out, names[1], table.markdown() + (f"{lines}\n" if lines else ""))
    if json:
        terminal.print_json(plain)
    else:
        terminal.print_tables(table)
        for sentence in sentences:
            terminal.echo(f"* {sentence}")
    console.print(f"written: {', '.join(str(out / name) for name in names)}")


def _read_sizes(text: str | None) -> list[int] | None:
    """Numbers of records from `--records`, none for all that doubling gives; None without it."""
    if text is None:
        return None
    try:
        return [] if text == _ALL else [int(x) for x in text.split(",") if x.strip()]
    except ValueError:
        raise InputError(
            "--records",
            f"'{text}'",
            f"numbers, separated by commas, or {_ALL}",
            "for instance --records 2,4,8",
        ) from None
