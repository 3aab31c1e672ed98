"""Options of verbs that fit: recipe, seeds, cores."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tustinnet as tn
from tustinnet.cli.automatic_report import AutomaticReport
from tustinnet.cli.options import Hardware
from tustinnet.errors import InputError
from tustinnet.fitting import task
from tustinnet.store import run_folder
from tustinnet.systems import files as system_files

_MAX_SEEDS, _LARGEST_SEED = 1000, 2**32 - 1


@dataclass(frozen=True)
class FitOptions:
    """Options of `fit` that apply to one recipe and to a selection of several.

    Attributes:
        load: reads and checks the records.
        out: folder for all results.
        system: the system, or None.
        earlier: treatment of results that are in the folder.
        report: settings of the report.
        json: whether to print JSON instead of tables.
        quiet: whether to hide the progress.
        leave_out_spoiled: whether to leave out parts of records that spoil the fit.
    """

    load: "Callable[[], tn.DataSet]"
    out: Path
    system: "system_files.SystemFile | str | None"
    earlier: "run_folder.Earlier"
    report: AutomaticReport
    json: bool
    quiet: bool
    leave_out_spoiled: bool = False


def require_cores(cluster: str | None, device: Hardware | None) -> None:
    """Raises an error if jobs of a cluster are to compute on another device than processors."""
    if cluster is not None and device not in (None, "cpu"):
        raise InputError(
            f"--device {device}", "not applicable to jobs on a cluster", "cpu", "omit the option"
        )


def open_cluster(address: str | None) -> AbstractContextManager[Executor | None]:
    """Context with an executor of jobs on a cluster; with None without an address."""
    if address is None:
        return nullcontext()

    return tn.cluster(address)


def choose_recipe(
    name: str | Mapping[str, Any] | None,
    changes: Sequence[str] | None,
    *,
    system: object,
    physics: object,
) -> "tn.Recipe":
    """Reads a recipe with its changes; by default the usual one for a system or physics."""
    usual = task.default_recipe_name(system=system is not None, physics=physics is not None)
    return tn.read_recipe(name or usual, changes or ())


def make_members(seeds: str | None, recipe: "tn.Recipe") -> "list[tn.Member]":
    """Makes the members of a fit from `--seeds`.

    Raises:
        InputError: seeds of an identification; see also `parse_seeds`.
    """
    if seeds is not None and not recipe.family.has_seeds:
        raise InputError(
            "--seeds",
            f"an option of a training; nothing in '{recipe.name}' is random",
            "a recipe whose models are trained",
        )
    return [tn.Member(seed) for seed in parse_seeds("1" if seeds is None else seeds)]


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds from the value of `--seeds`: `K` for the seeds 0 to K - 1, or a list."""
    try:
        seeds = tuple(int(x) for x in text.split(",") if x.strip())
    except ValueError:
        seeds = ()
    if seeds and "," not in text:
        seeds = tuple(range(min(*seeds, _MAX_SEEDS + 1)))
    different = {seed for seed in seeds if 0 <= seed <= _LARGEST_SEED}
    if not 0 < len(different) == len(seeds) <= _MAX_SEEDS:
        raise InputError(
            "--seeds",
            f"'{text}'",
            f"a number from 1 to {_MAX_SEEDS}, or different seeds, separated by commas",
            "for instance --seeds 3, or --seeds 4,5, (a comma behind a single one)",
        )
    return seeds
