"""Spectra of records: the power of a signal at each frequency."""

import numpy as np
from jaxtyping import Float

SEGMENT = 1024  # samples of a spectrum, at most; set by hand, not measured
ABOVE_NOISE = 4.0  # times the noise, from which on power is motion; set by hand, not measured

Density = tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]


def welch(signal: Float[np.ndarray, " n"], dt: float, segment: int) -> Density:
    """Welch's estimate: segments that overlap by half, each without its mean, in Hann windows.

    Args:
        signal: at least a segment of samples.
        dt: sampling period [s].
        segment: samples of a segment, at least 2.

    Returns:
        Frequencies from 0 on [Hz], and the one-sided power density at each [unit^2/Hz].
    """
    step = segment - segment // 2
    segments = np.lib.stride_tricks.sliding_window_view(signal, segment)[::step]
    return _density(segments, np.hanning(segment + 1)[:-1], dt)


def periodogram(signal: Float[np.ndarray, " n"], dt: float) -> Density:
    """The power density of a whole signal without its mean, as `welch` gives it."""
    return _density(signal[None], np.ones(len(signal)), dt)


def _density(
    segments: Float[np.ndarray, "m n"], window: Float[np.ndarray, " n"], dt: float
) -> Density:
    # written out, for scipy.signal takes longer to load than records take to be read
    size = len(window)
    spectra = np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window)
    density = np.mean(np.abs(spectra) ** 2, axis=0) * dt / (window @ window)
    density[1 : (size + 1) // 2] *= 2  # negative frequencies; half the sampling rate has none
    return np.fft.rfftfreq(size, dt), density
