"""The count of an encoder, found in the positions that it gave."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tustinnet.signals.encoder import encoder_count
from tustinnet.signals.resampling import unwrap_angle

DT = 0.01
COUNT = 2 * np.pi / 4096


@given(
    count=st.floats(1e-3, 3e-2),
    amplitude=st.floats(20, 400),
    speed=st.floats(0.5, 3.0),
    offset=st.floats(-2, 2),
    digits=st.sampled_from([6, 12]),
)
@settings(deadline=None, max_examples=30)
def test_the_count_of_an_encoder_is_found_to_a_thousandth(
    count: float, amplitude: float, speed: float, offset: float, digits: int
) -> None:
    t = np.arange(1500) * DT
    levels = np.round(amplitude * np.exp(-0.2 * t) * np.sin(speed * t))
    found = encoder_count(np.round(offset + count * levels, digits))
    assert found == pytest.approx(count, rel=1e-3)


@pytest.mark.parametrize("levels", [[0, 1, 2], [0, 1, 3], [5, 4, 7, 10, 11], [0, 2, 3, 40, 41]])
def test_a_few_levels_are_enough(levels: list[int]) -> None:
    q = np.round(0.7 + COUNT * np.repeat(levels, 20), 6)
    assert encoder_count(q) == pytest.approx(COUNT, rel=1e-3)


def test_a_fast_signal_that_skips_most_levels_has_a_count() -> None:
    t = np.arange(600) * DT
    assert encoder_count(np.round(6 * np.sin(7 * t) / COUNT) * COUNT) == pytest.approx(
        COUNT, rel=1e-3
    )


@pytest.mark.parametrize("digits", [6, 15])
@pytest.mark.parametrize("seed", range(5))
def test_a_continuous_signal_has_no_count(seed: int, digits: int) -> None:
    generator = np.random.default_rng(seed)
    t = np.arange(800) * DT
    q = np.exp(-generator.uniform(0, 0.5) * t) * np.sin(generator.uniform(1, 9) * t)
    assert encoder_count(np.round(q, digits)) is None


@pytest.mark.parametrize("q", [np.zeros(50), np.arange(50) % 2 * 0.1])
def test_fewer_than_three_levels_tell_no_count(q: np.ndarray) -> None:
    assert encoder_count(q) is None


@pytest.mark.parametrize("per_turn", [2400, 4096])
@pytest.mark.parametrize("digits", [6, 15])
@pytest.mark.parametrize("amplitude", [40.0, 300.0, 9000.0])
@pytest.mark.parametrize("first", [0.02, 6.26])
def test_an_encoder_that_wraps_near_zero_has_its_count(
    per_turn: int, digits: int, amplitude: float, first: float
) -> None:
    count, t = 2 * np.pi / per_turn, np.arange(1500) * DT
    levels = np.round(first / count + amplitude * np.sin(9 * t) * np.exp(-0.1 * t))
    q, jumps = unwrap_angle(np.round(count * (levels % per_turn), digits))
    assert len(jumps) > 2
    assert encoder_count(q) == pytest.approx(count, rel=1e-3)


@pytest.mark.parametrize("offset", [0.0, 2 * np.pi, 2e3])
def test_rounding_of_the_arithmetic_makes_no_levels(offset: float) -> None:
    generator, levels = np.random.default_rng(0), np.arange(400) // 10
    turns = 2 * np.pi * generator.integers(-40, 40, 400)
    q = offset + (COUNT * levels + turns) - turns  # equal but for the last digits
    assert len(np.unique(q)) > 2 * 40
    assert encoder_count(q) == pytest.approx(COUNT, rel=1e-3)
