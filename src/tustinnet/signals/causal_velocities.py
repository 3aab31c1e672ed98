"""Velocities as they are computed while a device runs: by positions up to now only."""

from collections.abc import Iterator

import numpy as np
import scipy.signal
from jaxtyping import Float

_SAMPLES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # of time constants, and of polynomials

Positions = Float[np.ndarray, "n n_q"]


def low_pass_velocities(q: Positions, dt: float) -> Iterator[Positions]:
    """Differences through low-passes of first order, of shorter and longer time constants.

    Args:
        q: positions, (n, n_q) [rad or m].
        dt: sampling period [s].

    Yields:
        Velocities, (n, n_q) [rad/s or m/s].
    """
    differences = np.diff(q, axis=0, prepend=q[:1]) / dt
    for samples in _SAMPLES:
        kept = np.exp(-1 / samples)
        yield np.asarray(scipy.signal.lfilter([1 - kept], [1, -kept], differences, axis=0))


def polynomial_velocities(q: Positions, dt: float) -> Iterator[Positions]:
    """Slopes at the last sample of parabolas through the last few positions.

    Args:
        q: positions, (n, n_q) [rad or m].
        dt: sampling period [s].

    Yields:
        Velocities, (n, n_q) [rad/s or m/s], from few samples to many.
    """
    for samples in _SAMPLES[1:]:
        slope = np.linalg.pinv(np.vander(-dt * np.arange(samples), 3))[1]
        yield np.asarray(scipy.signal.lfilter(slope, [1.0], q - q[0], axis=0))
