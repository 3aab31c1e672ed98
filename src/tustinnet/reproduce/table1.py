"""Table 1: free-run RMSE of the paper's models on a split of its data."""

import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluate.scores import Score, evaluate, mean_rmse, rmse_by_record
from tustinnet.fitting.recipe import Criterion, Recipe, TrainingRecipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.task import Member, make_task
from tustinnet.models.contract import Model
from tustinnet.report.tables import Table, number
from tustinnet.reproduce.published import (
    AUTHORS_ROWS,
    TABLE_1,
    WEIGHTS_FOLDER,
    load_authors_weights,
)
from tustinnet.store.run import MODEL, MakeListener, Run, run_task

START = "file"  # Table 1 starts from the first row as it is stored


@dataclass(frozen=True)
class Entry:
    """A row, or several by seed, that is fitted.

    Attributes:
        recipe: what is fitted.
        system: the system that is identified, or None.
        corrects: the entry whose model a network corrects, or None.
    """

    recipe: str
    system: str | None = None
    corrects: str | None = None


FITTED = {
    "tustin-standard": Entry("paper-code-standard"),
    "tustin-transfer": Entry("paper-code-transfer"),
    "tustin-text-standard": Entry("paper-standard"),
    "tustin-text-transfer": Entry("paper-transfer"),
    "euler-lagrange": Entry("grey", system="qube-servo2"),
    "euler-lagrange-naive": Entry("grey", system="qube-servo2-naive"),
    "best-tustin": Entry("best-tustin"),
    "best-grey": Entry("best-grey", system="qube-servo2-memory"),
    "best-hybrid": Entry("best-hybrid", corrects="best-grey"),
    "gru": Entry("gru"),
    "neural-ode": Entry("neural-ode"),
    "linear": Entry("linear"),
}
AUTHORS = "authors"
DEFAULT_MODELS = (
    AUTHORS, "tustin-standard", "tustin-transfer", "euler-lagrange", "euler-lagrange-naive",
    "best-tustin", "best-grey", "best-hybrid",
)  # fmt: skip
KNOWN_MODELS = (AUTHORS, *FITTED)


@dataclass(frozen=True)
class Row:
    """One model on all records of the split.

    Attributes:
        model: its name.
        seed: the seed it was trained from, None for published weights and identified models.
        recipe: what it was trained by, None for published weights; of identified models the system.
        scores: per record.
        what: the model itself.
        file: its file, None of published weights.
        train_seconds: time of the training, or None.
        windows: windows of each stage, or None.
        epochs: epochs of each stage, or None.
    """

    model: str
    seed: int | None
    recipe: str | None
    scores: tuple[Score, ...]
    what: Model
    file: Path | None = None
    train_seconds: float | None = None
    windows: Sequence[int] | None = None
    epochs: Sequence[int] | None = None

    @property
    def start(self) -> str:
        """Where its free runs start: models that need a warm-up do not start from the file."""
        return self.scores[0].start

    @property
    def mean(self) -> float:
        """Mean RMSE over the records [rad]."""
        return mean_rmse(self.scores)


def choose_split(data: DataSet, wanted: str | None) -> str:
    """The split to score: the one asked for, else `test` where it is there, else `validation`."""
    if wanted is not None:
        data.split(wanted)
        return wanted
    for split in ("test", "validation"):
        if split in data.splits:
            return split
    raise InputError(data.name, "neither a test nor a validation split", "one of them")


def choose_models(listed: Sequence[str], folder: Path) -> tuple[list[str], str]:
    """The models to score and a remark on what is left out.

    Args:
        listed: their names, also several separated by commas; all usual ones where there are none.
        folder: where the authors' weights may be.

    Raises:
        InputError: an unknown name, or `authors` asked for where their weights are not.
    """
    names = [name.strip() for some in listed for name in some.split(",") if name.strip()]
    present = (folder / WEIGHTS_FOLDER).is_dir()
    if not names:
        kept = [m for m in DEFAULT_MODELS if m != AUTHORS or present]
        left = (
            ""
            if present
            else f"no folder {folder / WEIGHTS_FOLDER}: the authors' rows are left out"
        )
        return kept, left
    for name in names:
        if name not in KNOWN_MODELS:
            raise InputError(
                "--models", f"unknown model '{name}'", f"one of {', '.join(KNOWN_MODELS)}"
            )
    if AUTHORS in names and not present:
        raise InputError(
            folder / WEIGHTS_FOLDER,
            "no such folder",
            "the authors' stored weights",
            "put them there or leave 'authors' out of --models",
        )
    return list(dict.fromkeys(names)), ""


@dataclass(frozen=True)
class Ask:
    """What is to be reproduced.

    Attributes:
        models: names from `choose_models`.
        split: the split to score.
        seeds: trainings of each recipe, from seed 0 on.
        keep: the criterion of the best weights, where it is not to be the recipe's.
        overwrite: fit anew instead of going on with what is there.
    """

    models: Sequence[str]
    split: str
    seeds: int = 1
    keep: Criterion | None = None
    overwrite: bool = False


def build_rows(
    data: DataSet, folder: Path, ask: Ask, runs_folder: Path, tell: Callable[[str], MakeListener]
) -> list[Row]:
    """Fits what is to be fitted and scores every model on the split.

    Args:
        data: all splits.
        folder: where the data, and perhaps the authors' weights, are.
        ask: what is to be reproduced.
        runs_folder: where fits are kept.
        tell: given a model's name, who is told while it is fitted.
    """
    judged = list(data.split(ask.split))
    runs: dict[str, Run] = {}

    def run_of(name: str) -> Run:
        if name not in runs:
            runs[name] = _fitted(name, data, ask, runs_folder / name, tell, run_of)
        return runs[name]

    rows = []
    for name in ask.models:
        if name == AUTHORS:
            for row, stem in AUTHORS_ROWS.items():
                model = load_authors_weights(folder / WEIGHTS_FOLDER / f"{stem}.npz", data)
                rows.append(Row(row, None, None, tuple(evaluate(model, judged, START)), model))
            continue
        for run in run_of(name).members:
            result, trains = run.result, run.result.recipe.family.trains
            # a model that needs a warm-up does not start from the first row
            start = result.start if result.model.warm_up else START
            rows.append(
                Row(
                    model=name,
                    seed=result.seed if trains else None,
                    recipe=result.recipe.name if trains else FITTED[name].system,
                    scores=tuple(evaluate(result.model, judged, start)),
                    what=result.model,
                    file=run.folder / MODEL,
                    train_seconds=result.seconds,
                    windows=result.told("windows"),
                    epochs=result.told("epochs"),
                )
            )
    return rows


def _fitted(
    name: str,
    data: DataSet,
    ask: Ask,
    folder: Path,
    tell: Callable[[str], MakeListener],
    run_of: Callable[[str], Run],
) -> Run:
    """Fits the members of an entry; an identification anew, which takes seconds."""
    entry = FITTED[name]
    recipe = _keeping(read_recipe(entry.recipe), ask.keep)
    trains = recipe.family.trains
    physics = None if entry.corrects is None else run_of(entry.corrects).best.result.model
    members = [Member(seed) for seed in range(ask.seeds)] if trains else [Member()]
    task = make_task(data, recipe, members, physics=physics, system=entry.system)
    earlier = "discard" if ask.overwrite or not trains else "resume"
    return run_task(task, data.name, folder, earlier, tell(name))


def _keeping(recipe: Recipe, criterion: Criterion | None) -> Recipe:
    """The same recipe with the best weights of every stage chosen by another criterion."""
    if criterion is None or not isinstance(recipe, TrainingRecipe):
        return recipe
    name = f"{recipe.name}, keep {criterion}"
    return recipe.each(keep=criterion).model_copy(update={"name": name})


def as_json(rows: Sequence[Row], split: str) -> dict[str, Any]:
    """The table as plain values, RMSE in rad."""
    return {
        "split": split,
        "units": "rad",
        "x0": START,
        "experiments": [score.experiment for score in rows[0].scores],
        "rows": [
            {
                "model": row.model,
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
    """Whether a file is there that says what `as_json` does."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {"x0", "experiments", "rows"} <= content.keys()
    except (OSError, ValueError, AttributeError):
        return False


def as_table(rows: Sequence[Row], split: str) -> Table:
    """The table for people: the paper's rows, ours, and medians where there are several seeds."""
    names = [score.experiment for score in rows[0].scores]
    same_records = split == "test" and len(names) == len(next(iter(TABLE_1.values())))
    lines = []
    for model, values in TABLE_1.items():
        cells = [number(v) for v in values] if same_records else ["–"] * len(names)
        mean = number(statistics.fmean(values))
        lines.append([f"paper: {model}", *cells, mean if same_records else f"{mean}*"])
    for row in rows:
        label = row.model if row.seed is None else f"{row.model}, seed {row.seed}"
        label += _told_start(row)
        lines.append([label, *[number(s.rmse) for s in row.scores], number(row.mean)])
    lines += _medians(rows)
    note = "" if same_records else "; * the paper's mean over its own (test) records"
    title = f"Table 1 on the {split} split: free-run RMSE [rad], start '{START}'{note}"
    return Table(["model", *names, "mean"], lines, title=title)


def _medians(rows: Sequence[Row]) -> list[list[str]]:
    by_model: dict[str, list[Row]] = {}
    for row in rows:
        by_model.setdefault(row.model, []).append(row)
    lines = []
    for model, group in by_model.items():
        if len(group) < 2:
            continue
        columns = zip(*[[s.rmse for s in row.scores] for row in group], strict=True)
        means = [row.mean for row in group]
        told = f"{number(statistics.median(means))} ({number(min(means))}..{number(max(means))})"
        cells = [number(statistics.median(column)) for column in columns]
        label = f"{model}, median of {len(group)} seeds{_told_start(group[0])}"
        lines.append([label, *cells, told])
    return lines


def _told_start(row: Row) -> str:
    return "" if row.start == START else f", from {row.start}"
