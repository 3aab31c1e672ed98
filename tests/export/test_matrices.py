"""Matrices of a linearised step: the file has the model's exact slopes, names and point."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from documented import blocks
from every_family import NAMES, example, example_source, physics
from scipy.io import loadmat
from scipy.signal import StateSpace, dlsim
from swinging import CART, SWING

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.export.mat import TARGET, Matrices
from tustinnet.program.numbers import run
from tustinnet.store.exported import find_targets


def names_of(cells: np.ndarray) -> list[str]:
    return [str(cell[0]) for cell in cells.ravel()]


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_every_model_leaves_as_matrices(name, tmp_path):
    source = example_source(name)
    (tmp_path / "linear.mat").write_bytes(bytes(TARGET.files(source)["linear.mat"]))  # pyright: ignore[reportArgumentType]
    step = TARGET.stepper(tmp_path, source)
    x, u = np.zeros(source.n_x), np.zeros(source.n_w)
    np.testing.assert_allclose(step(x, u), run(source.step, x=x, u=u)["x"], atol=1e-14)
    # along one direction, which mixes all columns
    direction = np.random.default_rng(0).normal(size=source.n_x + source.n_w)
    dx, du = np.split(1e-5 * direction, [source.n_x])
    ahead, behind = (run(source.step, x=s * dx, u=s * du)["x"] for s in (1, -1))
    np.testing.assert_allclose((step(dx, du) - step(x, u)) / 1e-5, (ahead - behind) / 2e-5, 0, 1e-6)


def test_an_export_is_compared_with_the_tangent_of_the_model(tmp_path):
    model, point = example("cart"), {"angle": 0.4, "der_x": -0.2, "force": 1.5}
    (found,) = tn.export_model(model, Matrices(point), tmp_path)
    assert found.checked.steps == 200
    assert found.checked.difference < 1e-14
    read = loadmat(tmp_path / "linear.mat")
    x, u = np.array([0.0, 0.4, -0.2, 0.0]), np.array([1.5])
    expected = tn.linearize(model, x, u)
    for name, value in {
        "A": expected.a,
        "B": expected.b,
        "C": np.eye(4),
        "D": np.zeros((4, 1)),
        "dt": [[0.01]],
        "x": x[:, None],
        "u": u[:, None],
        "drift": expected.drift[:, None],
    }.items():
        np.testing.assert_allclose(read[name], value, rtol=1e-12, atol=1e-14)
    assert names_of(read["states"]) == ["x", "angle", "der_x", "der_angle"]
    assert names_of(read["inputs"]) == ["force"]
    assert names_of(read["outputs"]) == names_of(read["states"])


def test_scipy_simulates_by_the_file_what_the_model_does_near_an_equilibrium(tmp_path):
    model = example("cart")
    tn.export_model(model, "mat", tmp_path)
    read = loadmat(tmp_path / "linear.mat")
    np.testing.assert_allclose(read["drift"], 0.0, atol=1e-17)
    system = StateSpace(*(read[k] for k in "ABCD"), dt=read["dt"].item())
    u = 1e-5 * np.sin(np.arange(50.0))[:, None]
    expected = np.asarray(tn.rollout(model, np.zeros(4), u[:-1]))
    np.testing.assert_allclose(dlsim(system, u)[1], expected, atol=1e-13)
    assert np.abs(expected).max() > 1e-8


def test_the_pages_programs_write_and_read_matrices(tmp_path, monkeypatch):
    programs = blocks("Matrices for scipy and MATLAB", "python")
    monkeypatch.chdir(tmp_path)
    known: dict[str, Any] = {"model": physics(system=SWING)}
    for program in programs:
        exec(compile(program, "mat.md", "exec"), known)
    np.testing.assert_array_equal(known["read"]["x"].ravel(), [0.1, 0.0])
    assert known["system"].dt == physics().dt


def test_inputs_at_other_samples_have_columns_and_names_of_their_own(tmp_path):
    tn.export_model(example("hybrid"), find_targets("mat", {"voltage": 2.0}), tmp_path)
    read = loadmat(tmp_path / "linear.mat")
    assert names_of(read["inputs"]) == ["voltage", "voltage_after_1", "voltage_before_1"]
    np.testing.assert_array_equal(read["u"], np.full((3, 1), 2.0))
    held = tn.linearize(example("hybrid"), np.zeros(3), np.array([2.0])).b
    np.testing.assert_allclose(read["B"].sum(axis=1, keepdims=True), held, rtol=1e-12)


def test_the_file_depends_on_its_content_only():
    source = example_source("cart")
    assert TARGET.files(source) == TARGET.files(source)


@pytest.mark.parametrize(
    ("point", "told"),
    [
        ({"tilt": 1.0}, "no state or input 'tilt'; expected some of x, angle"),
        ({"x": np.inf}, "x = inf"),
    ],
)
def test_a_point_that_the_model_does_not_have_is_refused(point, told, tmp_path):
    with pytest.raises(InputError, match=told):
        tn.export_model(example("cart"), Matrices(point), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_slopes_that_are_not_finite_are_refused(tmp_path):
    stuck = replace(CART, dissipation=lambda q, v, p: jnp.sqrt(jnp.abs(v)))
    model = tn.discretise(stuck.model({"mass": jnp.asarray(1.0)}), 0.01)
    with pytest.raises(InputError, match="operating point: derivatives that are not finite"):
        tn.export_model(model, "mat", tmp_path)


def test_an_operating_point_is_refused_where_no_target_has_one():
    with pytest.raises(InputError, match=r"`at=`: an operating point for casadi; .* add mat"):
        find_targets("casadi", {"theta": 0.1})
    both = find_targets("casadi,mat", {"theta": 0.1})
    assert [target.name for target in both] == ["casadi", "mat"]
    assert both[1] == Matrices({"theta": 0.1})


@pytest.mark.parametrize("to", ["mat,mat", ["mat", Matrices()], []])
def test_targets_are_named_once(to):
    with pytest.raises(InputError, match="none of them twice"):
        find_targets(to)
