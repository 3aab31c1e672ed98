"""System files with tables, cases and what JAX cannot trace: they work, or say what to write."""

import re
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.engine import engines as engine
from tustinnet.simulate.input_signal import InputSignal
from tustinnet.simulate.simulation import simulate_runs

FILE = """
import math
import numpy as np
import jax
import jax.numpy as jnp
import tustinnet as tn
ANGLES, TORQUES = jnp.linspace(-1.0, 1.0, 5), jnp.array([0.0, 0.1, 0.4, 0.2, 0.3])
def kinetic(q, v, p):
    return p["inertia"] * v[0] ** 2 / 2
def dissipation(q, v, p):
    BODY
SYSTEM = tn.LagrangianSystem(
    "swing", (tn.Coordinate("q", "angular"),), (tn.Input("u", "N m"),),
    (tn.Parameter("inertia", "kg m^2", 0.1, 0.01, 1.0), tn.Parameter("d", "N m s", 0.1, 0.01, 1.0)),
    kinetic, dissipation=dissipation, input_map=lambda q, v, u, p: u)
"""
BRANCH, NUMPY, VALUE = (
    "jnp.where(condition, a, b) for if",
    "jax.numpy for numpy",
    "jax.numpy for math",
)


def write_system(folder, body):
    path = folder / "arm.py"
    path.write_text(FILE.replace("BODY", body.replace("\n", "\n    ")))
    return path


def simulated(system):
    """The last state of a free run, and the same step by step with JAX."""
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    model = tn.discretise(system.model(values), 0.01)
    states = simulate_runs(model, np.array([[0.3, 0.2]]), InputSignal(np.full((1, 4, 1), 0.1)))
    x = jnp.array([0.3, 0.2])
    for _ in range(4):
        x = model.step(x, jnp.full(1, 0.1))
    return states[0, -1], x


@pytest.mark.thorough
@pytest.mark.parametrize(
    "body",
    [
        "return p['d'] * jnp.interp(q, ANGLES, TORQUES) * v",
        "return p['d'] * TORQUES[jnp.searchsorted(ANGLES, q[0])] * v",
        "return p['d'] * TORQUES[jnp.floor(4 * q[0]).astype(int)] * v",
        "return jnp.select([v < -1, v > 0.1], [0.1 * v, 0.2 * v], 0.3 * v)",
        "return jnp.piecewise(v, [v < 0, v >= 0], [lambda x: 0.1 * x, lambda x: 0.2 * x])",
        "return jnp.where(jnp.isfinite(v), abs(v), 0.0)",
    ],
)
def test_tables_and_cases_are_simulated_by_machine_code(body, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result, expected = simulated(tn.load_system(write_system(tmp_path, body)))
    np.testing.assert_allclose(result, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("body", "line", "message"),
    [
        ("if v[0] > 0:\n    return p['d'] * v\nreturn 2 * p['d'] * v", 11, BRANCH),
        ("return p['d'] * v if q[0] > 0 else 0 * v", 11, BRANCH),
        ("return jnp.where(v[0] > 0 and q[0] > 0, v, q)", 11, "& | ~ for and, or, not"),
        ("return max(v[0], 0.0) * v", 11, "jnp.maximum for max"),
        ("x = v\nwhile x[0] > 1:\n    x = x / 2\nreturn x", 12, "jax.lax.fori_loop for while"),
        ("return p['d'] * np.sin(q)", 11, NUMPY),
        ("return np.interp(q, np.arange(3.0), np.arange(3.0))", 11, NUMPY),
        ("return np.array([p['d'] * v[0]])", 11, NUMPY),
        ("return math.sin(q[0]) * v", 11, VALUE),
        ("return float(v[0]) * v", 11, VALUE),
        ("return [1.0, 2.0][jnp.floor(q[0]).astype(int)] * v", 11, "jnp.asarray(values)[i]"),
        ("return v[v > 0]", 11, "jnp.where(condition, a, b) for an index"),
        ("f = np.zeros(1)\nf[0] = v[0]\nreturn f", 12, "jnp.stack([a, b])"),
    ],
)
def test_what_needs_values_names_its_line_and_what_to_write(body, line, message, tmp_path):
    path = write_system(tmp_path, body)
    start, end = re.escape(f"{path} at line {line}: system 'swing', diss"), re.escape(message)
    with pytest.raises(tn.InputError, match=f"{start}.*; write .*{end}"):
        tn.load_system(path)


def test_an_optional_term_that_fails_later_names_its_line_and_what_to_write(tmp_path):
    body = "return p['d'] * v if not p.get('k', 0.0) else 2 * p['d'] * v"
    path = write_system(tmp_path, body)
    text = path.read_text().replace(
        'tn.Parameter("d"',
        "tn.Parameter('k', '', 0.0, -1.0, 1.0, optional=True), tn.Parameter(\"d\"",
    )
    path.write_text(text)
    with pytest.raises(tn.InputError, match=r"dissipation fails at line 11 .*jnp\.where"):
        tn.load_system(path)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return jnp.sort(jnp.stack([v[0], q[0]]))[:1]", "jnp.minimum and jnp.maximum"),
        ("return jax.scipy.special.erf(v)", "jnp.tanh"),
        ("return jnp.linalg.inv(jnp.eye(2) + q[0] ** 2)[:1, 0] * v", "cho_solve"),
    ],
)
def test_what_jax_must_simulate_names_its_line_and_what_to_write(
    body, message, tmp_path, monkeypatch
):
    monkeypatch.setattr(engine, "_warned_topics", set())
    system = tn.load_system(write_system(tmp_path, body))
    with pytest.warns(UserWarning, match=rf"in dissipation \(arm.py, line 11\).*{message}"):
        result, expected = simulated(system)
    np.testing.assert_allclose(result, expected, rtol=1e-12)
