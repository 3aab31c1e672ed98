"""Fits in folders: models are returned, logs and checkpoints of every member are written."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.gradient.loop import ResumePoint
from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.listener import SILENT, EpochReport, Iteration, Listener, StageResult
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.task import Member, Task
from tustinnet.store.checkpoint import Checkpointer, read_checkpoint
from tustinnet.store.files import require_writable_folder
from tustinnet.store.log import SearchLog, TrainingLog
from tustinnet.store.run_folder import CHECKPOINT


def fit_in_folder(folder: Path, task: Task, listener: Listener, *, resume: bool) -> list[FitResult]:
    """Fits all members of a task with logs and checkpoints in a folder, a folder each.

    Args:
        folder: where they go.
        task: recipe, records and members.
        listener: functions that are called while they go on.
        resume: whether to go on from the checkpoints that are there; an identification has none.
    """
    resumed = _find_resume_points(task, folder) if resume else []
    before = {
        member: progress
        for members, (_, all_progress) in resumed
        for member, progress in zip(members, all_progress, strict=True)
    }
    log = SILENT  # of the fits that run at present
    with ExitStack() as stack:

        def on_begin(prepared: TrainingPlan | Task) -> None:
            nonlocal log
            listener.on_begin(prepared)
            log = (
                _log_training(prepared, folder, before, listener.on_message, stack)
                if isinstance(prepared, TrainingPlan)
                else _log_search(folder, stack)
            )

        def on_epoch(report: EpochReport) -> None:
            log.on_epoch(report)
            listener.on_epoch(report)

        def on_state(state: TrainingState, progress: tuple[Progress, ...]) -> None:
            log.on_state(state, progress)
            listener.on_state(state, progress)

        def on_iteration(report: Iteration) -> None:
            log.on_iteration(report)
            listener.on_iteration(report)

        def on_stage(result: StageResult) -> None:
            log.on_stage(result)
            listener.on_stage(result)

        both = replace(
            listener,
            on_begin=on_begin,
            on_epoch=on_epoch,
            on_state=on_state,
            on_iteration=on_iteration,
            on_stage=on_stage,
        )
        return fit_task(task, both, resumed)


def _log_search(folder: Path, stack: ExitStack) -> Listener:
    """A listener that writes every iteration and stage of an identification to a log."""
    require_writable_folder(folder)
    log = SearchLog(folder)
    stack.callback(log.close)
    return Listener(on_iteration=log.write_iteration, on_stage=log.write_stage)


def _log_training(
    plan: TrainingPlan,
    folder: Path,
    before: Mapping[Member, Progress],
    on_message: Callable[[str], None],
    stack: ExitStack,
) -> Listener:
    """A listener that writes logs and checkpoints of trainings, a folder each.

    The stack closes the files and writes the last state, so that a training that was interrupted
    or stopped can go on from there.
    """
    folders = [folder / member.name for member in plan.members]
    for place in folders:
        require_writable_folder(place)
    logs = [
        TrainingLog(place, before.get(member), on_message)
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

    return Listener(
        on_epoch=lambda report: logs[report.member].write(report), on_state=checkpointer
    )


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
