"""The values that verbs make of their arguments: records, recipes, models, bands."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tustinnet.cli import terminal
from tustinnet.cli.completion import ALL
from tustinnet.errors import InputError
from tustinnet.wording import counted

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.channels import Channels
    from tustinnet.cli.automatic_report import AutomaticReport
    from tustinnet.cli.options import Hardware
    from tustinnet.data.dataset import DataSet
    from tustinnet.data.experiment import Experiment
    from tustinnet.evaluate.bands import Band, BandOptions
    from tustinnet.evaluate.scores import Score
    from tustinnet.fitting.recipe import Recipe
    from tustinnet.fitting.task import Member, Origin
    from tustinnet.models.contract import Model
    from tustinnet.selection.runner import MakeExecutor
    from tustinnet.simulate.range import Range
    from tustinnet.store.run_folder import Earlier
    from tustinnet.systems.files import AnySystem, SystemFile

_MAX_SEEDS, _LARGEST_SEED = 1000, 2**32 - 1
_MAX_NAMED = 6  # records that a note names


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

    load: "Callable[[], DataSet]"
    out: Path
    system: "SystemFile | str | None"
    earlier: "Earlier"
    report: "AutomaticReport"
    json: bool
    quiet: bool
    leave_out_spoiled: bool = False


def require_cores(cluster: str | None, device: "Hardware | None") -> None:
    """Raises an error if jobs of a cluster are to compute on another device than processors."""
    if cluster is not None and device not in (None, "cpu"):
        raise InputError(
            f"--device {device}", "not applicable to jobs on a cluster", "cpu", "omit the option"
        )


def open_cluster(
    address: str | None, on_message: "Callable[[str], None]"
) -> "AbstractContextManager[MakeExecutor | None]":
    """Context with an executor of jobs on a cluster; with None without an address."""
    if address is None:
        return nullcontext()
    from tustinnet.selection.cluster import cluster

    return cluster(address, on_message)


def choose_recipe(
    name: "str | Mapping[str, Any] | None",
    changes: Sequence[str] | None,
    *,
    system: object,
    physics: object,
) -> "Recipe":
    """Reads a recipe with its changes; by default the usual one for a system or physics."""
    from tustinnet.fitting.recipe_reading import read_recipe
    from tustinnet.fitting.task import default_recipe_name

    usual = default_recipe_name(system=system is not None, physics=physics is not None)
    return read_recipe(name or usual, changes or ())


def read_recipe_in(model: Path) -> "Mapping[str, Any]":
    """Reads the recipe that is stored in a model file; raises an error if it has none."""
    from tustinnet.store.header import read_header

    header = read_header(model)
    if not isinstance(recipe := header.get("recipe"), dict):
        raise InputError(
            f"--from {model}",
            f"a model of kind '{header['kind']}' that names no recipe",
            "a model that `fit` has made by a recipe",
            "of a model of one kind, name the recipe: --recipe NAME",
        )
    return recipe


def read_origin(
    model: Path, system: "AnySystem | None", changes: "Sequence[str] | None"
) -> "Origin":
    """Reads the model that `--from` names.

    Raises:
        InputError: `--set` changes the same initial values; see also `load_model`.
    """
    from tustinnet.store.model_file import load_origin

    for change in changes or ():
        if change.strip().startswith("model.begin"):
            raise InputError(
                f"--set {change}", "--from sets the same initial values", "one of them", "omit one"
            )
    return load_origin(model, kept_system(model) if system is None else system)


def make_members(seeds: str | None, recipe: "Recipe") -> "list[Member]":
    """Makes the members of a fit from `--seeds`.

    Raises:
        InputError: seeds of an identification; see also `parse_seeds`.
    """
    from tustinnet.fitting.task import Member

    if seeds is not None and not recipe.family.has_seeds:
        raise InputError(
            "--seeds",
            f"an option of a training; '{recipe.name}' identifies",
            "a recipe of a kind with weights",
            "an identification has no seeds",
        )
    return [Member(seed) for seed in parse_seeds("1" if seeds is None else seeds)]


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


def load_records_to_fit(
    data: str,
    card: Path | None,
    out: Path,
    console: "Console",
    *,
    strict: bool,
    follow_links: bool,
) -> "DataSet":
    """Loads the records of a fit; prints which are left out, or with `strict` refuses them."""
    from tustinnet.check.check import check_records
    from tustinnet.cli.inspect import assumed_lines, require_sound, spoiled_lines, warning_lines
    from tustinnet.data.catalog import locate
    from tustinnet.data.inspection import held_equilibrium
    from tustinnet.data.loading import load_folder
    from tustinnet.simulate.start_rules import DerivedStart
    from tustinnet.store.files import require_outputs
    from tustinnet.store.run_folder import LOG, MODEL, REPORT, SPECIFICATION, SUMMARY

    folder, located_card = locate(data, card)
    require_apart(out, folder)
    outputs = [out / name for name in (MODEL, SUMMARY, LOG, REPORT, SPECIFICATION)]
    require_outputs(outputs, overwrite=True, read=list_input_files(data, card))
    records = load_folder(
        folder,
        located_card,
        on_message=None if strict else console.print,
        follow_links=follow_links,
    )
    if not strict:
        kept = _leave_out_short([*records], DerivedStart.usual_name(), ())
        records = replace(records, experiments=tuple(kept))
    findings = check_records(records, located_card)
    if strict:
        require_sound(findings)
    lines = [*warning_lines(findings, len(records), data, card), *assumed_lines(findings)]
    for line in (*lines, *spoiled_lines(records, map(held_equilibrium, records))):
        console.print(line, highlight=False, soft_wrap=True)
    return records


def load_records(
    data: str, card: Path | None, names: "Collection[str]" = (), *, follow_links: bool
) -> "DataSet":
    """Loads the records of a verb that simulates them; prints which are left out.

    As a fit, it leaves out records that cannot be read or used, but not those of some names.
    """
    from tustinnet.data.catalog import locate
    from tustinnet.data.loading import load_folder

    return load_folder(
        *locate(data, card),
        on_message=terminal.messages().print,
        required=names,
        follow_links=follow_links,
    )


def require_apart(out: Path, folder: Path) -> None:
    """Raises an error if the folder for results is the folder of the data."""
    if out.resolve() == folder.resolve():
        raise InputError(out, "the folder of the data", "another folder for the run")


def require_no_new_records(paths: Sequence[Path], data: str, card: Path | None) -> None:
    """Raises an error if files that are written would be read as records of the data."""
    from tustinnet.data.card_files import would_be_record
    from tustinnet.data.catalog import locate

    folder, located_card = locate(data, card)
    for path in paths:
        if would_be_record(path, folder, located_card):
            raise InputError(
                path.parent,
                f"there {path.name} would be a record of '{located_card.name}'",
                "another folder",
            )


def list_input_files(
    data: str | None, card: Path | None, *others: "Path | str | None"
) -> list[Path]:
    """Lists the files that a verb reads: those of a data set, and others that were named.

    The others may also be names of packaged systems or recipes.
    """
    from tustinnet.data.catalog import list_input_files

    files = [] if data is None else list_input_files(data, card)
    return [*files, *(Path(other) for other in others if other is not None)]


def require_figures(
    option: str, paths: "Path | Sequence[Path] | None", inputs: Sequence[Path], *, overwrite: bool
) -> None:
    """Raises an error unless figures can be written, or on `overwrite` without figures.

    Args:
        option: the option that names the figures.
        paths: the files, None without the option.
        inputs: files that the verb reads, which are never replaced.
        overwrite: whether existing files may be replaced.
    """
    from tustinnet.store.files import FIGURE_ENDINGS, require_outputs, require_writable_folder

    if paths is not None:
        files = [paths] if isinstance(paths, Path) else paths
        require_outputs(files, overwrite=overwrite, read=inputs, endings=FIGURE_ENDINGS)
        for folder in {path.parent for path in files}:
            require_writable_folder(folder)
    elif overwrite:
        raise InputError(
            "--overwrite",
            "no figures that it could replace",
            "figures",
            f"add {option}, or omit it",
        )


def print_still_coordinates(experiments: "Sequence[Experiment]", console: "Console") -> None:
    """Prints the names of the coordinates that do not move in any training record."""
    from tustinnet.data.inspection import still_coordinates

    for name in still_coordinates(experiments):
        console.print(f"{name} never moves in the training records: nothing can be learnt of it")


def require_readable_robot(system: str | None) -> None:
    """Raises unless the file of a robot can be read, if one was named; JAX is not loaded for it."""
    from tustinnet.systems.robot_reading import ROBOT_ENDINGS, read_robot, read_robot_text

    if system is not None and (path := Path(system)).suffix in ROBOT_ENDINGS:
        read_robot(read_robot_text(path), path)


def require_system_of_card(system: "SystemFile | str | None", data: str, card: Path | None) -> None:
    """Raises unless a system can be loaded and a card has its coordinates and inputs.

    Records are not read for it.

    Args:
        system: the system, None for none.
        data: the data set; a folder without a card is not compared.
        card: its card, if it was named.
    """
    from tustinnet.data.catalog import CARD_NAME, lacks_card, locate
    from tustinnet.models.lagrangian import LagrangianSystem
    from tustinnet.systems.loading import load_system_or_template

    loaded = None if system is None else load_system_or_template(system)
    if not isinstance(loaded, LagrangianSystem) or (card is None and lacks_card(data)):
        return
    folder, content = locate(data, card)
    channels = content.channels(content.dt or 1.0).plant
    place = card or (data if Path(data).suffix == ".toml" else folder / CARD_NAME)
    loaded.for_channels(channels.coordinates, channels.inputs, place)


def find_system_to_fit(
    system: str | None, default_density: float | None
) -> "SystemFile | str | None":
    """The system of a fit, if one was named.

    Args:
        system: its name or file.
        default_density: density by which links of a URDF get inertias [kg/m^3]; None for none.

    Raises:
        InputError: no such system, or a density for what is no robot.
    """
    from tustinnet.systems.files import find_system

    file = None if system is None else find_system(system)
    if default_density is None:
        return file
    from tustinnet.systems.robot_shapes import with_inertias

    if file is None or isinstance(file, str):
        raise InputError(
            "--default-density",
            "not applicable without the file of a robot",
            "--system FILE.urdf",
            "omit it",
        )
    return with_inertias(file, default_density)


def load_model(path: Path, system: str | None) -> "Model":
    """Loads a model with the system that was named, or that is stored with it."""
    from tustinnet.store import model_file
    from tustinnet.systems.files import find_system

    model_system = kept_system(path) if system is None else find_system(system)
    return model_file.load_model(path, model_system)


def kept_system(model: Path) -> "SystemFile | None":
    """The system file that is stored with a model; raises an error unless the user trusts it."""
    from tustinnet.store.kept_system import find_trusted_copy

    def ask(copy: "SystemFile") -> bool:
        if terminal.confirm(f"{copy.path} is Python code that was kept with this model; run it?"):
            return True
        raise InputError(
            copy.path,
            "Python code that was kept with the model, and not trusted on this machine",
            "your consent",
            f"if you would run it yourself, add --system {copy.path}",
        )

    return find_trusted_copy(model, ask)


def records_of_split(data: "DataSet", split: str | None) -> "DataSet":
    """The records of a split; all of them for `all`, or without a split."""
    return data if split in (None, ALL) else data.split(split)


@dataclass(frozen=True)
class FreeRunRequest:
    """The free runs that a verb computes.

    Attributes:
        records: the records.
        split: name of their split, or `all`.
        start: where the free runs start.
        horizon: how long each lasts at most [s], None for whole records.
        fitted: names of the records that one of the models was fitted to.
        notes: sentences on defaults that were used, and on records that were fitted to.
    """

    records: "list[Experiment]"
    split: str
    start: str
    horizon: float | None
    fitted: list[str]
    notes: list[str]

    def as_plain(self) -> dict[str, Any]:
        """Split, start, horizon and the names of fitted records as plain values."""
        return {
            "split": self.split,
            "start": self.start,
            "horizon": self.horizon,
            "fitted_to": self.fitted,
        }

    def print_notes(self) -> None:
        """Prints the notes, a line each."""
        for note in self.notes:
            terminal.messages().print(f"note: {note}")


def choose_free_runs(
    data: "DataSet",
    models: "Mapping[Path, Model]",
    split: str | None,
    start: str | None,
    horizon: float | None,
    *,
    names: Sequence[str] = (),
    has_bands: bool = False,
) -> FreeRunRequest:
    """Chooses records, start and horizon of free runs: as given, else as the models were judged.

    Args:
        data: the records.
        models: the models that simulate them, by file.
        split: the split, None for the usual one: test, else validation, else all.
        start: name of the start, None for that of the files where they agree, else the usual one.
        horizon: longest duration [s], infinite for whole records, None for that of the files where
            they agree, else whole records.
        names: some of the records, () for all; others that are too short for the start are left
            out with a message.
        has_bands: whether start and horizon are by default those of the models' calibration.
    """
    from tustinnet.simulate.start_rules import DerivedStart
    from tustinnet.simulate.starts import default_start
    from tustinnet.store.header import find_fitted, read_header
    from tustinnet.store.judgement import judged_free_runs, usual_split

    headers = {path: read_header(path) for path in models}
    defaults = []
    if split is None and not names:
        split = usual_split(data) or ALL
        defaults.append(f"{split} records (--split)")
    selected = records_of_split(data, split)
    records = [selected[name] for name in names] if names else list(selected)
    file_start, file_horizon = judged_free_runs(headers, records, has_bands=has_bands)
    if start is None and file_start is not None:
        defaults.append(f"start '{file_start}' as in the model's file (--start)")
    start = file_start if start is None else start
    if start is None:
        usual = [e for e in records if len(e) >= DerivedStart.usual_samples] or records
        start = default_start(usual, *models.values())
    if horizon is None and file_horizon is not None:
        defaults.append(f"segments of {file_horizon:g} s as in the model's file (--horizon)")
    horizon = file_horizon if horizon is None else None if horizon == math.inf else horizon
    records = _leave_out_short(records, start, names)
    notes = [f"default: {', '.join(defaults)}"] if defaults else []
    used = {name for header in headers.values() for name in find_fitted(header, records)}
    fitted = [e.name for e in records if e.name in used]
    if fitted:
        count = "all records" if len(fitted) == len(records) else f"{len(fitted)} of the records"
        more = ", ..." if len(fitted) > _MAX_NAMED else ""
        named = ", ".join(fitted[:_MAX_NAMED]) + more
        notes.append(f"fitted to {count}, whose scores are optimistic: {named}")
    return FreeRunRequest(records, split or ALL, start, horizon, fitted, notes)


def _leave_out_short(
    records: "list[Experiment]", start: str, names: Sequence[str]
) -> "list[Experiment]":
    """The records that are long enough for a start; prints which are left out.

    Those that were named stay, and all of a split where none is long enough.
    """
    from tustinnet.simulate.start_rules import start_named

    fewest = start_named(start).samples
    remaining = {e.split for e in records if len(e) >= fewest}
    kept = []
    for e in records:
        if len(e) >= fewest or e.name in names or e.split not in remaining:
            kept.append(e)
        else:
            terminal.messages().print(
                f"left out: {e.name}: {counted(len(e), 'sample')}; expected at least {fewest}"
            )
    return kept


def compute_bands(
    path: Path,
    model: "Model",
    records: "Sequence[Experiment]",
    scores: "Sequence[Score]",
    band_options: "BandOptions",
) -> "list[Band]":
    """Computes the bands around the free runs of a model in a file, by its calibration."""
    from tustinnet.evaluate.bands import Calibration, find_alternatives, make_bands
    from tustinnet.store.header import read_header

    header = read_header(path)
    others = find_alternatives(model, header, path)
    calibration = Calibration.from_header(header, path)
    return make_bands(calibration, band_options, model, others, records, scores)


def make_band_options(level: float | None, *, whole: bool) -> "BandOptions | None":
    """Makes the options of bands from `--band` and `--whole-records`; None without bands."""
    from tustinnet.evaluate.bands import BandOptions, require_share

    if level is None:
        if whole:
            raise InputError("--whole-records", "no band", "a band", "add --band LEVEL")
        return None
    require_share(level)
    return BandOptions(level, "record" if whole else "time")


def parse_pairs(option: str, pairs: Sequence[str] | None) -> dict[str, str]:
    """Texts by name, each written as `NAME=VALUE`; empty without the option."""
    parts = [pair.partition("=") for pair in pairs or ()]
    texts = {name.strip(): value.strip() for name, _, value in parts}
    if len(texts) < len(parts) or not all(name and value for name, value in texts.items()):
        raise InputError(option, f"'{', '.join(pairs or ())}'", "NAME=VALUE, each name once")
    return texts


class OptionReader:
    """Reads options with values of coordinates and inputs, and prints what was understood.

    Args:
        channels: the channels of the model or system.
        header: the header of the model's file, which knows the columns; None without a file.
    """

    def __init__(self, channels: "Channels", header: "Mapping[str, Any] | None") -> None:
        from tustinnet.data.quantities import ValueReader
        from tustinnet.store.header import columns_in_header

        self._coordinates = channels.coordinates
        columns = columns_in_header(header or {})
        self.values = ValueReader(channels, columns, terminal.messages().print)

    def read(self, option: str, pairs: Sequence[str] | None) -> dict[str, float]:
        """Values by name, each written as `NAME=VALUE` with or without a unit."""
        read = self.values.read(option, parse_pairs(option, pairs))
        return {name: value for name, (value,) in read.items()}

    def read_limits(self, option: str, pairs: Sequence[str] | None) -> dict[str, Any]:
        """Lower and upper limits by name, each written as `NAME=LOW:HIGH`."""
        return self.values.read(option, parse_pairs(option, pairs), 2)

    def read_point(
        self, option: str, text: str | None, training_range: "Range | None" = None
    ) -> dict[str, float]:
        """Values by name, written as `NAME=VALUE,..`; raises an error far from the records.

        That is by more than the recorded span or, of an angle, half a turn: all its directions are
        within that of a recorded one.

        Args:
            option: the option.
            text: its value, None without the option.
            training_range: range of the training records; None to take any positions.
        """
        point = self.read(option, text and text.split(","))
        ends = () if training_range is None else training_range.states
        for c, (low, high) in zip(self._coordinates, ends, strict=False):
            reach = max(high - low, math.pi if c.kind == "angular" else 0.0)
            if not low - reach <= point.get(c.name, low) <= high + reach:
                unit, factor = self.values.units[c.name][1]
                raise InputError(
                    f"{option} {c.name} = {point[c.name] / factor:.6g} {unit}",
                    "far outside of the recorded motion",
                    f"about {low / factor:.4g} to {high / factor:.4g} {unit}, as recorded",
                    "check the unit, or add --trust-beyond",
                )
        return point
