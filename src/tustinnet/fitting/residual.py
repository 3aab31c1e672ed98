"""The residual: how simulated and recorded states are compared, in every kind of fit."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment, moving_coordinates
from tustinnet.engine import equations as engine
from tustinnet.fitting.recipe import Robust, SearchRecipe, StageRecipe
from tustinnet.signals.outliers import TO_DEVIATION

_STILL_UNIT = 1.0  # the unit of a signal that never changes
_HUBER = 1.345  # standard deviations; Huber's, for 95 % of the efficiency with normal residuals
_LEAST_SCALE = 1e-12  # where most residuals are 0


@dataclass(frozen=True)
class Residual:
    """The difference of a simulated state from a recorded one; its square is the loss.

    A residual is `e / unit`, or for a periodic channel `2 sin(e / 2) / unit`, whose square is the
    periodic distance `2 (1 - cos e)` of the paper. The first channels of a state are compared:
    positions, and velocities in a search, and in a training whose loss is of the `state`.

    Attributes:
        periodic: which of the compared channels are, (n_y,).
        unit: what each is divided by, (n_y,).

    References:
        van Esch, Bonassi, Schön, equations of the periodic distance and of the state loss.
    """

    periodic: tuple[bool, ...]
    unit: tuple[float, ...]

    @property
    def channels(self) -> int:
        """`n_y`, the number of channels that are compared."""
        return len(self.unit)

    @property
    def weight(self) -> Float[np.ndarray, " n_y"]:
        """The inverse units."""
        return 1.0 / np.array(self.unit)

    def wrapped_residual(self, error: Float[Array, "*any n_y"]) -> Float[Array, "*any n_y"]:
        """Residuals of errors before they are divided by the units; periodic ones are wrapped."""
        if not any(self.periodic):
            return error
        return jnp.where(np.array(self.periodic), 2 * jnp.sin(error / 2), error)

    @property
    def formula(self) -> engine.ResidualFormula:
        """The wrapped residual for simulations with derivatives, without units."""
        return _residual_formula(self.periodic)

    def window_loss(
        self, simulated: Float[Array, "samples n_x"], target: Float[Array, "samples n_x"]
    ) -> Float[Array, ""]:
        """Mean over the steps k = 1..T of a window of the squared residual.

        Args:
            simulated: states of the rollout, (T + 1, n_x); the first is the given start.
            target: recorded states, (T + 1, n_x).
        """
        error = (simulated - target)[1:, : self.channels]
        weight = jnp.asarray(self.weight, error.dtype)
        return jnp.mean(jnp.sum((weight * self.wrapped_residual(error)) ** 2, axis=1))


@lru_cache  # what was read once is not read again
def _residual_formula(periodic: tuple[bool, ...]) -> engine.ResidualFormula:
    return engine.ResidualFormula(
        Residual(periodic, (1.0,) * len(periodic)).wrapped_residual, len(periodic)
    )


def make_residual(
    recipe: StageRecipe | SearchRecipe, experiments: Sequence[Experiment]
) -> Residual:
    """The residual that a recipe describes, in units of the training records.

    Scaled, each velocity counts in the unit in which it spreads as much as its position does, and
    where coordinates are of different kinds each position is measured by its spread. Not scaled,
    all channels count in SI units, but for lengths in a training.

    A training counts lengths in their spread: else its rate, its clip and Adam's epsilon would act
    differently on a stage of 0.1 mm and on one of 1 m. (Angles need no such unit: a radian is the
    same everywhere.) All its units are rounded to powers of two: folds then share a program.

    Args:
        recipe: the keys `periodic` and `scaled` of it, and `loss` of a training.
        experiments: the training records.
    """
    channels = experiments[0].channels
    angular = tuple(bool(a) and recipe.periodic for a in channels.angular)
    trains = isinstance(recipe, StageRecipe)
    state = not trains or recipe.loss == "state"
    periodic = (*angular, *([False] * channels.n_q if state else []))
    span = np.where(
        moving_coordinates(experiments), _spread([e.q.var(axis=0) for e in experiments]), 0.0
    )
    length = ~channels.angular & (span > 0) & trains
    plain = np.where(length, _to_power_of_two(np.where(length, span, 1.0)), _STILL_UNIT)
    if not recipe.scaled:
        return Residual(periodic, tuple(np.tile(plain, 2 if state else 1).tolist()))
    mixed = len({c.kind for c in channels.coordinates}) > 1
    position = np.where(span > 0, span, _STILL_UNIT) if mixed else plain
    if trains:
        position = _to_power_of_two(position)
    if not state:
        return Residual(periodic, tuple(position.tolist()))
    speed = _spread([np.mean(e.velocities() ** 2, axis=0) for e in experiments])
    speed = np.where(speed > 0, speed, _STILL_UNIT)
    # a coordinate that never moves does not count
    rate = speed / np.where(span > 0, span, 1.0)
    velocity = np.where(span > 0, position * (_to_power_of_two(rate) if trains else rate), np.inf)
    return Residual(periodic, (*position.tolist(), *velocity.tolist()))


def robust_weights(
    kind: Robust, errors: Float[np.ndarray, "n n_q"], counts: Float[np.ndarray, " n_q"]
) -> Float[np.ndarray, "n n_q"]:
    """The weights of squared residuals in the next step of iteratively reweighted least squares.

    With `z` the residual over its channel's scale: `min(1, 1.345 / |z|)` (Huber), or
    `1 / (1 + z^2 / 4)` (Student's t). The scale is 1.4826 times the median absolute deviation,
    never below the error that rounding to an encoder's counts makes.

    Args:
        kind: the rule.
        errors: simulated minus measured positions, (n, n_q) [rad or m].
        counts: the encoders' counts, 0 where unknown, (n_q,) [rad or m].

    Returns:
        Weights of 0 to 1.

    References:
        Huber (1981), Robust Statistics. Lange, Little, Taylor (1989), Robust statistical
        modeling using the t distribution. Holland, Welsch (1977), Robust regression using
        iteratively reweighted least-squares.
    """
    if kind == "none":
        return np.ones_like(errors)
    least = np.maximum(np.nan_to_num(counts) / np.sqrt(12), _LEAST_SCALE)
    deviation = np.median(np.abs(errors - np.median(errors, axis=0)), axis=0)
    z = np.abs(errors) / np.maximum(TO_DEVIATION * deviation, least)
    if kind == "huber":
        return _HUBER / np.maximum(z, _HUBER)
    return 1 / (1 + z**2 / 4.0)  # Student's t of 4 degrees of freedom


def _to_power_of_two(units: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Units rounded to powers of two, above 0."""
    return 2.0 ** np.round(np.log2(units))


def _spread(squares: Sequence[np.ndarray]) -> np.ndarray:
    """The square root of the mean over records."""
    return np.sqrt(np.mean(squares, axis=0))
