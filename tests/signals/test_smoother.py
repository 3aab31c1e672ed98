"""The Kalman smoother."""

import numpy as np
import pytest

from tustinnet.signals.smoother import kalman_smoother

DT = 0.01
COUNT = np.array([3e-3])


@pytest.mark.parametrize("speed", [0.3, 40.0])
def test_steady_motion_is_smoothed_to_its_speed(speed: float) -> None:
    q = np.round(speed * np.arange(300)[:, None] * DT / COUNT) * COUNT
    v = kalman_smoother(q, DT, COUNT)
    np.testing.assert_allclose(v[20:-20], speed, rtol=0.02)


def test_rest_is_rest() -> None:
    np.testing.assert_allclose(kalman_smoother(np.full((50, 1), 0.7), DT, COUNT), 0, atol=1e-9)


def test_turning_the_clock_round_turns_the_velocity_round() -> None:
    t = np.arange(400) * DT
    q = np.round((np.exp(-t) * np.cos(6 * t))[:, None] / COUNT) * COUNT
    forward, backward = kalman_smoother(q, DT, COUNT), kalman_smoother(q[::-1], DT, COUNT)[::-1]
    # away from the ends, where the two start from different guesses
    np.testing.assert_allclose(forward[30:-30], -backward[30:-30], atol=0.02)


def test_a_finer_encoder_gives_a_smaller_error() -> None:
    t = np.arange(400) * DT
    q, v = np.sin(4 * t)[:, None], 4 * np.cos(4 * t)[:, None]
    errors = [
        np.sqrt(np.mean((kalman_smoother(np.round(q / c) * c, DT, np.array([c])) - v) ** 2))
        for c in (1e-2, 1e-3, 1e-4)
    ]
    assert errors[0] > 2 * errors[1] > 4 * errors[2]
