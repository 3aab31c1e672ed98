"""Run folders: training that leaves a log, checkpoints and models on disk.

folder/seed-0/log.jsonl               one line an epoch
folder/seed-0/checkpoint.safetensors  what `resume` goes on from
folder/seed-0/model.safetensors       the best weights of that seed
folder/model.safetensors              those of the best seed
folder/summary.json                   every seed and the spread

Seeds that are trained at several rates have folders like seed-0-rate-0.5.
"""

import dataclasses
import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tustinnet.artifact.checkpoint import (
    Checkpointer,
    fingerprint,
    read_checkpoint,
    together,
)
from tustinnet.artifact.files import (
    finite,
    require_writable_folder,
    to_json,
    write_atomically,
)
from tustinnet.artifact.model_file import data_header, save, scores_header
from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluation.free_run import Score, evaluate, mean_rmse
from tustinnet.models.base import DiscreteModel
from tustinnet.training.fit import FitResult, run_plan
from tustinnet.training.plan import Member, Plan, plan
from tustinnet.training.recipe import Recipe
from tustinnet.training.state import EpochReport, Listener, Progress, TrainingState

MODEL = "model.safetensors"
SUMMARY = "summary.json"
_CHECKPOINT = "checkpoint.safetensors"
_LOG = "log.jsonl"


@dataclass(frozen=True)
class SeedRun:
    """The training of one seed at one rate.

    Attributes:
        result: the model and how it came about.
        scores: free runs of the judged records, in float64.
        folder: where its files are.
    """

    result: FitResult
    scores: tuple[Score, ...]
    folder: Path

    @property
    def mean(self) -> float:
        """Mean RMSE over the judged records [rad or m]."""
        return mean_rmse(self.scores)


@dataclass(frozen=True)
class Runs:
    """Trainings of one recipe from several seeds.

    Attributes:
        seeds: per seed.
        judged: the split whose free runs rank them.
        start: where these start.
        folder: where the files are.
    """

    seeds: tuple[SeedRun, ...]
    judged: str
    start: str
    folder: Path

    @property
    def best(self) -> SeedRun:
        """The seed with the lowest mean RMSE."""
        return min(self.seeds, key=lambda run: run.mean)

    def spread(self) -> dict[str, float]:
        """Median, mean, standard deviation, lowest and highest mean RMSE [rad or m]."""
        means = [run.mean for run in self.seeds]
        return {
            "median": statistics.median(means),
            "mean": statistics.fmean(means),
            "std": statistics.stdev(means) if len(means) > 1 else 0.0,
            "min": min(means),
            "max": max(means),
        }


def train_runs(
    data: DataSet,
    recipe: Recipe,
    seeds: Sequence[int],
    folder: Path,
    *,
    rates: Sequence[float] = (1.0,),
    physics: DiscreteModel | None = None,
    resume: bool = False,
    overwrite: bool = False,
    tell: Callable[[Plan], Callable[[EpochReport], None]] = lambda plan: lambda report: None,
) -> Runs:
    """Trains a recipe from several seeds, together, and keeps everything in a folder.

    Args:
        data: the records.
        recipe: what to do.
        seeds: one training each; none touches another.
        folder: where the files go.
        rates: factors of the recipe's rates; every seed is trained with each.
        physics: a model that the networks are to correct, see `fit`.
        resume: go on from the checkpoints that are there; seeds without one start.
        overwrite: discard what an earlier run left in the folder.
        tell: given the plan of trainings that run together, returns who is told of every epoch.

    Raises:
        InputError: the folder cannot be written, holds an earlier run and neither `resume` nor
            `overwrite` is set, or its checkpoints belong to another run; see also `plan`.
    """
    require_writable_folder(folder)
    earlier = sorted(place for place in folder.glob("seed-*") if (place / _LOG).exists())
    if earlier and overwrite:
        _discard(folder, earlier)
    elif earlier and not resume:
        raise InputError(
            folder,
            f"holds an earlier run ({earlier[0].name}, ...)",
            "a new folder",
            "add --resume to go on with it, --overwrite to discard it, or choose another --out",
        )
    judged = "validation" if "validation" in data.splits else "train"
    records = list(data.split(judged) if data.splits else data)
    members = [Member(seed, rate) for seed in seeds for rate in rates]
    results: dict[Member, FitResult] = {}
    for group, states in _groups(data, recipe, members, folder, physics, resume=resume):
        prepared = plan(data, recipe, group, physics=physics)
        trained = _train_together(data, prepared, folder, states, tell(prepared))
        results.update(zip(group, trained, strict=True))
    runs = []
    for member in members:
        place, result = folder / member.name, results[member]
        scores = tuple(evaluate(result.model, records, result.start))
        save(result.model, place / MODEL, **_header(data, result, judged, scores))
        runs.append(SeedRun(result, scores, place))
    done = Runs(tuple(runs), judged, runs[0].result.start, folder)
    save(
        done.best.result.model,
        folder / MODEL,
        **_header(data, done.best.result, judged, done.best.scores),
    )
    write_atomically(folder / SUMMARY, to_json(summary(done)))
    return done


def _discard(folder: Path, seed_folders: Sequence[Path]) -> None:
    """Removes the files that a run has written, and no others."""
    for place in seed_folders:
        for name in (MODEL, _LOG, _CHECKPOINT):
            (place / name).unlink(missing_ok=True)
        if not any(place.iterdir()):
            place.rmdir()
    for name in (MODEL, SUMMARY):
        (folder / name).unlink(missing_ok=True)


def summary(runs: Runs) -> dict[str, Any]:
    """The runs as plain values, every seed and the spread."""
    return {
        "recipe": runs.seeds[0].result.recipe.name,
        "split": runs.judged,
        "start": runs.start,
        "best_seed": runs.best.result.seed,
        "spread": runs.spread(),
        "seeds": [
            {
                "seed": run.result.seed,
                "rate": run.result.member.rate,
                "outcome": run.result.outcome,
                "mean": run.mean,
                "rmse": {score.experiment: score.rmse for score in run.scores},
                "train_seconds": run.result.train_seconds,
                "windows": list(run.result.windows),
                "window_lengths": list(run.result.window_lengths),
                "epochs": list(run.result.epochs),
                "kept_epoch": run.result.kept_epoch,
                "model": (run.folder / MODEL).relative_to(runs.folder).as_posix(),
            }
            for run in runs.seeds
        ],
    }


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The training log of a seed's folder, a mapping an epoch."""
    return [json.loads(line) for line in (folder / _LOG).read_text(encoding="utf-8").splitlines()]


_Resumed = tuple[TrainingState, tuple[Progress, ...]] | None


def _groups(
    data: DataSet,
    recipe: Recipe,
    members: Sequence[Member],
    folder: Path,
    physics: DiscreteModel | None,
    *,
    resume: bool,
) -> list[tuple[list[Member], _Resumed]]:
    """Members that can train together: those that begin, and those that are in the same stage."""
    fresh: list[Member] = []
    found: dict[int, list[tuple[Member, TrainingState, Progress]]] = {}
    for member in members:
        path = folder / member.name / _CHECKPOINT
        if resume and path.is_file():
            state, progress = read_checkpoint(path, data, recipe, member, physics)
            found.setdefault(progress.stage, []).append((member, state, progress))
        else:
            fresh.append(member)
    groups: list[tuple[list[Member], _Resumed]] = [(fresh, None)] if fresh else []
    for resumed in found.values():
        names, states, progress = zip(*resumed, strict=True)
        groups.append((list(names), (together(states), progress)))
    return groups


def _train_together(
    data: DataSet,
    prepared: Plan,
    folder: Path,
    resumed: _Resumed,
    told: Callable[[EpochReport], None],
) -> list[FitResult]:
    folders = [folder / member.name for member in prepared.members]
    for place in folders:
        require_writable_folder(place)
    keeps = Checkpointer(
        [place / _CHECKPOINT for place in folders],
        [fingerprint(data, prepared.recipe, m, prepared.physics) for m in prepared.members],
    )
    begun = resumed[1] if resumed else (None,) * len(folders)
    logs = [
        _Log(place / _LOG, prepared, progress)
        for place, progress in zip(folders, begun, strict=True)
    ]

    def epoch(report: EpochReport) -> None:
        logs[report.member].write(report)
        told(report)

    try:
        return run_plan(prepared, Listener(epoch, keeps), resumed)
    finally:
        for log in logs:
            log.close()


class _Log:
    """A line of JSON an epoch; a resumed run drops the lines it is about to repeat."""

    def __init__(self, path: Path, prepared: Plan, resumed: Progress | None) -> None:
        self._stages = [stage.recipe.name for stage in prepared.stages]
        kept = self._lines_before(path, resumed) if resumed and path.is_file() else []
        write_atomically(path, "".join(line + "\n" for line in kept))
        self._file = path.open("a", encoding="utf-8")

    def _lines_before(self, path: Path, resumed: Progress) -> list[str]:
        kept = []
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                break  # the line that was being written when the run was killed
            if (self._stages.index(entry["stage"]), entry["epoch"]) <= (
                resumed.stage,
                resumed.epoch,
            ):
                kept.append(line)
        return kept

    def write(self, report: EpochReport) -> None:
        line = dataclasses.asdict(report)
        del line["member"]  # each has a log of its own
        self._file.write(json.dumps(finite(line)) + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def _header(
    data: DataSet, result: FitResult, judged: str, scores: Sequence[Score]
) -> dict[str, Any]:
    """What a model file says of its training."""
    return {
        "recipe": result.recipe.model_dump(),
        "training": {
            "seed": result.seed,
            "rate": result.member.rate,
            "outcome": result.outcome,
            "windows": list(result.windows),
            "window_lengths": list(result.window_lengths),
            "epochs": list(result.epochs),
            "kept_epoch": result.kept_epoch,
        },
        "data": data_header(data),
        "scores": scores_header(data, judged, result.start, scores),
    }
