"""Programs as machine code, against the same programs by NumPy."""

import numpy as np
import pytest
from every_family import NAMES, example_source
from every_step import PROGRAMS, state_of, stepping

from tustinnet.engine import functions
from tustinnet.engine.by_machine_code import evaluate
from tustinnet.engine.emission import _WRITERS
from tustinnet.engine.equations import Formula
from tustinnet.engine.machine import compile_module
from tustinnet.engine.text import Module
from tustinnet.export.source import Source
from tustinnet.program.numbers import run


def stepped(source: Source, points: np.ndarray) -> np.ndarray:
    n_x = source.n_x
    formula = Formula(lambda x: source.function(x[:n_x], x[n_x:]), points.shape[1])
    return evaluate(formula, points, derivatives=False)


@pytest.mark.parametrize("name", PROGRAMS)
def test_all_that_a_program_may_hold_is_computed(name):
    source = stepping(PROGRAMS[name])
    x, u = state_of(source), np.array([0.4])
    many = np.tile(np.concatenate([x, u]), (80, 1))
    many[1:, 5] += np.linspace(0, 0.1, 79)
    result = stepped(source, many)
    for k in (0, 7, 79):
        expected = run(source.step, x=many[k, :-1], u=u)["x"]
        np.testing.assert_allclose(result[k], expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_steps_of_every_family_are_computed(name):
    source = example_source(name)
    x, w = source.samples(70)
    result = stepped(source, np.concatenate([x, w], axis=1))
    for k in (0, 69):
        expected = run(source.step, x=x[k], u=w[k])["x"]
        np.testing.assert_allclose(result[k], expected, rtol=1e-12, atol=1e-12)


ANGLES = np.concatenate(
    [
        np.linspace(-30, 30, 1001),
        np.geomspace(1e-300, 1e300, 601),
        -np.geomspace(1e-5, 1e9, 50),
        [0.0, np.nan, np.inf, -np.inf, np.pi / 2, np.pi, 1e5, 710.0, -745.2, 709.7, -746.0, 20.0],
    ]
)


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "tanh", "log1p", "sinh"])
@pytest.mark.parametrize("lanes", [1, 4])
def test_elementary_functions_are_those_of_numpy(name, lanes):
    """Within 4 units of the last place; also what is no finite number."""
    module = Module(lanes)
    with (
        module.procedure("all", "ptr %x, ptr %y, i64 %n", is_internal=False) as f,
        f.loop(0, "%n") as i,
    ):
        x = f.load("%x", i)
        if name in ("sin", "cos"):
            pair = f"{{ {module.v}, {module.v} }}"
            both = f.value(f"call {pair} @{functions.sine_and_cosine(module)}({module.v} {x})")
            value = f.value(f"extractvalue {pair} {both}, {int(name == 'cos')}")
        else:
            value = _WRITERS[name](f, x)
        f.store(value, "%y", i)
    from ctypes import c_int64, c_void_p

    function = compile_module(module.text()).function("all", (c_void_p, c_void_p, c_int64))
    memory = np.zeros((2, 4096))
    first = -memory.ctypes.data % 64 // 8
    given, result = (row[first : first + 2048] for row in memory)
    given[: len(ANGLES)] = np.abs(ANGLES) if name == "log1p" else ANGLES
    function(given.ctypes.data, result.ctypes.data, 2048 // lanes)
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(given)
    finite = np.isfinite(expected)
    np.testing.assert_array_equal(result[~finite], expected[~finite])
    off = np.abs(result[finite] - expected[finite]) / np.spacing(np.abs(expected[finite]))
    assert off.max() <= 4
