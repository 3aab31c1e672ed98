"""Initial states from which a model explains the first samples of a record best."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.engines import compare
from tustinnet.engine.equations import Equations, ResidualFormula
from tustinnet.engine.runs import Directions, Samples
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised
from tustinnet.simulate.engine_rollouts import layered_steps
from tustinnet.simulate.input_signal import InputSignal
from tustinnet.simulate.rollout import precision, rollout
from tustinnet.simulate.simulation import model_equations

FEWEST_FOR_A_VELOCITY = 3  # samples that say something of a velocity
ITERATIONS = 12  # of Levenberg-Marquardt; from a parabola 3 or 4 are enough
CONSTRAINED_ITERATIONS = 8  # before them, with internal states kept near the guess
CONSTRAINT = 30.0  # times as near to it as in the end
FIRST_DAMPING = 1e-3
_RISING = 4  # power of its place among the samples with which one weighs
_SAMPLES_A_POWER = 5  # samples for each of these powers: those that weigh must say a velocity, too
_REACH = 10.0  # times what the samples move, and how fast: as far a start may be from its guess
EXPLAINED = 2.5  # standard deviations (root mean square) of errors that a model explains
_UNKNOWN_ERROR = 1e-3  # [rad or m], of positions whose resolution nobody declared
_LEAST_DAMPING = 1e-12  # with which states that samples cannot tell apart stay finite


def position_weights(model: Model) -> Float[np.ndarray, " n_q"]:
    """One over the standard deviation of the positions' errors, (n_q,) [1/rad or 1/m].

    An encoder that counts in steps of `r` errs by `r / sqrt(12)`.
    """
    errors = [r / np.sqrt(12.0) if r else _UNKNOWN_ERROR for r in model.channels.resolution]
    return 1.0 / np.array(errors)


def sample_shares(
    samples: int,
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Weights of errors by their place among the samples: the more the later, and all the same."""
    places = np.arange(1, samples + 1) / samples
    return places ** min(_RISING, samples / _SAMPLES_A_POWER), np.ones(samples)


def _state_spread(
    xp: Any,
    model: Model,
    q: Float[Array | np.ndarray, "records samples n_q"],
    internal: Float[Array | np.ndarray, " n_z"],
) -> Any:
    """Standard deviations of states about a guess from the first samples, (records, n_x).

    Positions and velocities are some times as far off as the samples move, and as fast; else those
    of which a stiff model keeps nothing would be anywhere. Means, as a sample that jumps says
    nothing of the others.

    Args:
        xp: NumPy, or JAX's.
        model: the model.
        q: the samples.
        internal: those of internal states.
    """
    error = 1 / position_weights(model)
    travel = error + xp.mean(xp.abs(q - q[:, :1]), axis=1)
    speed = (error + xp.mean(xp.abs(xp.diff(q, axis=1)), axis=1)) / model.channels.dt
    of_internal = xp.broadcast_to(internal, (len(q), len(internal)))
    return xp.concatenate([_REACH * travel, _REACH * speed, of_internal], axis=1)


@lru_cache  # so that it is read and compiled once
def position_residual(n_q: int) -> ResidualFormula:
    """The residual of positions: their errors as they are."""
    return ResidualFormula(lambda error: error, n_q)


def fit_states(
    model: Model,
    guess: Float[np.ndarray, "records n_x"],
    signal: InputSignal,
    q: Float[np.ndarray, "records samples n_q"],
) -> Float[np.ndarray, "records n_x"]:
    """Initial states by least squares through the model.

    Minimises the squared position errors over the samples, each over the encoder's standard
    deviation; states are kept near the guess, internal ones with the model's `internal_spread` as
    standard deviations, others with ten times what the samples move and how fast. Errors weigh the
    more, the later they are: that of the k-th of N samples (k/N)^4, or (k/N)^(N/5) where there are
    fewer than 20. The first samples are often disturbed, as a rule by the hand that releases the
    system, and a model that is nearly right can take that for an internal state. Where errors of
    more than 2.5 standard deviations (root mean square, weighed) remain, the fault is the model's,
    and all samples weigh the same.

    Levenberg-Marquardt with exact derivatives, in few iterations. Where a hand acted, the parabola
    may be far from the motion after it, and internal states then grow to explain that, from where
    the search does not come back in time. So where it explains nothing, it is also started with
    internal states that are kept near the guess.

    Args:
        model: the model.
        guess: states at which the search begins, (records, n_x).
        signal: what acts between the samples, (records, samples - 1, ...).
        q: measured positions, (records, samples, n_q).
    """
    engine_model = model_equations(model, signal)
    parameters = np.tile(engine_model.parameters, (len(guess), 1))
    return _fit(model, engine_model.equations, parameters, guess, signal, q)[0]


def fit_states_traced(
    model: Model,
    guess: Float[Array, "records n_x"],
    signal: InputSignal,
    q: Float[Array | np.ndarray, "records samples n_q"],
) -> Float[Array, "records n_x"]:
    """Initial states by `fit_states`, as a part of a program that JAX compiles.

    Args:
        model: the model, whose numbers may be traced.
        guess: states at which the search begins, (records, n_x).
        signal: what acts between the samples, (records, samples - 1, ...).
        q: measured positions, (records, samples, n_q).
    """
    kind = precision(model, guess, jnp.asarray(signal.u), jnp.asarray(q))
    variants = _Variants(jnp, model, len(guess), q.shape[1])
    start, repeated, measured = (
        variants.repeat(jax.tree.map(jnp.asarray, a)) for a in (guess.astype(kind), signal, q)
    )
    weight = jnp.asarray(variants.share[:, :, None] * position_weights(model), kind)
    spread = _state_spread(jnp, model, measured, model.internal_spread).astype(kind)
    engine_steps = None
    if signal.periods is None:
        engine_steps = layered_steps(model, repeated.u.shape[2:], kind)

    def products_by_jax(
        x: Array, signal: InputSignal, q: Array, weight: Array
    ) -> tuple[Array, Array, Array]:
        def residuals(x: Array) -> tuple[Array, Array]:
            errors = ((rollout(model, x, signal)[:, model.channels.position] - q) * weight).ravel()
            return errors, errors

        jacobian, errors = jax.jacfwd(residuals, has_aux=True)(x)
        return jacobian.T @ jacobian, jacobian.T @ errors, jnp.sum(errors**2)

    def squares(x: Array, constraint: Array) -> tuple[Array, Array, Array]:
        if engine_steps is not None:
            residual = position_residual(q.shape[2])
            terms = engine_steps.compare(x, repeated.u, residual, measured.astype(kind), weight)
        else:
            terms = jax.vmap(products_by_jax)(x, repeated, measured, weight)
        precision = _departure_precision(jnp, model, spread, constraint)
        return _with_departures(jnp, terms, x - start, precision)

    x, cost = variants.search(squares, start, jax.lax.fori_loop)
    return x[variants.choose(cost, q.shape[2])]


def fit_states_with_derivatives(
    model: Discretised,
    equations: Equations,
    parameters: Float[np.ndarray, "records n_c"],
    guess: Float[np.ndarray, "records n_x"],
    by_guess: Float[np.ndarray, "records n_p n_x"],
    signal: InputSignal,
    q: Float[np.ndarray, "records samples n_q"],
) -> tuple[Float[np.ndarray, "records n_x"], Float[np.ndarray, "records n_p n_x"]]:
    """Initial states fitted to samples, and their derivatives by parameters of the equations.

    By the theorem of implicit functions, without the second derivatives of the residuals (as in
    Gauss-Newton).

    Args:
        model: the model, for the layout of its states and how inputs act.
        equations: its equations, with derivatives by `n_p` parameters.
        parameters: values of the parameters of the equations, one row a record.
        guess: states at which the search begins.
        by_guess: derivatives of the guess by the parameters.
        signal: what acts between the samples, (records, samples - 1, ...).
        q: measured positions.
    """
    x, share = _fit(model, equations, parameters, guess, signal, q)
    count, n_x = x.shape
    n_p, ones = equations.n_p, np.ones(len(x))
    squares = _Squares(model, equations, parameters, guess, signal, q, share)
    seeds = np.zeros((count, n_p + n_x, n_x))
    seeds[:, n_p:] = np.eye(n_x)
    products, _, _ = squares.evaluate(x, ones, Directions(seeds, parameters=True))
    mixed = products[:, n_p:, :n_p]
    # the guess itself moves, and with it the states near which they are kept
    mixed -= squares.precision(ones)[:, :, None] * np.swapaxes(by_guess, 1, 2)
    with np.errstate(over="ignore", invalid="ignore"):  # of runs that diverge
        columns = [
            -newton_step(products[:, n_p:, n_p:], mixed[:, :, i], _LEAST_DAMPING * ones)
            for i in range(n_p)
        ]
    return x, np.stack(columns, axis=1) if columns else np.zeros((count, 0, n_x))


def _fit(
    model: Model,
    equations: Equations,
    parameters: np.ndarray,
    guess: np.ndarray,
    signal: InputSignal,
    q: np.ndarray,
) -> tuple[Float[np.ndarray, "records n_x"], Float[np.ndarray, "records samples"]]:
    """States fitted to the first samples of records, and the weights of these samples."""
    guess, q = np.asarray(guess, np.float64), np.asarray(q, np.float64)
    n_x = guess.shape[1]
    variants = _Variants(np, model, len(guess), q.shape[1])
    start, values, measured, u = (
        variants.repeat(a) for a in (guess, parameters, q, np.asarray(signal.u))
    )
    squares = _Squares(model, equations, values, start, InputSignal(u), measured, variants.share)
    directions = Directions(np.tile(np.eye(n_x), (len(start), 1, 1)), parameters=False)

    def loop(begin: int, end: int, body: Callable[[int, Any], Any], carry: Any) -> Any:
        for i in range(begin, end):
            carry = body(i, carry)
        return carry

    with np.errstate(over="ignore", invalid="ignore"):  # of runs that diverge
        x, cost = variants.search(partial(squares.evaluate, directions=directions), start, loop)
    best = variants.choose(cost, q.shape[2])
    return x[best], variants.share[best]


def _departure_precision(xp: Any, model: Model, spread: Any, constraint: Any) -> Any:
    """Weights of squared departures of states, internal ones kept so many times as near.

    Args:
        xp: NumPy, or JAX's.
        model: the model.
        spread: standard deviations of the states, (records, n_x).
        constraint: how many times as near, (records,).
    """
    is_internal = np.arange(spread.shape[1]) >= model.channels.internal.start
    return (xp.where(is_internal, constraint[:, None], 1.0) / spread) ** 2


def _with_departures(
    xp: Any, terms: tuple[Any, Any, Any], departure: Any, precision: Any
) -> tuple[Any, Any, Any]:
    """Products, gradient and cost of errors, with squared departures of states added.

    Args:
        xp: NumPy, or JAX's.
        terms: products of derivatives (records, n_d, n_d), of derivatives and errors
            (records, n_d), and the cost (records,); the last directions are the states.
        departure: how far these are from the guess, (records, n_x).
        precision: weights of their squares, (records, n_x).
    """
    products, gradient, cost = terms
    n_d, n_x = gradient.shape[1], departure.shape[1]
    states = np.eye(n_d, dtype=gradient.dtype)[n_d - n_x :]
    return (
        products + (states.T * precision[:, None]) @ states,
        gradient + (precision * departure) @ states,
        cost + xp.sum(precision * departure**2, axis=1),
    )


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
        self._constrained = CONSTRAINED_ITERATIONS if model.internal else 0
        rising, even = sample_shares(samples)
        # the first that explains the samples is taken, or the last
        shares = [rising, rising, even] if self._constrained else [rising, even]
        iterations = [0, self._constrained, 0] if self._constrained else [0, 0]
        self._iterations = np.tile(iterations, count)  # with internal states kept near the guess
        self._ways = len(shares)
        self.share = np.tile(np.stack(shares), (count, 1))

    def repeat(self, arrays: Any) -> Any:
        """Arrays of the records, for every variant."""
        return jax.tree.map(lambda a: self._xp.repeat(a, self._ways, axis=0), arrays)

    def search(
        self, squares: Callable[..., tuple[Any, ...]], start: Any, loop: Callable[..., Any]
    ) -> tuple[Any, Any]:
        """Best states by Levenberg-Marquardt, first with internal states kept near the guess.

        Args:
            squares: from states, and how near to the guess internal ones are kept, to products of
                derivatives, of derivatives and residuals, and the cost.
            start: states at which it begins.
            loop: a loop over iterations, as `jax.lax.fori_loop`.

        Returns:
            The best states and their cost.
        """
        xp, constrained = self._xp, self._iterations
        count, n_x = start.shape
        first = xp.full(count, 10 * FIRST_DAMPING, start.dtype)

        def iterate(i: Any, carry: tuple[Any, ...]) -> tuple[Any, ...]:
            best, candidate, cost, products, gradient, damping = carry
            # from the first free iteration on costs are others: the best is evaluated again
            is_fresh = i == constrained
            cost = xp.where(is_fresh, xp.inf, cost).astype(start.dtype)
            candidate = xp.where(is_fresh[:, None], best, candidate)
            damping = xp.where(is_fresh, first, damping)
            constraint = xp.where(i < constrained, CONSTRAINT, 1.0).astype(start.dtype)
            new_products, new_gradient, new_cost = squares(candidate, constraint)
            is_better = (new_cost < cost) & (i <= constrained + ITERATIONS)
            best = xp.where(is_better[:, None], candidate, best)
            cost = xp.where(is_better, new_cost, cost)
            products = xp.where(is_better[:, None, None], new_products, products)
            gradient = xp.where(is_better[:, None], new_gradient, gradient)
            damping = xp.where(is_better, damping / 10, damping * 10)
            candidate = best - newton_step(products, gradient, damping, xp)
            return best, candidate, cost, products, gradient, damping

        initial = (
            start,
            start,
            xp.full(count, xp.inf, start.dtype),
            xp.zeros((count, n_x, n_x), start.dtype),
            xp.zeros((count, n_x), start.dtype),
            first,
        )
        best, _, cost, *_ = loop(0, self._constrained + 1 + ITERATIONS, iterate, initial)
        return best, cost

    def choose(self, cost: Any, n_q: int) -> Any:
        """Indices of the first variant of every record that explains its samples, or the last."""
        xp = self._xp
        is_explained = cost <= EXPLAINED**2 * n_q * np.sum(self.share**2, axis=1)
        is_last = np.arange(self._ways) == self._ways - 1
        is_chosen = is_explained.reshape(self._count, self._ways) | is_last
        return xp.argmax(is_chosen, axis=1) + self._ways * np.arange(self._count)


class _Squares:
    """Squares of position errors and of departures of states, at given states."""

    def __init__(
        self,
        model: Model,
        equations: Equations,
        parameters: np.ndarray,
        guess: np.ndarray,
        signal: InputSignal,
        q: np.ndarray,
        share: np.ndarray,
    ) -> None:
        engine_model = model_equations(model, signal)
        self._equations, self._guess, self._substeps = equations, guess, engine_model.substeps
        self._runs = replace(engine_model.runs(guess, signal), parameters=parameters)
        self._model = model
        self._spread = _state_spread(np, model, q, np.asarray(model.internal_spread, np.float64))
        weight, n_q = share[:, :, None] * position_weights(model), q.shape[2]
        self._samples = Samples(q.reshape(-1, n_q), weight.reshape(-1, n_q))
        self._residual = position_residual(n_q)

    def precision(self, constraint: np.ndarray) -> Float[np.ndarray, "records n_x"]:
        """Weights of squared departures, see `_departure_precision`."""
        return _departure_precision(np, self._model, self._spread, constraint)

    def evaluate(
        self, x: np.ndarray, constraint: np.ndarray, directions: Directions
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Products, gradient and cost at some states; the last directions are those of states."""
        runs = replace(self._runs, start=x)
        errors = compare(
            self._equations, self._residual, runs, self._substeps, directions, self._samples
        )
        terms = errors.products, errors.gradient, errors.cost
        with np.errstate(over="ignore", invalid="ignore"):
            return _with_departures(np, terms, x - self._guess, self.precision(constraint))


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
    # a state that no sample depends on, as the speed of what dry friction holds, stays
    idle = size <= 0
    size = xp.where(idle, 1.0, size)
    scaled = products / (size[:, :, None] * size[:, None, :])
    own = damping[:, None] + idle
    scaled = scaled + own[:, :, None] * xp.eye(size.shape[1], dtype=size.dtype)
    return xp.linalg.solve(scaled, (gradient / size)[:, :, None])[:, :, 0] / size
