"""Spectra, compared with those of scipy."""

import numpy as np
import pytest
import scipy.signal

from tustinnet.signals.spectra import periodogram, welch

DT = 0.02
SIGNAL = 3 + np.random.default_rng(0).normal(size=1001)


@pytest.mark.parametrize("segment", [2, 3, 64, 65, 1000, 1001])
def test_welchs_estimate_is_that_of_scipy(segment):
    expected = scipy.signal.welch(SIGNAL, fs=1 / DT, nperseg=segment)
    for ours, theirs in zip(welch(SIGNAL, DT, segment), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("n", [1000, 1001])
def test_the_periodogram_is_that_of_scipy(n):
    expected = scipy.signal.periodogram(SIGNAL[:n], fs=1 / DT, detrend="constant")
    for ours, theirs in zip(periodogram(SIGNAL[:n], DT), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-15)


def test_the_power_of_a_sine_is_half_its_square():
    t = DT * np.arange(1000)
    frequency, density = periodogram(3 * np.sin(2 * np.pi * 5 * t), DT)
    assert frequency[density.argmax()] == pytest.approx(5)
    assert density.sum() * frequency[1] == pytest.approx(9 / 2)
