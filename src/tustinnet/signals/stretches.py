"""Keys of stretches of signals in motion, by which equal stretches of two records are found."""

import numpy as np
from jaxtyping import Bool, Int, UInt64


def stretch_keys(
    steps: Int[np.ndarray, "n c"], counts: Bool[np.ndarray, " n"], length: int, fewest: int
) -> tuple[Int[np.ndarray, " m"], UInt64[np.ndarray, " m"]]:
    """Starts and keys of all stretches of a signal in which enough happens.

    A key is a number that depends only on the steps in its stretch: equal stretches have equal
    keys, wherever they are, and different ones hardly ever do.

    Args:
        steps: changes from sample to sample, rounded to whole numbers.
        counts: mask of the steps in which something happens.
        length: steps of a stretch.
        fewest: of these, so many must count.

    Returns:
        The first sample of each stretch, and its key.
    """
    if len(steps) < length:
        return np.zeros(0, np.int64), np.zeros(0, np.uint64)
    starts = np.flatnonzero(np.convolve(counts, np.ones(length, int), "valid") >= fewest)
    with np.errstate(over="ignore"):
        mixed = (steps @ (2 * np.arange(1, steps.shape[1] + 1) + 1)).astype(np.uint64)
        keys = np.zeros(len(steps) - length + 1, np.uint64)
        for k in range(length):
            keys = keys * np.uint64(1_000_003) + mixed[k : k + len(keys)]
    return starts, keys[starts]
