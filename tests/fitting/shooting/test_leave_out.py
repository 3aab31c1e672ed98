"""What other records say of one, without a new fit."""

import numpy as np
import pytest

from tustinnet.fitting.shooting.leave_out import QuadraticCost

RANDOM = np.random.default_rng(0)
REGRESSORS = RANDOM.normal(size=(4, 9, 3))  # groups, samples, parameters
TARGETS = REGRESSORS @ [1.0, -2.0, 0.1] + 0.3 * RANDOM.normal(size=(4, 9))
AT, UNIT = np.array([0.7, -1.0, 0.4]), np.array([1.0, 5.0, 0.2])


def of_linear_problem(regressors: np.ndarray = REGRESSORS) -> QuadraticCost:
    """Of a linear least-squares problem, for which it is exact."""
    residuals = regressors @ AT - TARGETS
    return QuadraticCost(
        point=AT * UNIT,
        unit=UNIT,
        cost=np.sum(residuals**2, axis=1),
        gradient=np.einsum("gsp,gs->gp", regressors, residuals) / UNIT,
        curvature=np.einsum("gsp,gsr->gpr", regressors, regressors) / np.outer(UNIT, UNIT),
        regularisation=np.zeros(3),
    )


@pytest.fixture(scope="module")
def model() -> QuadraticCost:
    return of_linear_problem()


def solved(groups: list[int], fixed: dict[int, float]) -> np.ndarray:
    regressors, targets = np.concatenate(REGRESSORS[groups]), np.concatenate(TARGETS[groups])
    free = [i for i in range(3) if i not in fixed]
    vector = np.zeros(3)
    vector[list(fixed)] = list(fixed.values())
    rest = targets - regressors @ vector
    vector[free] = np.linalg.lstsq(regressors[:, free], rest, rcond=None)[0]
    return vector


@pytest.mark.parametrize("fixed", [{}, {2: 0.0}, {2: 0.0, 0: 1.0}, {0: 0.0, 1: 0.0, 2: 0.0}])
def test_it_says_what_new_fits_without_a_group_would(model, fixed):
    vectors = [solved([g for g in range(4) if g != out], fixed) for out in range(4)]
    expected = sum(np.sum((REGRESSORS[g] @ vectors[g] - TARGETS[g]) ** 2) for g in range(4))
    assert model.leave_one_out_cost(fixed) == pytest.approx(expected)
    every = solved([0, 1, 2, 3], fixed)
    np.testing.assert_allclose(model.best_vector(fixed), every, atol=1e-12)
    assert model.best_cost(fixed) == pytest.approx(np.sum((REGRESSORS @ every - TARGETS) ** 2))


def test_two_terms_that_are_one_cost_what_one_of_them_does():
    twice = of_linear_problem(REGRESSORS[:, :, [0, 1, 1]])
    alone = twice.leave_one_out_cost({2: 0.0})
    assert twice.leave_one_out_cost({}) == pytest.approx(alone, rel=1e-6)
