"""Frictions with memory, identified from twins."""

import pytest
from friction_with_memory import LAWS, TRUTH, identify_friction


@pytest.mark.thorough
@pytest.mark.parametrize("law", LAWS)
def test_a_friction_with_memory_is_found(law):
    worst, inside, result = identify_friction(law, 0, LAWS[law] | TRUTH)
    assert {e.name for e in result.estimates} >= set(LAWS[law]) - {"joint.hysteresis_exponent"}
    assert worst < 0.02
    # 95 % of the intervals contain the true values: benchmarks/friction_with_memory.py
    assert sum(inside) >= 0.75 * len(inside)
