"""What training is: its state, its stages, and what is told of it.

Several members, the same recipe from different seeds or at different rates, train as one. Arrays
of a state have the member as their first axis.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from tustinnet.models.base import DiscreteModel
from tustinnet.training.material import StageWindows
from tustinnet.training.plateau import Plateau, new_plateau
from tustinnet.training.recipe import StageRecipe


class Weights(NamedTuple):
    """What the optimiser changes, epoch by epoch.

    Attributes:
        model: the model.
        average: the running average of its weights, or the model itself where none is asked for.
        optimiser: the optimiser's state.
        key: the sampler's key.
        best: the best average so far in this stage.
    """

    model: DiscreteModel
    average: DiscreteModel
    optimiser: PyTree
    key: Key[Array, "*members"]
    best: DiscreteModel


class Course(NamedTuple):
    """Where a member is in its stage.

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
    """All that a compiled epoch changes.

    Attributes:
        weights: models and optimisers.
        course: where each member is.
    """

    weights: Weights
    course: Course


class EpochFigures(NamedTuple):
    """What a compiled epoch tells.

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
    """Where a member is in its training, in plain numbers.

    Attributes:
        stage: index of the stage.
        epochs: epochs done in each stage that was reached.
        best_score: the figure of the best weights in this stage.
        best_epoch: the epoch that gave them.
        rollbacks: how often this stage went back to the last good state.
        seconds: its share of the time spent.
        outcome: empty while training goes on; then a sentence.
    """

    stage: int = 0
    epochs: tuple[int, ...] = (0,)
    best_score: float = math.inf
    best_epoch: int = 0
    rollbacks: int = 0
    seconds: float = 0.0
    outcome: str = ""

    @property
    def epoch(self) -> int:
        """Epochs done in its stage."""
        return self.epochs[-1]


@dataclass(frozen=True)
class EpochReport:
    """What an epoch of a member did.

    Attributes:
        stage: the stage's name.
        epoch: its number in the stage, from 1.
        loss: mean training loss.
        validation: mean free-run RMSE over the validation records [rad or m], NaN without them.
        rate: the rate that was used.
        best: the lowest figure of the stage so far.
        event: a sentence when something happened, else empty.
        member: which of those that train together.
    """

    stage: str
    epoch: int
    loss: float
    validation: float
    rate: float
    best: float
    event: str = ""
    member: int = 0


@dataclass(frozen=True)
class Listener:
    """Who is told while training goes on; each call may be slow.

    Attributes:
        epoch: every epoch of every member.
        state: after every compiled call, which does several epochs, and at the ends of stages:
            all that a resumed run needs.
    """

    epoch: Callable[[EpochReport], None] = field(default=lambda report: None)
    state: Callable[[TrainingState, tuple[Progress, ...]], None] = field(
        default=lambda state, progress: None
    )


SILENT = Listener()  # nobody is told


@dataclass(frozen=True)
class Stage:
    """A stage with its windows drawn.

    Attributes:
        recipe: what it says.
        windows: what each member is trained on, rows of shape (members, count).
        trainable: a tree like the model, True where an array trains.
        held: windows of the validation records, where the scheduler watches their loss.
    """

    recipe: StageRecipe
    windows: StageWindows
    trainable: PyTree
    held: StageWindows | None = None


def new_course(rates: Float[Array, " members"], stopped: Bool[Array, " members"]) -> Course:
    """Where members are when a stage begins."""
    none = jnp.zeros(rates.shape, jnp.int32)
    unknown = jnp.full(rates.shape, jnp.inf, jnp.float32)
    return Course(none, new_plateau(rates), unknown, none, none, stopped)
