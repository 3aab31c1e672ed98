"""`tustinnet cross-validate`: a recipe on records that its models never saw."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import completion, options, terminal

if TYPE_CHECKING:
    from tustinnet.data.dataset import DataSet
    from tustinnet.evaluate.folds import Question, Validated

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
    from tustinnet.evaluate.folds import cross_validate, make_question, taking_part
    from tustinnet.report.fits import folds_table
    from tustinnet.report.progress import FitProgress
    from tustinnet.selection.cross_validation import discard_jobs
    from tustinnet.store.files import owned, require_new, to_json, write_into

    chosen = recipe_of(recipe, changes, system=system, physics=physics)
    asked = make_question(
        chosen, system=system, physics=physics, folds=folds,
        seeds=None if seeds is None else seeds_of(seeds), starts=start or (),
    )  # fmt: skip
    told, file = terminal.messages(), out / "folds.json"
    require_new([file], overwrite=overwrite)
    records = loaded(data, card, out, told, strict=strict)
    tell_still(taking_part(records), told)
    with owned(out), FitProgress(told, quiet=quiet) as progress:
        if cluster is None:
            found = cross_validate(records, asked, progress.follow)
        else:
            if overwrite:
                discard_jobs(out)
            found = _by_jobs(records, asked, (out, cluster), system, quiet=quiet)
        table = folds_table(found)
        write_into(out, file.name, to_json(found.as_plain()))
        write_into(out, "folds.md", table.markdown())
    if json:
        terminal.print_json(found.as_plain())
    else:
        terminal.print_tables(table)
    told.print(f"written: {file}, {out / 'folds.md'}")


def _by_jobs(
    records: "DataSet",
    asked: "Question",
    at: tuple[Path, str],
    system: str | None,
    *,
    quiet: bool,
) -> "Validated":
    """Validates by jobs below a folder, on a cluster: `at` has both."""
    from tustinnet.selection.cluster import cluster
    from tustinnet.selection.cross_validation import cross_validate_by_jobs
    from tustinnet.systems.files import find_system

    folder, address = at
    named = None if system is None else find_system(system)
    with (
        terminal.interruptible("the same command goes on with the folds that are done"),
        cluster(address, (lambda _: None) if quiet else terminal.messages().print) as executor,
    ):
        return cross_validate_by_jobs(records, asked, folder, executor, named)
