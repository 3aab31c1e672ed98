"""Positions about which coordinates move."""

import numpy as np

from tustinnet.signals.rest import usual_positions

ANGLE_AND_CART = np.array([True, False])


def test_a_pendulum_that_came_to_rest_after_a_turn_rests_at_the_bottom():
    falling = np.linspace(0.1, -np.pi, 40)
    angle = np.concatenate([falling, np.full(200, -np.pi), np.full(100, np.pi), -falling])
    found = usual_positions(np.stack([angle, np.zeros(len(angle))], axis=1), ANGLE_AND_CART)
    np.testing.assert_allclose(np.abs(found[0]), np.pi, atol=1e-12)
    assert found[1] == 0


def test_whole_turns_do_not_count_for_angles_but_metres_do():
    about = np.array([0.3, 0.4, 0.5])
    q = np.stack([about + 2 * np.pi * np.array([0, 3, -2]), about + np.array([0.0, 9.0, 0.0])], 1)
    np.testing.assert_allclose(usual_positions(q, ANGLE_AND_CART), [0.4, 0.5], rtol=1e-12)
