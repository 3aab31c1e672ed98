"""The training loop: one for all recipes, blind to the model's family."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from tustinnet.models.base import DiscreteModel
from tustinnet.simulation.rollout import rollout
from tustinnet.training.losses import window_loss
from tustinnet.training.material import Records, StageWindows, ValidationRuns
from tustinnet.training.plateau import Plateau, after_epoch
from tustinnet.training.recipe import Criterion, LossName, StageRecipe

_ROLLBACKS = 5  # a stage gives up after this many
_ROLLBACK_FACTOR = 0.5  # each multiplies the rate


class Weights(NamedTuple):
    """What the optimiser changes, epoch by epoch.

    Attributes:
        model: the model.
        optimiser: the optimiser's state.
        key: the sampler's key.
        best: the best model so far in this stage.
    """

    model: DiscreteModel
    optimiser: PyTree
    key: PRNGKeyArray
    best: DiscreteModel


@dataclass(frozen=True)
class Progress:
    """Where training is. With `Weights`, all that a resumed run needs.

    Attributes:
        stage: index of the stage.
        epoch: epochs done in it.
        plateau: the scheduler.
        best_score: the figure of the best weights in this stage.
        best_epoch: the epoch that gave them.
        rollbacks: how often this stage went back to the last good state.
        seconds: time spent so far.
        outcome: empty while training goes on; then a sentence.
    """

    stage: int
    epoch: int
    plateau: Plateau
    best_score: float = math.inf
    best_epoch: int = 0
    rollbacks: int = 0
    seconds: float = 0.0
    outcome: str = ""


@dataclass(frozen=True)
class EpochReport:
    """What an epoch did.

    Attributes:
        stage: the stage's name.
        epoch: its number in the stage, from 1.
        loss: mean training loss.
        validation: mean free-run RMSE over the validation records [rad or m], NaN without them.
        rate: the rate that was used.
        best: the lowest figure of the stage so far.
        event: a sentence when something happened, else empty.
    """

    stage: str
    epoch: int
    loss: float
    validation: float
    rate: float
    best: float
    event: str = ""


@dataclass(frozen=True)
class Listener:
    """Who is told while training goes on; each call may be slow.

    Attributes:
        epoch: after every epoch.
        state: after every epoch, with all that a resumed run needs.
    """

    epoch: Callable[[EpochReport], None] = field(default=lambda report: None)
    state: Callable[[Weights, Progress], None] = field(default=lambda weights, progress: None)


@dataclass(frozen=True)
class Stage:
    """A stage with its windows drawn.

    Attributes:
        recipe: what it says.
        windows: what it is trained on.
        trainable: a tree like the model, True where an array trains.
        held: windows of the validation records, where the scheduler watches their loss.
    """

    recipe: StageRecipe
    windows: StageWindows
    trainable: PyTree
    held: StageWindows | None = None


def train(
    model: DiscreteModel,
    stages: Sequence[Stage],
    records: Records,
    validation: ValidationRuns | None,
    key: PRNGKeyArray,
    listener: Listener = Listener(),
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
    optimiser = _optimiser(stage.recipe).init(trainable)
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
    run_epoch = _compiled_epoch(stage)
    keep: Criterion = recipe.keep if validation is not None else "training"
    watch: Criterion = "training"
    if recipe.plateau is not None and validation is not None:
        watch = recipe.plateau.watch
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


def _figures(
    model: DiscreteModel, loss: float, validation: ValidationRuns | None, stage: Stage
) -> dict[Criterion, float]:
    """What decides over the best weights and the rate after an epoch."""
    figures: dict[Criterion, float] = {"training": loss, "validation": math.nan}
    if validation is not None:
        figures["validation"] = float(validation_rmse(model, validation))
        if stage.held is not None:
            rows = jnp.asarray(stage.held.rows, jnp.int32)
            held = _held_loss(model, rows, validation.records, stage.held.length, stage.recipe.loss)
            figures["validation-loss"] = float(held)
    return figures


@eqx.filter_jit
def _held_loss(
    model: DiscreteModel, rows: Int[Array, " count"], records: Records, length: int, kind: LossName
) -> Float[Array, ""]:
    weight = jnp.ones(len(rows), jnp.float32)
    return _batch_loss(model, None, rows, weight, records, length=length, kind=kind)


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


def _optimiser(recipe: StageRecipe) -> optax.GradientTransformation:
    """Adam without its rate, which changes from epoch to epoch."""
    clip = optax.clip_by_global_norm(recipe.clip) if recipe.clip else optax.identity()
    return optax.chain(clip, optax.scale_by_adam())


EpochFunction = Callable[
    [Weights, Float[Array, ""], Int[Array, " count"], Records],
    tuple[Weights, Float[Array, ""], Array],
]


def _compiled_epoch(stage: Stage) -> EpochFunction:
    """One epoch as one compiled call: shuffle, then a scan over batches."""
    recipe, length = stage.recipe, stage.windows.length
    count = len(stage.windows.rows)
    batch = min(recipe.batch, count)
    steps = -(-count // batch)
    optimiser = _optimiser(recipe)

    def epoch(
        weights: Weights, rate: Float[Array, ""], rows: Int[Array, " count"], records: Records
    ) -> tuple[Weights, Float[Array, ""], Array]:
        trainable, frozen = eqx.partition(weights.model, stage.trainable)
        key, for_order = jax.random.split(weights.key)
        order = jax.random.permutation(for_order, count)
        # the last batch is filled up with windows that weigh nothing
        order = jnp.pad(order, (0, steps * batch - count), constant_values=0)
        valid = (jnp.arange(steps * batch) < count).astype(jnp.float32)

        def advance(
            carry: tuple[PyTree, PyTree], chosen: tuple[Array, Array]
        ) -> tuple[tuple[PyTree, PyTree], Array]:
            trained, optimiser_state = carry
            index, weight = chosen
            loss, gradient = jax.value_and_grad(
                partial(_batch_loss, length=length, kind=recipe.loss)
            )(trained, frozen, rows[index], weight, records)
            update, optimiser_state = optimiser.update(gradient, optimiser_state)
            trained = jax.tree.map(lambda p, d: p - rate * d, trained, update)
            return (trained, optimiser_state), loss * jnp.sum(weight)

        (trainable, optimiser_state), losses = jax.lax.scan(
            advance,
            (trainable, weights.optimiser),
            (order.reshape(steps, batch), valid.reshape(steps, batch)),
        )
        loss = jnp.sum(losses) / count
        finite = jnp.isfinite(loss)
        for leaf in jax.tree.leaves(trainable):
            finite &= jnp.all(jnp.isfinite(leaf))
        model = eqx.combine(trainable, frozen)
        return Weights(model, optimiser_state, key, weights.best), loss, finite

    return eqx.filter_jit(epoch)


def _batch_loss(
    trainable: PyTree,
    frozen: PyTree,
    rows: Int[Array, " batch"],
    weight: Float[Array, " batch"],
    records: Records,
    *,
    length: int,
    kind: LossName,
) -> Float[Array, ""]:
    model: DiscreteModel = trainable if frozen is None else eqx.combine(trainable, frozen)
    # a stem is folded once a batch, not applied at every step; its gradient passes the fold
    simulator = model.folded()
    angular = model.angular

    def one(row: Array) -> Array:
        target = jax.lax.dynamic_slice_in_dim(records.x, row, length + 1)
        u = jax.lax.dynamic_slice_in_dim(records.u, row, length)
        return window_loss(rollout(simulator, target[0], u), target, angular, kind)

    return jnp.sum(weight * jax.vmap(one)(rows)) / jnp.sum(weight)


@eqx.filter_jit
def validation_rmse(model: DiscreteModel, runs: ValidationRuns) -> Float[Array, ""]:
    """Mean over records of the free run's RMSE in float32 [rad or m]; NaN counts as infinite."""
    simulator = model.folded()
    n_q = runs.q.shape[-1]
    simulated = jax.vmap(lambda x, u: rollout(simulator, x, u))(runs.x0, runs.u)[..., :n_q]
    # beyond a record's end the model may do anything, also overflow
    error = jnp.where(runs.weight[..., None] > 0, simulated - runs.q, 0.0)
    mean = jnp.mean(jnp.sqrt(jnp.sum(runs.weight * jnp.sum(error**2, axis=-1), axis=-1)))
    return jnp.where(jnp.isfinite(mean), mean, jnp.inf)
