"""Runs of equations: both engines do the same, whatever is simulated."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tustinnet as tn
from tustinnet.engine import by_jax, by_machine_code
from tustinnet.engine import engines as engine
from tustinnet.engine.equations import Equations, Formula, ResidualFormula, SampledValues
from tustinnet.engine.runs import Directions, Runs, Samples

SMALL = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def swing(x, u, p, c):
    """A pendulum with a motor, friction and something that remembers."""
    pull = p[0] * u[0] - p[1] * x[1] - c[0] * jnp.sin(x[0]) - 0.1 * jnp.tanh(x[1] / 0.2) + x[2]
    return jnp.stack([x[1], pull / (1 + 0.1 * jnp.cos(x[0])), -jnp.abs(x[1]) - p[1] * x[2]])


CONTINUOUS = Equations(swing, n_x=3, n_u=1, n_p=2, n_c=1)
DISCRETE = Equations(
    lambda x, u, p, c: x + 0.05 * swing(x, u, p, c), n_x=3, n_u=1, n_p=2, n_c=1, continuous=False
)
SAMPLED = Equations(
    lambda x, u, p, c, held: swing(x, u + held, p, c),
    n_x=3,
    n_u=1,
    n_p=2,
    n_c=1,
    # the second state settles, and the value is held until the next sample
    sampled=SampledValues(
        lambda x, u, p, c: (
            x.at[1].set(jnp.clip(x[1], -0.5, 0.5)),
            p[1] * (u - x[:1]) - c[0] * x[1:2],
        ),
        1,
    ),
)
PLAIN = ResidualFormula(lambda error: error, 2)
PERIODIC = ResidualFormula(lambda error: jnp.stack([2 * jnp.sin(error[0] / 2), error[1]]), 2)


def made(seed: int, lengths: list[int], order: int = 1) -> tuple[Runs, Samples]:
    generator = np.random.default_rng(seed)
    steps = np.array(lengths)
    rows = int(np.sum(steps + 1))
    shape = (rows, order, 1)
    runs = Runs(
        start=generator.normal(size=(len(steps), 3)),
        parameters=generator.uniform(0.3, 1.5, (len(steps), 3)),
        steps=steps,
        first=np.cumsum(steps + 1) - steps - 1,
        drive=generator.normal(size=shape) / (1 + np.arange(order))[:, None],
        periods=generator.uniform(0.02, 0.06, rows),
    )
    weight = generator.uniform(0, 1, (rows, 2)) * (generator.uniform(size=(rows, 2)) > 0.2)
    return runs, Samples(generator.normal(size=(rows, 2)), weight)


def alike(result: np.ndarray, expected: np.ndarray) -> None:
    scale = np.abs(expected).max(initial=1e-300)
    np.testing.assert_allclose(result, expected, rtol=1e-10, atol=1e-11 * scale)


# JAX compiles for each
LENGTHS = ([0], [17], [30, 0, 4, 12, 1, 7, 23, 2, 9])
lengths_of_runs = st.sampled_from(LENGTHS)
seeds_of_runs = st.integers(0, 2**16)


@pytest.mark.thorough
@pytest.mark.parametrize("equations", [CONTINUOUS, DISCRETE, SAMPLED])
@SMALL
@given(seed=seeds_of_runs, lengths=lengths_of_runs, substeps=st.integers(1, 3))
def test_both_engines_simulate_the_same(equations, seed, lengths, substeps):
    order = 1 + seed % 3 if equations.continuous else 1
    runs, _ = made(seed, lengths, order)
    result = by_machine_code.simulate(equations, runs, substeps)
    alike(result, by_jax.simulate(equations, runs, substeps))
    for row, x0 in zip(runs.results, runs.start, strict=True):
        np.testing.assert_array_equal(result[row], x0)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("equations", "residual"),
    [(CONTINUOUS, PLAIN), (CONTINUOUS, PERIODIC), (DISCRETE, PLAIN), (SAMPLED, PERIODIC)],
)
@settings(SMALL, max_examples=3)
@given(seed=seeds_of_runs, lengths=lengths_of_runs, parameters=st.booleans())
def test_both_engines_find_the_same_products(equations, residual, seed, lengths, parameters):
    runs, samples = made(seed, lengths)
    n_d = 5 if parameters else 3
    seeds = np.random.default_rng(seed).normal(size=(len(lengths), n_d, 3))
    directions = Directions(seeds, parameters)
    given = equations, residual, runs, 2, directions, samples
    result, expected = by_machine_code.compare(*given), by_jax.compare(*given)
    for name in ("products", "gradient", "cost", "error"):
        alike(getattr(result, name), getattr(expected, name))


def test_measured_samples_take_the_place_of_the_simulated_ones():
    runs, _ = made(3, [12, 5, 7])
    rows = np.random.default_rng(1).normal(size=(len(runs.drive), 2))
    runs = replace(runs, measured=rows, measured_samples=np.array([4, 6, 0]))
    for equations in (CONTINUOUS, DISCRETE, SAMPLED):
        result = by_machine_code.simulate(equations, runs, 2)
        alike(result, by_jax.simulate(equations, runs, 2))


def test_formulas_and_their_derivatives_are_evaluated_alike():
    formula = Formula(lambda x: jnp.stack([jnp.sin(x[0]) * x[1], x[2] ** 2]), 3, range(1, 3))
    few, many = (np.random.default_rng(n).normal(size=(n, 3)) for n in (5, 20_000))
    for points in (few, many):
        for derivatives in (False, True):
            result = by_machine_code.evaluate(formula, points, derivatives=derivatives)
            alike(result, by_jax.evaluate(formula, points, derivatives=derivatives))


def test_a_run_that_diverges_stays_visible_and_spoils_no_other():
    explosive = Equations(lambda x, u, p, c: x**3, n_x=1, n_u=1)
    runs = Runs(
        start=np.array([[3.0], [0.1]]),
        parameters=np.zeros((2, 0)),
        steps=np.array([60, 60]),
        first=np.zeros(2, int),
        drive=np.zeros((61, 1, 1)),
        periods=np.full(61, 0.1),
    )
    states = by_machine_code.simulate(explosive, runs, 1).reshape(2, 61)
    assert not np.isfinite(states[0, -1])
    assert np.isfinite(states[1]).all()
    samples = Samples(np.zeros((61, 1)), np.ones((61, 1)))
    result = by_machine_code.compare(
        explosive,
        ResidualFormula(lambda e: e, 1),
        runs,
        1,
        Directions(np.ones((2, 1, 1)), False),
        samples,
    )
    assert list(np.isfinite(result.cost)) == [False, True]
    assert np.isfinite(result.products[1]).all()


def test_the_environment_chooses_the_engine(monkeypatch):
    monkeypatch.setenv(engine.VARIABLE, "jax")
    assert engine.current_engine() == "jax"
    monkeypatch.setenv(engine.VARIABLE, "")
    assert engine.current_engine() == "llvm"
    monkeypatch.setenv(engine.VARIABLE, "fortran")
    with pytest.raises(tn.InputError, match=r"TUSTINNET_ENGINE: 'fortran'; expected one of llvm"):
        engine.current_engine()


def test_what_no_program_can_hold_is_simulated_by_jax_and_says_so_once(recwarn):
    def until_small(x, u, p, c):
        from jax import lax

        return -lax.while_loop(lambda y: jnp.max(jnp.abs(y)) > 1.0, lambda y: y / 2, x)

    equations = Equations(until_small, n_x=1, n_u=1, where="system 'odd'")
    runs = Runs(
        start=np.array([[3.0]]),
        parameters=np.zeros((1, 0)),
        steps=np.array([4]),
        first=np.zeros(1, int),
        drive=np.zeros((5, 1, 1)),
        periods=np.full(5, 0.1),
    )
    first = engine.simulate(equations, runs)
    np.testing.assert_array_equal(engine.simulate(equations, runs), first)
    messages = [str(w.message) for w in recwarn]
    assert len(messages) == 1
    assert "system 'odd': the model uses 'while'" in messages[0]
    assert "in until_small" in messages[0]
    assert "simulated by JAX instead" in messages[0]


def test_without_llvm_jax_does_it(monkeypatch):
    monkeypatch.setattr(engine, "find_spec", lambda name: None)
    monkeypatch.setattr(engine, "_warned_topics", set())
    with pytest.warns(UserWarning, match="llvmlite is not installed"):
        assert engine.current_engine() == "jax"


def test_what_no_program_can_hold_is_simulated_by_jax_and_that_is_said_once(monkeypatch):
    monkeypatch.setattr(engine, "_warned_topics", set())
    runs = Runs(
        start=np.array([[0.3, 0.1]]),
        parameters=np.zeros((1, 0)),
        steps=np.array([4]),
        first=np.zeros(1, int),
        drive=np.zeros((5, 1, 1)),
        periods=np.ones(5),
    )
    sorting = [
        Equations(lambda x, u, p, c: jnp.sort(0.5 * x), 2, 1, continuous=False, where=where)
        for where in ("one", "another")
    ]
    with pytest.warns(UserWarning, match="'sort'.*simulated by JAX") as warnings:
        states = [engine.simulate(equations, runs) for equations in sorting]
    assert len(warnings) == 1
    np.testing.assert_allclose(states[0][1], [0.05, 0.15])


@SMALL
@given(seed=seeds_of_runs)
def test_both_engines_linearise_the_same(seed):
    equations = Equations(
        lambda x, u, p, c: x + 0.05 * swing(x, u, jnp.array([1.2, 0.7]), jnp.array([0.4])),
        n_x=3,
        n_u=1,
        continuous=False,
    )
    generator = np.random.default_rng(seed)
    x, u = generator.normal(size=3), generator.normal(size=1)
    result = by_machine_code.make_linearised_step(equations)(x, u)
    for value, expected in zip(result, by_jax.make_linearised_step(equations)(x, u), strict=True):
        alike(value, expected)
    alike(result[0], engine.make_step(equations)(x, u))
