"""The training loop: one for all recipes, blind to the model's family."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import numpy as np

from tustinnet.fitting.gradient.compiling import last_compiled
from tustinnet.fitting.gradient.epoch import ROLLBACK_FACTOR, ROLLBACKS, compiled_epochs
from tustinnet.fitting.gradient.plan import Plan
from tustinnet.fitting.gradient.state import (
    EpochFigures,
    Progress,
    Stage,
    TrainingState,
    begin_stage,
)
from tustinnet.fitting.listener import SILENT, EpochReport, Listener
from tustinnet.fitting.report import FINISHED
from tustinnet.models.contract import Model
from tustinnet.simulate.rollout import LONG

OUT_OF_TIME = "out of time"  # the outcome of a training that was stopped

Resumed = tuple[TrainingState, tuple[Progress, ...]]
ShouldStop = Callable[[Sequence[Progress]], bool]


def never_stop(progress: Sequence[Progress]) -> bool:
    """A `should_stop` without a deadline."""
    return False


def train(
    prepared: Plan,
    listener: Listener = SILENT,
    resume: Resumed | None = None,
    should_stop: ShouldStop = never_stop,
) -> tuple[Model, tuple[Progress, ...]]:
    """Folds the epochs of all members over the stages.

    Each stage starts from the best weights of the one before with a fresh optimiser state. A
    member that diverged for good stays where it was.

    Args:
        prepared: models, stages, records.
        listener: who is told.
        resume: a state that a listener was given, to go on from there.
        should_stop: asked after every compiled call, with the members' progress; what the listener
            was given is not changed by a stop, so that the training can go on from there.

    Returns:
        The best models of the last stage that was reached, and where training ended.
    """
    stages, members = prepared.stages, len(prepared.members)
    state, progress = resume or (prepared.begin(0), (Progress(),) * members)
    going = [p.stage for p in progress if not p.outcome]
    for index in range(going[0] if going else len(stages), len(stages)):
        state, progress, stopped = _run_stage(
            prepared, index, state, progress, listener, should_stop
        )
        if stopped:
            progress = tuple(replace(p, outcome=p.outcome or OUT_OF_TIME) for p in progress)
            break
        if all(p.outcome for p in progress):
            break
        if index + 1 == len(stages):
            progress = tuple(replace(p, outcome=p.outcome or FINISHED) for p in progress)
        else:
            weights, given_up = state.weights, state.course.stopped
            state = begin_stage(
                weights.best, stages[index + 1], weights.key, prepared.factors, given_up
            )
            progress = tuple(
                p
                if p.outcome
                else Progress(
                    stage=index + 1, epochs=(*p.epochs, 0), seconds=p.seconds, reported=p.reported
                )
                for p in progress
            )
        listener.state(state, progress)
    return state.weights.best, progress


def _run_stage(
    prepared: Plan,
    index: int,
    state: TrainingState,
    progress: tuple[Progress, ...],
    listener: Listener,
    should_stop: ShouldStop,
) -> tuple[TrainingState, tuple[Progress, ...], bool]:
    """The state and progress at the end of a stage, and whether it was stopped before."""
    stage = prepared.stages[index]
    run = compiled_epochs(prepared, stage)
    while any(_is_due(stage, p) for p in progress):
        begun = time.perf_counter()
        state, told = run(state)
        told = jax.tree.map(np.asarray, told)
        ended = time.perf_counter()
        spent = (ended - begun) / sum(not p.outcome for p in progress)
        computing = max(begun, last_compiled())
        pace = (ended - computing) / len(told.epoch), computing - begun
        reports = [r for m in range(len(progress)) for r in _reports(stage, told, m, pace)]
        progress = _went_on(index, state, progress, reports, spent)
        # epoch by epoch, members side by side, as they happened
        for report in sorted(reports, key=lambda r: r.epoch):
            listener.epoch(report)
        listener.state(state, progress)
        last = index + 1 == len(prepared.stages)
        ends = all(p.outcome or (last and not _is_due(stage, p)) for p in progress)
        if not ends and should_stop(progress):
            return state, progress, True
    return state, progress, False


def _went_on(
    index: int,
    state: TrainingState,
    progress: tuple[Progress, ...],
    reports: Sequence[EpochReport],
    spent: float,
) -> tuple[Progress, ...]:
    """Where the members are after a compiled call that took each so many seconds."""
    course = jax.tree.map(np.asarray, state.course)
    return tuple(
        p
        if p.outcome
        else Progress(
            stage=index,
            epochs=(*p.epochs[:-1], int(course.epoch[m])),
            best_score=float(course.best_score[m]),
            best_epoch=int(course.best_epoch[m]),
            rollbacks=int(course.rollbacks[m]),
            seconds=p.seconds + spent,
            reported=p.reported + sum(r.member == m for r in reports),
            outcome=_gave_up(reports, m) if course.stopped[m] else "",
        )
        for m, p in enumerate(progress)
    )


def _is_due(stage: Stage, progress: Progress) -> bool:
    """Whether a member has epochs of the stage to do; the compiled epochs judge alike."""
    patience = stage.recipe.patience
    stalled = patience is not None and progress.epoch - progress.best_epoch >= patience
    return not progress.outcome and progress.epoch < stage.recipe.epochs and not stalled


def _reports(
    stage: Stage, told: EpochFigures, member: int, pace: tuple[float, float]
) -> list[EpochReport]:
    """The epochs that a member did in a compiled call of such seconds an epoch, and before them."""
    figures = [
        EpochFigures(*(field[turn, member] for field in told)) for turn in range(len(told.epoch))
    ]
    return [
        EpochReport(
            stage=stage.recipe.name,
            epoch=int(f.epoch),
            loss=float(f.loss),
            validation=float(f.validation),
            rate=float(f.rate),
            best=float(f.best),
            event=_note(stage, f) if f.finite else _event(stage, f),
            member=member,
            seconds=pace[0],
            compiling=pace[1],
        )
        for f in figures
        if f.active
    ]


def _note(stage: Stage, figures: EpochFigures) -> str:
    """What is worth saying when a stage begins."""
    if figures.epoch > 1 or stage.windows.length <= LONG:
        return ""
    return (
        f"windows of {stage.windows.length} steps: the gradient keeps some states and computes "
        f"those between them again, which saves memory and takes longer"
    )


def _event(stage: Stage, figures: EpochFigures) -> str:
    rate = float(figures.rate)
    return (
        f"loss not finite in epoch {int(figures.epoch)} of stage '{stage.recipe.name}' at rate "
        f"{rate:.3g}; back to the last good state with rate {rate * ROLLBACK_FACTOR:.3g}"
    )


def _gave_up(reports: Sequence[EpochReport], member: int) -> str:
    last = next(r for r in reversed(reports) if r.member == member)
    return (
        f"diverged: {last.event.split(';')[0]}, after {ROLLBACKS} returns to the last good state; "
        f"the best weights so far are kept. Lower `rate` or `length` in the recipe, or set "
        f"`clip`."
    )
