"""Signals for a page: thinned so that no peak is lost, and packed into text."""

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

_LARGEST = 32767  # of the whole numbers that stand for a signal
_GAP = -32768  # stands for what is not finite
_GROWTH = 1.15  # of the stretches that are tried
_FARTHEST = 3.0  # times the measured span from its middle, beyond which a simulation is cut


def kept(signals: Float[np.ndarray, "n c"], points: int) -> Int[np.ndarray, " m"]:
    """The samples that lines through all signals need: at most so many, without losing a peak.

    Of stretches of equal length those at which any signal is smallest or largest, and both ends;
    the stretches are as short as the number of points allows.

    Args:
        signals: a column each, NaN where there is a gap.
        points: how many at most.

    Returns:
        Their indices, rising; all where there are no more.
    """
    n, length = len(signals), 2
    if n <= points:
        return np.arange(n)
    found = _extremes(signals, length)
    while len(found) > points and length < n:
        length = max(length + 1, int(_GROWTH * length))
        found = _extremes(signals, length)
    return found


def _extremes(signals: Float[np.ndarray, "n c"], length: int) -> Int[np.ndarray, " m"]:
    """The samples at which any signal is smallest or largest in its stretch."""
    n, stretches = len(signals), -(-len(signals) // length)
    padded = np.full((stretches * length, signals.shape[1]), np.nan)
    padded[:n] = signals
    parts = padded.reshape(stretches, length, -1)
    begins = length * np.arange(stretches)[:, None]
    low = begins + np.argmin(np.where(np.isnan(parts), np.inf, parts), axis=1)
    high = begins + np.argmax(np.where(np.isnan(parts), -np.inf, parts), axis=1)
    return np.unique(np.concatenate([low.ravel(), high.ravel(), [0, n - 1]]))


def packed(values: Float[np.ndarray, " n"] | Sequence[float]) -> dict[str, Any]:
    """A signal as 16-bit numbers in base64, the lowest byte first, with its smallest and largest.

    A value is `low + (high - low) (k + 32767) / 65534`; k is -32768 where it is not finite.
    """
    y = np.asarray(values, np.float64)
    finite = np.isfinite(y)
    low, high = (float(y[finite].min()), float(y[finite].max())) if finite.any() else (0.0, 0.0)
    share = (np.where(finite, y, low) - low) / ((high - low) or 1.0)
    whole = np.where(finite, np.round(share * 2 * _LARGEST) - _LARGEST, _GAP)
    return {"low": low, "high": high, "k": b64encode(whole.astype("<i2").tobytes()).decode()}


def bounded(
    simulated: Float[np.ndarray, "n *c"], measured: Float[np.ndarray, "n *c"]
) -> Float[np.ndarray, "n *c"]:
    """A simulation without what leaves the picture, so that a divergence does not hide the rest."""
    middle = (measured.max(axis=0) + measured.min(axis=0)) / 2
    reach = np.ptp(measured, axis=0) + 1e-12
    with np.errstate(invalid="ignore", over="ignore"):
        inside = np.abs(simulated - middle) < _FARTHEST * reach
    return np.where(inside, simulated, np.nan)
