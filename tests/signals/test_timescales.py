"""Time scales of a motion, in samples."""

import numpy as np
import pytest

from tustinnet.signals.timescales import correlation_time


def test_the_correlation_time_of_a_relaxing_velocity_is_its_time_constant():
    generator, samples = np.random.default_rng(0), 20.0
    decay = np.exp(-1 / samples)
    records = []
    for _ in range(10):
        v = np.zeros(2000)
        for k, push in enumerate(generator.normal(size=1999)):
            v[k + 1] = decay * v[k] + push
        records.append(v)
    assert correlation_time(records) == pytest.approx(samples, rel=0.2)


def test_a_velocity_that_never_turns_is_correlated_over_half_a_record():
    assert 20 < correlation_time([np.linspace(-1.0, 1.0, 100)]) < 60
