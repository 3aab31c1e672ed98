"""Initial states fitted to the first samples of records by the engine.

What `fitted_start.model_starts` does where it is part of a compiled training, step for step.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.engine.equations import Residual
from tustinnet.engine.runs import Comparison, Directions, Samples, compare
from tustinnet.models.contract import Model
from tustinnet.simulate.drive import Drive
from tustinnet.simulate.fitted_start import (
    EXPLAINED,
    FIRST_DAMPING,
    HELD,
    HELD_TURNS,
    TURNS,
    position_weights,
    sample_shares,
)
from tustinnet.simulate.simulation import ModelEquations, equations_of

_KEPT: dict[int, Residual] = {}


@dataclass(frozen=True)
class StateFit:
    """States fitted to the first samples of records.

    Attributes:
        x: the states, (records, n_x).
        share: what the samples of each weigh, (records, samples).
    """

    x: Float[np.ndarray, "records n_x"]
    share: Float[np.ndarray, "records samples"]


def positions(n_q: int) -> Residual:
    """Errors of positions that count as they are."""
    return _KEPT.setdefault(n_q, Residual(lambda error: error, n_q))


def fitted_states(
    model: Model,
    guess: Float[np.ndarray, "records n_x"],
    drive: Drive,
    q: Float[np.ndarray, "records samples n_q"],
) -> StateFit:
    """Initial states by least squares through the model, see `fitted_start.model_starts`.

    Args:
        model: the model.
        guess: where the search begins, (records, n_x).
        drive: what acts between the samples, (records, samples - 1, ...).
        q: measured positions, (records, samples, n_q).
    """
    guess = np.asarray(guess, np.float64)
    count, samples, n_x = len(guess), q.shape[1], guess.shape[1]
    most = HELD_TURNS if model.internal else 0
    rising, even = sample_shares(samples)
    shares = np.stack([rising, rising, even] if most else [rising, even])
    turns_held = np.array([0, most, 0] if most else [0, 0])
    variants = len(shares)
    # every record with every way of weighing, all side by side
    share = np.repeat(shares[None], count, axis=0).reshape(-1, samples)
    held = np.tile(turns_held, count)
    start = np.repeat(guess, variants, axis=0)
    fit = _Problem(model, start, drive, np.asarray(q, np.float64), share, variants)

    best, tried = start.copy(), start.copy()
    cost = np.full(len(start), np.inf)
    products, gradient = np.zeros((len(start), n_x, n_x)), np.zeros((len(start), n_x))
    damping = np.full(len(start), 10 * FIRST_DAMPING)
    for turn in range(most + 1 + TURNS):
        # from the first free turn on costs are others: what was best is tried again
        fresh = turn == held
        cost[fresh], tried[fresh], damping[fresh] = np.inf, best[fresh], 10 * FIRST_DAMPING
        there = fit.at(tried, np.where(turn < held, HELD, 1.0))
        better = (there.cost < cost) & (turn <= held + TURNS)
        best[better], cost[better] = tried[better], there.cost[better]
        products[better], gradient[better] = there.products[better], there.gradient[better]
        damping = np.where(better, damping / 10, damping * 10)
        tried = best - newton_step(products, gradient, damping)
    explained = cost <= EXPLAINED**2 * q.shape[2] * np.sum(share**2, axis=1)
    explained = explained.reshape(count, variants)
    explained[:, -1] = True
    chosen = np.argmax(explained, axis=1) + variants * np.arange(count)
    return StateFit(best[chosen], share[chosen])


class _Problem:
    """Squares of position errors and of departures of internal states, at given states."""

    def __init__(
        self, model: Model, guess: np.ndarray, drive: Drive, q: np.ndarray, share: np.ndarray,
        variants: int,
    ) -> None:  # fmt: skip
        self.of: ModelEquations = equations_of(model, drive)
        self._guess, self._internal = guess, model.channels.internal
        self._spread = np.asarray(model.internal_spread, np.float64)
        self._drive = Drive(np.repeat(np.asarray(drive.u), variants, axis=0))
        weight = share[:, :, None] * position_weights(model)
        n_q = q.shape[2]
        self._samples = Samples(
            np.repeat(q, variants, axis=0).reshape(-1, n_q), weight.reshape(-1, n_q)
        )
        self._residual = positions(n_q)

    def at(self, x: np.ndarray, near: np.ndarray) -> Comparison:
        """The products at some states; internal ones are kept so many times as near."""
        count, n_x = x.shape
        directions = Directions(np.tile(np.eye(n_x), (count, 1, 1)), parameters=False)
        runs = self.of.runs(x, self._drive)
        found = compare(
            self.of.equations, self._residual, runs, self.of.substeps, directions, self._samples
        )
        precision = (near[:, None] / self._spread) ** 2
        away = (x - self._guess)[:, self._internal]
        places = np.arange(n_x)[self._internal]
        found.products[:, places, places] += precision
        found.gradient[:, places] += precision * away
        with np.errstate(over="ignore", invalid="ignore"):
            found.cost[...] += np.sum(precision * away**2, axis=1)
        return found


def newton_step(
    products: Float[np.ndarray, "records n_x n_x"],
    gradient: Float[np.ndarray, "records n_x"],
    damping: Float[np.ndarray, " records"],
) -> Float[np.ndarray, "records n_x"]:
    """Damped Gauss-Newton steps, each state in units of its own size."""
    size = np.sqrt(np.einsum("rii->ri", products))
    size = np.where(size > 0, size, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):  # of what diverged
        scaled = products / (size[:, :, None] * size[:, None, :])
        scaled = scaled + damping[:, None, None] * np.eye(size.shape[1])
        return np.linalg.solve(scaled, (gradient / size)[:, :, None])[:, :, 0] / size
