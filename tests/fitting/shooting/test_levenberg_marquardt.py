"""The iteration of Levenberg and Marquardt on costs that are made up."""

from dataclasses import dataclass

import pytest

from tustinnet.fitting.shooting.levenberg_marquardt import DampingRule, IterationResult, iterate

RULE = DampingRule(1e-3, 1e6, 10.0, lambda damping, _: damping / 10, 0.0)


@dataclass(frozen=True)
class Point:
    """A point of a valley whose floor falls by a share of the cost with every step."""

    cost: float
    fall: float


def creep(fall: float, least_decrease: float) -> IterationResult[Point]:
    """Steps that each take off a share of the cost, and promise as much."""
    return iterate(
        Point(1.0, fall),
        lambda point, _: (Point(point.cost * (1 - fall), fall), point.cost * fall),
        lambda point, before: False,
        RULE,
        200,
        lambda *told: None,
        lambda: False,
        least_decrease,
    )


@pytest.mark.parametrize(("fall", "status"), [(1e-8, "slow"), (9e-4, "slow"), (2e-3, "limit")])
def test_steps_that_take_off_next_to_nothing_end_it(fall, status):
    result = creep(fall, 1e-2)
    assert (result.status, result.iterations) == (status, 10 if status == "slow" else 200)
    assert creep(fall, 0.0).status == "limit"
