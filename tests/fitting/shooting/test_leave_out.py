"""What other records say of one, without a new fit."""

import numpy as np
import pytest

from tustinnet.fitting.shooting.leave_out import QuadraticCost

RANDOM = np.random.default_rng(0)
SEEN = RANDOM.normal(size=(4, 9, 3))  # groups, samples, parameters
SAID = SEEN @ [1.0, -2.0, 0.1] + 0.3 * RANDOM.normal(size=(4, 9))
AT, UNIT = np.array([0.7, -1.0, 0.4]), np.array([1.0, 5.0, 0.2])


@pytest.fixture(scope="module")
def model() -> QuadraticCost:
    """Of a linear least-squares problem, for which it is exact."""
    left = SEEN @ AT - SAID
    return QuadraticCost(
        point=AT * UNIT,
        unit=UNIT,
        cost=np.sum(left**2, axis=1),
        gradient=np.einsum("gsp,gs->gp", SEEN, left) / UNIT,
        curvature=np.einsum("gsp,gsr->gpr", SEEN, SEEN) / np.outer(UNIT, UNIT),
        regularisation=np.zeros(3),
    )


def solved(groups: list[int], given: dict[int, float]) -> np.ndarray:
    seen, said = np.concatenate(SEEN[groups]), np.concatenate(SAID[groups])
    free = [i for i in range(3) if i not in given]
    found = np.zeros(3)
    found[list(given)] = list(given.values())
    found[free] = np.linalg.lstsq(seen[:, free], said - seen @ found, rcond=None)[0]
    return found


@pytest.mark.parametrize("given", [{}, {2: 0.0}, {2: 0.0, 0: 1.0}, {0: 0.0, 1: 0.0, 2: 0.0}])
def test_it_says_what_new_fits_without_a_group_would(model, given):
    others = [solved([g for g in range(4) if g != left], given) for left in range(4)]
    wanted = sum(np.sum((SEEN[g] @ others[g] - SAID[g]) ** 2) for g in range(4))
    assert model.leave_one_out_cost(given) == pytest.approx(wanted)
    every = solved([0, 1, 2, 3], given)
    np.testing.assert_allclose(model.best_vector(given), every, atol=1e-12)
    assert model.best_cost(given) == pytest.approx(np.sum((SEEN @ every - SAID) ** 2))
