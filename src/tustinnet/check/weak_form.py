"""Averages of a signal and of its derivatives over smooth windows, without differentiating it.

A window is a modulating function, which is zero with its first derivatives at both ends. By parts,
the average of a derivative is that of the signal itself under the derivative of the window, so that
the noise of an encoder is averaged, too (M. Shinbrot, On the analysis of linear and nonlinear
systems, Trans. ASME 79, 1957).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Windows:
    """Smooth windows that are moved over a record.

    Attributes:
        half: half their width, in samples.
        stride: samples from one to the next.
        dt: sampling period [s].
    """

    half: int
    stride: int
    dt: float

    def average(
        self, signals: Float[np.ndarray, "n c"], derivative: int = 0
    ) -> Float[np.ndarray, "m c"]:
        """Averages of signals, or of their first or second derivatives, in every window, (m, c)."""
        weights = self.weights(derivative)
        if len(signals) < len(weights):
            return np.zeros((0, signals.shape[1]))
        windows = np.lib.stride_tricks.sliding_window_view(signals, len(weights), axis=0)
        return windows[:: self.stride] @ weights

    def weights(self, derivative: int) -> Float[np.ndarray, " w"]:
        """Weights of the samples of a window for the average of a derivative, 0 for none."""
        return _weights(self.half, self.dt)[derivative]


@lru_cache(maxsize=64)
def _weights(half: int, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of the samples of a window for the average and those of both derivatives."""
    s = np.linspace(-1.0, 1.0, 2 * half + 1)
    bump = 1 - s**2
    time = s * half * dt
    zeroth = bump**4 / np.sum(bump**4)
    first = s * bump**3
    second = -(bump**3) + 6 * s**2 * bump**2
    second -= second.mean()
    # exact for straight lines and parabolas, which sampled windows are not by themselves
    return zeroth, first / (first @ time), second / (second @ time**2 / 2)
