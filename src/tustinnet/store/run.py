"""Run folders: a fit that leaves models, an account of itself, logs and checkpoints on disk.

folder/model.safetensors              the model, of several members the best one's
folder/summary.json                   the account: every member and the spread
folder/question.json                  what was asked: recipe, records, system
folder/system.py                      a copy of the system's file, where one was given
folder/report.html                    the page of it, written by the command when all else is there
folder/log.jsonl                      of identifications: one line an iteration and a stage
folder/seed-0/model.safetensors       of trainings: the best weights of that seed
folder/seed-0/log.jsonl               one line an epoch
folder/seed-0/checkpoint.safetensors  what `resume` goes on from, of all that train together

Members whose rates have a factor have folders like seed-0-rate-0.5.
"""

import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from tustinnet.errors import InputError
from tustinnet.evaluate.scores import Score, evaluate, mean_rmse, rmse_by_record, scores_header
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.gradient.loop import ResumePoint
from tustinnet.fitting.gradient.plan import TrainingPlan, make_plan
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.listener import EpochReport, Iteration, Listener, StageResult
from tustinnet.fitting.report import FitResult, data_header
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Member, Task
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.simulate.range import KEY as RANGE
from tustinnet.simulate.range import TrainingSupport, recorded_range, training_support
from tustinnet.store.checkpoint import Checkpointer, read_checkpoint
from tustinnet.store.files import (
    owned,
    require_outputs,
    require_writable_folder,
    to_json,
    write_into,
)
from tustinnet.store.header import ORIGIN
from tustinnet.store.kept_system import header_of, keep, require_room
from tustinnet.store.log import DAMAGED, LOG, Log, SearchLog
from tustinnet.store.model_file import save
from tustinnet.store.question import (
    QUESTION,
    Question,
    question_of,
    require_same,
    write_question,
)
from tustinnet.systems.files import SystemFile

MODEL = "model.safetensors"
SUMMARY = "summary.json"
REPORT = "report.html"  # written by rooms above this one; discarded here with the rest
FIGURES = "figures"  # drawn by rooms above this one
_CHECKPOINT = "checkpoint.safetensors"
WRITTEN = (MODEL, LOG, DAMAGED, _CHECKPOINT)  # into the folder of a member

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
        system: the system's file, where one was given.
        origin: what is known of the model that the fits began with, empty where they began anew.
    """

    members: tuple[MemberRun, ...]
    data: str
    roles: Roles
    start: str
    folder: Path
    system: SystemFile | None = None
    origin: Mapping[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> MemberRun:
        """The member with the lowest mean RMSE."""
        return min(self.members, key=lambda run: run.mean)

    @cached_property
    def fitted(self) -> Mapping[str, float]:
        """RMSE of each training record that the best model leaves [rad or m].

        Of a training that of its free run; of an identification from the initial states found.
        """
        result = self.best.result
        if result.identification is not None:
            return result.identification.rmse
        if self.roles.ranking is self.roles.train:
            return rmse_by_record(self.best.scores)
        horizon = effective_horizon(result.horizon, self.roles.train)
        return rmse_by_record(
            evaluate(result.model, self.roles.train, result.start, horizon=horizon)
        )

    @cached_property
    def _cloud(self) -> TrainingSupport | None:
        return training_support(self.roles.train[0].channels, self.roles.train)

    @property
    def judged(self) -> str:
        """The split whose free runs rank them."""
        return self.roles.ranking_split

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
            RANGE: recorded_range(of.result.model, self.roles.train, self._cloud).as_header(),
            "scores": scores_header(
                self.judged, self.start, channels, of.scores[0].horizon, rmse_by_record(of.scores)
            ),
            **header_of(self.system),
            **({ORIGIN: dict(self.origin)} if self.origin else {}),
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
            "horizon": best.scores[0].horizon,
            "best_seed": best.result.seed,
            "spread": self.spread(),
            "training_rmse": dict(self.fitted),
            "seeds": [
                {
                    "seed": run.result.seed,
                    "rate": run.result.member.rate,
                    "outcome": run.result.outcome,
                    "mean": run.mean,
                    "rmse": rmse_by_record(run.scores),
                    "train_seconds": run.result.seconds,
                    **run.result.details.get("training", {}),
                    "findings": list(run.result.findings),
                    "model": (run.folder / MODEL).relative_to(self.folder).as_posix(),
                }
                for run in self.members
            ],
        }


Tell = Callable[[TrainingPlan | Task], Listener]


def run_task(
    task: Task,
    data: str,
    folder: Path,
    earlier: Earlier = "refuse",
    tell: Tell = lambda prepared: Listener(),
    system: SystemFile | None = None,
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
        system: the file of the system that the task is of; a copy is kept with the models.

    Raises:
        InputError: the folder cannot be written, another run is writing there, it holds an earlier
            run that is neither resumed nor discarded; what is resumed was asked otherwise, or its
            checkpoints belong to another run; an identification is to be resumed; see also `fit`.
    """
    with owned(folder):
        if earlier != "discard":
            require_room(system, folder)
        question = question_of(task, system)
        _make_room(folder, earlier, question, trains=task.recipe.family.trains)

        def begin(prepared: TrainingPlan | Task) -> Listener:
            # the records of a training are known to fit the recipe
            if isinstance(prepared, TrainingPlan):
                write_question(folder, question)
            return tell(prepared)

        done = _fitted(task, data, folder, begin, resume=earlier == "resume")
        done = replace(done, system=system)
        write_question(folder, question)
        _keep(done)
    return done


def _fitted(task: Task, data: str, folder: Path, tell: Tell, *, resume: bool) -> Run:
    trains, roles = task.recipe.family.trains, task.folds[0].roles
    fitted = fit_in(folder, task, tell, resume=resume)
    runs = []
    for member, result in zip(task.members, fitted, strict=True):
        horizon = effective_horizon(result.horizon, roles.ranking)
        scores = tuple(evaluate(result.model, roles.ranking, result.start, horizon=horizon))
        runs.append(MemberRun(result, scores, folder / member.name if trains else folder))
    origin = task.folds[0].origin
    known = {} if origin is None else origin.provenance
    return Run(tuple(runs), data, roles, fitted[0].start, folder, origin=known)


def fit_in(folder: Path, task: Task, tell: Tell, *, resume: bool) -> list[FitResult]:
    """Fits all members of a task with logs and checkpoints in a folder, a folder each.

    Args:
        folder: where they go.
        task: what to fit.
        tell: see `run_task`.
        resume: whether to go on from the checkpoints that are there; an identification has none.
    """
    if task.recipe.family.trains:
        return _trained(task, folder, tell, resume=resume)
    return _searched(task, folder, tell)


def _keep(done: Run) -> None:
    """Writes models, the account of the run and the system's file."""
    folder = done.folder
    if done.system is not None:
        keep(done.system, folder)
    for run in done.members:
        save(run.result.model, run.folder / MODEL, **done.header(run))
    save(done.best.result.model, folder / MODEL, **done.header(done.best))
    write_into(folder, SUMMARY, to_json(done.summary()))


def _make_room(folder: Path, earlier: Earlier, question: Question, *, trains: bool) -> None:
    """Refuses, discards or leaves what an earlier run left in a folder."""
    if earlier == "resume" and not trains:
        raise InputError(
            "--resume", "an identification is not resumed", "a training", "leave the option out"
        )
    if earlier == "resume":
        require_same(folder, question, MODEL)
        (folder / REPORT).unlink(missing_ok=True)  # of the model as it was
        return
    places = sorted(place for place in folder.glob("seed-*") if (place / LOG).exists())
    if earlier == "discard":
        _discard(folder, places)
    elif places:
        raise InputError(
            folder,
            f"holds an earlier run ({places[0].name}, ...)",
            "a new folder",
            "add --resume to go on with it, --overwrite to discard it, or choose another --out",
        )
    files = [folder / name for name in (MODEL, SUMMARY, LOG, REPORT, FIGURES)]
    require_outputs(files, overwrite=earlier == "discard")


def _discard(folder: Path, seed_folders: Sequence[Path]) -> None:
    """Removes the files that a run has written, and no others."""
    for place in seed_folders:
        for name in WRITTEN:
            (place / name).unlink(missing_ok=True)
        if not any(place.iterdir()):
            place.rmdir()
    for name in (MODEL, SUMMARY, LOG, REPORT, QUESTION):
        (folder / name).unlink(missing_ok=True)


def _searched(task: Task, folder: Path, tell: Tell) -> list[FitResult]:
    """The result of an identification, every iteration in its log."""
    require_writable_folder(folder)
    told, log = tell(task), SearchLog(folder)

    def iteration(of: Iteration) -> None:
        log.iteration(of)
        told.on_iteration(of)

    def stage(of: StageResult) -> None:
        log.stage(of)
        told.on_stage(of)

    try:
        return fit_task(task, lambda _: replace(told, on_iteration=iteration, on_stage=stage))
    finally:
        log.close()


def _trained(task: Task, folder: Path, tell: Tell, *, resume: bool) -> list[FitResult]:
    """The results of all members, in their order, those in the same stage trained together."""
    results: dict[Member, FitResult] = {}
    for group, states in _groups(task, folder, resume=resume):
        prepared = make_plan(task.with_members(group))
        trained = _train_together(prepared, folder, states, tell(prepared))
        results.update(zip(group, trained, strict=True))
    return [results[member] for member in task.members]


def _groups(
    task: Task, folder: Path, *, resume: bool
) -> list[tuple[list[Member], ResumePoint | None]]:
    """Members that train together: those that begin, and those that did when they stopped."""
    groups: list[tuple[list[Member], ResumePoint | None]] = []
    fresh = list(task.members)
    paths = folder.glob(f"*/{_CHECKPOINT}") if resume else ()
    # the newest first: a member may since have gone on without some of the others
    for path in sorted(paths, key=lambda path: path.stat().st_mtime_ns, reverse=True):
        members, resumed = read_checkpoint(path, task.with_members(fresh))
        if resumed:
            groups.append((list(members), resumed))
            fresh = [member for member in fresh if member not in members]
    return [(fresh, None), *groups] if fresh else groups


def _train_together(
    prepared: TrainingPlan, folder: Path, resumed: ResumePoint | None, told: Listener
) -> list[FitResult]:
    folders = [folder / member.name for member in prepared.members]
    for place in folders:
        require_writable_folder(place)
    keeps = Checkpointer(folders[0] / _CHECKPOINT, prepared.task)
    begun = resumed[1] if resumed else (None,) * len(folders)
    logs = [
        Log(place, progress, told.on_message)
        for place, progress in zip(folders, begun, strict=True)
    ]

    def epoch(report: EpochReport) -> None:
        logs[report.member].write(report)
        told.on_epoch(report)

    def state(of: TrainingState, progress: tuple[Progress, ...]) -> None:
        keeps(of, progress)
        told.on_state(of, progress)

    try:
        return train_plan(prepared, Listener(epoch, state), resumed)
    except KeyboardInterrupt:  # also how SIGTERM and SIGHUP arrive
        keeps.flush()
        raise
    finally:
        for log in logs:
            log.close()
