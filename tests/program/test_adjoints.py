"""Programs in reverse, against JAX and against derivatives forwards."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import NAMES, example, example_source, step_and_jacobians
from every_step import PROGRAMS, SIZE, stepping
from test_tape_derivatives import same, smooth

import tustinnet as tn
from tustinnet.export.source import make_source
from tustinnet.program.adjoints import with_adjoints
from tustinnet.program.derivatives import with_derivatives
from tustinnet.program.numbers import run
from tustinnet.program.program import Program
from tustinnet.program.reading import Unreadable, read


def compare_adjoints(program: Program, adjoints, x, u) -> None:
    """Compares the adjoints of a program's inputs with those that others find for a weight."""
    weight = np.random.default_rng(1).normal(size=len(run(program, x=x, u=u)["x"]))
    reverse = with_adjoints(program, "x", ("x", "u"), value=True).program
    result = run(reverse, x=x, u=u, adjoint=weight)
    np.testing.assert_array_equal(result["x"], run(program, x=x, u=u)["x"])
    expected = adjoints(jnp.asarray(x), jnp.asarray(u), jnp.asarray(weight))
    for name, by_others in zip(("by_x", "by_u"), expected, strict=True):
        same(result[name], np.asarray(by_others))


def adjoints_of(function):
    """The adjoints of a function's arguments by JAX."""
    return lambda x, u, weight: jax.vjp(function, x, u)[1](weight)


@pytest.mark.parametrize("size", [3, SIZE])
def test_every_operation_is_differentiated_as_jax_does_it(size):
    x, u = np.linspace(0.1, 0.9, size), np.array([0.9])

    def function(x, u):
        return jnp.concatenate(smooth(x * u[0]))

    program = read(lambda x, u: {"x": function(x, u)}, {"x": size, "u": 1})
    compare_adjoints(program, jax.jit(adjoints_of(function)), x, u)


@pytest.mark.parametrize("name", [name for name in PROGRAMS if name != "operations"])
def test_loops_vectors_and_matrices_are_differentiated(name):
    source = stepping(PROGRAMS[name])
    x = 0.3 + 0.1 * np.random.default_rng(0).normal(size=source.n_x)
    # not compiled, which rounds otherwise at a kink
    compare_adjoints(source.step, adjoints_of(source.function), x, np.array([0.4]))


# all nine members of the committee are several times as slow as three of them
@pytest.mark.thorough
@pytest.mark.parametrize("name", [name for name in NAMES if name != "committee"])
def test_steps_of_every_family_are_differentiated(name):
    source = example_source(name)
    x, w = (values[0] for values in source.samples(2))
    _, *jacobians = step_and_jacobians(name)
    compare_adjoints(source.step, lambda x, u, weight: [weight @ by[0] for by in jacobians], x, w)


@pytest.mark.thorough
def test_the_step_of_a_committee_is_differentiated():
    members = ("network memory", "physics", "network memory 2")  # two of one structure
    source = make_source(tn.committee([example(name) for name in members]))
    x, w = (values[0] for values in source.samples(1))
    compare_adjoints(source.step, jax.jit(adjoints_of(source.function)), x, w)


def layered(x, outer, inner):
    """A layer that acts twice, once turned, and one that does not see the input."""
    hidden = jnp.tanh(inner @ x) + inner @ jnp.ones(4)
    return outer @ hidden + inner.T @ hidden


@pytest.mark.thorough
def test_layers_that_are_given_have_the_gradients_of_jax():
    generator = np.random.default_rng(0)
    matrices = {"outer": (4, 12), "inner": (12, 4)}
    given = [generator.normal(size=shape) for shape in matrices.values()]
    x, weight = generator.normal(size=4), generator.normal(size=4)
    program = read(lambda *vectors: {"x": layered(*vectors)}, {"x": 4}, matrices=matrices)
    named = dict(zip(matrices, given, strict=True))
    np.testing.assert_allclose(run(program, x=x, **named)["x"], layered(x, *given), rtol=1e-12)
    # forwards, too
    jacobian = run(with_derivatives(program, "x", {"by": "x"}), x=x, **named)["by"].reshape(4, 4)
    same(jacobian, np.asarray(jax.jacfwd(layered)(x, *given)))

    reverse = with_adjoints(program, "x", ("x",))
    assert sorted(reverse.layers) == ["inner", "inner", "inner", "outer"]
    result = run(reverse.program, x=x, adjoint=weight, **named)
    gradients = {name: np.zeros(shape) for name, shape in matrices.items()}
    for i, name in enumerate(reverse.layers):
        gradients[name] += np.outer(result[f"out_{i}"], result[f"in_{i}"])
    _, back = jax.vjp(layered, x, *given)
    for ours, theirs in zip((result["by_x"], *gradients.values()), back(weight), strict=True):
        same(ours, np.asarray(theirs))


@pytest.mark.parametrize(
    "function",
    [
        lambda x, w: w[0] * x,
        lambda x, w: (w @ w) @ x,
        lambda x, w: jnp.tanh(w) @ x,
        lambda x, w: w @ jnp.outer(x, x),
    ],
)
def test_weights_that_do_more_than_multiply_a_vector_are_refused(function):
    with pytest.raises(Unreadable, match="on the weights of a layer"):
        read(lambda x, w: {"x": function(x, w)}, {"x": 3}, matrices={"w": (3, 3)})


def test_numbers_that_are_copies_of_an_input_are_known():
    program = read(
        lambda x, u: {"x": jnp.concatenate([x[2:4], u, x[1:2] * 2, x[:1]])}, {"x": 4, "u": 1}
    )
    assert program.copies("x", "x") == [2, 3, None, None, 0]
    assert program.copies("x", "u") == [None, None, 0, None, None]


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_zero_where_structure_says_so(name):
    source = example_source(name)
    _, (by_x, *_), (by_w, *_) = step_and_jacobians(name)
    depends = source.step.dependencies("x")
    assert any(depends)
    for i, on in enumerate(depends):
        for input_name, row in (("x", by_x[i]), ("u", by_w[i])):
            assert not any(row[j] for j in range(len(row)) if (input_name, j) not in on)
