"""Runs of equations by JAX, compiled by XLA: the alternative to `by_machine_code`."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.equations import Equations, Formula, ResidualFormula
from tustinnet.engine.runs import Comparison, Directions, Runs, Samples


def simulate(equations: Equations, runs: Runs, substeps: int) -> Float[np.ndarray, "rows n_x"]:
    """The states at all samples, run after run; see `runs.simulate`."""
    longest = int(np.max(runs.steps, initial=0))
    rows = _rows(runs, longest)
    measured = None if runs.measured is None else runs.measured[rows]
    counts = runs.measured_samples
    counts = np.zeros(len(rows), int) if counts is None else counts
    states = _states(
        equations,
        substeps,
        runs.start,
        runs.parameters,
        runs.drive[rows],
        _periods(runs, rows),
        measured,
        counts,
    )
    return _run_after_run(runs, np.asarray(states))


def compare(
    equations: Equations,
    residual: ResidualFormula,
    runs: Runs,
    substeps: int,
    directions: Directions,
    samples: Samples,
) -> Comparison:
    """Products of residuals and derivatives, see `runs.compare`."""
    longest = int(np.max(runs.steps, initial=0))
    rows = _rows(runs, longest)
    running = np.arange(longest + 1) <= runs.steps[:, None]
    weight = samples.weight[rows] * running[:, :, None]
    products, gradient, cost, error = _products(
        equations,
        residual,
        substeps,
        directions.parameters,
        runs.start,
        runs.parameters,
        directions.seeds,
        runs.drive[rows],
        _periods(runs, rows),
        samples.target[rows],
        weight,
    )
    return Comparison(
        np.array(products),
        np.array(gradient),
        np.array(cost),
        _run_after_run(runs, np.asarray(error)),
    )


def evaluate(
    formula: Formula, points: Float[np.ndarray, "n n_in"], *, derivatives: bool
) -> Float[np.ndarray, "n n_out"]:
    """Values of a formula, or its derivatives, at many points; see `runs.evaluate`."""
    return np.array(_values(formula, derivatives, points)).reshape(len(points), -1)


def compile_formula(formula: Formula, *, derivatives: bool) -> None:
    """Nothing: programs are compiled for a number of points; see `runs.compile_formula`."""


def make_step(equations: Equations) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A function that steps a discrete model once; see `runs.make_step`."""
    program = _compile(equations, lambda x: x)
    return lambda state, inputs: np.asarray(program(state, inputs))


def make_linearised_step(
    equations: Equations,
) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A function that steps and linearises a discrete model; see `runs.make_linearised_step`."""
    program = _compile(
        equations, lambda f: jax.jacfwd(lambda x, u: (f(x, u),) * 2, argnums=(0, 1), has_aux=True)
    )

    def step(state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (a, b), following = program(state, inputs)
        return np.asarray(following), np.asarray(a), np.asarray(b)

    return step


def _compile(equations: Equations, change: Callable[..., Any]) -> Callable[..., Any]:
    """The step of a discrete model by its state and inputs, as `change` changes it, compiled."""
    none = jnp.zeros(0)
    function = change(lambda x, u: equations.function(x, u, none, none))
    shapes = np.zeros(equations.n_x), np.zeros(equations.n_u)
    program = jax.jit(function).lower(*shapes).compile()
    return lambda state, inputs: program(np.asarray(state, float), np.asarray(inputs, float))


def _rows(runs: Runs, longest: int) -> np.ndarray:
    """Rows of the samples of every run; of shorter ones the last is repeated."""
    places = np.minimum(np.arange(longest + 1), runs.steps[:, None])
    return runs.first[:, None] + places


def _periods(runs: Runs, rows: np.ndarray) -> np.ndarray:
    """The period of each step; a run that has ended stands still."""
    running = np.arange(rows.shape[1]) < runs.steps[:, None]
    return np.where(running, runs.periods[rows], 0.0)


def _run_after_run(runs: Runs, padded: np.ndarray) -> np.ndarray:
    if not len(padded):
        return np.zeros((0, padded.shape[-1]))
    return np.concatenate([x[: n + 1] for x, n in zip(padded, runs.steps, strict=True)])


def _next_state(
    equations: Equations, substeps: int, x: Array, p: Array, pieces: Array, period: Array
) -> Array:
    """The state a period later."""
    n_p = equations.n_p
    held = ()
    if equations.sampled is not None:
        x, *held = equations.sampled.function(x, pieces[0], p[:n_p], p[n_p:])

    def at(state: Array, part: Array | float) -> Array:
        """The equations at a state and a part of the period."""
        inputs = pieces[-1]
        for coefficient in pieces[-2::-1]:
            inputs = coefficient + part * inputs
        return equations.function(state, inputs, p[:n_p], p[n_p:], *held)

    if not equations.continuous:
        return at(x, 0.0)
    h = period / substeps

    def step(i: Array, x: Array) -> Array:
        begin, middle, end = (i + part for part in (0.0, 0.5, 1.0))
        first = at(x, begin / substeps)
        second = at(x + h / 2 * first, middle / substeps)
        third = at(x + h / 2 * second, middle / substeps)
        fourth = at(x + h * third, end / substeps)
        return x + h / 6 * (first + 2 * second + 2 * third + fourth)

    # a loop of a fixed number of turns can be differentiated forwards
    return jax.lax.fori_loop(0, substeps, step, x)


def _run(
    equations: Equations,
    substeps: int,
    x0: Array,
    p: Array,
    u: Array,
    periods: Array,
    measured: Array | None = None,
    measured_samples: Array | int = 0,
) -> Array:
    """The states of one run."""

    def step(x: Array, k: Array) -> tuple[Array, Array]:
        current = x
        if measured is not None:
            corrected = jnp.concatenate([measured[k], x[measured.shape[1] :]])
            current = jnp.where(k < measured_samples, corrected, x)
        return _next_state(equations, substeps, current, p, u[k], periods[k]), x

    end, states = jax.lax.scan(step, x0, jnp.arange(len(u) - 1))
    return jnp.concatenate([states, end[None]])


@partial(jax.jit, static_argnums=(0, 1))
def _states(equations: Equations, substeps: int, *arrays: Any) -> Array:
    """The states of runs side by side, by the arrays that `_run` takes of each."""
    return jax.vmap(partial(_run, equations, substeps))(*arrays)


@partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _products(
    equations: Equations,
    residual: ResidualFormula,
    substeps: int,
    by_parameters: bool,
    start: Array,
    parameters: Array,
    seeds: Array,
    drive: Array,
    periods: Array,
    target: Array,
    weight: Array,
) -> tuple[Array, Array, Array, Array]:
    n_d = seeds.shape[1]
    # the derivative of the parameters along each direction
    dp = jnp.eye(n_d, parameters.shape[1])
    dp = dp * (jnp.arange(n_d) < equations.n_p)[:, None] * by_parameters

    def run(
        x0: Array, p: Array, dx0: Array, u: Array, h: Array, target: Array, weight: Array
    ) -> tuple[Array, Array, Array, Array]:
        def errors(x0: Array, p: Array) -> Array:
            return _run(equations, substeps, x0, p, u, h)[:, : residual.n_y] - target

        def along(dx0: Array, dp: Array) -> Array:
            return jax.jvp(errors, (x0, p), (dx0, dp))[1]

        error, changes = errors(x0, p), jax.vmap(along)(dx0, dp)
        value, slope = jax.jvp(jax.vmap(residual.function), (error,), (jnp.ones_like(error),))
        is_counted = weight > 0
        r = jnp.where(is_counted, value * weight, 0.0)
        jacobian = changes * slope * weight
        return (
            jnp.einsum("aki,bki->ab", jacobian, jacobian),
            jnp.einsum("aki,ki->a", jacobian, r),
            jnp.sum(r**2),
            jnp.where(is_counted, error, 0.0),
        )

    return jax.vmap(run)(start, parameters, seeds, drive, periods, target, weight)


@partial(jax.jit, static_argnums=(0, 1))
def _values(formula: Formula, derivatives: bool, points: Array) -> Array:
    if not derivatives:
        return jax.vmap(formula.function)(points)
    by = slice(None) if formula.by is None else np.array(formula.by)
    return jax.vmap(jax.jacfwd(formula.function))(points)[..., by]
