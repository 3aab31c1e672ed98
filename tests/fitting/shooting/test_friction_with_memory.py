"""Frictions with memory, identified from twins."""

import pytest
from friction_with_memory import LAWS, TRUTH, identify_friction


@pytest.mark.parametrize("law", LAWS)
def test_a_friction_with_memory_is_found_within_its_intervals(law):
    worst, inside, result = identify_friction(law, 0, LAWS[law] | TRUTH)
    assert {e.name for e in result.estimates} >= set(LAWS[law]) - {"joint.hysteresis_exponent"}
    assert worst < 0.02
    assert all(inside)
