"""Signals of unequal length side by side."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def stack_padded(
    signals: Sequence[Float[np.ndarray, "_ *columns"]],
) -> Float[np.ndarray, "signals longest *columns"]:
    """Signals as one array, zeros after the end of shorter ones.

    Args:
        signals: each (n, ...); n may differ, the other axes are equal.

    Returns:
        (signals, longest n, ...).
    """
    longest = max(map(len, signals))
    rest = [(0, 0)] * (signals[0].ndim - 1)
    return np.stack([np.pad(s, [(0, longest - len(s)), *rest]) for s in signals])
