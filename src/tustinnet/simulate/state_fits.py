"""Initial states fitted to the first samples of records by the engine.

What `fitted_start.model_starts` does where it is part of a compiled training, step for step.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from tustinnet.engine.equations import Equations, Residual
from tustinnet.engine.runs import Comparison, Directions, Samples, compare
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised
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
from tustinnet.simulate.simulation import equations_of


@dataclass(frozen=True)
class StateFit:
    """States fitted to the first samples of records.

    Attributes:
        x: the states, (records, n_x).
        share: what the samples of each weigh, (records, samples).
    """

    x: Float[np.ndarray, "records n_x"]
    share: Float[np.ndarray, "records samples"]


@lru_cache  # so that it is read and compiled once
def positions(n_q: int) -> Residual:
    """Errors of positions that count as they are."""
    return Residual(lambda error: error, n_q)


def fitted_states(
    model: Model,
    guess: Float[np.ndarray, "records n_x"],
    drive: Drive,
    q: Float[np.ndarray, "records samples n_q"],
) -> Float[np.ndarray, "records n_x"]:
    """Initial states by least squares through the model, see `fitted_start.model_starts`.

    Args:
        model: the model.
        guess: where the search begins, (records, n_x).
        drive: what acts between the samples, (records, samples - 1, ...).
        q: measured positions, (records, samples, n_q).
    """
    of = equations_of(model, drive)
    parameters = np.tile(of.parameters, (len(guess), 1))
    return _fit(model, of.equations, parameters, guess, drive, q).x


def fitted_with_derivatives(
    model: Discretised,
    equations: Equations,
    parameters: Float[np.ndarray, "records n_c"],
    guess: Float[np.ndarray, "records n_x"],
    by_guess: Float[np.ndarray, "records n_p n_x"],
    drive: Drive,
    q: Float[np.ndarray, "records samples n_q"],
) -> tuple[Float[np.ndarray, "records n_x"], Float[np.ndarray, "records n_p n_x"]]:
    """Initial states fitted to samples, and their derivatives by parameters of the equations.

    By the theorem of implicit functions, without the second derivatives of the residuals (as in
    Gauss-Newton).

    Args:
        model: the model, for the layout of its states and how inputs act.
        equations: its equations, with derivatives by `n_p` parameters.
        parameters: what the equations take of parameters, one row a record.
        guess: where the search begins.
        by_guess: derivatives of the guess by the parameters.
        drive: what acts between the samples, (records, samples - 1, ...).
        q: measured positions.
    """
    fit = _fit(model, equations, parameters, guess, drive, q)
    count, n_x = fit.x.shape
    n_p = equations.n_p
    squares = _Squares(model, equations, parameters, guess, drive, q, fit.share)
    seeds = np.zeros((count, n_p + n_x, n_x))
    seeds[:, n_p:] = np.eye(n_x)
    there = squares.at(fit.x, np.ones(count), Directions(seeds, parameters=True))
    mixed = there.products[:, n_p:, :n_p]
    internal = np.arange(n_x)[model.channels.internal]
    # the guess itself moves, and with it what internal states are kept near
    mixed[:, internal] -= squares.precision(np.ones(count))[:, :, None] * np.swapaxes(
        by_guess[:, :, internal], 1, 2
    )
    columns = [
        -newton_step(there.products[:, n_p:, n_p:], mixed[:, :, i], np.zeros(count))
        for i in range(n_p)
    ]
    return fit.x, np.stack(columns, axis=1) if columns else np.zeros((count, 0, n_x))


def _fit(
    model: Model, equations: Equations, parameters: np.ndarray, guess: np.ndarray, drive: Drive,
    q: np.ndarray,
) -> StateFit:  # fmt: skip
    guess, q = np.asarray(guess, np.float64), np.asarray(q, np.float64)
    count, samples, n_x = len(guess), q.shape[1], guess.shape[1]
    most = HELD_TURNS if model.internal else 0
    rising, even = sample_shares(samples)
    shares = np.stack([rising, rising, even] if most else [rising, even])
    turns_held = np.array([0, most, 0] if most else [0, 0])
    variants = len(shares)
    # every record with every way of weighing, all side by side
    share = np.repeat(shares[None], count, axis=0).reshape(-1, samples)
    held = np.tile(turns_held, count)
    start, each, measured, driven = (
        np.repeat(a, variants, axis=0) for a in (guess, parameters, q, np.asarray(drive.u))
    )
    squares = _Squares(model, equations, each, start, Drive(driven), measured, share)
    directions = Directions(np.tile(np.eye(n_x), (len(start), 1, 1)), parameters=False)

    best, tried = start.copy(), start.copy()
    cost = np.full(len(start), np.inf)
    products, gradient = np.zeros((len(start), n_x, n_x)), np.zeros((len(start), n_x))
    damping = np.full(len(start), 10 * FIRST_DAMPING)
    for turn in range(most + 1 + TURNS):
        # from the first free turn on costs are others: what was best is tried again
        fresh = turn == held
        cost[fresh], tried[fresh], damping[fresh] = np.inf, best[fresh], 10 * FIRST_DAMPING
        there = squares.at(tried, np.where(turn < held, HELD, 1.0), directions)
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


class _Squares:
    """Squares of position errors and of departures of internal states, at given states."""

    def __init__(
        self, model: Model, equations: Equations, parameters: np.ndarray, guess: np.ndarray,
        drive: Drive, q: np.ndarray, share: np.ndarray,
    ) -> None:  # fmt: skip
        of = equations_of(model, drive)
        self._equations, self._guess, self._substeps = equations, guess, of.substeps
        self._runs = replace(of.runs(guess, drive), parameters=parameters)
        self._internal = np.arange(guess.shape[1])[model.channels.internal]
        self._spread = np.asarray(model.internal_spread, np.float64)
        weight, n_q = share[:, :, None] * position_weights(model), q.shape[2]
        self._samples = Samples(q.reshape(-1, n_q), weight.reshape(-1, n_q))
        self._residual = positions(n_q)

    def precision(self, near: np.ndarray) -> Float[np.ndarray, "records n_z"]:
        """What squared departures of internal states weigh, kept so many times as near."""
        return (near[:, None] / self._spread) ** 2

    def at(self, x: np.ndarray, near: np.ndarray, directions: Directions) -> Comparison:
        """The products at some states, the last directions those of the states."""
        runs = replace(self._runs, start=x)
        found = compare(
            self._equations, self._residual, runs, self._substeps, directions, self._samples
        )
        precision = self.precision(near)
        away = (x - self._guess)[:, self._internal]
        places = directions.seeds.shape[1] - x.shape[1] + self._internal
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
