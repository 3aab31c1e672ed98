"""Low-pass filter without lag, with derivatives, and the band that a motion occupies."""

import numpy as np
from jaxtyping import Float

from tustinnet.signals.spectra import ABOVE_NOISE, SEGMENT, welch

HIGHEST_CUTOFF = 0.4  # of the sampling rate, at most; set by hand, not measured
_ORDER = 4  # of the Butterworth filter that acts forwards and back


def low_pass(
    signal: Float[np.ndarray, "n m"], dt: float, cutoff: float, derivative: int = 0
) -> Float[np.ndarray, "n m"]:
    """Signals without what is faster than a frequency, or derivatives of them.

    A Butterworth filter of order 4 that acts forwards and back, so that nothing lags. About a
    period of the cut-off frequency at each end is less certain than the rest.

    Args:
        signal: samples, (n, m).
        dt: sampling period [s].
        cutoff: frequency at which half of the amplitude is left [Hz].
        derivative: 0 for the signal itself, 1 or 2 for its derivative by time [unit/s, unit/s^2].
    """
    # written out, for scipy.signal takes longer to load than records take to be filtered
    n = len(signal)
    # three periods of the cut-off frequency
    reach = min(n - 1, int(np.ceil(3 / (cutoff * dt))))
    # behind the end as far as a multiple of a power of two, whose transform is fast
    block = 2 ** max(0, (n + 2 * reach).bit_length() - 5)
    behind = min(n - 1, reach - (n + 2 * reach) % -block)
    before, after = signal[reach:0:-1], signal[-2 : -behind - 2 : -1]
    whole = np.concatenate([2 * signal[:1] - before, signal, 2 * signal[-1:] - after])
    # without a straight line its ends meet, as those of a period do
    slope = (whole[-1] - whole[0]) / (len(whole) - 1)
    line = whole[0] + slope * np.arange(len(whole))[:, None]
    frequency = np.fft.rfftfreq(len(whole), dt)[:, None]
    response = (2j * np.pi * frequency) ** derivative / (1 + (frequency / cutoff) ** (2 * _ORDER))
    filtered = np.fft.irfft(np.fft.rfft(whole - line, axis=0) * response, len(whole), axis=0)
    trend = line if derivative == 0 else slope / dt if derivative == 1 else 0.0
    return (filtered + trend)[reach : reach + n]


def noise_bandwidth(cutoff: float) -> float:
    """The band of an ideal filter that lets as much white noise through as `low_pass` [Hz]."""
    order = 2 * _ORDER
    return cutoff * (1 - 1 / order) / np.sinc(1 / order)


def occupied_band(q: Float[np.ndarray, "n n_q"], dt: float) -> float:
    """The frequency below which all velocities have 99.9 % of their power [Hz].

    Power that is near the noise of the positions does not count; their noise is read from the upper
    half of the frequencies.

    Args:
        q: positions, (n, n_q) [rad or m].
        dt: sampling period [s].
    """
    highest = 1 / (len(q) * dt)
    for column in q.T:
        frequency, density = welch(column, dt, min(len(column), SEGMENT))
        noise = np.median(density[len(density) // 2 :])
        power = np.maximum(density - ABOVE_NOISE * noise, 0.0) * frequency**2
        total = np.cumsum(power)
        if total[-1] > 0:
            highest = max(highest, float(frequency[np.searchsorted(total, 0.999 * total[-1])]))
    return highest
