"""Fits in folders: models are returned, logs and checkpoints of every member are written."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from tustinnet.fitting.fit import MakeListener, MakeStopCheck, fit_task
from tustinnet.fitting.gradient.loop import ResumePoint, never_stop
from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.listener import EpochReport, Iteration, Listener, StageResult
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.shooting.levenberg_marquardt import ShouldStopSearch, never_stop_search
from tustinnet.fitting.task import Member, Task
from tustinnet.store.checkpoint import Checkpointer, read_checkpoint
from tustinnet.store.files import require_writable_folder
from tustinnet.store.log import SearchLog, TrainingLog
from tustinnet.store.run_folder import CHECKPOINT


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
        make_listener: see `run_fit`.
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
    checkpointer = Checkpointer(folders[0] / CHECKPOINT, plan.task)

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
    paths = folder.glob(f"*/{CHECKPOINT}")
    # the newest first: a member may since have gone on without some of the others
    for path in sorted(paths, key=lambda path: path.stat().st_mtime_ns, reverse=True):
        members, point = read_checkpoint(path, task.with_members(remaining))
        if point:
            groups.append((members, point))
            remaining = [member for member in remaining if member not in members]
    return groups
