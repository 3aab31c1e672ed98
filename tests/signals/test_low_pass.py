"""The low-pass filter without lag."""

import numpy as np
import pytest

from tustinnet.signals.low_pass import low_pass, noise_bandwidth


def test_as_much_white_noise_passes_as_an_ideal_filter_of_its_bandwidth_lets_through():
    noise = np.random.default_rng(0).normal(size=(200_000, 1))
    for cutoff in (4.0, 20.0):
        share = np.var(low_pass(noise, 0.005, cutoff))
        assert share == pytest.approx(noise_bandwidth(cutoff) / 100.0, rel=0.05)  # of 100 Hz
