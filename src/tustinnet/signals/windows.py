"""Windows: beginnings of the subsequences that a model is trained on.

A window of `length` steps that begins at sample k holds the samples k..k+length. Windows are
pairs (record, first sample), never copies of the data.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

Windows = Int[np.ndarray, "count 2"]


def strided_windows(lengths: Sequence[int], length: int, step: int, part: float = 1.0) -> Windows:
    """Windows every `step` samples from the first row on.

    Args:
        lengths: samples in each record.
        length: steps in a window.
        step: samples between the beginnings of two windows.
        part: share of the possible beginnings that is used, from the first on.

    Returns:
        (count, 2) record and first sample; records shorter than a window give none.
    """
    starts = [np.arange(0, round(part * max(n - length, 0)), step) for n in lengths]
    if not starts:
        return np.zeros((0, 2), dtype=np.int64)
    record = np.repeat(np.arange(len(starts)), [len(s) for s in starts])
    return np.stack([record, np.concatenate(starts)], axis=1).astype(np.int64)


def random_windows(
    lengths: Sequence[int],
    length: int,
    count: int,
    generator: np.random.Generator,
    ends: Sequence[int] | None = None,
) -> Windows:
    """Windows at random: a record uniformly, then a beginning uniformly.

    Beginnings are drawn from 2..end - 2, where `end` is the record's entry in `ends` (`k_bar`
    in the paper's step 1), and never so late that the window leaves the record less 2 samples
    (the paper's step 3).

    Args:
        lengths: samples in each record.
        length: steps in a window.
        count: number of windows.
        generator: the source of randomness.
        ends: per record the sample before which windows begin; the record's end by default.

    Returns:
        (count, 2) record and first sample. Records that cannot hold a window are left out.

    References:
        van Esch, Bonassi, Schön, section 3.2, definitions of the two data sets.
    """
    limits = np.asarray(lengths) if ends is None else np.asarray(ends)
    last = np.minimum(limits - 2, np.asarray(lengths) - length - 2)
    usable = np.flatnonzero(last >= 2)
    if not len(usable):
        return np.zeros((0, 2), dtype=np.int64)
    record = usable[generator.integers(len(usable), size=count)]
    return np.stack([record, generator.integers(2, last[record] + 1)], axis=1)
