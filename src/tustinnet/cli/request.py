"""What the verbs make of their arguments: records, recipes, members."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.data.dataset import DataSet
    from tustinnet.data.experiment import Experiment
    from tustinnet.fitting.recipe import Recipe
    from tustinnet.fitting.task import Member
    from tustinnet.models.contract import Model


def recipe_of(
    name: str | None, changes: Sequence[str] | None, *, system: object, physics: object
) -> "Recipe":
    """The recipe that was asked for, or the usual one for what was given, with its changes."""
    from tustinnet.fitting.recipe import read_recipe
    from tustinnet.fitting.task import usual_recipe

    usual = usual_recipe(system=system is not None, physics=physics is not None)
    return read_recipe(name or usual, changes or ())


def members_of(seeds: str | None, rates: str | None, recipe: "Recipe") -> "list[Member]":
    """The members that `--seeds` and `--rates` ask for."""
    from tustinnet.errors import InputError
    from tustinnet.fitting.task import Member

    for option, given in (("--seeds", seeds), ("--rates", rates)):
        if given is not None and not recipe.family.trains:
            raise InputError(
                option, f"an option of a training; '{recipe.name}' identifies",
                "a recipe of a kind with weights", "an identification has no seeds",
            )  # fmt: skip
    return [Member(seed, rate) for seed in seeds_of(seeds) for rate in _rates_of(rates)]


def seeds_of(seeds: str | None) -> tuple[int, ...]:
    """`K` seeds from 0 on, or those that are listed."""
    from tustinnet.errors import InputError

    try:
        listed = [int(x) for x in ("1" if seeds is None else seeds).split(",") if x.strip()]
    except ValueError:
        listed = []
    several = seeds is not None and "," in seeds
    found = tuple(listed) if several else tuple(range(*listed[:1] or (0,)))
    if not found or min(found) < 0 or len(set(found)) < len(found):
        raise InputError(
            "--seeds", f"'{seeds}'", "a number above 0, or different seeds, separated by commas",
            "for instance --seeds 3, or --seeds 4,5, (a comma behind a single one)",
        )  # fmt: skip
    return found


def _rates_of(rates: str | None) -> list[float]:
    from tustinnet.errors import InputError

    try:
        factors = [float(x) for x in rates.split(",")] if rates is not None else [1.0]
    except ValueError:
        factors = []
    if (
        not factors
        or not all(0 < x < float("inf") for x in factors)
        or len(set(factors)) < len(factors)
    ):
        raise InputError(
            "--rates", f"'{rates}'", "different numbers above 0, separated by commas",
            "for instance --rates 0.3,1,3",
        )  # fmt: skip
    return factors


def loaded(data: str, card: Path | None, out: Path, told: "Console") -> "DataSet":
    """The records to fit to; says what looks wrong in them, and refuses to write among them."""
    from tustinnet.cli.inspect import suspicions
    from tustinnet.data.catalog import locate
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.data.loading import load_folder
    from tustinnet.errors import InputError

    folder, declared = locate(data, card)
    if out.resolve() == folder.resolve():
        raise InputError(out, "the folder of the data", "another folder for the run")
    records = load_folder(folder, declared)
    if "validation" not in records.splits:
        told.print("note: no validation split; the scores below are of the training records")
    for line in suspicions(map(inspect_experiment, records)):
        told.print(line)
    return records


def judged_records(
    data: str, card: Path | None, split: str | None, start: str | None, models: "Sequence[Model]"
) -> "tuple[list[Experiment], str]":
    """The records of a split, or all, and where free runs of some models start on them."""
    from tustinnet.data.catalog import load
    from tustinnet.simulate.starts import default_start

    found = load(data, card)
    records = list(found.split(split) if split else found)
    needing = max(models, key=lambda model: model.warm_up)
    return records, start or default_start(records, needing)
