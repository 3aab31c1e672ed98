"""Derivatives of programs, against those of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import NAMES, example_source, step_and_jacobians
from every_step import PROGRAMS, SIZE, stepping

from tustinnet.program.derivatives import PARTIALS, with_derivatives
from tustinnet.program.numbers import run
from tustinnet.program.program import OPERATIONS, Program
from tustinnet.program.reading import read


def jacobians(program: Program, x: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
    both = with_derivatives(program, "x", {"a": "x", "b": "u"})
    values = run(both, x=x, u=u)
    np.testing.assert_array_equal(values["x"], run(program, x=x, u=u)["x"])
    return [values[name].reshape(len(values["x"]), -1) for name in ("a", "b")]


def same(result: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(result, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_every_operation_on_numbers_has_a_rule():
    numbers = {name for name, operation in OPERATIONS.items() if not operation.truth}
    assert {*PARTIALS, "select"} == numbers


def smooth(x: jax.Array) -> list:
    """Every operation where it is smooth, of numbers within (0, 1)."""
    y = x[::-1] + 0.3
    one = [
        jnp.sqrt,
        jnp.exp,
        jnp.expm1,
        jnp.log,
        jnp.log1p,
        jnp.sin,
        jnp.cos,
        jnp.tan,
        jnp.arcsin,
        jnp.arccos,
        jnp.arctan,
        jnp.sinh,
        jnp.cosh,
        jnp.tanh,
        jnp.arcsinh,
        jnp.arctanh,
        jnp.abs,
        jnp.floor,
        jnp.ceil,
        jnp.sign,
        lambda z: -z,
        lambda z: jnp.arccosh(z + 1.5),
    ]
    two = [x + y, x - y, x * y, x / y, x**y, jnp.maximum(x, y), jnp.minimum(x, y)]
    more = [jnp.fmod(7 * x, y), jnp.arctan2(x, y), jnp.where(x > y, x**2, y)]
    return [*(f(x) for f in one), *two, *more]


@pytest.mark.thorough
@pytest.mark.parametrize("size", [3, SIZE])
def test_every_operation_is_differentiated_as_jax_does_it(size):
    x = np.linspace(0.1, 0.9, size)

    def function(x, u):
        return jnp.concatenate(smooth(x * u[0]))

    program = read(lambda x, u: {"x": function(x, u)}, {"x": size, "u": 1})
    u = np.array([0.9])
    result = jacobians(program, x, u)
    for ours, theirs in zip(result, jax.jit(jax.jacfwd(function, (0, 1)))(x, u), strict=True):
        same(ours, np.asarray(theirs))


@pytest.mark.parametrize("at", [-1.0, -0.0, 0.0, 2.0])
def test_kinks_have_the_derivatives_that_jax_gives_them(at):
    def function(x, u):
        return jnp.stack([jnp.abs(x[0]), jnp.maximum(x[0], 0.0), jnp.minimum(0.0, x[0])])

    x, u = np.array([at]), np.array([1.0])
    program = read(lambda x, u: {"x": function(x, u)}, {"x": 1, "u": 1})
    same(jacobians(program, x, u)[0], np.asarray(jax.jacfwd(function)(x, u)))


@pytest.mark.thorough
@pytest.mark.parametrize("name", [name for name in PROGRAMS if name != "operations"])
def test_loops_vectors_and_matrices_are_differentiated(name):
    source = stepping(PROGRAMS[name])
    x = 0.3 + 0.1 * np.random.default_rng(0).normal(size=source.n_x)
    u = np.array([0.4])
    result = jacobians(source.step, x, u)
    for i in (0, 1):
        same(result[i], np.asarray(jax.jit(jax.jacfwd(source.function, i))(x, u)))


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_steps_of_every_family_are_differentiated(name):
    source = example_source(name)
    x, w = (values[0] for values in source.samples(2))
    _, *expected = step_and_jacobians(name)
    for ours, theirs in zip(jacobians(source.step, x, w), expected, strict=True):
        same(ours, theirs[0])


def test_only_what_is_asked_for_is_differentiated():
    program = read(lambda x: {"y": jnp.sin(x) * x[0]}, {"x": 3})
    both = with_derivatives(program, "y", {"by": "x"}, {"x": range(1, 3)})
    x = np.array([0.3, 0.5, -0.2])
    expected = np.asarray(jax.jacfwd(lambda x: jnp.sin(x) * x[0])(x))[:, 1:]
    same(run(both, x=x)["by"].reshape(3, 2), expected)
