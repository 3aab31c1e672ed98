"""Levenberg-Marquardt within a box."""

import numpy as np
import pytest
from swinging import DT, FAR, SWING, TRUTH, changed, noisy, records, swing_model

import tustinnet as tn
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting import least_squares
from tustinnet.fitting.shooting.least_squares import (
    CostFunction,
    LeastSquaresResult,
    OnStep,
    Prior,
    StoppingRule,
    minimise,
    solve_in_box,
)
from tustinnet.fitting.shooting.normal import compute_products, eliminate_initial_states
from tustinnet.fitting.shooting.segments import CutOptions, Segments, cut_records
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.models.lagrangian import LagrangianSystem

SPACE = make_search_space(SWING, {}, {})
POSITION = Residual((False,), (1.0,))
NO_PRIOR = Prior(np.zeros(3), np.zeros(3), 0.0)
SEARCHED_TRUTH = {name: TRUTH[name] for name in SPACE.names}


def segments(length: int | None = 25, noise: float = 0.0) -> Segments:
    experiments = [noisy(e, noise, i) for i, e in enumerate(records())]
    how = CutOptions(POSITION, length, timestamps=False)
    return cut_records(experiments, tn.discretise(swing_model(), DT), how)


def search(
    values: dict[str, float],
    pieces: Segments,
    *,
    prior: Prior = NO_PRIOR,
    anchor_variance: float = 1e-10,
    system: LagrangianSystem = SWING,
    tolerance: float = 1e-9,
    iterations: int = 60,
    on_step: OnStep = lambda iterations, cost, damping, is_accepted: None,
) -> LeastSquaresResult:
    space = make_search_space(system, {}, {})
    vector = space.to_vector(system.nominal() | values)
    cost = CostFunction(system, POSITION, space, pieces, prior, anchor_variance, substeps=1)
    return minimise(cost, vector, StoppingRule(tolerance, iterations), on_step)


def test_it_reaches_the_truth_from_afar():
    steps: list[tuple[int, float, float, bool]] = []
    fitted = search(FAR, segments(), on_step=lambda *args: steps.append(args))
    found = SPACE.to_values_in_range(fitted.vector)
    assert {n: found[n] for n in SEARCHED_TRUTH} == pytest.approx(SEARCHED_TRUTH, rel=1e-4)
    assert fitted.status == "converged"
    assert fitted.iterations > 2
    iterations = [step for step in steps if step[-1]]
    assert [number for number, *_ in iterations] == list(range(1, fitted.iterations + 1))
    costs = [cost for _, cost, *_ in iterations]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == fitted.cost < 1e-6


def test_initial_states_are_found_with_the_parameters():
    pieces = segments()
    fitted = search(FAR, pieces)
    begins = np.concatenate([[0], np.cumsum(pieces.steps)])[:-1]
    truth = np.concatenate([np.hstack([e.q, e.velocities("file")])[:-1] for e in records()])
    read, found = (np.abs(x0 - truth[begins]).max() for x0 in (pieces.x0, fitted.x0))
    assert found < 1e-4 < 0.1 < read


def test_every_iterate_stays_within_the_box_and_an_active_bound_is_told(monkeypatch):
    narrow = changed("damping", lower=0.03, upper=0.07, nominal=0.05)
    space = make_search_space(narrow, {}, {})
    visited = []

    def watched(system, residual, space, vector, *rest):
        visited.append(vector)
        return compute_products(system, residual, space, vector, *rest)

    monkeypatch.setattr(least_squares, "compute_products", watched)
    fitted = search(FAR, segments(), system=narrow)
    assert len(visited) > fitted.iterations > 2
    assert np.all(np.array(visited) >= space.lower)
    assert np.all(np.array(visited) <= space.upper)
    assert space.active_bounds(fitted.vector) == {"damping": "lower"}
    assert fitted.status == "converged"


def test_a_bound_that_was_touched_on_the_way_is_left_again():
    fitted = search({"damping": 1e-3, "gravity": 10.0, "gain": 0.01}, segments())
    assert SPACE.active_bounds(fitted.vector) == {}
    assert SPACE.to_values_in_range(fitted.vector)["gain"] == pytest.approx(TRUTH["gain"], rel=1e-4)


def test_eliminating_the_initial_states_gives_the_whole_gauss_newton_step():
    pieces = segments(50)
    vector = SPACE.to_vector(TRUTH | {"gravity": 1.2, "damping": 0.03})
    normal = compute_products(SWING, POSITION, SPACE, vector, pieces.x0, pieces, 1)
    matrices, gradients, by_gradient, by_step = eliminate_initial_states(normal)
    step = -np.linalg.solve(matrices.sum(axis=0), gradients.sum(axis=0))
    states = by_gradient + by_step @ step

    n_s, n_x = pieces.x0.shape
    whole = np.zeros((3 + n_s * n_x, 3 + n_s * n_x))
    whole[:3, :3] = normal.pp.sum(axis=0)
    for s in range(n_s):
        rows = slice(3 + s * n_x, 3 + (s + 1) * n_x)
        whole[:3, rows], whole[rows, :3] = normal.px[s], normal.px[s].T
        whole[rows, rows] = normal.xx[s]
    gradient = np.concatenate([normal.gp.sum(axis=0), normal.gx.ravel()])
    dense = -np.linalg.solve(whole, gradient)
    np.testing.assert_allclose(step, dense[:3], rtol=1e-6)
    np.testing.assert_allclose(states.ravel(), dense[3:], rtol=1e-6, atol=1e-9)


def test_states_that_are_given_do_not_move():
    how = CutOptions(POSITION, initial_treatment="file", timestamps=False)
    pieces = cut_records(records(), tn.discretise(swing_model(), DT), how)
    fitted = search({"gravity": 1.4}, pieces)
    np.testing.assert_array_equal(fitted.x0, pieces.x0)
    assert SPACE.to_values_in_range(fitted.vector)["gravity"] == pytest.approx(1.5, rel=1e-4)


def test_the_limit_of_iterations_is_told():
    assert search(FAR, segments(), iterations=2).status == "limit"


def test_what_was_measured_holds_the_initial_positions():
    pieces = segments(None, noise=0.02)
    loose, tight = (search({}, pieces, anchor_variance=variance) for variance in (1e-10, 1e3))
    moved = [np.abs(f.x0 - pieces.x0)[:, 0].max() for f in (loose, tight)]
    assert moved[1] < 1e-4 < 1e-3 < moved[0]


def test_a_strong_prior_decides():
    pieces = segments(None)
    prior = Prior(np.array([0.0, 3.0, 0.0]), np.array([0.0, 1 / 0.01, 0.0]), 1e3)
    fitted = search({}, pieces, prior=prior, anchor_variance=1e-6)
    assert SPACE.to_values_in_range(fitted.vector)["gravity"] == pytest.approx(3.0, abs=0.05)


def test_the_least_within_bounds_leaves_no_slope_but_towards_them():
    """Also where active sets come round to earlier ones: in 11 of these."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        turned, _ = np.linalg.qr(rng.normal(size=(8, 8)))
        root = rng.normal(size=(8, 8)) @ np.diag(10.0 ** rng.uniform(-2, 0, 8)) @ turned
        matrix = root.T @ root
        unit = np.sqrt(np.diag(matrix))
        gradient, lower, upper = rng.normal(size=8) * unit, -rng.random(8), rng.random(8)
        x = solve_in_box(matrix, gradient, lower, upper)
        slope = (matrix @ x + gradient) / unit
        assert np.all((x >= lower) & (x <= upper))
        at_low, at_high = x < lower + 1e-12, x > upper - 1e-12
        assert np.all(np.abs(slope[~(at_low | at_high)]) < 1e-9)
        assert np.all(slope[at_low] > -1e-9)
        assert np.all(slope[at_high] < 1e-9)
