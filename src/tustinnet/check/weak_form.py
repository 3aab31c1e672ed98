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

    def average(self, signals: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "m c"]:
        """Averages of signals in every window, (m, c)."""
        return self._apply(signals, self.weights()[0])

    def average_derivative(self, signals: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "m c"]:
        """Averages of the first derivatives of signals in every window, (m, c)."""
        return self._apply(signals, self.weights()[1])

    def average_second_derivative(
        self, signals: Float[np.ndarray, "n c"]
    ) -> Float[np.ndarray, "m c"]:
        """Averages of the second derivatives of signals in every window, (m, c)."""
        return self._apply(signals, self.weights()[2])

    def weights(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weights of the samples for the average and those of both derivatives."""
        return _weights(self.half, self.dt)

    def _apply(self, signals: np.ndarray, weights: np.ndarray) -> np.ndarray:
        if len(signals) < len(weights):
            return np.zeros((0, signals.shape[1]))
        windows = np.lib.stride_tricks.sliding_window_view(signals, len(weights), axis=0)
        return windows[:: self.stride] @ weights


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
