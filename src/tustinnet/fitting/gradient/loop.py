"""The training loop: one for all recipes, blind to the model's family."""

import time
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from tustinnet.fitting.gradient.compiling import last_compiled
from tustinnet.fitting.gradient.epoch import (
    EPOCHS_A_CALL,
    ROLLBACK_FACTOR,
    ROLLBACKS,
    compile_epochs,
)
from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.gradient.state import (
    EpochFigures,
    Progress,
    Stage,
    TrainingState,
    begin_stage,
)
from tustinnet.fitting.listener import SILENT, EpochReport, Listener
from tustinnet.fitting.report import FINISHED, OUT_OF_TIME
from tustinnet.models.contract import Model
from tustinnet.simulate.rollout import LONG_ROLLOUT

_CALL = 1.0  # s, compiled calls of several epochs take at most: between two a training can stop

ResumePoint = tuple[TrainingState, tuple[Progress, ...]]


def train(
    plan: TrainingPlan,
    listener: Listener = SILENT,
    resume: ResumePoint | None = None,
) -> tuple[Model, tuple[Progress, ...]]:
    """Folds the epochs of all members over the stages.

    Each stage starts from the best weights of the one before with a fresh optimiser state. A
    member that diverged for good stays where it was.

    Args:
        plan: models, stages, records.
        listener: its `on_epoch` and `on_state` are called, and `should_stop` after every compiled
            call; what it was given is not changed by a stop, so that the training can go on from
            there.
        resume: a state that a listener was given, to go on from there.

    Returns:
        The best models of the last stage that was reached, and where training ended.
    """
    stages, members = plan.stages, len(plan.members)
    state, progress = resume or (plan.begin(0), (Progress(),) * members)
    unfinished = [p.stage for p in progress if not p.outcome]
    for index in range(unfinished[0] if unfinished else len(stages), len(stages)):
        state, progress, is_stopped = _run_stage(plan, index, state, progress, listener)
        if is_stopped:
            progress = tuple(replace(p, outcome=p.outcome or OUT_OF_TIME) for p in progress)
            break
        if all(p.outcome for p in progress):
            break
        if index + 1 == len(stages):
            progress = tuple(replace(p, outcome=p.outcome or FINISHED) for p in progress)
        else:
            weights, stopped = state.weights, state.progress.stopped
            state = begin_stage(weights.best, stages[index + 1], weights.key, plan.factors, stopped)
            progress = tuple(
                p
                if p.outcome
                else Progress(
                    stage=index + 1, epochs=(*p.epochs, 0), seconds=p.seconds, reported=p.reported
                )
                for p in progress
            )
        listener.on_state(state, progress)
    return state.weights.best, progress


def _run_stage(
    plan: TrainingPlan,
    index: int,
    state: TrainingState,
    progress: tuple[Progress, ...],
    listener: Listener,
) -> tuple[TrainingState, tuple[Progress, ...], bool]:
    """The state and progress of all members after a stage, and whether it was stopped before."""
    stage = plan.stages[index]
    # the first call says how long an epoch takes; as it compiles, it does not say how long a call
    run, count, is_first = compile_epochs(plan, stage), 1, True
    while any(_is_due(stage, p) for p in progress):
        begin = time.perf_counter()
        state, figures = run(state, count)
        figures = jax.tree.map(np.asarray, figures)
        end = time.perf_counter()
        share = (end - begin) / sum(not p.outcome for p in progress)
        computing = max(begin, last_compiled())
        seconds = max(end - computing, 1e-6) / count
        count = min(max(int(_CALL / seconds), 1), EPOCHS_A_CALL)
        reports = _report_epochs(stage, figures, seconds, compiling=computing - begin)
        stage_progress = jax.tree.map(np.asarray, state.progress)
        progress = tuple(
            p
            if p.outcome
            else Progress(
                stage=index,
                epochs=(*p.epochs[:-1], int(stage_progress.epoch[m])),
                best_score=float(stage_progress.best_score[m]),
                best_epoch=int(stage_progress.best_epoch[m]),
                rollbacks=int(stage_progress.rollbacks[m]),
                seconds=p.seconds + share,
                reported=p.reported + sum(r.member == m for r in reports),
                outcome=_describe_divergence(reports, m) if stage_progress.stopped[m] else "",
            )
            for m, p in enumerate(progress)
        )
        # epoch by epoch, members side by side, as they happened
        for report in sorted(reports, key=lambda r: r.epoch):
            listener.on_epoch(report)
        listener.on_state(state, progress)
        is_last = index + 1 == len(plan.stages)
        is_complete = all(p.outcome or (is_last and not _is_due(stage, p)) for p in progress)
        call = 0.0 if is_first else time.perf_counter() - begin
        if not is_complete and listener.should_stop(call):
            return state, progress, True
        is_first = False
    return state, progress, False


def _is_due(stage: Stage, progress: Progress) -> bool:
    """Whether a member has epochs of the stage to do; the compiled epochs judge alike."""
    patience = stage.recipe.patience
    stalled = patience is not None and progress.epoch - progress.best_epoch >= patience
    return not progress.outcome and progress.epoch < stage.recipe.epochs and not stalled


def _report_epochs(
    stage: Stage, figures: EpochFigures, seconds: float, compiling: float
) -> list[EpochReport]:
    """The epochs of a compiled call, member by member.

    Args:
        stage: the stage.
        figures: arrays, (epochs, members).
        seconds: what an epoch of all members took.
        compiling: what came before them.
    """
    reports = []
    for member, turn in np.argwhere(figures.active.T).tolist():
        f = EpochFigures(*(field[turn, member] for field in figures))
        event, rate = "", float(f.rate)
        if not f.finite:
            event = (
                f"loss not finite in epoch {int(f.epoch)} of stage '{stage.recipe.name}' at "
                f"rate {rate:.3g}; back to the last good state with rate "
                f"{rate * ROLLBACK_FACTOR:.3g}"
            )
        elif f.epoch <= 1 and stage.windows.length > LONG_ROLLOUT:
            event = (
                f"windows of {stage.windows.length} steps: the gradient keeps some states and "
                "computes those between them again, which saves memory and takes longer"
            )
        reports.append(
            EpochReport(
                stage=stage.recipe.name,
                epoch=int(f.epoch),
                loss=float(f.loss),
                validation=float(f.validation),
                rate=rate,
                best=float(f.best),
                event=event,
                member=member,
                seconds=seconds,
                compiling=compiling,
            )
        )
    return reports


def _describe_divergence(reports: Sequence[EpochReport], member: int) -> str:
    """The outcome of a member that gave up, and what to change."""
    last = next(r for r in reversed(reports) if r.member == member)
    return (
        f"diverged: {last.event.split(';')[0]}, after {ROLLBACKS} returns to the last good state; "
        f"the best weights so far are kept. Lower `rate` or `length` in the recipe, or set "
        f"`clip`."
    )
