"""What the verbs make of their arguments: records, recipes, members."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tustinnet.cli import terminal

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.cli.options import Hardware
    from tustinnet.data.dataset import DataSet
    from tustinnet.data.experiment import Experiment
    from tustinnet.evaluate.bands import Band, BandOptions
    from tustinnet.evaluate.scores import Score
    from tustinnet.fitting.recipe import Recipe
    from tustinnet.fitting.task import Member, Origin
    from tustinnet.models.contract import Model
    from tustinnet.systems.files import AnySystem, SystemFile

_MOST_SEEDS, _LARGEST_SEED = 1000, 2**32 - 1


def require_cores(cluster: str | None, device: "Hardware | None") -> None:
    """Raises where jobs of a cluster are to compute on something else."""
    from tustinnet.errors import InputError

    if cluster is not None and device is not None and device.value != "cpu":
        raise InputError(f"--device {device.value}", "means nothing to jobs on a cluster",
                         "cpu", "leave the option out")  # fmt: skip


def recipe_of(
    name: "str | Mapping[str, Any] | None",
    changes: Sequence[str] | None,
    *,
    system: object,
    physics: object,
) -> "Recipe":
    """The recipe that was asked for, or the usual one for what was given, with its changes."""
    from tustinnet.fitting.recipe_reading import read_recipe
    from tustinnet.fitting.task import usual_recipe

    usual = usual_recipe(system=system is not None, physics=physics is not None)
    return read_recipe(name or usual, changes or ())


def recipe_within(model: Path) -> "Mapping[str, Any]":
    """The recipe that a model file keeps of how its model was fitted."""
    from tustinnet.errors import InputError
    from tustinnet.store.header import read_header

    header = read_header(model)
    if not isinstance(told := header.get("recipe"), dict):
        raise InputError(
            f"--from {model}", f"a model of kind '{header['kind']}' that names no recipe",
            "a model that `fit` has made by a recipe",
            "of a model of one kind, name the recipe: --recipe NAME",
        )  # fmt: skip
    return told


def begun_with(
    model: Path, system: "AnySystem | None", changes: "Sequence[str] | None"
) -> "Origin":
    """The model that `--from` names.

    Raises:
        InputError: what it begins with is also set by hand; see also `load_model`.
    """
    from tustinnet.errors import InputError
    from tustinnet.store.model_file import load_origin

    for change in changes or ():
        if change.strip().startswith("model.begin"):
            raise InputError(f"--set {change}", "--from says where the search begins",
                             "one of them", "leave one out")  # fmt: skip
    return load_origin(model, kept_system(model) if system is None else system)


def members_of(seeds: str | None, recipe: "Recipe") -> "list[Member]":
    """The members that `--seeds` and the recipe's `rates` ask for."""
    from tustinnet.errors import InputError
    from tustinnet.fitting.recipe import rates_of
    from tustinnet.fitting.task import Member

    if seeds is not None and not recipe.family.trains:
        raise InputError(
            "--seeds", f"an option of a training; '{recipe.name}' identifies",
            "a recipe of a kind with weights", "an identification has no seeds",
        )  # fmt: skip
    return [Member(seed, rate) for seed in seeds_of(seeds) for rate in rates_of(recipe)]


def seeds_of(seeds: str | None) -> tuple[int, ...]:
    """`K` seeds from 0 on, or those that are listed."""
    from tustinnet.errors import InputError

    try:
        listed = [int(x) for x in ("1" if seeds is None else seeds).split(",") if x.strip()]
    except ValueError:
        listed = []
    several = seeds is not None and "," in seeds
    found = tuple(listed if several else range(min(*listed, _MOST_SEEDS + 1) if listed else 0))
    if (
        not 0 < len(found) <= _MOST_SEEDS
        or not 0 <= min(found) <= max(found) <= _LARGEST_SEED
        or len(set(found)) < len(found)
    ):
        raise InputError(
            "--seeds", f"'{seeds}'",
            f"a number from 1 to {_MOST_SEEDS}, or different seeds, separated by commas",
            "for instance --seeds 3, or --seeds 4,5, (a comma behind a single one)",
        )  # fmt: skip
    return found


def loaded(data: str, card: Path | None, out: Path, told: "Console", *, strict: bool) -> "DataSet":
    """The records to fit to; says what looks wrong in them, and refuses to write among them.

    Strict, it refuses records in which something looks wrong.
    """
    from tustinnet.cli.inspect import require_sound, suspicions
    from tustinnet.data.catalog import locate
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.data.loading import load_folder

    folder, declared = locate(data, card)
    require_apart(out, folder)
    records = load_folder(folder, declared)
    reports = [inspect_experiment(e) for e in records]
    if strict:
        require_sound(reports)
    for line in suspicions(reports):
        told.print(line)
    return records


def require_apart(out: Path, folder: Path) -> None:
    """Raises where results would be written among the records that they are made from."""
    from tustinnet.errors import InputError

    if out.resolve() == folder.resolve():
        raise InputError(out, "the folder of the data", "another folder for the run")


def files_of(data: str | None, card: Path | None, *others: "Path | str | None") -> list[Path]:
    """The files that a verb reads: card and records of a data set, and others that it was given.

    Of names that may also be packaged ones (systems, recipes) those count that are files.
    """
    from tustinnet.data.catalog import files_read

    known = [] if data is None else files_read(data, card)
    return [*known, *(Path(other) for other in others if other is not None)]


def require_figures(
    option: str, paths: "Path | Sequence[Path] | None", read: Sequence[Path], *, overwrite: bool
) -> None:
    """Raises unless figures may be drawn into files.

    Raises:
        InputError: no figures that could be replaced; see also `require_outputs`.
    """
    from tustinnet.errors import InputError
    from tustinnet.report.figure_file import ENDINGS
    from tustinnet.store.files import require_outputs, require_writable_folder

    if paths is not None:
        listed = [paths] if isinstance(paths, Path) else paths
        require_outputs(listed, overwrite=overwrite, read=read, endings=ENDINGS)
        for folder in {path.parent for path in listed}:
            require_writable_folder(folder)
    elif overwrite:
        raise InputError("--overwrite", "no figures that it could replace", "figures",
                         f"add {option}, or leave it out")  # fmt: skip


def tell_still(experiments: "Sequence[Experiment]", told: "Console") -> None:
    """Says which coordinates do not move in any of the records that train."""
    from tustinnet.data.inspection import still

    for name in still(experiments):
        told.print(f"{name} never moves in the training records: nothing can be learnt of it")


def model_of(path: Path, system: str | None) -> "Model":
    """The model of a file, with the system that was named, or that was kept with it."""
    from tustinnet.store.model_file import load_model
    from tustinnet.systems.files import find_system

    return load_model(path, kept_system(path) if system is None else find_system(system))


def kept_system(model: Path) -> "SystemFile | None":
    """The system file that was kept with a model, where the user trusts it; asks on a terminal.

    Raises:
        InputError: it is not trusted.
    """
    from tustinnet.errors import InputError
    from tustinnet.store.kept_system import find_system_copy, is_trusted, trust

    copy = find_system_copy(model)
    if copy is None or is_trusted(copy):
        return copy
    if terminal.confirmed(f"{copy.path} is Python code that was kept with this model; run it?"):
        trust(copy)
        return copy
    raise InputError(
        copy.path, "Python code that was kept with the model, and not trusted on this machine",
        "your consent", f"if you would run it yourself, add --system {copy.path}",
    )  # fmt: skip


def judged_records(
    data: str, card: Path | None, split: str | None, start: str | None, models: "Sequence[Model]"
) -> "tuple[list[Experiment], str]":
    """The records of a split, or all, and where free runs of some models start on them."""
    from tustinnet.data.catalog import load
    from tustinnet.simulate.starts import default_start

    found = load(data, card)
    records = list(found if split is None else found.split(split))
    return records, default_start(records, *models) if start is None else start


def bands_of(
    path: Path, model: "Model", records: "Sequence[Experiment]", scores: "Sequence[Score]",
    asked: "BandOptions",
) -> "list[Band]":  # fmt: skip
    """The bands around free runs.

    Args:
        path: the model's file.
        model: the model.
        records: the records.
        scores: their free runs.
        asked: which bands.

    Raises:
        InputError: a model that was not calibrated, or from another start or horizon.
    """
    from tustinnet.evaluate.bands import Calibration, find_alternatives, make_bands
    from tustinnet.store.header import read_header

    header = read_header(path)
    others = find_alternatives(model, header, path)
    calibration = Calibration.from_header(header, path)
    return make_bands(calibration, asked, model, others, records, scores)


def band_asked(level: float | None, *, whole: bool) -> "BandOptions | None":
    """What `--band` and `--whole-records` ask for.

    Raises:
        InputError: no share; whole records without a band.
    """
    from tustinnet.errors import InputError
    from tustinnet.evaluate.bands import BandOptions, require_share

    if level is None:
        if whole:
            raise InputError("--whole-records", "no band", "a band", "add --band LEVEL")
        return None
    require_share(level)
    return BandOptions(level, "record" if whole else "time")
