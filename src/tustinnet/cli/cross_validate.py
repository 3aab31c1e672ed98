"""`tustinnet cross-validate`: scores of a recipe on records that its models were not fitted to."""

from pathlib import Path
from typing import Annotated

import typer

from tustinnet.cli import completion, options, terminal
from tustinnet.cli.files import list_input_files
from tustinnet.cli.fit_options import choose_recipe, open_cluster, parse_seeds, require_cores
from tustinnet.cli.records import load_records_to_fit, print_still_coordinates

_FILE, _TABLE = "folds.json", "folds.md"

_Physics = Annotated[
    str | None,
    typer.Option(
        metavar="RECIPE",
        autocompletion=completion.recipe,
        help="For a hybrid: recipe that identifies the physics, again in every fold. Default: "
        "best-grey.",
    ),
]


_Starts = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        autocompletion=completion.start,
        help="Initial states of the free runs, as for evaluate; may be repeated. Default: the "
        "usual start (see evaluate) and model-20.",
    ),
]


def cross_validate(
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for folds.json and folds.md.")],
    recipe: Annotated[
        str | None,
        options.recipe("standard; with --system: grey; with --physics: best-hybrid"),
    ] = None,
    changes: options.Set = None,
    system: options.System = None,
    physics: _Physics = None,
    folds: Annotated[int, typer.Option(min=3, metavar="N", help="Number of folds.")] = 5,
    seeds: options.Seeds = None,
    start: _Starts = None,
    cluster: Annotated[str | None, options.cluster("Fit each fold as a job of its own on")] = None,
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
    strict: options.Strict = False,
    device: options.Device = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Score a recipe by cross-validation over the records.

    Every record is scored by models that were fitted without it. Records of the split test are
    left out.
    """
    require_cores(cluster, device)
    terminal.prepare_jax(device)
    from tustinnet.fitting.roles import records_without_test
    from tustinnet.report.fits import folds_table
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.cross_validation import (
        cross_validate,
        make_cross_validation_options,
        remove_results,
    )
    from tustinnet.store.files import lock_folder, require_outputs, to_json, write_into
    from tustinnet.systems.files import find_system

    validation = make_cross_validation_options(
        choose_recipe(recipe, changes, system=system, physics=physics),
        system=system,
        physics=physics,
        folds=folds,
        seeds=None if seeds is None else parse_seeds(seeds),
        starts=start or (),
    )
    console = terminal.messages()
    inputs = list_input_files(data, card, system)
    require_outputs([out / _FILE, out / _TABLE], overwrite=overwrite, read=inputs)
    records = load_records_to_fit(
        data, card, out, console, strict=strict, follow_links=follow_links
    )
    print_still_coordinates(records_without_test(records), console)
    remedy = "the same command, without --overwrite, continues with the folds that are done"
    with (
        terminal.interruptible("" if cluster is None else remedy),
        open_cluster(cluster) as executor,
        lock_folder(out),
        FitProgress(console, quiet=quiet) as progress,
    ):
        if executor is not None:
            remove_results(out, (_FILE, _TABLE), jobs=overwrite)
        result = cross_validate(
            records,
            validation,
            progress.follow,
            folder=out,
            executor=executor,
            system=system and find_system(system),
            on_message=terminal.make_printer(quiet=quiet),
        )
        table = folds_table(result)
        write_into(out, _FILE, to_json(result.as_plain()))
        write_into(out, _TABLE, table.markdown())
    if json:
        terminal.print_json(result.as_plain())
    else:
        terminal.print_tables(table)
    console.print(f"written: {out / _FILE}, {out / _TABLE}")
