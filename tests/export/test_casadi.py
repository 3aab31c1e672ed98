"""A step in CasADi: value, Jacobian and Hessian are the model's; it is loaded by CasADi alone."""

import subprocess
import sys
from importlib import import_module

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from documented import blocks
from every_family import NAMES, example, example_source, physics
from swinging import SWING

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.export import casadi as target
from tustinnet.program.numbers import run
from tustinnet.program.program import OPERATIONS
from tustinnet.program.reading import read
from tustinnet.program.tape import Tape

casadi = import_module("casadi")  # no types are known

EDGES = np.array([-2.5, -1.5, -0.5, -0.0, 0.0, 0.5, 1.0, 1.5, 2.5, 1e-9])
# what somebody does who has nothing but CasADi: loads each function and steps by it
ALONE = """
import sys, casadi, numpy as np
from pathlib import Path
for folder in Path(sys.argv[1]).iterdir():
    step = casadi.Function.load(str(folder / "step.casadi"))
    assert (step.name_in(), step.name_out()) == (["x", "u"], ["x_next"])
    states, inputs = np.load(folder / "x.npy"), np.load(folder / "u.npy")
    found = [step(x, u).full().ravel() for x, u in zip(states, inputs)]
    np.save(folder / "x_next.npy", found)
assert "tustinnet" not in sys.modules and "jax" not in sys.modules
"""


@pytest.fixture(scope="module")
def stepped(tmp_path_factory):
    """Steps of every model in a process that knows CasADi and not this package."""
    place = tmp_path_factory.mktemp("casadi")
    for name in NAMES:
        source, folder = example_source(name), place / name
        folder.mkdir()
        for file, content in target.TARGET.files(source).items():
            assert isinstance(content, bytes)
            (folder / file).write_bytes(content)
        for file, values in zip("xu", source.samples(10), strict=True):
            np.save(folder / f"{file}.npy", values)
    command = [sys.executable, "-I", "-c", ALONE, str(place)]
    subprocess.run(command, check=True, cwd=place)
    return place


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_casadi_alone_steps_as_every_model_does(stepped, name):
    states, inputs, found = (np.load(stepped / name / f"{f}.npy") for f in ("x", "u", "x_next"))
    expected = [
        run(example_source(name).step, x=x, u=u)["x"] for x, u in zip(states, inputs, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["physics", "gru", "band-limited"])
def test_value_jacobian_and_hessian_are_jaxs(name):
    source, step = example_source(name), tn.casadi_step(example(name))
    weights = np.random.default_rng(0).normal(size=source.n_x)
    points = np.concatenate(source.samples(100, seed=1), axis=1)

    def function(z):
        return source.function(z[: source.n_x], z[source.n_x :])

    @jax.jit
    @jax.vmap
    def expected(z):
        both = jax.jacfwd(function)(z), jax.hessian(lambda y: weights @ function(y))(z)
        return function(z), *both

    z = casadi.MX.sym("z", points.shape[1])
    y = step(z[: source.n_x], z[source.n_x :])
    second = casadi.hessian(casadi.dot(casadi.DM(weights), y), z)[0]
    mine = casadi.Function("mine", [z], [y, casadi.jacobian(y, z), second])
    for *values, point in zip(*expected(jnp.asarray(points)), points, strict=True):
        for value, found in zip(values, mine(point), strict=True):
            shaped = found.full().reshape(np.shape(value))
            np.testing.assert_allclose(shaped, value, rtol=1e-12, atol=1e-12)


def same(program, **inputs):
    """The CasADi function of a program returns what the program does."""
    function = target.make_function(program, "f", list(inputs), list(program.outputs))
    found = function.call([casadi.DM(values) for values in inputs.values()])
    for value, expected in zip(found, run(program, **inputs).values(), strict=True):
        np.testing.assert_allclose(value.full().ravel(), expected.astype(float), 1e-14, 1e-14)
    return function


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("op", OPERATIONS)
def test_every_operation_is_casadis(op, single):
    tape = Tape({"x": 10, "y": 10})
    sides = [tape.input(name) for name in ("x", "y")]
    if single:
        sides = [tape.split(side)[1] for side in sides]
    holds = tape.apply("lt", *sides), tape.apply("lt", sides[0], tape.number(0.4))
    count = {"select": 3}.get(op) or getattr(OPERATIONS[op].apply, "nin", 3)
    args = {"select": (holds[1], *sides), "and": holds, "or": holds, "not": holds[:1]}
    out = tape.apply(op, *args.get(op, sides)[:count])
    with np.errstate(all="ignore"):
        same(tape.program({"out": tape.split(out)}), x=EDGES, y=EDGES[::-1] - 0.3)


MATRIX = np.random.default_rng(3).normal(size=(12, 12)) / 4


def turned(x):
    """A loop in a loop, with constants, three carried vectors and rows that are given."""

    def inner(carried, row):
        a, b, turn = carried
        return (jnp.sin(a + row[0] * b), jnp.where(turn, b, 0.5 * a * x[1]), a > b), None

    def outer(carried, row):
        return jax.lax.scan(inner, carried, jnp.outer(row, jnp.ones(2)))[0], None

    rows = jnp.outer(jnp.arange(30.0), x[:9]) / 100
    a, b, turn = jax.lax.scan(outer, (x, jnp.cos(x), x > 0), rows)[0]
    return jnp.where(turn, a, b)


def layered(x):
    """Layers in a loop, and products one after the other."""
    start = jnp.concatenate([x, x[:2]])
    found = jax.lax.scan(lambda y, _: (jnp.tanh(MATRIX @ y + x[0]), None), start, None, length=200)[
        0
    ]
    return MATRIX @ jnp.maximum(MATRIX @ found, 0.01 * found)


@pytest.mark.parametrize("most", [0, 30_000])
@pytest.mark.parametrize("function", [turned, layered])
def test_loops_are_written_out_or_called_again_and_again(function, most, monkeypatch):
    monkeypatch.setattr(target, "_WRITTEN_OUT", most)
    program = read(lambda x: {"out": function(x)}, {"x": 10})
    assert [loop.length for loop in program.loops]
    found = same(program, x=EDGES)
    scalar = function is turned and most > 0
    assert found.class_name() == ("SXFunction" if scalar else "MXFunction")
    x = casadi.MX.sym("x", 10)
    slopes = casadi.Function("slopes", [x], [casadi.jacobian(found(x), x)])(EDGES + 0.1).full()
    expected = jax.jit(jax.jacfwd(function))(jnp.asarray(EDGES + 0.1))
    np.testing.assert_allclose(slopes, expected, rtol=1e-12, atol=1e-12)


def test_constants_may_be_anything():
    tape = Tape({"x": 2})
    whole = [tape.number(v) for v in (np.inf, -np.inf, np.nan, True, -0.0)]
    same(
        tape.program({"a": whole, "b": [*whole[:2], *tape.split(tape.input("x"))], "c": []}),
        x=np.ones(2),
    )


def test_the_pages_program_steps(tmp_path, monkeypatch):
    model = physics(system=SWING)
    tn.export_model(model, "casadi", tmp_path / "my-casadi")
    (program,) = blocks("CasADi", "python")
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "casadi.md", "exec"), known := {})
    expected = model.step(jnp.array([0.1, 0.0]), jnp.array([0.5]))
    np.testing.assert_allclose(known["x_next"].full().ravel(), expected, rtol=1e-14)


def test_a_function_of_layers_can_be_expanded():
    step = tn.casadi_step(example("gru"))
    x, u = np.full(5, 0.1), np.ones(1)
    assert step.expand().class_name() == "SXFunction"
    np.testing.assert_allclose(step.expand()(x, u).full(), step(x, u).full(), rtol=1e-14)


@pytest.mark.thorough
def test_physics_is_sx_and_networks_are_mx():
    found = [tn.casadi_step(example(name)).class_name() for name in ("qube", "qube hybrid")]
    assert found == ["SXFunction", "MXFunction"]


def test_it_asks_for_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(InputError, match=r"casadi is not installed.*'tustinnet\[casadi\]'"):
        tn.casadi_step(example("qube"))
