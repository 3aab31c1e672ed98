"""When a watched figure stops improving, the rate goes down."""

import math
from dataclasses import dataclass, replace

from tustinnet.training.recipe import PlateauRecipe

_THRESHOLD = 1e-4  # relative improvement that counts
_SMALLEST_CHANGE = 1e-8  # a smaller change of the rate is not made


@dataclass(frozen=True)
class Plateau:
    """State of the scheduler.

    Attributes:
        rate: the rate in force.
        best: lowest figure so far.
        bad_epochs: epochs since then that did not improve.
    """

    rate: float
    best: float = math.inf
    bad_epochs: int = 0


def after_epoch(state: Plateau, figure: float, recipe: PlateauRecipe | None) -> Plateau:
    """The state after an epoch with a figure that should fall.

    An epoch is bad unless the figure is below `best (1 - 1e-4)`. After patience + 1 bad epochs
    in a row the rate is multiplied by the factor and the count starts again: the rule of
    PyTorch's ReduceLROnPlateau with mode `min` and a relative threshold.
    """
    if recipe is None:
        return state
    if figure < state.best * (1.0 - _THRESHOLD):
        return replace(state, best=figure, bad_epochs=0)
    bad = state.bad_epochs + 1
    if bad <= recipe.patience:
        return replace(state, bad_epochs=bad)
    reduced = state.rate * recipe.factor
    rate = reduced if state.rate - reduced > _SMALLEST_CHANGE else state.rate
    return replace(state, rate=rate, bad_epochs=0)
