"""Table 1: free-run RMSE of the paper's models on a split of its data."""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tustinnet.artifact.identification import write_identification
from tustinnet.artifact.run import train_runs
from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluation.free_run import Score, evaluate, mean_rmse
from tustinnet.identification.identify import identify
from tustinnet.identification.least_squares import Iteration
from tustinnet.identification.recipe import read_identification_recipe
from tustinnet.identification.result import Identification
from tustinnet.identification.search import DEFAULT_SETTINGS
from tustinnet.paper.published import (
    AUTHORS_ROWS,
    TABLE_1,
    WEIGHTS_FOLDER,
    load_authors_weights,
)
from tustinnet.report.tables import Table, number
from tustinnet.systems.registry import load_system
from tustinnet.training.plan import Plan
from tustinnet.training.recipe import Criterion, keeping, read_recipe
from tustinnet.training.state import EpochReport

START = "file"  # Table 1 starts from the first row as it is stored

TRAINED = {
    "tustin-standard": "paper-code-standard",
    "tustin-transfer": "paper-code-transfer",
    "tustin-text-standard": "paper-standard",
    "tustin-text-transfer": "paper-transfer",
    "best-tustin": "best-tustin",
    "best-hybrid": "best-hybrid",
}
# the system of each, and the recipe of the identification where it is not the paper's
IDENTIFIED: dict[str, tuple[str, str | None]] = {
    "euler-lagrange": ("qube-servo2", None),
    "euler-lagrange-naive": ("qube-servo2-naive", None),
    "best-grey": ("qube-servo2-memory", "best-grey"),
}
CORRECTED = {"best-hybrid": "best-grey"}  # the identified model that a network corrects
AUTHORS = "authors"
DEFAULT_MODELS = (
    AUTHORS, "tustin-standard", "tustin-transfer", "euler-lagrange", "euler-lagrange-naive",
    "best-tustin", "best-grey", "best-hybrid",
)  # fmt: skip
KNOWN_MODELS = (AUTHORS, *TRAINED, *IDENTIFIED)


@dataclass(frozen=True)
class Row:
    """One model on all records of the split.

    Attributes:
        model: its name.
        seed: the seed it was trained from, None for published weights and identified models.
        recipe: what it was trained by, None for published weights; of identified models the system.
        scores: per record.
        train_seconds: time of the training, or None.
        windows: windows of each stage, or None.
        epochs: epochs of each stage, or None.
    """

    model: str
    seed: int | None
    recipe: str | None
    scores: tuple[Score, ...]
    train_seconds: float | None = None
    windows: tuple[int, ...] | None = None
    epochs: tuple[int, ...] | None = None

    @property
    def mean(self) -> float:
        """Mean RMSE over the records [rad]."""
        return mean_rmse(self.scores)


Tell = Callable[[str], Callable[[Plan], Callable[[EpochReport], None]]]


def choose_split(data: DataSet, wanted: str | None) -> str:
    """The split to score: the one asked for, else `test` where it is there, else `validation`."""
    if wanted is not None:
        data.split(wanted)
        return wanted
    for split in ("test", "validation"):
        if split in data.splits:
            return split
    raise InputError(data.name, "neither a test nor a validation split", "one of them")


def choose_models(names: Sequence[str] | None, folder: Path) -> tuple[list[str], str]:
    """The models to score and a remark on what is left out.

    Raises:
        InputError: an unknown name, or `authors` asked for where their weights are not.
    """
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


def build_rows(
    data: DataSet,
    folder: Path,
    models: Sequence[str],
    split: str,
    seeds: int,
    runs_folder: Path,
    *,
    overwrite: bool,
    tell: Tell,
    tell_identification: Callable[[str], Callable[[Iteration], None]] = lambda _: lambda _: None,
    keep: Criterion | None = None,
) -> list[Row]:
    """Trains and identifies what is to be trained and scores every model on the split.

    Args:
        data: all splits.
        folder: where the data, and perhaps the authors' weights, are.
        models: names from `choose_models`.
        split: the split to score.
        seeds: trainings of each recipe, from seed 0 on.
        runs_folder: where trainings are kept.
        overwrite: train anew instead of going on with trainings that are there.
        tell: given a model's name, who is told while it trains.
        tell_identification: given a model's name, who is told while it is identified.
        keep: the criterion of the best weights, where it is not to be the recipe's.
    """
    judged = list(data.split(split))
    # no test record takes part in training or selection
    material = DataSet(data.name, tuple(e for e in data if e.split in ("train", "validation")))
    rows = []
    identified: dict[str, Identification] = {}

    def identify_once(name: str) -> Identification:
        if name not in identified:
            told, home = tell_identification(name), runs_folder / name
            identified[name] = _identified(IDENTIFIED[name], material, home, told)
        return identified[name]

    for name in models:
        if name == AUTHORS:
            for row, stem in AUTHORS_ROWS.items():
                model = load_authors_weights(folder / WEIGHTS_FOLDER / f"{stem}.npz", data)
                rows.append(Row(row, None, None, tuple(evaluate(model, judged, START))))
            continue
        if name in IDENTIFIED:
            result = identify_once(name)
            rows.append(
                Row(
                    model=name,
                    seed=None,
                    recipe=result.system.name,
                    scores=tuple(evaluate(result.model, judged, START)),
                    train_seconds=result.seconds,
                )
            )
            continue
        recipe = read_recipe(TRAINED[name])
        runs = train_runs(
            material, keeping(recipe, keep) if keep else recipe, range(seeds), runs_folder / name,
            resume=True, overwrite=overwrite, tell=tell(name),
            physics=identify_once(CORRECTED[name]).model if name in CORRECTED else None,
        )  # fmt: skip
        rows += [
            Row(
                model=name,
                seed=run.result.seed,
                recipe=run.result.recipe.name,
                scores=tuple(evaluate(run.result.model, judged, START)),
                train_seconds=run.result.train_seconds,
                windows=run.result.windows,
                epochs=run.result.epochs,
            )
            for run in runs.seeds
        ]
    return rows


def _identified(
    what: tuple[str, str | None],
    material: DataSet,
    folder: Path,
    told: Callable[[Iteration], None],
) -> Identification:
    """Identifies a system anew, which takes seconds, and keeps it in a folder."""
    system, recipe = what
    settings = read_identification_recipe(recipe).settings if recipe else DEFAULT_SETTINGS
    result = identify(material, load_system(system), settings=settings, told=told)
    chosen_by = "validation" if "validation" in material.splits else "train"
    scores = evaluate(result.model, list(material.split(chosen_by)), START)
    write_identification(folder, material, result, chosen_by, START, scores)
    return result


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
                "rmse": {score.experiment: score.rmse for score in row.scores},
                "mean": row.mean,
                "train_seconds": row.train_seconds,
                "windows": None if row.windows is None else list(row.windows),
                "epochs": None if row.epochs is None else list(row.epochs),
            }
            for row in rows
        ],
    }


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
        lines.append([f"{model}, median of {len(group)} seeds", *cells, told])
    return lines
