"""Velocities from a record's own spectrum."""

import numpy as np
import pytest

from tustinnet.signals.derivatives import differentiate

DT = 1 / 600
COUNT = np.array([3e-4])


def fast(samples: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of a motion with six to ten samples a period."""
    generator = np.random.default_rng(0)
    f = np.linspace(60, 100, 25)
    phase, t = generator.uniform(0, 2 * np.pi, 25), np.arange(samples) * DT
    angle = 2 * np.pi * np.outer(t, f) + phase
    return 0.01 * np.cos(angle).sum(axis=1), -0.02 * np.pi * (f * np.sin(angle)).sum(axis=1)


def relative(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.std(found[:, 0] - true) / np.std(true))


def test_a_fast_motion_is_differentiated_ten_times_better_than_by_the_stencil():
    q, v = fast()
    read = np.round(q[:, None] / COUNT) * COUNT
    error = {m: relative(differentiate(read, DT, m, COUNT), v) for m in ("stencil", "wiener")}
    assert error["wiener"] < 0.006
    assert error["wiener"] < error["stencil"] / 5


def test_the_first_and_last_samples_are_estimated_too():
    q, v = fast()
    ends = np.r_[:12, -12:0]
    found = differentiate(q[:, None], DT, "wiener", COUNT)
    assert np.abs(found[ends, 0] - v[ends]).max() < 0.1 * np.std(v)


def test_trapezoidal_velocities_sum_to_the_positions_and_are_not_the_derivative():
    q, v = fast()
    found = differentiate(q[:, None], DT, "trapezoidal", None)
    inside = slice(20, -20)
    summed = DT * (found[1:, 0] + found[:-1, 0]) / 2
    np.testing.assert_allclose(summed[inside], np.diff(q)[inside], atol=1e-3 * np.ptp(q))
    assert 0.05 < relative(found, v) < 0.2


@pytest.mark.parametrize("method", ["wiener", "trapezoidal"])
def test_a_slow_motion_has_the_velocities_of_the_stencil(method):
    t = np.arange(800) * 0.01
    q = np.stack([np.sin(3 * t), np.cos(2 * t)], axis=1)
    found = differentiate(q, 0.01, method, np.array([1e-3, 0.0]))
    assert np.abs(found - differentiate(q, 0.01, "stencil"))[20:-20].max() < 0.03


def test_a_coordinate_that_never_moves_has_none_and_few_samples_are_enough():
    q = np.stack([np.ones(6), np.arange(6.0)], axis=1)
    found = differentiate(q, 0.1, "wiener")
    assert (found[:, 0] == 0).all()
    assert np.isfinite(found).all()
    # whose mean is rounded
    assert not differentiate(np.full((150, 1), 1.2396694214876032), 1e-3, "wiener").any()


def test_noise_that_nobody_declared_is_read_from_the_spectrum():
    t = np.arange(1000) * 0.01
    q, v = np.sin(3 * t) + 0.3 * np.sin(11 * t), 3 * np.cos(3 * t) + 3.3 * np.cos(11 * t)
    noisy = (q + np.random.default_rng(0).normal(0, 5e-4, len(q)))[:, None]
    found = {m: differentiate(noisy, 0.01, m) for m in ("stencil", "wiener", "trapezoidal")}
    inside = slice(20, -20)
    error = {m: np.std(x[inside, 0] - v[inside]) for m, x in found.items()}
    assert error["wiener"] < error["stencil"] / 5
    assert error["trapezoidal"] < error["stencil"] / 5
