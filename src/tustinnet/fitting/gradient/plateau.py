"""Schedulers of the rate: it falls when a watched figure stops improving, or with every epoch."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tustinnet.fitting.recipe import PlateauRecipe, StageRecipe

_THRESHOLD = 1e-4  # relative improvement that counts, as in PyTorch


class Plateau(NamedTuple):
    """The state of a scheduler.

    Attributes:
        rate: the rate in force.
        best: lowest figure so far.
        bad_epochs: epochs since then that did not improve.
    """

    rate: Float[Array, "..."]
    best: Float[Array, "..."]
    bad_epochs: Int[Array, "..."]


def new_plateau(rate: Float[Array, "..."]) -> Plateau:
    """The state of a scheduler before the first epoch."""
    rate = jnp.asarray(rate, jnp.float32)
    return Plateau(rate, jnp.full_like(rate, jnp.inf), jnp.zeros(rate.shape, jnp.int32))


def update_plateau(
    state: Plateau, figure: Float[Array, "..."], recipe: PlateauRecipe | None
) -> Plateau:
    """The state of a scheduler after an epoch with a figure that should fall.

    An epoch is bad unless the figure is below `best (1 - 1e-4)`. After patience + 1 bad epochs
    in a row the rate is multiplied by the factor and the count starts again: the rule of
    PyTorch's ReduceLROnPlateau with mode `min` and a relative threshold.
    """
    if recipe is None:
        return state
    better = figure < state.best * (1.0 - _THRESHOLD)
    bad = jnp.where(better, 0, state.bad_epochs + 1)
    due = bad > recipe.patience
    reduced = state.rate * recipe.factor
    # PyTorch makes no smaller change of the rate
    changed = due & (state.rate - reduced > 1e-8)
    return Plateau(
        rate=jnp.where(changed, reduced, state.rate),
        best=jnp.where(better, figure, state.best),
        bad_epochs=jnp.where(due, 0, bad),
    )


def decay_rate(
    rate: Float[Array, "..."],
    epoch: Int[Array, "..."],
    epochs: Int[Array, "..."],
    recipe: StageRecipe,
) -> Float[Array, "..."]:
    """The rate of the next epoch after `epoch` ones: `rate (1 + cos(pi epoch / epochs)) / 2`.

    Without a decay in the recipe it is the rate itself.
    """
    if recipe.decay is None:
        return rate
    return rate * (1.0 + jnp.cos(jnp.pi * epoch / epochs)) / 2.0
