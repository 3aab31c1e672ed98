"""A function of JAX arrays, read as a program, computes the same without JAX."""

import math

import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
import pytest
from every_family import NAMES, example, example_source, step_and_jacobians

from tustinnet.errors import InputError
from tustinnet.program.numbers import run
from tustinnet.program.primitives import MOVES, RULES
from tustinnet.program.reading import read
from tustinnet.program.tape import Tape
from tustinnet.registry import FAMILIES

EDGES = np.array([-2.5, -1.5, -0.5, -0.0, 0.0, 0.5, 1.0, 1.5, 2.5, 1e-9])


def same(function, *values: np.ndarray, atol: float = 1e-14) -> None:
    """The program of a function of vectors returns what JAX does."""
    names = [f"in{i}" for i in range(len(values))]
    sizes = {name: len(v) for name, v in zip(names, values, strict=True)}
    program = read(lambda *v: {"out": function(*v)}, sizes)
    result = run(program, **dict(zip(names, values, strict=True)))["out"]
    # one program; without it, one for each operation on each shape
    expected = np.ravel(jax.jit(function)(*map(jnp.asarray, values)))
    np.testing.assert_allclose(result, expected.astype(float), rtol=1e-14, atol=atol)


@pytest.mark.parametrize(
    "function",
    [
        jnp.sin,
        jnp.cos,
        jnp.tan,
        jnp.arctan,
        jnp.sinh,
        jnp.cosh,
        jnp.tanh,
        jnp.arcsinh,
        jnp.exp,
        jnp.expm1,
        jnp.abs,
        jnp.sign,
        jnp.floor,
        jnp.ceil,
        jnp.round,
        jnp.square,
        jnp.cbrt,
        jnp.exp2,
        jax.nn.relu,
        jax.nn.leaky_relu,
        jax.nn.softplus,
        jax.nn.sigmoid,
        jax.nn.silu,
        jax.nn.elu,
        jnp.cumsum,
        jnp.cumprod,
        jnp.flip,
        jnp.trunc,
        lambda x: jnp.arcsin(x / 3),
        lambda x: jnp.arccos(x / 3),
        lambda x: jnp.arctanh(x / 3),
        lambda x: jnp.sqrt(x**2 + 1),
        lambda x: jax.lax.rsqrt(x**2 + 1),
        lambda x: x**7,
        lambda x: x**0,
        lambda x: (x + 3.0) ** -3,
        lambda x: jnp.log(x + 4),
        lambda x: jnp.log1p(x / 4),
        lambda x: (x + 4) ** 1.5,
        lambda x: jnp.arctan2(x, x[::-1] - 0.3),
        lambda x: x % 0.7,
        lambda x: jnp.remainder(x + jnp.pi, 2 * jnp.pi) - jnp.pi,
        lambda x: jnp.fmod(x, 0.7),
        lambda x: jnp.clip(x, -1, x[6]),
        lambda x: jnp.where((x > 0) & ~(x > 1), x, -x),
        lambda x: jnp.where((x < 0) | (x >= 1.5), 1.0, 2.0),
        lambda x: jnp.maximum(x, x[::-1]),
        lambda x: x.reshape(2, 5).T @ x[:2],
        lambda x: jnp.outer(x, x),
        lambda x: jnp.sum(x),
        lambda x: jnp.max(x.reshape(2, 5), axis=0),
        lambda x: jnp.prod(x + 3),
        lambda x: jnp.mean(x),
        lambda x: jnp.any(x > 2.4) * 1.0,
        lambda x: jnp.all(x > -2) * 1.0,
        lambda x: x[jnp.array([3, 1])],
        lambda x: x.at[2].set(x[0]),
        lambda x: x.at[jnp.array([2, 3])].add(5.0),
        lambda x: jnp.roll(x, 2),
        lambda x: jnp.diag(x),
        lambda x: jnp.tril(jnp.outer(x, x)),
        lambda x: jnp.tile(x, 3),
        lambda x: jax.lax.round(x),
        lambda x: (x > 0.2).astype(float) + x.astype(int),
        lambda x: jnp.stack([x, 2 * x])[:, ::3],
        lambda x: jnp.pad(x, (2, 1)),
        lambda x: jnp.cross(x[:3], x[3:6]),
        lambda x: jax.lax.dynamic_slice(x, (2,), (3,)),
        lambda x: jnp.linalg.norm(x),
        lambda x: jax.grad(lambda y: jnp.sum(jnp.cos(y) * y))(x),
        lambda x: jax.jacrev(jnp.tanh)(x),
        lambda x: jax.lax.cond(x[0] > 0, lambda y: y, lambda y: -y, x),
        lambda x: jax.lax.switch(2, [jnp.sin, jnp.cos, jnp.tanh], x),
        lambda x: jax.lax.fori_loop(0, 4, lambda i, y: y * 0.5 + x[i], x),
        lambda x: jax.lax.while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, s[1] * x), (0, x))[1],
        lambda x: jax.lax.scan(lambda c, y: (c + y, c * y), 0.0, x)[1],
        lambda x: jax.lax.scan(lambda c, y: (c + y, c * y), 0.0, x, reverse=True)[1],
        lambda x: jax.scipy.linalg.cho_solve(
            (jnp.linalg.cholesky(jnp.outer(x, x) + 3 * jnp.eye(10)), True), x
        ),
        lambda x: x[:0],
        jax.checkpoint(lambda x: jnp.sin(x) ** 2),
        lambda x: jnp.interp(0.3, jnp.arange(10.0), x),
        lambda x: jnp.interp(x, jnp.linspace(-1, 2, 7), jnp.arange(7.0) ** 2),
        lambda x: jnp.interp(x[5], jnp.arange(10.0), x),
        lambda x: jnp.interp(x, x[:4], x[4:8]),
        lambda x: jnp.searchsorted(jnp.linspace(-2, 2, 9), x, side="right"),
        lambda x: jnp.searchsorted(jnp.arange(3.0), x, method="compare_all"),
        lambda x: jnp.digitize(x, jnp.linspace(-2, 2, 5)),
        lambda x: x[jnp.argmax(x)],
        lambda x: jnp.argmin(x.reshape(2, 5), axis=1),
        lambda x: jnp.argmax(jnp.log(x)),
        lambda x: x[x[0].astype(int)],
        lambda x: x.reshape(2, 5)[x[6].astype(int) - 1, (2 * x[5:]).astype(int) % 5],
        lambda x: jax.lax.dynamic_slice(x, (x[-2].astype(int) * 5,), (3,)),
        lambda x: jax.lax.dynamic_slice(x.reshape(2, 5), (x[6].astype(int), 1), (1, 2)),
        lambda x: x.astype(int) // 2 + x.astype(int) % 2,
        lambda x: jnp.isfinite(1 / x) * 1.0,
        lambda x: jnp.nan_to_num(jnp.sqrt(x)),
        lambda x: jnp.select([x < -1, x > 1], [x**2, 2 * x], 0.5),
        lambda x: jnp.piecewise(x, [x < 0, x >= 1], [lambda y: -y, lambda y: y**2, 0.3]),
        # some versions of JAX have primitives of their own for these
        lambda x: jax.hessian(lambda y: jnp.sum(jnp.tanh(y)))(x),
        lambda x: jnp.log2(x + 4),
        jax.jacrev(lambda x: jnp.log2(x + 4)),
        lambda x: jnp.polyval(jnp.array([0.5, -1.0, 2.0]), x),
        lambda x: jnp.polyval(x[:4], x),
        lambda x: jnp.polyval(x[:6].reshape(3, 2), x[1:3]),
        jax.jacfwd(lambda x: jnp.polyval(x[:4], x)),
        lambda x: math.prod(x),
        lambda x: sum(x.reshape(5, 2)),
        jax.jacrev(lambda x: math.prod(x)),
    ],
)
def test_what_jax_computes_a_program_computes(function):
    same(function, EDGES)


@pytest.mark.parametrize(
    ("name", "params", "sizes", "expected"),
    [
        ("one_minus_square", {}, [3], lambda x: 1 - x**2),
        ("log2", {"accuracy": None}, [3], np.log2),
        ("polynomial", {}, [3, 3, 1, 1], lambda x, a, b, c: a + b * x + c * x**2),
    ],
)
def test_rules_for_primitives_that_not_every_version_of_jax_has(name, params, sizes, expected):
    inputs = {f"in{i}": size for i, size in enumerate(sizes)}
    tape = Tape(inputs)
    arrays = [np.array(tape.split(tape.input(n)), int) for n in inputs]
    arrays = [a[0] if len(a) == 1 else a for a in arrays]
    program = tape.program({"out": RULES[name](tape, params, *arrays)})
    values = {n: np.linspace(0.3, 1.2 + i, size) for i, (n, size) in enumerate(inputs.items())}
    result = run(program, **values)["out"]
    np.testing.assert_allclose(result, expected(*values.values()), rtol=1e-14)


@pytest.mark.parametrize("shape", [(4,), (4, 3), (2, 4, 3)])
@pytest.mark.parametrize("axis", [0, -1])
def test_arrays_are_taken_apart_along_an_axis(shape, axis):
    array = np.arange(math.prod(shape)).reshape(shape)
    parts = MOVES["unstack"]({"axis": axis % len(shape)}, array)
    for part, other in zip(parts, jnp.unstack(array, axis=axis), strict=True):
        np.testing.assert_array_equal(part, other)


def make_loop(constants, carried, rows, length, *, collects):
    """A loop over rows, with constants and carried arrays, of given numbers of axes each."""

    def function(x):
        fixed = [jnp.full((2,) * n, 0.3) * x[0] for n in constants]
        starts = [jnp.full((2,) * n, 0.1) * x[1] for n in carried]
        given = [jnp.sin(jnp.arange(length * 2.0**n)).reshape(length, *(2,) * n) for n in rows]

        def turn(state, row):
            total = sum(jnp.sum(jnp.cos(a)) for a in [*fixed, *row]) * x[2]
            state = [jnp.sin(a) + total for a in state]
            return state, [a * total for a in state[:collects]]

        results = jax.lax.scan(turn, starts, given, length, reverse=bool(collects))
        return jnp.concatenate([jnp.ravel(a) for a in jax.tree.leaves(results)])

    return function


CONSTANTS = ([], [2], [0, 1])
CARRIED = ([1], [2, 0], [1, 1, 2])
ROWS = ([], [1], [0, 1])


# of all 27 those in which each kind meets each of another kind once
@pytest.mark.thorough
@pytest.mark.parametrize("k", range(9))
def test_constants_carried_arrays_and_rows_of_a_loop_are_told_apart(k):
    constants, carried = CONSTANTS[k // 3], CARRIED[k % 3]
    rows = ROWS[(k // 3 + k) % 3]
    same(make_loop(constants, carried, rows, 3, collects=1), EDGES[5:8])
    same(make_loop(constants, carried, rows, 1, collects=0), EDGES[5:8])
    long = make_loop(constants, carried, rows, 160, collects=0)
    same(long, EDGES[5:8], atol=1e-12)
    (loop,) = read(lambda x: {"out": long(x)}, {"x": 3}).loops
    assert loop.length == 160


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_a_step_and_its_derivatives_are_read(name):
    source = example_source(name)
    states, inputs = source.samples(2)
    expected, a, b = step_and_jacobians(name)
    for i, (x, u) in enumerate(zip(states, inputs, strict=True)):
        result = run(source.linearised, x=x, u=u)
        np.testing.assert_allclose(run(source.step, x=x, u=u)["x"], expected[i], atol=1e-13)
        np.testing.assert_allclose(result["x"], expected[i], atol=1e-13)
        np.testing.assert_allclose(result["a"], np.ravel(a[i]), atol=1e-12)
        np.testing.assert_allclose(result["b"], np.ravel(b[i]), atol=1e-12)


def test_single_precision_weights_are_folded_in_double():
    model, x = example("hybrid"), jnp.array([0.1, 0.2, 0.3])
    result = run(example_source("hybrid").step, x=np.asarray(x), u=np.ones(3))["x"]
    np.testing.assert_allclose(result, model.step(x, jnp.ones(1)), rtol=1e-15, atol=1e-15)


def test_every_registered_family_is_among_the_examples():
    models = [example(name) for name in NAMES]
    kinds = {kind for kind in FAMILIES.places if any(FAMILIES[kind].owns(m) for m in models)}
    assert kinds == set(FAMILIES.places) - {"toy"}


def test_layers_stay_matrices_and_substeps_loops():
    network, physics = example_source("gru"), example_source("qube memory")
    assert "product" in {node.op for node in network.step.nodes}
    assert physics.step.operations < 300  # though it does 4 substeps of four stages
    assert [loop.length for loop in physics.step.loops] == [4]


def test_the_same_thing_is_computed_once():
    program = read(lambda x: {"out": jnp.sin(x) + jnp.sin(x) * 1.0 + 0.0 * x}, {"x": 1})
    assert [node.op for node in program.nodes if node.op == "sin"] == ["sin"]
    assert program.operations == 2


def test_a_counter_that_is_an_index_is_no_choice_and_an_index_in_a_long_loop_is_one():
    def by_counter(x):
        return jax.lax.fori_loop(0, 10, lambda i, y: jnp.sin(y) * x[i], x)

    def by_state(x):
        table = jnp.arange(5.0)
        return jax.lax.scan(lambda y, _: (jnp.sin(y) + table[y[0].astype(int)], None), x, None, 40)[
            0
        ]

    same(by_counter, EDGES)
    same(by_state, EDGES)
    operations = [n.op for n in read(lambda x: {"out": by_counter(x)}, {"x": 10}).nodes]
    assert "select" not in operations
    (loop,) = read(lambda x: {"out": by_state(x)}, {"x": 10}).loops
    assert loop.length == 40


def blur(x):
    return jax.lax.conv(x[None, None], jnp.ones((1, 1, 3)), (1,), "SAME")[0, 0]


def test_what_has_no_rule_is_refused_by_name_and_place():
    with pytest.raises(InputError, match=r"'conv_general_dilated', in blur \(test_reading.py"):
        read(lambda x: {"out": blur(x)}, {"x": 10})


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: jnp.sort(x), r"'sort', in <lambda> .*jnp.minimum"),
        (lambda x: x.at[x[0].astype(int)].set(1.0), "by an index that depends on the .*jnp.where"),
        (lambda x: jnp.tile(x, 30)[x[0].astype(int)], "in more than 256 places"),
        (lambda x: jnp.take(x, x[:2].astype(int)), "as batched or filled"),
        (lambda x: jax.lax.while_loop(lambda y: y[0] < 9, lambda y: 2 * y + 1, x), "whose end"),
    ],
)
def test_what_depends_on_the_state_is_refused(function, message):
    with pytest.raises(InputError, match=message):
        read(lambda x: {"out": function(x)}, {"x": 10})
