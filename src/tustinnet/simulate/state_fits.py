"""Initial states from which a model explains the first samples of a record best."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.equations import Equations, Residual
from tustinnet.engine.runs import Comparison, Directions, Samples, compare
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised
from tustinnet.simulate.drive import Drive
from tustinnet.simulate.engine_rollouts import layered_steps
from tustinnet.simulate.rollout import precision, rollout
from tustinnet.simulate.simulation import equations_of

FEWEST = 3  # samples that say something of a velocity
TURNS = 12  # Levenberg-Marquardt steps; from a parabola 3 or 4 are enough
HELD_TURNS = 8  # before them, with internal states held
HELD = 30.0  # times as near to the guess as they are kept in the end
FIRST_DAMPING = 1e-3
_RISING = 4  # power of its place among the samples with which one weighs
_FEW = 5  # samples for each of these powers: what is left must say a velocity, too
EXPLAINED = 2.5  # standard deviations (root mean square) that a model may leave
_UNKNOWN_ERROR = 1e-3  # [rad or m], of positions whose resolution nobody declared


def position_weights(model: Model) -> Float[np.ndarray, " n_q"]:
    """One over the standard deviation of the positions' errors, (n_q,) [1/rad or 1/m].

    An encoder that counts in steps of `r` errs by `r / sqrt(12)`.
    """
    errors = [r / np.sqrt(12.0) if r else _UNKNOWN_ERROR for r in model.channels.resolution]
    return 1.0 / np.array(errors)


def sample_shares(
    samples: int,
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """What errors weigh by their place among the samples: the more the later, and all the same."""
    places = np.arange(1, samples + 1) / samples
    return places ** min(_RISING, samples / _FEW), np.ones(samples)


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
    """Initial states by least squares through the model.

    Minimises the squared position errors over the samples, each over the encoder's standard
    deviation; internal states are kept near the guess, with the model's `internal_spread` as
    standard deviations. Errors weigh the more, the later they are: that of the k-th of N samples
    (k/N)^4, or (k/N)^(N/5) where there are fewer than 20. At first something else often still acts,
    as a rule the hand that lets go, and a model that is nearly right can take that for an internal
    state. Where more than 2.5 standard deviations (root mean square, weighed) are left, the fault
    is the model's, and all samples weigh the same.

    Levenberg-Marquardt with exact derivatives, in few turns. Where a hand acted, the parabola may
    be far from the motion after it, and internal states then grow to explain that, from where the
    search does not come back in time. So where it explains nothing, it is also begun with internal
    states that are held near the guess.

    Args:
        model: the model.
        guess: where the search begins, (records, n_x).
        drive: what acts between the samples, (records, samples - 1, ...).
        q: measured positions, (records, samples, n_q).
    """
    of = equations_of(model, drive)
    parameters = np.tile(of.parameters, (len(guess), 1))
    return _fit(model, of.equations, parameters, guess, drive, q).x


def fitted_states_in_training(
    model: Model,
    guess: Float[Array, "records n_x"],
    drive: Drive,
    q: Float[Array | np.ndarray, "records samples n_q"],
) -> Float[Array, "records n_x"]:
    """What `fitted_states` says, as a part of a program that JAX compiles.

    Args:
        model: the model, whose numbers may be traced.
        guess: where the search begins, (records, n_x).
        drive: what acts between the samples, (records, samples - 1, ...).
        q: measured positions, (records, samples, n_q).
    """
    kind = precision(model, guess, jnp.asarray(drive.u), jnp.asarray(q))
    variants = _Variants(jnp, model, len(guess), q.shape[1])
    start, each, measured = (
        variants.repeated(jax.tree.map(jnp.asarray, a)) for a in (guess.astype(kind), drive, q)
    )
    weight = jnp.asarray(variants.share[:, :, None] * position_weights(model), kind)
    internal = np.arange(guess.shape[1])[model.channels.internal]
    spread = model.internal_spread.astype(kind)
    by_engine = None
    if drive.periods is None:
        by_engine = layered_steps(model, each.u.shape[2:], kind)

    def products(x: Array) -> tuple[Array, Array, Array]:
        if by_engine is not None:
            residual = positions(q.shape[2])
            return by_engine.compare(x, each.u, residual, measured.astype(kind), weight)
        return jax.vmap(partial(_products, model))(x, each, measured, weight)

    def squares(x: Array, near: Array) -> tuple[Array, Array, Array]:
        by_two, by_one, cost = products(x)
        precisions = (near[:, None] / spread) ** 2
        away = (x - start)[:, internal]
        return (
            by_two.at[:, internal, internal].add(precisions),
            by_one.at[:, internal].add(precisions * away),
            cost + jnp.sum(precisions * away**2, axis=1),
        )

    x, cost = variants.search(squares, start, jax.lax.fori_loop)
    chosen = variants.chosen(cost, q.shape[2])
    return x[chosen]


def _products(
    model: Model, x: Array, drive: Drive, q: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Products of position errors and their derivatives by the initial state, by JAX."""

    def residuals(x: Array) -> tuple[Array, Array]:
        errors = ((rollout(model, x, drive)[:, model.channels.position] - q) * weight).ravel()
        return errors, errors

    jacobian, found = jax.jacfwd(residuals, has_aux=True)(x)
    return jacobian.T @ jacobian, jacobian.T @ found, jnp.sum(found**2)


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
    n_x = guess.shape[1]
    variants = _Variants(np, model, len(guess), q.shape[1])
    start, each, measured, driven = (
        variants.repeated(a) for a in (guess, parameters, q, np.asarray(drive.u))
    )
    squares = _Squares(model, equations, each, start, Drive(driven), measured, variants.share)
    directions = Directions(np.tile(np.eye(n_x), (len(start), 1, 1)), parameters=False)

    def at(x: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, ...]:
        there = squares.at(x, near, directions)
        return there.products, there.gradient, there.cost

    with np.errstate(over="ignore", invalid="ignore"):  # of what diverges
        x, cost = variants.search(at, start, _loop)
    chosen = variants.chosen(cost, q.shape[2])
    return StateFit(x[chosen], variants.share[chosen])


def _loop(begin: int, end: int, turn: Callable[[int, Any], Any], carry: Any) -> Any:
    """What `jax.lax.fori_loop` does."""
    for i in range(begin, end):
        carry = turn(i, carry)
    return carry


class _Variants:
    """Every record with every way of weighing its samples, all side by side.

    Args:
        xp: NumPy, or JAX's.
        model: the model.
        count: how many records.
        samples: how many of each.
    """

    def __init__(self, xp: Any, model: Model, count: int, samples: int) -> None:
        self._xp, self._count = xp, count
        self._most = HELD_TURNS if model.internal else 0
        rising, even = sample_shares(samples)
        # the first that explains the samples is taken, or the last
        shares = [rising, rising, even] if self._most else [rising, even]
        self._held = np.tile([0, self._most, 0] if self._most else [0, 0], count)
        self._ways = len(shares)
        self.share = np.tile(np.stack(shares), (count, 1))

    def repeated(self, arrays: Any) -> Any:
        """Arrays of the records, for every variant."""
        return jax.tree.map(lambda a: self._xp.repeat(a, self._ways, axis=0), arrays)

    def search(
        self, squares: Callable[..., tuple[Any, ...]], start: Any, loop: Callable[..., Any]
    ) -> tuple[Any, Any]:
        """Levenberg-Marquardt, some turns with internal states held, then with free ones.

        Args:
            squares: of states, and of how near to the guess internal ones are kept: products of
                derivatives, of derivatives and residuals, and the cost.
            start: where it begins.
            loop: what does turns one after the other, as `jax.lax.fori_loop`.

        Returns:
            The best states and their cost.
        """
        xp, held = self._xp, self._held
        count, n_x = start.shape
        first = xp.full(count, 10 * FIRST_DAMPING, start.dtype)

        def turn(i: Any, carry: tuple[Any, ...]) -> tuple[Any, ...]:
            best, tried, cost, products, gradient, damping = carry
            # from the first free turn on costs are others: what was best is tried again
            fresh = i == held
            cost = xp.where(fresh, xp.inf, cost).astype(start.dtype)
            tried = xp.where(fresh[:, None], best, tried)
            damping = xp.where(fresh, first, damping)
            near = xp.where(i < held, HELD, 1.0).astype(start.dtype)
            by_two, by_one, there = squares(tried, near)
            better = (there < cost) & (i <= held + TURNS)
            best = xp.where(better[:, None], tried, best)
            cost = xp.where(better, there, cost)
            products = xp.where(better[:, None, None], by_two, products)
            gradient = xp.where(better[:, None], by_one, gradient)
            damping = xp.where(better, damping / 10, damping * 10)
            tried = best - newton_step(products, gradient, damping, xp)
            return best, tried, cost, products, gradient, damping

        begun = (
            start, start, xp.full(count, xp.inf, start.dtype),
            xp.zeros((count, n_x, n_x), start.dtype), xp.zeros((count, n_x), start.dtype), first,
        )  # fmt: skip
        best, _, cost, *_ = loop(0, self._most + 1 + TURNS, turn, begun)
        return best, cost

    def chosen(self, cost: Any, n_q: int) -> Any:
        """Of every record the first variant that explains its samples, or the last."""
        xp = self._xp
        explained = cost <= EXPLAINED**2 * n_q * np.sum(self.share**2, axis=1)
        last = np.arange(self._ways) == self._ways - 1
        explained = explained.reshape(self._count, self._ways) | last
        return xp.argmax(explained, axis=1) + self._ways * np.arange(self._count)


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
    products: Float[Array | np.ndarray, "records n_x n_x"],
    gradient: Float[Array | np.ndarray, "records n_x"],
    damping: Float[Array | np.ndarray, " records"],
    xp: Any = np,
) -> Any:
    """Damped Gauss-Newton steps, each state in units of its own size, (records, n_x).

    Args:
        products: of derivatives.
        gradient: of derivatives and residuals.
        damping: added to the scaled products.
        xp: NumPy, or JAX's.
    """
    size = xp.sqrt(xp.einsum("rii->ri", products))
    size = xp.where(size > 0, size, 1.0)
    scaled = products / (size[:, :, None] * size[:, None, :])
    scaled = scaled + damping[:, None, None] * xp.eye(size.shape[1], dtype=size.dtype)
    return xp.linalg.solve(scaled, (gradient / size)[:, :, None])[:, :, 0] / size
