"""The training loop: one for all recipes, blind to the model's family."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from tustinnet.models.base import DiscreteModel
from tustinnet.training.epoch import (
    adam_without_rate,
    compiled_epoch,
    held_loss,
    validation_rmse,
)
from tustinnet.training.material import Records, ValidationRuns
from tustinnet.training.plateau import Plateau, after_epoch
from tustinnet.training.recipe import Criterion
from tustinnet.training.state import SILENT, EpochReport, Listener, Progress, Stage, Weights

_ROLLBACKS = 5  # a stage gives up after this many
_ROLLBACK_FACTOR = 0.5  # each multiplies the rate


def train(
    model: DiscreteModel,
    stages: Sequence[Stage],
    records: Records,
    validation: ValidationRuns | None,
    key: PRNGKeyArray,
    listener: Listener = SILENT,
    resume: tuple[Weights, Progress] | None = None,
) -> tuple[DiscreteModel, Progress]:
    """Folds the epochs over the stages.

    Each stage starts from the best weights of the one before with a fresh optimiser state.

    Args:
        model: the model with its initial weights.
        stages: what to do, in order.
        records: the training records.
        validation: the validation free runs; None when there are none, in which case training
            loss decides.
        key: the source of the shuffling.
        listener: who is told.
        resume: a state that a listener was given, to go on from there.

    Returns:
        The best model of the last stage that was reached, and where training ended.
    """
    weights, progress = resume or begin_stage(model, stages, 0, key)
    while not progress.outcome:
        stage = stages[progress.stage]
        weights, progress = _run_stage(stage, weights, progress, records, validation, listener)
        if progress.outcome:
            break
        if progress.stage + 1 == len(stages):
            progress = replace(progress, outcome="finished")
        else:
            seconds, following = progress.seconds, progress.stage + 1
            weights, progress = begin_stage(weights.best, stages, following, weights.key)
            progress = replace(progress, seconds=seconds)
        listener.state(weights, progress)
    return weights.best, progress


def begin_stage(
    model: DiscreteModel, stages: Sequence[Stage], index: int, key: PRNGKeyArray
) -> tuple[Weights, Progress]:
    """The state in which a stage begins."""
    stage = stages[index]
    trainable, _ = eqx.partition(model, stage.trainable)
    optimiser = adam_without_rate(stage.recipe).init(trainable)
    progress = Progress(stage=index, epoch=0, plateau=Plateau(stage.recipe.rate))
    return Weights(model, optimiser, key, model), progress


def _run_stage(
    stage: Stage,
    weights: Weights,
    progress: Progress,
    records: Records,
    validation: ValidationRuns | None,
    listener: Listener,
) -> tuple[Weights, Progress]:
    recipe = stage.recipe
    run_epoch = compiled_epoch(stage)
    keep = _possible(recipe.keep, stage, validation)
    watch = _possible(recipe.plateau.watch if recipe.plateau else "training", stage, validation)
    rows = jnp.asarray(stage.windows.rows, jnp.int32)
    while progress.epoch < recipe.epochs and not progress.outcome:
        begun = time.perf_counter()
        rate = progress.plateau.rate
        attempt, loss, finite = run_epoch(weights, jnp.float32(rate), rows, records)
        event = ""
        if not bool(finite):
            progress, event = _roll_back(progress, stage)
            figures: dict[Criterion, float] = {"training": math.nan, "validation": math.nan}
        else:
            figures = _figures(attempt.model, float(loss), validation, stage)
            if figures[keep] < progress.best_score:
                attempt = attempt._replace(best=attempt.model)
                progress = replace(
                    progress, best_score=figures[keep], best_epoch=progress.epoch + 1
                )
            plateau = after_epoch(progress.plateau, figures[watch], recipe.plateau)
            weights = attempt
            progress = replace(progress, epoch=progress.epoch + 1, plateau=plateau)
        progress = replace(progress, seconds=progress.seconds + time.perf_counter() - begun)
        listener.epoch(
            EpochReport(
                stage=recipe.name,
                epoch=progress.epoch + (0 if bool(finite) else 1),
                loss=figures["training"],
                validation=figures["validation"],
                rate=rate,
                best=progress.best_score,
                event=event,
            )
        )
        listener.state(weights, progress)
    return weights, progress


def _possible(wanted: Criterion, stage: Stage, validation: ValidationRuns | None) -> Criterion:
    """The criterion, or the next one where there are no records or windows for it."""
    if validation is None:
        return "training"
    if wanted == "validation-loss" and stage.held is None:
        return "validation"  # the validation records are shorter than a window
    return wanted


def _figures(
    model: DiscreteModel, loss: float, validation: ValidationRuns | None, stage: Stage
) -> dict[Criterion, float]:
    """What decides over the best weights and the rate after an epoch."""
    figures: dict[Criterion, float] = {"training": loss, "validation": math.nan}
    if validation is not None:
        figures["validation"] = float(validation_rmse(model, validation))
        if stage.held is not None:
            rows = jnp.asarray(stage.held.rows, jnp.int32)
            held = held_loss(model, rows, validation.records, stage.held.length, stage.recipe.loss)
            figures["validation-loss"] = float(held)
    return figures


def _roll_back(progress: Progress, stage: Stage) -> tuple[Progress, str]:
    """After a loss that is not finite: the last good state again, at a lower rate."""
    lower = progress.plateau.rate * _ROLLBACK_FACTOR
    told = (
        f"loss not finite in epoch {progress.epoch + 1} of stage '{stage.recipe.name}' "
        f"at rate {progress.plateau.rate:.3g}"
    )
    if progress.rollbacks >= _ROLLBACKS:
        return replace(
            progress,
            outcome=f"diverged: {told}, after {_ROLLBACKS} returns to the last good state; "
            f"the best weights so far are kept. Lower `rate` or `length` in the recipe, or set "
            f"`clip`.",
        ), told
    plateau = replace(progress.plateau, rate=lower)
    event = f"{told}; back to the last good state with rate {lower:.3g}"
    return replace(progress, plateau=plateau, rollbacks=progress.rollbacks + 1), event
