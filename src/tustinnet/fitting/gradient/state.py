"""The state of a training, its stages, and the progress that is reported of it.

Several members, the same recipe from different seeds or at different rates, train as one. Arrays
of a state have the member as their first axis.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from tustinnet.fitting.gradient.plateau import Plateau, new_plateau
from tustinnet.fitting.gradient.windows import StageWindows
from tustinnet.fitting.recipe import StageRecipe
from tustinnet.fitting.residual import Residual
from tustinnet.models.contract import Model


class MemberWeights(NamedTuple):
    """Models, their averages and the state of the optimiser, which change epoch by epoch.

    Attributes:
        model: the model.
        average: the running average of its weights, or the model itself where there is none.
        optimiser: the optimiser's state.
        key: the sampler's key.
        best: the best average so far in this stage.
    """

    model: Model
    average: Model
    optimiser: PyTree
    key: Key[Array, "*members"]
    best: Model


class StageProgress(NamedTuple):
    """The place of a member in its stage.

    Attributes:
        epoch: epochs done.
        plateau: the scheduler.
        best_score: the figure of the best weights in this stage.
        best_epoch: the epoch that gave them.
        rollbacks: how often this stage went back to the last good state.
        stopped: whether it gave up.
    """

    epoch: Int[Array, "..."]
    plateau: Plateau
    best_score: Float[Array, "..."]
    best_epoch: Int[Array, "..."]
    rollbacks: Int[Array, "..."]
    stopped: Bool[Array, "..."]


class TrainingState(NamedTuple):
    """The state of a training: all that a compiled epoch changes.

    Attributes:
        weights: models and optimisers.
        progress: where each member is in its stage.
    """

    weights: MemberWeights
    progress: StageProgress


class EpochFigures(NamedTuple):
    """The figures that a compiled epoch returns.

    Attributes:
        active: whether there was an epoch to do.
        finite: whether it gave finite weights; otherwise the last good state was kept.
        epoch: its number in the stage, from 1.
        loss: mean training loss, NaN where it was not finite.
        validation: mean free-run RMSE over the validation records [rad or m], NaN without them.
        rate: the rate that was used.
        best: the lowest figure of the stage so far.
    """

    active: Bool[Array, "..."]
    finite: Bool[Array, "..."]
    epoch: Int[Array, "..."]
    loss: Float[Array, "..."]
    validation: Float[Array, "..."]
    rate: Float[Array, "..."]
    best: Float[Array, "..."]


@dataclass(frozen=True)
class Progress:
    """The place of a member in its training, in plain numbers.

    Attributes:
        stage: index of the stage.
        epochs: epochs done in each stage that was reached.
        best_score: the figure of the best weights in this stage.
        best_epoch: the epoch that gave them.
        rollbacks: how often this stage went back to the last good state.
        seconds: its share of the time spent.
        reported: epochs reported so far, with those that were taken back.
        outcome: empty while training goes on; then a sentence.
    """

    stage: int = 0
    epochs: tuple[int, ...] = (0,)
    best_score: float = math.inf
    best_epoch: int = 0
    rollbacks: int = 0
    seconds: float = 0.0
    reported: int = 0
    outcome: str = ""

    @property
    def epoch(self) -> int:
        """Epochs done in its stage."""
        return self.epochs[-1]


@dataclass(frozen=True)
class Stage:
    """A stage with its windows drawn.

    Attributes:
        recipe: its keys in the recipe.
        windows: what each member is trained on, rows of shape (members, count).
        trainable: a tree like the model, True where an array trains.
        residual: what is compared.
        validation_rows: rows of windows of the validation records, (members, count), where the
            stage's criteria need their loss.
    """

    recipe: StageRecipe
    windows: StageWindows
    trainable: PyTree
    residual: Residual
    validation_rows: Int[np.ndarray, "members count"] | None = None


def adam_without_rate(recipe: StageRecipe) -> optax.GradientTransformation:
    """Adam without its rate, which changes from epoch to epoch."""
    clip = optax.clip_by_global_norm(recipe.clip) if recipe.clip else optax.identity()
    return optax.chain(clip, optax.scale_by_adam())


def begin_stage(
    models: Model,
    stage: Stage,
    keys: Key[Array, " members"],
    factors: Float[np.ndarray, " members"],
    stopped: Bool[Array, " members"],
) -> TrainingState:
    """The state in which a stage begins."""
    trainable, _ = eqx.partition(models, stage.trainable)
    optimiser = jax.vmap(adam_without_rate(stage.recipe).init)(trainable)
    rates = jnp.asarray(stage.recipe.rate * factors, jnp.float32)
    zero = jnp.zeros(rates.shape, jnp.int32)
    infinite = jnp.full(rates.shape, jnp.inf, jnp.float32)
    progress = StageProgress(zero, new_plateau(rates), infinite, zero, zero, stopped)
    return TrainingState(MemberWeights(models, models, optimiser, keys, models), progress)
