"""Run folders: a fit that leaves models, an account of itself, logs and checkpoints on disk.

folder/model.safetensors              the model, of several members the best one's
folder/summary.json                   the account: every member and the spread
folder/seed-0/model.safetensors       of trainings: the best weights of that seed
folder/seed-0/log.jsonl               one line an epoch
folder/seed-0/checkpoint.safetensors  what `resume` goes on from

Seeds that are trained at several rates have folders like seed-0-rate-0.5.
"""

import dataclasses
import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tustinnet.errors import InputError
from tustinnet.evaluate.scores import Score, evaluate, mean_rmse, rmse_by_record, scores_header
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.gradient.loop import Resumed
from tustinnet.fitting.gradient.plan import Plan, plan
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.listener import EpochReport, Listener
from tustinnet.fitting.report import FitResult, data_header
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Member, Task
from tustinnet.store.checkpoint import Checkpointer, fingerprint, read_checkpoint, together
from tustinnet.store.files import (
    finite,
    require_new,
    require_writable_folder,
    to_json,
    write_atomically,
)
from tustinnet.store.model_file import save

MODEL = "model.safetensors"
SUMMARY = "summary.json"
_CHECKPOINT = "checkpoint.safetensors"
_LOG = "log.jsonl"

Earlier = Literal["refuse", "resume", "discard"]  # what is done with a run that is there


@dataclass(frozen=True)
class MemberRun:
    """The fit of one member.

    Attributes:
        result: the model and how it came about.
        scores: free runs of the judging records, in float64.
        folder: where its files are.
    """

    result: FitResult
    scores: tuple[Score, ...]
    folder: Path

    @property
    def mean(self) -> float:
        """Mean RMSE over the judging records [rad or m]."""
        return mean_rmse(self.scores)


@dataclass(frozen=True)
class Run:
    """Fits of one recipe.

    Attributes:
        members: each of them.
        data: what the records are called.
        roles: the records.
        start: where the free runs start that rank the members.
        folder: where the files are.
    """

    members: tuple[MemberRun, ...]
    data: str
    roles: Roles
    start: str
    folder: Path

    @property
    def best(self) -> MemberRun:
        """The member with the lowest mean RMSE."""
        return min(self.members, key=lambda run: run.mean)

    @property
    def judged(self) -> str:
        """The split whose free runs rank them."""
        return self.roles.judged

    def spread(self) -> dict[str, float]:
        """Median, mean, standard deviation, lowest and highest mean RMSE [rad or m]."""
        means = [run.mean for run in self.members]
        return {
            "median": statistics.median(means),
            "mean": statistics.fmean(means),
            "std": statistics.stdev(means) if len(means) > 1 else 0.0,
            "min": min(means),
            "max": max(means),
        }

    def header(self, of: MemberRun) -> dict[str, Any]:
        """What the model file of a member says beside the model."""
        channels = self.roles.train[0].channels
        return {
            **of.result.as_header(),
            "data": data_header(self.data, self.roles.all),
            "scores": scores_header(self.judged, self.start, channels, of.scores),
        }

    def summary(self) -> dict[str, Any]:
        """The account of the run as plain values: what its best model says, and every member."""
        best = self.best
        return {
            **self.header(best),
            "recipe": best.result.recipe.name,
            "kind": best.result.recipe.model.kind,
            "split": self.judged,
            "start": self.start,
            "best_seed": best.result.seed,
            "spread": self.spread(),
            "seeds": [
                {
                    "seed": run.result.seed,
                    "rate": run.result.member.rate,
                    "outcome": run.result.outcome,
                    "mean": run.mean,
                    "rmse": rmse_by_record(run.scores),
                    "train_seconds": run.result.seconds,
                    **run.result.details.get("training", {}),
                    "model": (run.folder / MODEL).relative_to(self.folder).as_posix(),
                }
                for run in self.members
            ],
        }


Tell = Callable[[Plan | Task], Listener]


def run_task(
    task: Task,
    data: str,
    folder: Path,
    earlier: Earlier = "refuse",
    tell: Tell = lambda prepared: Listener(),
) -> Run:
    """Fits all members of a task and keeps everything in a folder.

    Args:
        task: what to fit; of one fold.
        data: what the records are called.
        folder: where the files go.
        earlier: what to do with a run that the folder holds: `refuse`, `discard`, or `resume`: go
            on from the checkpoints that are there; members without one start.
        tell: given the plan of trainings that run together, or the task of an identification,
            returns who is told while it goes on.

    Raises:
        InputError: the folder cannot be written, holds an earlier run that is neither resumed nor
            discarded, or its checkpoints belong to another run; an identification is to be
            resumed; see also `fit`.
    """
    require_writable_folder(folder)
    trains, roles = task.recipe.family.trains, task.folds[0].roles
    _make_room(folder, earlier, trains=trains)
    results = _trained(task, folder, earlier, tell) if trains else fit_task(task, tell(task))
    runs = []
    for member, result in zip(task.members, results, strict=True):
        scores = tuple(evaluate(result.model, roles.judging, result.start))
        runs.append(MemberRun(result, scores, folder / member.name if trains else folder))
    done = Run(tuple(runs), data, roles, results[0].start, folder)
    for run in runs:
        save(run.result.model, run.folder / MODEL, **done.header(run))
    save(done.best.result.model, folder / MODEL, **done.header(done.best))
    write_atomically(folder / SUMMARY, to_json(done.summary()))
    return done


def _make_room(folder: Path, earlier: Earlier, *, trains: bool) -> None:
    """Refuses, discards or leaves what an earlier run left in a folder."""
    if earlier == "resume" and not trains:
        raise InputError(
            "--resume", "an identification is not resumed", "a training", "leave the option out"
        )
    if earlier == "resume":
        return
    places = sorted(place for place in folder.glob("seed-*") if (place / _LOG).exists())
    if earlier == "discard":
        _discard(folder, places)
    elif places:
        raise InputError(
            folder,
            f"holds an earlier run ({places[0].name}, ...)",
            "a new folder",
            "add --resume to go on with it, --overwrite to discard it, or choose another --out",
        )
    require_new([folder / MODEL, folder / SUMMARY], overwrite=earlier == "discard")


def _discard(folder: Path, seed_folders: Sequence[Path]) -> None:
    """Removes the files that a run has written, and no others."""
    for place in seed_folders:
        for name in (MODEL, _LOG, _CHECKPOINT):
            (place / name).unlink(missing_ok=True)
        if not any(place.iterdir()):
            place.rmdir()
    for name in (MODEL, SUMMARY):
        (folder / name).unlink(missing_ok=True)


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The training log of a member's folder, a mapping an epoch; empty where there is none."""
    path = folder / _LOG
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _trained(task: Task, folder: Path, earlier: Earlier, tell: Tell) -> list[FitResult]:
    """The results of all members, in their order, those in the same stage trained together."""
    results: dict[Member, FitResult] = {}
    for group, states in _groups(task, folder, resume=earlier == "resume"):
        prepared = plan(task.of(group))
        trained = _train_together(prepared, folder, states, tell(prepared))
        results.update(zip(group, trained, strict=True))
    return [results[member] for member in task.members]


def _groups(task: Task, folder: Path, *, resume: bool) -> list[tuple[list[Member], Resumed | None]]:
    """Members that can train together: those that begin, and those that are in the same stage."""
    fresh: list[Member] = []
    found: dict[int, list[tuple[Member, TrainingState, Progress]]] = {}
    for member in task.members:
        path = folder / member.name / _CHECKPOINT
        if resume and path.is_file():
            state, progress = read_checkpoint(path, task, member)
            found.setdefault(progress.stage, []).append((member, state, progress))
        else:
            fresh.append(member)
    groups: list[tuple[list[Member], Resumed | None]] = [(fresh, None)] if fresh else []
    for resumed in found.values():
        names, states, progress = zip(*resumed, strict=True)
        groups.append((list(names), (together(states), progress)))
    return groups


def _train_together(
    prepared: Plan, folder: Path, resumed: Resumed | None, told: Listener
) -> list[FitResult]:
    folders = [folder / member.name for member in prepared.members]
    for place in folders:
        require_writable_folder(place)
    keeps = Checkpointer(
        [place / _CHECKPOINT for place in folders],
        [fingerprint(prepared.task, member) for member in prepared.members],
    )
    begun = resumed[1] if resumed else (None,) * len(folders)
    logs = [
        _Log(place / _LOG, prepared, progress)
        for place, progress in zip(folders, begun, strict=True)
    ]

    def epoch(report: EpochReport) -> None:
        logs[report.member].write(report)
        told.epoch(report)

    try:
        return train_plan(prepared, Listener(epoch, keeps), resumed)
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
