"""Time scales of a motion, in samples: the period of its dominant frequency, and its decay."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tustinnet.signals.spectra import welch

_FEW_SAMPLES = 20  # in a period: below, definitions of velocity differ by a percent


class Timescales(NamedTuple):
    """Time scales of one coordinate in some records.

    Attributes:
        swing: the standard deviation of its positions [rad or m].
        period: period of the dominant frequency of its spectrum, in samples.
        decay: number of samples after which the envelope of its autocorrelation is 1/e.
    """

    swing: float
    period: float
    decay: float

    @property
    def is_fast(self) -> bool:
        """Whether the coordinate oscillates, with few samples in a period."""
        return self.period < _FEW_SAMPLES and self.decay > self.period


def timescales(positions: Sequence[Float[np.ndarray, " _"]]) -> Timescales:
    """The time scales of a coordinate that moves, over records of equal sampling periods.

    Spectra are averaged over the records. The autocorrelation of a lightly damped oscillation that
    noise drives decays as the oscillation does by itself.

    Args:
        positions: positions of the coordinate in each record.
    """
    segment = min(2048, min(map(len, positions)))
    spectra = [welch(q - q.mean(), 1.0, segment)[1] for q in positions]
    power = np.mean(spectra, axis=0)
    dominant = 1 + int(np.argmax(power[1:]))
    # of a one-sided spectrum: the analytic autocorrelation, whose size is the envelope
    envelope = np.abs(np.fft.ifft(power, 8 * len(power)))[: 4 * len(power)]
    below = np.flatnonzero(envelope < envelope[0] / np.e)
    lag = 2 * (len(power) - 1) / (8 * len(power))  # samples between two values of the envelope
    decay = lag * below[0] if len(below) else float(segment)
    variance = np.mean([q.var() for q in positions])
    return Timescales(float(np.sqrt(variance)), segment / dominant, float(decay))


def correlation_time(velocities: Sequence[Float[np.ndarray, " _"]]) -> float:
    """Number of samples after which the autocorrelation of a velocity has fallen to 1/e.

    For so long a motion goes on as it does. It is short of the time in which a position returns,
    and other than that it is known for a carriage that nothing pulls back.

    Args:
        velocities: velocities of the coordinate in each record, not all of them constant.

    References:
        Bendat, Piersol (2010), Random data, chapter 5.
    """
    longest = max(map(len, velocities))
    total = np.zeros(longest)
    for v in velocities:
        spectrum = np.abs(np.fft.rfft(v - v.mean(), 2 * longest)) ** 2  # padded: no wrap around
        total += np.fft.irfft(spectrum)[:longest]
    below = np.flatnonzero(total < total[0] / np.e)
    return float(below[0]) if len(below) else float(longest)
