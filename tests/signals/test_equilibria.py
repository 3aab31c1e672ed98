"""Unstable positions that are held, and those that only look so."""

import numpy as np
import pytest

from tustinnet.signals.equilibria import find_held_equilibrium

DT = 0.005


def held_pendulum(seed: int) -> tuple[np.ndarray, ...]:
    """Positions, velocities and inputs of an inverted pendulum, growing with 5 /s, that is held."""
    rng, x = np.random.default_rng(seed), np.array([0.02, 0.0])
    rows = []
    for _ in range(1200):
        u = -60.0 * x[0] - 10.0 * x[1] + rng.normal()
        rows.append([*x, u])
        for _ in range(10):
            x = x + DT / 10 * np.array([x[1], 25.0 * x[0] + u])
    table = np.array(rows)
    return table[:, :1], table[:, 1:2], table[:, 2:]


@pytest.mark.parametrize("seed", range(3))
def test_a_position_that_a_controller_holds_is_found_with_its_growth(seed):
    q, v, u = held_pendulum(seed)
    held = find_held_equilibrium(q, v, u, (True,), DT)
    assert held is not None
    assert held.sample == 0
    assert 1 / held.e_fold == pytest.approx(5.0, rel=0.2)


def test_a_position_that_is_held_at_one_place_after_another_is_held_from_the_first_sample_on():
    q, v, u = held_pendulum(0)
    q[:500] += 1.0
    held = find_held_equilibrium(q, v, u, (True,), DT)
    assert held is not None
    assert held.sample == 0


@pytest.mark.parametrize("seed", range(5))
def test_joints_that_move_to_their_last_pose_are_not_held(seed):
    rng, t = np.random.default_rng(seed), DT * np.arange(300)
    # of six joints a linear fit has nearly as many numbers as a short motion has bends
    phase, rate = rng.uniform(0, 2 * np.pi, 6), rng.uniform(1, 4, 6)
    q = 0.2 * np.sin(rate * t[:, None] + phase) * np.exp(-((t[:, None] - 1.5) ** 2))
    v = np.gradient(q, DT, axis=0)
    torque = 5 * np.gradient(v, DT, axis=0) + 2 * np.sign(v) + 0.1 * rng.normal(size=q.shape)
    assert find_held_equilibrium(q, v, torque, (True,) * 6, DT) is None
