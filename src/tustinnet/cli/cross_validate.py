"""`tustinnet cross-validate`: a recipe on records that its models never saw."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import completion, options, terminal

if TYPE_CHECKING:
    from tustinnet.selection.runner import MakeExecutor

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
        "default of evaluate, and model-20.",
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
    from tustinnet.cli.request import loaded, recipe_of, require_cores, seeds_of, tell_still

    require_cores(cluster, device)
    terminal.prepare_jax(device)
    from tustinnet.report.fits import folds_table
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.cross_validation import (
        cross_validate,
        make_cross_validation_options,
        remove_results,
    )
    from tustinnet.selection.folds import records_without_test
    from tustinnet.store.files import lock_folder, require_outputs, to_json, write_into
    from tustinnet.systems.files import find_system

    asked = make_cross_validation_options(
        recipe_of(recipe, changes, system=system, physics=physics), system=system, physics=physics,
        folds=folds, seeds=None if seeds is None else seeds_of(seeds), starts=start or (),
    )  # fmt: skip
    told = terminal.messages()
    require_outputs([out / _FILE, out / _TABLE], overwrite=overwrite)
    records = loaded(data, card, out, told, strict=strict)
    tell_still(records_without_test(records), told)
    with (
        _joined(cluster, quiet=quiet) as by,
        lock_folder(out),
        FitProgress(told, quiet=quiet) as bars,
    ):
        if by is not None:
            remove_results(out, (_FILE, _TABLE), jobs=overwrite)
        found = cross_validate(
            records, asked, bars.follow, folder=out, executor=by,
            system=system and find_system(system),
        )  # fmt: skip
        table = folds_table(found)
        write_into(out, _FILE, to_json(found.as_plain()))
        write_into(out, _TABLE, table.markdown())
    if json:
        terminal.print_json(found.as_plain())
    else:
        terminal.print_tables(table)
    told.print(f"written: {out / _FILE}, {out / _TABLE}")


@contextmanager
def _joined(address: str | None, *, quiet: bool) -> "Iterator[MakeExecutor | None]":
    """The machines of a cluster, None where none is asked for."""
    if address is None:
        yield None
        return
    from tustinnet.selection.cluster import cluster

    goes_on = "the same command, without --overwrite, goes on with the folds that are done"
    with (
        terminal.interruptible(goes_on),
        cluster(address, terminal.teller(quiet=quiet)) as executor,
    ):
        yield executor
