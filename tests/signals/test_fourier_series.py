"""Periodic motions that begin and end at rest."""

import numpy as np
import pytest

from tustinnet.signals.fourier_series import FourierMotion, motions_from_rest


@pytest.mark.parametrize(("count", "frequency"), [(2, 1.0), (5, 0.1), (12, 0.37)])
def test_every_shape_begins_and_ends_at_rest_and_is_as_fast_as_the_others(count, frequency):
    shapes = motions_from_rest(count, frequency)
    assert shapes.shape == (2 * count - 2, 2 * count)
    sine, cosine = np.split(shapes.T, 2)
    motion = FourierMotion(frequency, np.zeros(len(shapes)), sine, cosine)
    ends = motion.sample(np.array([0.0, 1 / frequency, 3 / frequency]))
    speed = 2 * np.pi * frequency * count
    assert np.abs(ends[1]).max() < 1e-9
    assert np.abs(ends[2]).max() < 1e-9 * speed
    n = 200 * count
    v = motion.sample(np.arange(n) / (n * frequency))[1]
    assert v.T @ v * 2 / n == pytest.approx(np.eye(len(shapes)), abs=1e-9)


def test_velocities_and_accelerations_are_derivatives():
    rng = np.random.default_rng(0)
    motion = FourierMotion(
        0.4, rng.normal(size=3), rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    )
    t, h = np.linspace(0, 2, 50), 1e-5
    before, here, after = (motion.sample(t + s) for s in (-h, 0, h))
    for derivative in (1, 2):
        slope = (after - before)[derivative - 1] / (2 * h)
        assert here[derivative] == pytest.approx(slope, abs=1e-6)
    assert motion.sample(t)[0].mean(axis=0) == pytest.approx(motion.offset, abs=0.3)
