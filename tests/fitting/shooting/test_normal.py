"""Products of simulation errors and their derivatives, against a simulation written in numpy."""

from dataclasses import fields, replace

import numpy as np
import pytest
from swinging import CREEPING, DT, TILT, TRUTH, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.normal import NormalProducts, compute_products
from tustinnet.fitting.shooting.segments import CutOptions, Segments, cut_records
from tustinnet.fitting.shooting.space import make_search_space

SPACE = make_search_space(CREEPING, {}, {})
VALUES = CREEPING.nominal() | {"damping": 0.03, "gravity": 1.3, "gain": 0.12}
VECTOR = SPACE.to_vector(VALUES)
SUBSTEPS = 2
# what segments have each for itself
BY_SEGMENT = (
    "x0",
    "is_free",
    "adds_expected",
    "precision",
    "steps",
    "first_row",
    "record",
    "share",
    "group_indices",
)


def segments() -> Segments:
    """Seven segments of three records of unequal length, timestamps jittering."""
    lengths = (70, 50, 31)
    experiments = []
    for i, samples in enumerate(lengths):
        e = simulated(f"e{i}", [2.5 - 2 * i, 0.5], voltage(samples, i))
        experiments.append(replace(e, t=e.t + 1e-3 * np.sin(np.arange(samples))))
    model = tn.discretise(swing_model(system=CREEPING), DT)
    return cut_records(experiments, model, CutOptions(Residual((False,), (1 / 1.5,)), 22))


def products(
    vector: np.ndarray,
    states: np.ndarray,
    pieces: Segments,
    substeps: int = SUBSTEPS,
    *,
    periodic: bool = False,
) -> NormalProducts:
    residual = Residual((periodic,), (1 / 1.5,))
    return compute_products(CREEPING, residual, SPACE, vector, states, pieces, substeps)


@pytest.fixture(scope="module")
def pieces() -> Segments:
    return segments()


@pytest.fixture(scope="module")
def states(pieces) -> np.ndarray:
    """Initial states away from those that were read."""
    away = 0.1 * np.random.default_rng(5).normal(size=pieces.x0.shape)
    return pieces.x0 + away * pieces.is_free


@pytest.fixture(scope="module")
def normal(pieces, states) -> NormalProducts:
    return products(VECTOR, states, pieces)


def by_hand(p: dict[str, float], x0: np.ndarray, u: np.ndarray, periods: np.ndarray) -> np.ndarray:
    """Angles of the creeping swing by the classical Runge-Kutta method."""

    def slope(x: np.ndarray, volts: float) -> np.ndarray:
        force = p["gain"] * volts + p["offset"] - p["damping"] * x[1] - p["stiffness"] * x[2]
        force -= p["gravity"] * np.sin(x[0] - TILT)
        return np.array([x[1], force / p["inertia"], x[1] - p["relaxation"] * x[2]])

    x, angles = x0, [x0[0]]
    for volts, period in zip(u, periods, strict=True):
        h = period / SUBSTEPS
        for _ in range(SUBSTEPS):
            k1 = slope(x, volts)
            k2 = slope(x + h / 2 * k1, volts)
            k3 = slope(x + h / 2 * k2, volts)
            k4 = slope(x + h * k3, volts)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        angles.append(x[0])
    return np.array(angles)


def residuals(
    s: Segments, row: int, vector: np.ndarray, x0: np.ndarray, *, periodic: bool = False
) -> np.ndarray:
    at = s.rows(row)
    angles = by_hand(SPACE.to_values_in_range(vector), x0, s.inputs[at][:-1, 0], s.periods[at][:-1])
    error = angles - s.measurements[at, 0]
    return (2 * np.sin(error / 2) if periodic else error) * s.weights[at, 0]


def differences(function, at: np.ndarray) -> np.ndarray:
    h = 1e-5
    steps = h * np.eye(len(at))
    return np.stack([(function(at + d) - function(at - d)) / (2 * h) for d in steps], axis=1)


@pytest.mark.thorough
@pytest.mark.parametrize("periodic", [False, True])
def test_products_are_those_of_finite_differences(pieces, states, normal, periodic):
    if periodic:
        normal = products(VECTOR, states, pieces, periodic=True)
    for row, x0 in enumerate(states):
        r = residuals(pieces, row, VECTOR, x0, periodic=periodic)
        jacobian = differences(
            lambda v, row=row, x0=x0: residuals(pieces, row, v, x0, periodic=periodic), VECTOR
        )
        by_state = pieces.is_free[row] * differences(
            lambda x, row=row: residuals(pieces, row, VECTOR, x, periodic=periodic), x0
        )
        expected = {
            "pp": jacobian.T @ jacobian,
            "px": jacobian.T @ by_state,
            "xx": by_state.T @ by_state,
            "gp": jacobian.T @ r,
            "gx": by_state.T @ r,
            "cost": r @ r,
        }
        for name, value in expected.items():
            actual = getattr(normal, name)[row]
            np.testing.assert_allclose(actual, value, rtol=1e-6, atol=1e-9, err_msg=name)


def test_errors_are_simulated_minus_measured(pieces, states, normal):
    for row, x0 in enumerate(states):
        expected = residuals(pieces, row, VECTOR, x0) / pieces.weights[pieces.rows(row), 0]
        np.testing.assert_allclose(normal.error[row][:, 0], expected, atol=1e-10)


def test_states_that_are_not_searched_for_have_no_derivative(pieces, normal):
    fixed = pieces.is_free == 0
    assert fixed.any()
    assert not np.diagonal(normal.xx, axis1=1, axis2=2)[fixed].any()
    assert not normal.gx[fixed].any()


def require_alike(actual: NormalProducts, expected: NormalProducts, order: np.ndarray) -> None:
    for part in fields(NormalProducts):
        values = getattr(expected, part.name)
        for now, before in zip(getattr(actual, part.name), (values[i] for i in order), strict=True):
            np.testing.assert_allclose(now, before, rtol=1e-9, atol=1e-12, err_msg=part.name)


@pytest.mark.thorough
@pytest.mark.parametrize("engine", ["jax", "llvm"])
def test_both_engines_find_the_same_products(pieces, states, normal, engine, monkeypatch):
    monkeypatch.setenv("TUSTINNET_ENGINE", engine)
    require_alike(products(VECTOR, states, pieces), normal, np.arange(len(states)))


def test_products_do_not_depend_on_what_stands_beside(pieces, states, normal):
    alone = [
        products(VECTOR, states[[row]], part)
        for row in range(len(states))
        for part in [replace(pieces, **{name: getattr(pieces, name)[[row]] for name in BY_SEGMENT})]
    ]
    for row, part in enumerate(alone):
        require_alike(part, normal, np.array([row]))


def test_products_come_in_the_order_of_the_segments(pieces, states, normal):
    order = np.random.default_rng(3).permutation(len(states))
    shuffled = replace(pieces, **{name: getattr(pieces, name)[order] for name in BY_SEGMENT})
    other = products(VECTOR, states[order], shuffled)
    require_alike(other, normal, order)


def test_the_truth_leaves_no_error(pieces):
    e = simulated("e", [1.0, 0.0, 0.0], voltage(60, 4), {"stiffness": 0.8}, CREEPING)
    model = tn.discretise(swing_model(system=CREEPING), DT)
    s = cut_records(
        [e],
        model,
        CutOptions(Residual((False,), (1.0,)), initial_treatment="file", timestamps=False),
    )
    truth = SPACE.to_vector(CREEPING.nominal() | TRUTH | {"stiffness": 0.8})
    actual = products(truth, s.x0, s, 8)
    assert actual.cost[0] < 1e-20
