"""What training is: its state, its stages, and what is told of it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from jaxtyping import PRNGKeyArray, PyTree

from tustinnet.models.base import DiscreteModel
from tustinnet.training.material import StageWindows
from tustinnet.training.plateau import Plateau
from tustinnet.training.recipe import StageRecipe


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


SILENT = Listener()  # nobody is told


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
