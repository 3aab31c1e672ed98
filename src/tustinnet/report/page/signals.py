"""Signals of a page: thinned so that no peak is lost, and packed into text."""

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

_LARGEST_INTEGER = 32767  # largest integer that stands for a value
_GAP = -32768  # stands for a value that is not finite


def thin(signals: Float[np.ndarray, "n c"], points: int) -> Int[np.ndarray, " m"]:
    """Indices of the samples that lines through all signals need, so that no peak is lost.

    They are both ends and, of stretches of equal length, the samples at which any signal is
    smallest or largest. The stretches are as short as the number of points allows.

    Args:
        signals: a column each, NaN where there is a gap.
        points: largest number of samples.

    Returns:
        Their indices in rising order; all if there are no more than `points`.
    """
    n, length = len(signals), 2
    if n <= points:
        return np.arange(n)
    samples = find_extremes(signals, length)
    while len(samples) > points and length < n:
        # lengths of stretches that are tried
        length = max(length + 1, int(1.15 * length))
        samples = find_extremes(signals, length)
    return samples


def find_extremes(signals: Float[np.ndarray, "n c"], length: int) -> Int[np.ndarray, " m"]:
    """Indices of both ends, and of the samples where a signal is extreme in its stretch.

    Args:
        signals: a column each, NaN where there is a gap.
        length: samples of a stretch; one of nothing but NaN stays a gap.
    """
    n, stretches = len(signals), -(-len(signals) // length)
    padded = np.full((stretches * length, signals.shape[1]), np.nan)
    padded[:n] = signals
    parts = padded.reshape(stretches, length, -1)
    begins = length * np.arange(stretches)[:, None]
    low = begins + np.argmin(np.where(np.isnan(parts), np.inf, parts), axis=1)
    high = begins + np.argmax(np.where(np.isnan(parts), -np.inf, parts), axis=1)
    return np.unique(np.concatenate([low.ravel(), high.ravel(), [0, n - 1]]))


def pack(values: Float[np.ndarray, " n"] | Sequence[float]) -> dict[str, Any]:
    """Packs a signal into 16-bit numbers in base64, low byte first, with its limits.

    A value is `low + (high - low) (k + 32767) / 65534`; k is -32768 where it is not finite.
    """
    y = np.asarray(values, np.float64)
    finite = np.isfinite(y)
    low, high = (float(y[finite].min()), float(y[finite].max())) if finite.any() else (0.0, 0.0)
    share = (np.where(finite, y, low) - low) / ((high - low) or 1.0)
    whole = np.where(finite, np.round(share * 2 * _LARGEST_INTEGER) - _LARGEST_INTEGER, _GAP)
    return {"low": low, "high": high, "k": b64encode(whole.astype("<i2").tobytes()).decode()}


def bounded(
    simulated: Float[np.ndarray, "n *c"], measured: Float[np.ndarray, "n *c"]
) -> Float[np.ndarray, "n *c"]:
    """Simulated values, NaN far from the measured range, so that a divergence hides no details."""
    centre = (measured.max(axis=0) + measured.min(axis=0)) / 2
    reach = np.ptp(measured, axis=0) + 1e-12
    with np.errstate(invalid="ignore", over="ignore"):
        # three times the measured span from its centre
        inside = np.abs(simulated - centre) < 3.0 * reach
    return np.where(inside, simulated, np.nan)
