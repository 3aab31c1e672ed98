"""Table 1: free-run RMSE of the paper's models on a split of its data."""

import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluate.scores import Score, mean_rmse, rmse_by_record, score_runs
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import Run, run_fit
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.recipe import Criterion, TrainingRecipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.task import Member
from tustinnet.models.contract import Model
from tustinnet.report.tables import Table, number
from tustinnet.reproduce.entries import ALL_MODELS, AUTHORS, DEFAULT_MODELS, ENTRIES
from tustinnet.reproduce.published import (
    AUTHORS_ROWS,
    TABLE_1,
    WEIGHTS_FOLDER,
    load_authors_weights,
)
from tustinnet.store.run_folder import MODEL
from tustinnet.wording import counted

START = "file"  # Table 1 starts from the first row as it is stored


@dataclass(frozen=True)
class Row:
    """One model on all records of the split.

    Attributes:
        name: name of the model.
        seed: seed of the training, None for published weights and identified models.
        recipe: name of the recipe, None for published weights; of identified models the system.
        scores: scores of the records.
        model: the model.
        file: its file, None for published weights.
        train_seconds: duration of the training, or None.
        windows: windows of each stage, or None.
        epochs: epochs of each stage, or None.
    """

    name: str
    seed: int | None
    recipe: str | None
    scores: tuple[Score, ...]
    model: Model
    file: Path | None = None
    train_seconds: float | None = None
    windows: Sequence[int] | None = None
    epochs: Sequence[int] | None = None

    @property
    def start(self) -> str:
        """Start of its free runs; models that need a warm-up do not start from the file."""
        return self.scores[0].start

    @property
    def mean(self) -> float:
        """Mean RMSE over the records [rad]."""
        return mean_rmse(self.scores)


def choose_split(data: DataSet, name: str | None) -> str:
    """Chooses the split to score: by name, else `test` if there is one, else `validation`."""
    if name is not None:
        data.split(name)
        return name
    for split in ("test", "validation"):
        if split in data.splits:
            return split
    raise InputError(data.name, "neither a test nor a validation split", "one of them")


def choose_models(names: Sequence[str], folder: Path) -> tuple[list[str], str]:
    """Chooses the models to score; also returns a remark on models that are left out.

    Args:
        names: their names, also several separated by commas; empty for the default models.
        folder: the folder that may contain the authors' weights.

    Raises:
        InputError: an unknown name, or `authors` where their weights are missing.
    """
    model_names = [name.strip() for part in names for name in part.split(",") if name.strip()]
    weights = folder / WEIGHTS_FOLDER
    if not model_names:
        if weights.is_dir():
            return list(DEFAULT_MODELS), ""
        remark = f"no folder {weights}: the authors' rows are left out"
        return [name for name in DEFAULT_MODELS if name != AUTHORS], remark
    for name in model_names:
        if name not in ALL_MODELS:
            raise InputError(
                "`models=`", f"unknown model '{name}'", f"one of {', '.join(ALL_MODELS)}"
            )
    if AUTHORS in model_names and not weights.is_dir():
        raise InputError(
            weights,
            "no such folder",
            "the authors' stored weights",
            "put them there or leave 'authors' out of `models=`",
        )
    return list(dict.fromkeys(model_names)), ""


@dataclass(frozen=True)
class ReproductionOptions:
    """Options of a reproduction of the table.

    Attributes:
        models: names from `choose_models`.
        split: the split to score.
        seeds: number of trainings of each recipe, from seed 0 on.
        keep: criterion of the best weights, None for that of each recipe.
        overwrite: whether to fit anew instead of continuing earlier trainings.
    """

    models: Sequence[str]
    split: str
    seeds: int = 1
    keep: Criterion | None = None
    overwrite: bool = False


def build_rows(
    data: DataSet,
    folder: Path,
    options: ReproductionOptions,
    runs_folder: Path,
    make_listener: Callable[[str], Listener],
) -> list[Row]:
    """Fits the models and scores each of them on the split.

    Args:
        data: all splits.
        folder: folder of the data, and perhaps of the authors' weights.
        options: options of the reproduction.
        runs_folder: folder where fits are kept.
        make_listener: makes the listener of a model's fits, given the name of the model.
    """
    records = list(data.split(options.split))
    runs: dict[str, Run] = {}

    def fit(name: str) -> Run:
        if name not in runs:
            entry = ENTRIES[name]
            recipe = read_recipe(entry.recipe)
            if options.keep is not None and isinstance(recipe, TrainingRecipe):
                changed_name = f"{recipe.name}, keep {options.keep}"
                changed_recipe = recipe.with_stages(keep=options.keep)
                recipe = changed_recipe.model_copy(update={"name": changed_name})
            physics = None if entry.corrects is None else fit(entry.corrects).best.result.model
            members = [Member(seed) for seed in recipe.family.select_seeds(range(options.seeds))]
            request = FitRequest(data, recipe, members, physics=physics, system=entry.system)
            continues = recipe.family.resumable and not options.overwrite
            earlier = "resume" if continues else "discard"
            listener = make_listener(name)
            runs[name] = run_fit(prepare(request), runs_folder / name, earlier, listener)
        return runs[name]

    rows = []
    for name in options.models:
        if name == AUTHORS:
            for authors_name, stem in AUTHORS_ROWS.items():
                model = load_authors_weights(folder / WEIGHTS_FOLDER / f"{stem}.npz", data)
                scores = tuple(score_runs(model, records, START, horizon=None))
                rows.append(Row(authors_name, None, None, scores, model))
            continue
        run = fit(name)
        for result in (member.result for member in run.members):
            # a model that needs a warm-up does not start from the first row
            start = result.start if result.model.warm_up else START
            rows.append(
                Row(
                    name=name,
                    seed=result.seed if result.recipe.family.has_seeds else None,
                    recipe=ENTRIES[name].system or result.recipe.name,
                    scores=tuple(score_runs(result.model, records, start, horizon=None)),
                    model=result.model,
                    file=run.folder / MODEL,
                    train_seconds=result.seconds,
                    windows=result.detail("windows"),
                    epochs=result.detail("epochs"),
                )
            )
    return rows


def as_json(rows: Sequence[Row], split: str) -> dict[str, Any]:
    """The table as plain values, RMSE in rad."""
    return {
        "split": split,
        "units": "rad",
        "x0": START,
        "experiments": [score.experiment for score in rows[0].scores],
        "rows": [
            {
                "model": row.name,
                "seed": row.seed,
                "recipe": row.recipe,
                "rmse": rmse_by_record(row.scores),
                "mean": row.mean,
                "train_seconds": row.train_seconds,
                "windows": None if row.windows is None else list(row.windows),
                "epochs": None if row.epochs is None else list(row.epochs),
            }
            | ({} if row.start == START else {"start": row.start})
            for row in rows
        ],
    }


def is_table(path: Path) -> bool:
    """Whether a file exists that has the contents of `as_json`."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {"x0", "experiments", "rows"} <= content.keys()
    except (OSError, ValueError, AttributeError):
        return False


def as_table(rows: Sequence[Row], split: str) -> Table:
    """The table as text: the paper's rows, ours, and medians where there are several seeds."""
    names = [score.experiment for score in rows[0].scores]
    same_records = split == "test" and len(names) == len(next(iter(TABLE_1.values())))
    lines = []
    for model, values in TABLE_1.items():
        cells = [number(v) for v in values] if same_records else ["–"] * len(names)
        mean = number(statistics.fmean(values))
        lines.append([f"paper: {model}", *cells, mean if same_records else f"{mean}*"])
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.name, []).append(row)
        label = row.name if row.seed is None else f"{row.name}, seed {row.seed}"
        cells = [number(s.rmse) for s in row.scores]
        lines.append([label + _other_start(row), *cells, number(row.mean)])
    for name, group in groups.items():
        if len(group) < 2:
            continue
        columns = zip(*[[s.rmse for s in row.scores] for row in group], strict=True)
        medians = [number(statistics.median(column)) for column in columns]
        means = [row.mean for row in group]
        mean = f"{number(statistics.median(means))} ({number(min(means))}..{number(max(means))})"
        label = f"{name}, median of {counted(len(group), 'seed')}{_other_start(group[0])}"
        lines.append([label, *medians, mean])
    note = "" if same_records else "; * the paper's mean over its own (test) records"
    title = f"Table 1 on the {split} split: free-run RMSE [rad], start '{START}'{note}"
    return Table(["model", *names, "mean"], lines, title=title)


def _other_start(row: Row) -> str:
    """Text that names the start of a row, empty if it is that of the table."""
    return "" if row.start == START else f", from {row.start}"
