"""Time bases and unwrapped angles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tustinnet.errors import InputError
from tustinnet.signals.resampling import (
    regular_grid,
    regularity,
    require_short_grid,
    resample_held,
    resample_linear,
    resample_positions,
    turns_to_beginning,
    unwrap_angle,
    wraps_within_turn,
)

DT = 0.01


def irregular_times(samples: int, seed: int) -> np.ndarray:
    """Timestamps whose intervals vary by a third."""
    intervals = DT * np.random.default_rng(seed).uniform(0.7, 1.3, samples - 1)
    return 5.0 + np.concatenate([[0.0], np.cumsum(intervals)])


def wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def test_a_regular_time_base_has_no_jitter_and_no_gaps() -> None:
    found = regularity(3.0 + np.arange(50) * DT, DT)
    assert found.median_dt == pytest.approx(DT)
    assert found.jitter < 1e-12
    assert found.worst < 1e-12
    assert found.gaps == ()


def test_jitter_is_the_rms_deviation_from_the_period() -> None:
    t = np.cumsum([0.0, 0.011, 0.009, 0.011, 0.009])
    found = regularity(t, DT)
    assert found.jitter == pytest.approx(1e-3)
    assert found.worst == pytest.approx(1e-3)


def test_gaps_are_named_by_the_sample_before_them_and_left_out_of_the_jitter() -> None:
    t = np.delete(np.arange(60) * DT, [10, 11, 30, 31, 32])
    found = regularity(t, DT)
    assert found.gaps == (9, 27)
    assert found.jitter < 1e-12
    assert found.worst == pytest.approx(3 * DT)
    assert found.worst_row == 28


def test_one_missing_sample_counts_as_jitter_not_as_a_gap() -> None:
    found = regularity(np.delete(np.arange(60) * DT, 20), DT)
    assert found.gaps == ()
    assert found.worst_row == 20


@given(
    samples=st.integers(2, 3000),
    start=st.floats(-1e3, 1e3),
    dt=st.sampled_from([0.01, 0.002, 1 / 3, 0.1, 1 / 60]),
)
@settings(deadline=None, max_examples=30)
def test_the_grid_of_a_regular_record_keeps_its_last_sample(
    samples: int, start: float, dt: float
) -> None:
    t = start + np.arange(samples) * dt
    grid = regular_grid(t, dt)
    assert len(grid) == samples
    np.testing.assert_allclose(grid, t, atol=1e-9)


def test_the_grid_ends_inside_the_record() -> None:
    np.testing.assert_allclose(regular_grid(np.array([1.0, 1.05, 1.36]), 0.1), [1, 1.1, 1.2, 1.3])


def test_a_grid_is_at_most_ten_times_as_long_as_the_record() -> None:
    t = np.arange(20.0)
    require_short_grid(t, 0.1, str)
    with pytest.raises(InputError, match=r"^7: a grid of 0\.1 s makes .* \(interval of 1e\+18 s\)"):
        require_short_grid(np.where(t < 7, t, 1e18), 0.1, str)


def test_positions_are_interpolated_to_a_millionth_of_a_swing() -> None:
    t = irregular_times(300, seed=0)
    grid = regular_grid(t, DT)
    q = np.stack([np.sin(3 * t), np.cos(2 * t)], axis=1)
    truth = np.stack([np.sin(3 * grid), np.cos(2 * grid)], axis=1)
    np.testing.assert_allclose(resample_positions(t, q, grid), truth, atol=1e-6)


@pytest.mark.parametrize("samples", [2, 3, 4])
def test_short_records_are_interpolated_with_the_degree_they_allow(samples: int) -> None:
    t = np.arange(float(samples))
    q = resample_positions(t, 2 * t[:, None], np.array([0.5, samples - 1.0]))
    np.testing.assert_allclose(q[:, 0], [1.0, 2 * (samples - 1)])


def test_linear_interpolation_of_no_columns_keeps_the_rows() -> None:
    assert resample_linear(np.arange(4.0), np.zeros((4, 0)), np.arange(3.0)).shape == (3, 0)


@given(
    seed=st.integers(0, 1000), samples=st.integers(3, 60), factor=st.sampled_from([0.3, 1.0, 2.5])
)
@settings(deadline=None, max_examples=30)
def test_held_inputs_keep_their_impulse_on_a_regular_grid(
    seed: int, samples: int, factor: float
) -> None:
    t = irregular_times(samples, seed)
    u = np.random.default_rng(seed).uniform(-5, 5, (samples, 2))
    dt = min(factor * DT, (t[-1] - t[0]) / 2)
    grid = regular_grid(t, dt)
    applied = np.diff(t, append=grid[-1] + dt)  # the last value is held to the grid's end
    impulse = (resample_held(t, u, grid) * dt).sum(axis=0)
    np.testing.assert_allclose(impulse, applied @ u, atol=1e-9)


def test_a_held_pulse_between_grid_points_is_not_lost() -> None:
    t = np.array([0.0, 0.14, 0.16, 0.3, 0.4])
    u = np.array([[0.0], [10.0], [0.0], [0.0], [0.0]])
    np.testing.assert_allclose(
        resample_held(t, u, regular_grid(t, 0.1))[:, 0], [0, 2, 0, 0, 0], atol=1e-12
    )


def test_held_inputs_on_their_own_grid_are_unchanged() -> None:
    t = np.arange(30) * DT
    u = np.random.default_rng(0).normal(size=(30, 1))
    np.testing.assert_allclose(resample_held(t, u, t), u, atol=1e-9)


@given(speed=st.floats(-250, 250), start=st.floats(-3, 3))
@settings(deadline=None, max_examples=30)
def test_a_wrapped_ramp_is_unwrapped_up_and_down(speed: float, start: float) -> None:
    angle = start + speed * np.arange(200) * DT
    found, jumps = unwrap_angle(wrapped(angle))
    np.testing.assert_allclose(np.diff(found), speed * DT, atol=1e-9)
    assert found[0] == pytest.approx(wrapped(angle)[0])
    # one jump for every half turn that the ramp passes
    turns = np.floor((angle + np.pi) / (2 * np.pi))
    np.testing.assert_array_equal(jumps, np.flatnonzero(np.diff(turns)) + 1)


def test_an_angle_that_never_jumps_is_left_alone() -> None:
    angle = 20 * np.sin(np.arange(300) * DT)
    found, jumps = unwrap_angle(angle)
    np.testing.assert_array_equal(found, angle)
    assert len(jumps) == 0


def test_equal_readings_in_a_turn_are_equal_angles() -> None:
    counts = np.array([4095, 0, 4095, 1, 4094, 0, 4095, 0] * 20)
    found, jumps = unwrap_angle(counts * 2 * np.pi / 4096)
    assert len(jumps) > 100
    assert len(np.unique(found)) == len(np.unique(counts))


@pytest.mark.parametrize(
    ("angle", "wraps"),
    [
        ([6.1, 6.2, 0.02, 6.25], True),
        ([3.0, -3.1, 3.1], True),
        ([0.0, 3.0, 6.2], False),  # no jump
        ([100.0, 104.0, 100.1], False),  # two bad rows, or too fast to tell
        ([12.0, 6.0, 0.1, 12.5, 12.4], False),  # a counter of two turns
        ([4.5, 4.4, 0.0, 4.4], False),  # a bad row
    ],
)
def test_an_encoder_wraps_that_jumps_by_a_turn_within_a_turn(
    angle: list[float], *, wraps: bool
) -> None:
    assert wraps_within_turn(np.array(angle)) is wraps


@pytest.mark.parametrize("sample", [0, 30, 41, 42, 59])
@pytest.mark.parametrize("reading", [57.0, -200.0])
def test_a_single_reading_turns_away_from_the_others_is_no_wrap(sample: int, reading: float):
    clean = np.mod(np.linspace(0, 9, 60), 2 * np.pi)  # wraps at 42
    bad = clean.copy()
    bad[sample] = reading
    expected, _ = unwrap_angle(clean)
    found, jumps = unwrap_angle(bad)
    others = np.arange(60) != sample
    np.testing.assert_array_equal(found[others], expected[others])
    assert abs(found[sample] - reading) < 2 * np.pi + 1e-9
    assert len(jumps) == 1


def test_a_counter_of_several_turns_wraps_also_for_a_single_reading() -> None:
    angle = np.array([24.7, 24.9, 25.0, 25.2, 25.1, 25.2, 25.0, 24.9])
    found, jumps = unwrap_angle(np.mod(angle, 8 * np.pi))
    np.testing.assert_allclose(np.diff(found), np.diff(angle))
    assert len(jumps) == 4


@given(angle=st.floats(-40, 40))
def test_a_wrapped_record_begins_between_minus_135_and_225_degrees(angle: float) -> None:
    begins = angle + 2 * np.pi * turns_to_beginning(angle)
    assert -3 / 8 - 1e-9 < begins / (2 * np.pi) < 5 / 8 + 1e-9


@pytest.mark.parametrize("rest", np.deg2rad([-90, 0, 90, 180]))
@pytest.mark.parametrize("turn", [-2 * np.pi, 0.0, 2 * np.pi])
def test_both_sides_of_a_position_of_rest_begin_together(rest: float, turn: float) -> None:
    for side in (-0.3, 0.3):
        begins = rest + side + turn
        assert begins + 2 * np.pi * turns_to_beginning(begins) == pytest.approx(rest + side)
