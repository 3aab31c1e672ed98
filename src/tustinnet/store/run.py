"""Run folders: a fit that leaves models, an account of itself, logs and checkpoints on disk.

folder/model.safetensors              the model, of several members the best one's
folder/summary.json                   the account: every member and the spread
folder/question.json                  the specification: recipe, records, system
folder/system.py, .urdf or .xml       a copy of the system's file, where one was given
folder/report.html                    the page of it, written by the command when all else is there
folder/log.jsonl                      of identifications: one line an iteration and a stage
folder/seed-0/model.safetensors       of trainings: the best weights of that seed
folder/seed-0/log.jsonl               one line an epoch
folder/seed-0/checkpoint.safetensors  for `resume`, of all members that train together

Members whose rates have a factor have folders like seed-0-rate-0.5.
"""

import csv
import io
import json
import statistics
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from tustinnet.channels import Channels
from tustinnet.data.spoiled import SpoiledPart, spoiled_header
from tustinnet.errors import InputError
from tustinnet.evaluate.scores import (
    Score,
    evaluate,
    mean_rmse,
    mean_rmse_by_unit,
    rmse_by_record,
    scores_header,
)
from tustinnet.evaluate.spoiled import find_spoiled
from tustinnet.fitting.fit import MakeListener, MakeStopCheck, fit_task
from tustinnet.fitting.gradient.loop import ResumePoint, never_stop
from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.listener import EpochReport, Iteration, Listener, StageResult
from tustinnet.fitting.report import FitResult, Identification, data_header
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.shooting.levenberg_marquardt import ShouldStopSearch, never_stop_search
from tustinnet.fitting.task import Member, Task
from tustinnet.models.contract import require_float64
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.simulate.range import KEY as RANGE
from tustinnet.simulate.range import TrainingSupport, recorded_range, training_support
from tustinnet.store.checkpoint import Checkpointer, read_checkpoint
from tustinnet.store.files import (
    lock_folder,
    remove_below,
    require_outputs,
    require_writable_folder,
    to_json,
    write_into,
)
from tustinnet.store.header import ORIGIN
from tustinnet.store.kept_system import (
    CANDIDATES,
    require_copy_fits,
    system_header,
    write_system_copy,
)
from tustinnet.store.log import DAMAGED, LOG, SearchLog, TrainingLog
from tustinnet.store.model_file import save
from tustinnet.store.specification import (
    SPECIFICATION,
    Specification,
    make_specification,
    require_same_specification,
    write_specification,
)
from tustinnet.systems.files import SystemFile

MODEL = "model.safetensors"
SUMMARY = "summary.json"
REPORT = "report.html"  # written by rooms above this one; discarded here with the rest
FIGURES = "figures"  # drawn by rooms above this one
SCORES = "scores.json"  # of a job of a selection
BASE_PARAMETERS = "base_parameters.csv"  # of an identification by inverse dynamics
TABLE = "candidates.md"  # of a selection
_CHECKPOINT = "checkpoint.safetensors"
WRITTEN = (MODEL, LOG, DAMAGED, _CHECKPOINT)  # into the folder of a member

Earlier = Literal["refuse", "resume", "discard"]  # the treatment of a run that is there


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
        origin: the account of the model that the fits began with, empty where they began anew.
        spoiled: parts of the records that the best model does not explain.
        left_out: sentences on the parts of records that were left out before.
    """

    members: tuple[MemberRun, ...]
    data: str
    roles: Roles
    start: str
    folder: Path
    system: SystemFile | None = None
    origin: Mapping[str, Any] = field(default_factory=dict)
    spoiled: tuple[SpoiledPart, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def best(self) -> MemberRun:
        """The member with the lowest mean RMSE."""
        return min(self.members, key=lambda run: run.mean)

    @cached_property
    def training_rmse(self) -> Mapping[str, float]:
        """RMSE of each training record that the best model leaves [rad or m].

        Of a training that of its free run; of an identification from its initial states.
        """
        identification = self.best.result.identification
        return (
            rmse_by_record(self.training_scores) if identification is None else identification.rmse
        )

    @cached_property
    def training_scores(self) -> Sequence[Score]:
        """Scores of the best model's free runs of the training records."""
        result = self.best.result
        if self.roles.ranking is self.roles.train:
            return self.best.scores
        horizon = effective_horizon(result.horizon, self.roles.train)
        return evaluate(result.model, self.roles.train, result.start, horizon=horizon)

    @property
    def channels(self) -> Channels:
        """Coordinates, inputs and sampling period of the records."""
        return self.roles.train[0].channels

    @cached_property
    def _support(self) -> TrainingSupport | None:
        return training_support(self.channels, self.roles.train)

    @property
    def seconds(self) -> float:
        """Time that the fits of all members took [s]."""
        return sum(member.result.seconds for member in self.members)

    @property
    def judging_split(self) -> str:
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

    def header(self, member: MemberRun) -> dict[str, Any]:
        """The header of the model file of a member, beside the model's own."""
        channels = self.channels
        return {
            **member.result.as_header(),
            "data": data_header(self.data, self.roles.all),
            RANGE: recorded_range(member.result.model, self.roles.train, self._support).as_header(),
            "scores": scores_header(
                self.judging_split,
                self.start,
                channels,
                member.scores[0].horizon,
                rmse_by_record(member.scores),
                mean_rmse_by_unit(member.scores, channels),
            ),
            **system_header(self.system),
            **({ORIGIN: dict(self.origin)} if self.origin else {}),
            **spoiled_header(self.spoiled, self.left_out),
        }

    def summary(self) -> dict[str, Any]:
        """The account of the run as plain values: the best model's header, and every member."""
        best = self.best
        return {
            **self.header(best),
            "recipe": best.result.recipe.name,
            "kind": best.result.recipe.model.kind,
            "split": self.judging_split,
            "start": self.start,
            "horizon": best.scores[0].horizon,
            "best_seed": best.result.seed,
            "spread": self.spread(),
            "training_rmse": dict(self.training_rmse),
            "seeds": [
                {
                    "seed": run.result.seed,
                    "rate": run.result.member.rate,
                    "outcome": run.result.outcome,
                    "mean": run.mean,
                    "mean_by_unit": mean_rmse_by_unit(run.scores, self.channels),
                    "rmse": rmse_by_record(run.scores),
                    "train_seconds": run.result.seconds,
                    **run.result.details.get("training", {}),
                    "findings": list(run.result.findings),
                    "model": (run.folder / MODEL).relative_to(self.folder).as_posix(),
                }
                for run in self.members
            ],
        }


def run_task(
    task: Task,
    data: str,
    folder: Path,
    earlier: Earlier = "refuse",
    make_listener: MakeListener = lambda prepared: Listener(),
    system: SystemFile | None = None,
    *,
    judges_records: bool = False,
    left_out: tuple[str, ...] = (),
) -> Run:
    """Fits all members of a task and keeps everything in a folder.

    Args:
        task: recipe, records and members; of one fold.
        data: the name of the data set.
        folder: where the files go.
        earlier: what to do with a run that the folder holds: `refuse`, `discard`, or `resume`: go
            on from the checkpoints that are there; members without one start.
        make_listener: given the plan of trainings that run together, or the task of an
            identification, returns the listener of its progress.
        system: the file of the system that the task is of; a copy is kept with the models.
        judges_records: whether parts of records that spoil the fit are looked for with networks,
            too, which takes longer than with an identified system.
        left_out: sentences on the parts of records that were left out before.

    Raises:
        InputError: the folder cannot be written, another run is writing there, it holds an earlier
            run that is neither resumed nor discarded; a resumed run had another specification, or
            its checkpoints belong to another run; an identification is to be resumed; see also
            `fit`.
    """
    require_float64("run_task")
    with lock_folder(folder):
        own = [folder / MODEL, folder / SPECIFICATION] if earlier == "discard" else []
        require_copy_fits(system, folder, own)
        specification, family = make_specification(task, system), task.recipe.family
        _prepare_folder(folder, earlier, specification, resumable=family.resumable)

        def listen(prepared: TrainingPlan | Task) -> Listener:
            if isinstance(
                prepared, TrainingPlan
            ):  # a training whose records are known to fit the recipe
                write_specification(folder, specification)
            return make_listener(prepared)

        fits = fit_in_folder(folder, task, listen, resume=earlier == "resume")
        roles, origin = task.folds[0].roles, task.folds[0].origin
        roles = roles.with_long_validation(fits[0].fewest_samples)
        members = []
        for member, result in zip(task.members, fits, strict=True):
            horizon = effective_horizon(result.horizon, roles.ranking)
            scores = tuple(evaluate(result.model, roles.ranking, result.start, horizon=horizon))
            place = folder / member.name if family.has_seeds else folder
            members.append(MemberRun(result, scores, place))
        account = {} if origin is None else origin.provenance
        run = Run(
            tuple(members), data, roles, fits[0].start, folder, system, account, left_out=left_out
        )
        if judges_records or not family.has_seeds:
            run = replace(run, spoiled=find_spoiled(run.best.result.model, roles.all))
        write_specification(folder, specification)
        if system is not None:
            write_system_copy(system, folder)
        for member in run.members:
            save(member.result.model, member.folder / MODEL, **run.header(member))
        save(run.best.result.model, folder / MODEL, **run.header(run.best))
        identification = run.best.result.identification
        if identification is not None and identification.base_parameters:
            write_into(folder, BASE_PARAMETERS, _base_parameters_csv(identification))
        write_into(folder, SUMMARY, to_json(run.summary()))
    return run


def _base_parameters_csv(identification: Identification) -> str:
    """The base parameters of an identification as CSV: a row each, with value and interval."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["base parameter", "unit", "value", "low (95 %)", "high (95 %)"])
    for b in identification.base_parameters:
        writer.writerow([b.expression, b.unit, b.value, *(b.interval or ("", ""))])
    return text.getvalue()


def fit_in_folder(
    folder: Path,
    task: Task,
    make_listener: MakeListener,
    *,
    resume: bool,
    make_stop_check: MakeStopCheck = lambda plan: never_stop,
    should_stop_search: ShouldStopSearch = never_stop_search,
) -> list[FitResult]:
    """Fits all members of a task with logs and checkpoints in a folder, a folder each.

    Args:
        folder: where they go.
        task: recipe, records and members.
        make_listener: see `run_task`.
        resume: whether to go on from the checkpoints that are there; an identification has none.
        make_stop_check: given the plan of trainings that run together, returns the `should_stop`
            of `train_plan`.
        should_stop_search: the `should_stop` of `identify_task`.
    """
    resumed = _find_resume_points(task, folder) if resume else []
    before = {
        member: progress
        for members, (_, all_progress) in resumed
        for member, progress in zip(members, all_progress, strict=True)
    }
    with ExitStack() as stack:

        def listen(prepared: TrainingPlan | Task) -> Listener:
            listener = make_listener(prepared)
            if isinstance(prepared, TrainingPlan):
                return _log_training(prepared, folder, before, listener, stack)
            return _log_search(folder, listener, stack)

        return fit_task(task, listen, resumed, make_stop_check, should_stop_search)


def _prepare_folder(
    folder: Path, earlier: Earlier, specification: Specification, *, resumable: bool
) -> None:
    """Refuses, discards or keeps the files of an earlier run in a folder."""
    if earlier == "resume" and not resumable:
        raise InputError(
            "--resume", "an identification is not resumed", "a training", "leave the option out"
        )
    if earlier == "resume":
        require_same_specification(folder, specification, MODEL)
        (folder / REPORT).unlink(missing_ok=True)  # of the model as it was
        return
    places = _seed_folders(folder)
    if earlier == "discard":
        discard_results(folder)
    elif places:
        raise InputError(
            folder,
            f"holds an earlier run ({places[0].name}, ...)",
            "a new folder",
            "add --resume to go on with it, --overwrite to discard it, or choose another --out",
        )
    files = [folder / name for name in (MODEL, SUMMARY, BASE_PARAMETERS, LOG, REPORT, FIGURES)]
    require_outputs(files, overwrite=earlier == "discard")


def _seed_folders(folder: Path) -> list[Path]:
    """The folders of the members of a training in the folder of a run."""
    return sorted(place for place in folder.glob("seed-*") if (place / LOG).exists())


def discard_results(folder: Path) -> None:
    """Removes the files that a run or a selection has written into a folder, and no others."""
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        starts = [s for c in summary.get("candidates", []) for s in c.get("starts", {}).values()]
        records = {record for start in starts for record in start["rmse"]}
        records |= {record for seed in summary.get("seeds", []) for record in seed["rmse"]}
        drawn = {f"{name}.png" for name in (CANDIDATES, "training", "correlation", *records)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        drawn = set[str]()  # nobody knows which figures are its own
    remove_below(folder / FIGURES, drawn)
    remove_below(folder / CANDIDATES, {*WRITTEN, SCORES})
    for place in _seed_folders(folder):
        remove_below(place, WRITTEN)
        with suppress(OSError):  # other files are in it
            place.rmdir()
    for name in (MODEL, SUMMARY, LOG, REPORT, SPECIFICATION, TABLE, BASE_PARAMETERS):
        (folder / name).unlink(missing_ok=True)


def _log_search(folder: Path, listener: Listener, stack: ExitStack) -> Listener:
    """A listener of an identification that also writes every iteration and stage to a log."""
    require_writable_folder(folder)
    log = SearchLog(folder)
    stack.callback(log.close)

    def on_iteration(report: Iteration) -> None:
        log.write_iteration(report)
        listener.on_iteration(report)

    def on_stage(result: StageResult) -> None:
        log.write_stage(result)
        listener.on_stage(result)

    return replace(listener, on_iteration=on_iteration, on_stage=on_stage)


def _log_training(
    plan: TrainingPlan,
    folder: Path,
    before: Mapping[Member, Progress],
    listener: Listener,
    stack: ExitStack,
) -> Listener:
    """A listener of trainings that also writes logs and checkpoints, a folder each.

    The stack closes the files and writes the last state, so that a training that was interrupted
    or stopped can go on from there.
    """
    folders = [folder / member.name for member in plan.members]
    for place in folders:
        require_writable_folder(place)
    logs = [
        TrainingLog(place, before.get(member), listener.on_message)
        for member, place in zip(plan.members, folders, strict=True)
    ]
    for log in logs:
        stack.callback(log.close)
    checkpointer = Checkpointer(folders[0] / _CHECKPOINT, plan.task)

    @stack.push
    def flush(kind: type[BaseException] | None, *_: Any) -> None:
        # an interruption is also how SIGTERM and SIGHUP arrive
        if kind is None or issubclass(kind, KeyboardInterrupt):
            checkpointer.flush()

    def on_epoch(report: EpochReport) -> None:
        logs[report.member].write(report)
        listener.on_epoch(report)

    def on_state(state: TrainingState, progress: tuple[Progress, ...]) -> None:
        checkpointer(state, progress)
        listener.on_state(state, progress)

    return replace(listener, on_epoch=on_epoch, on_state=on_state)


def _find_resume_points(task: Task, folder: Path) -> list[tuple[Sequence[Member], ResumePoint]]:
    """Members that trained together when they stopped, and the state from which they go on."""
    groups: list[tuple[Sequence[Member], ResumePoint]] = []
    remaining = list(task.members)
    paths = folder.glob(f"*/{_CHECKPOINT}")
    # the newest first: a member may since have gone on without some of the others
    for path in sorted(paths, key=lambda path: path.stat().st_mtime_ns, reverse=True):
        members, point = read_checkpoint(path, task.with_members(remaining))
        if point:
            groups.append((members, point))
            remaining = [member for member in remaining if member not in members]
    return groups
