"""The time base of a record as it was logged."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.signals.encoder import encoder_count
from tustinnet.signals.resampling import regularity


@dataclass(frozen=True)
class Recording:
    """The time base and the encoders of a record as it was logged.

    Attributes:
        samples: number of samples.
        median_dt: median interval [s].
        jitter: root mean square deviation of the intervals from the period, outside gaps [s].
        worst_interval: the interval farthest from the period [s].
        worst_sample: the sample that ends it.
        gaps: beginning and end of every interval of more than 2.5 periods [s].
        counts: estimated encoder count of each coordinate [rad or m], None where not quantised.
    """

    samples: int
    median_dt: float
    jitter: float
    worst_interval: float
    worst_sample: int
    gaps: tuple[tuple[float, float], ...]
    counts: tuple[float | None, ...]


def describe_recording(
    t: Float[np.ndarray, " n"], q: Float[np.ndarray, "n n_q"], dt: float
) -> Recording:
    """Describes timestamps [s] and positions [rad or m] as logged.

    The period is the nominal `dt` [s], or the median interval where that is another one, as in a
    record that is to be put on a coarser grid.
    """
    median = float(np.median(np.diff(t)))
    # a nominal period this near to the median one is that of the log
    times = regularity(t, dt if abs(median / dt - 1) < 0.1 else median)
    return Recording(
        samples=len(t),
        median_dt=times.median_dt,
        jitter=times.jitter,
        worst_interval=float(t[times.worst_row] - t[times.worst_row - 1]),
        worst_sample=times.worst_row,
        gaps=tuple((float(t[k]), float(t[k + 1])) for k in times.gaps),
        counts=tuple(encoder_count(column) for column in q.T),
    )
