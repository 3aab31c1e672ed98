"""Signals for a page: thinned so that no peak is lost, and packed into text."""

from base64 import b64encode
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

_LARGEST = 32767  # of the whole numbers that stand for a signal
_GAP = -32768  # stands for what is not finite
_FARTHEST = 3.0  # times the measured span from its middle, beyond which a simulation is cut


def thinned(
    t: Float[np.ndarray, " n"], signals: Float[np.ndarray, "n c"], points: int
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m c"]]:
    """Signals in at most so many points: of each bin the smallest and the largest value.

    Both stand in the order in which they came, at two times that all signals share, so that none is
    farther from where it was than a bin is wide.

    Args:
        t: times, (n,) [s].
        signals: a column each.
        points: how many at most; signals that have no more stay as they are.

    Returns:
        Times and signals.
    """
    n, bins = len(t), max(points // 2, 1)
    if n <= points:
        return t, signals
    edges = np.linspace(0, n, bins + 1).astype(int)
    times, values = np.empty(2 * bins), np.empty((2 * bins, signals.shape[1]))
    for k, (a, b) in enumerate(pairwise(edges)):
        part = signals[a:b]
        gap = np.isnan(part)
        low = np.argmin(np.where(gap, np.inf, part), axis=0)
        high = np.argmax(np.where(gap, -np.inf, part), axis=0)
        places = np.stack([np.minimum(low, high), np.maximum(low, high)])
        values[2 * k : 2 * k + 2] = np.take_along_axis(part, places, axis=0)
        times[2 * k : 2 * k + 2] = t[a + (b - a) // 4], t[a + 3 * (b - a) // 4]
    return times, values


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
