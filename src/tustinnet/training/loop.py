"""The training loop: one for all recipes, blind to the model's family."""

import time
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float, Key

from tustinnet.models.base import DiscreteModel
from tustinnet.simulation.rollout import LONG
from tustinnet.training.epoch import (
    ROLLBACK_FACTOR,
    ROLLBACKS,
    adam_without_rate,
    compiled_epochs,
)
from tustinnet.training.layout import MEMBERS
from tustinnet.training.material import Records, ValidationRuns
from tustinnet.training.state import (
    SILENT,
    EpochFigures,
    EpochReport,
    Listener,
    Progress,
    Stage,
    TrainingState,
    Weights,
    new_course,
)

FINISHED = "finished"


def train(
    models: DiscreteModel,
    stages: Sequence[Stage],
    records: Records,
    validation: ValidationRuns | None,
    keys: Key[Array, " members"],
    mesh: Mesh,
    factors: Float[np.ndarray, " members"] | None = None,
    listener: Listener = SILENT,
    resume: tuple[TrainingState, tuple[Progress, ...]] | None = None,
) -> tuple[DiscreteModel, tuple[Progress, ...]]:
    """Folds the epochs of all members over the stages.

    Each stage starts from the best weights of the one before with a fresh optimiser state. A
    member that diverged for good stays where it was.

    Args:
        models: the members' initial weights, arrays with the member first.
        stages: what to do, in order.
        records: the training records.
        validation: the validation free runs; None when there are none, in which case training
            loss decides.
        keys: the sources of the shuffling, one a member.
        mesh: which device trains what.
        factors: multiply the recipe's rates, one a member; 1 by default.
        listener: who is told.
        resume: a state that a listener was given, to go on from there.

    Returns:
        The best models of the last stage that was reached, and where training ended.
    """
    members = len(keys)
    factors = np.ones(members) if factors is None else factors
    state, progress = resume or (
        begin_stage(models, stages[0], keys, factors, jnp.zeros(members, bool)),
        (Progress(),) * members,
    )
    going = [p.stage for p in progress if not p.outcome]
    for index in range(going[0] if going else len(stages), len(stages)):
        stage = stages[index]
        state, progress = _run_stage(
            index, stage, state, progress, records, validation, mesh, listener
        )
        if all(p.outcome for p in progress):
            break
        if index + 1 == len(stages):
            progress = tuple(replace(p, outcome=p.outcome or FINISHED) for p in progress)
        else:
            weights, stopped = state.weights, state.course.stopped
            state = begin_stage(weights.best, stages[index + 1], weights.key, factors, stopped)
            progress = tuple(
                p
                if p.outcome
                else Progress(stage=index + 1, epochs=(*p.epochs, 0), seconds=p.seconds)
                for p in progress
            )
        listener.state(state, progress)
    return state.weights.best, progress


def begin_stage(
    models: DiscreteModel,
    stage: Stage,
    keys: Key[Array, " members"],
    factors: Float[np.ndarray, " members"],
    stopped: Bool[Array, " members"],
) -> TrainingState:
    """The state in which a stage begins."""
    trainable, _ = eqx.partition(models, stage.trainable)
    optimiser = jax.vmap(adam_without_rate(stage.recipe).init)(trainable)
    rates = jnp.asarray(stage.recipe.rate * factors, jnp.float32)
    return TrainingState(
        Weights(models, models, optimiser, keys, models), new_course(rates, stopped)
    )


def _run_stage(
    index: int,
    stage: Stage,
    state: TrainingState,
    progress: tuple[Progress, ...],
    records: Records,
    validation: ValidationRuns | None,
    mesh: Mesh,
    listener: Listener,
) -> tuple[TrainingState, tuple[Progress, ...]]:
    run = compiled_epochs(stage, records, validation, mesh)
    # laid out from the first call on as the calls leave it, or the second compiles anew
    state = jax.device_put(state, NamedSharding(mesh, PartitionSpec(MEMBERS)))
    while any(_is_due(stage, p) for p in progress):
        begun = time.perf_counter()
        state, told = run(state)
        told = jax.tree.map(np.asarray, told)
        spent = (time.perf_counter() - begun) / sum(not p.outcome for p in progress)
        reports = [r for m in range(len(progress)) for r in _reports(stage, told, m)]
        course = jax.tree.map(np.asarray, state.course)
        progress = tuple(
            p
            if p.outcome
            else Progress(
                stage=index,
                epochs=(*p.epochs[:-1], int(course.epoch[m])),
                best_score=float(course.best_score[m]),
                best_epoch=int(course.best_epoch[m]),
                rollbacks=int(course.rollbacks[m]),
                seconds=p.seconds + spent,
                outcome=_gave_up(reports, m) if course.stopped[m] else "",
            )
            for m, p in enumerate(progress)
        )
        # epoch by epoch, members side by side, as they happened
        for report in sorted(reports, key=lambda r: r.epoch):
            listener.epoch(report)
        listener.state(state, progress)
    return state, progress


def _is_due(stage: Stage, progress: Progress) -> bool:
    """Whether a member has epochs of the stage to do; the compiled epochs judge alike."""
    patience = stage.recipe.patience
    stalled = patience is not None and progress.epoch - progress.best_epoch >= patience
    return not progress.outcome and progress.epoch < stage.recipe.epochs and not stalled


def _reports(stage: Stage, told: EpochFigures, member: int) -> list[EpochReport]:
    """The epochs that a member did in a compiled call."""
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
