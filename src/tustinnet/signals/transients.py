"""The end of a record's transient."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

_SHARE = 0.05  # of the largest speed and excursion


@dataclass(frozen=True)
class RestThresholds:
    """Thresholds below which a record counts as at rest, per coordinate.

    Attributes:
        speed: threshold of |v| [rad/s or m/s], (n_q,).
        excursion: threshold of |q - resting value| [rad or m], (n_q,).
        resting: the resting value [rad or m], (n_q,).
    """

    speed: Float[np.ndarray, " n_q"]
    excursion: Float[np.ndarray, " n_q"]
    resting: Float[np.ndarray, " n_q"]


def rest_thresholds(
    q: Float[np.ndarray, "n n_q"],
    v: Float[np.ndarray, "n n_q"],
    resolution: Float[np.ndarray, " n_q"],
    dt: float,
) -> RestThresholds:
    """Thresholds that adapt to a record.

    The resting value is the median of the record's last tenth (at least 10 samples). Speeds
    count as rest below 5 % of their largest value, excursions below 5 % of the
    largest distance from the resting value; never below three encoder counts (per sample
    distance of the stencil's baseline for speeds), which the encoder cannot tell from rest.

    Args:
        q: positions, (n, n_q) [rad or m].
        v: velocities, (n, n_q) [rad/s or m/s].
        resolution: encoder count or 0 where unknown, (n_q,) [rad or m].
        dt: sampling period [s].
    """
    resting = resting_positions(q)
    floor = 3.0 * resolution
    return RestThresholds(
        speed=np.maximum(_SHARE * np.abs(v).max(axis=0), floor / (4 * dt)),
        excursion=np.maximum(_SHARE * np.abs(q - resting).max(axis=0), floor),
        resting=resting,
    )


def resting_positions(q: Float[np.ndarray, "n n_q"]) -> Float[np.ndarray, " n_q"]:
    """The medians of a record's last tenth, of at least 10 samples, (n_q,)."""
    return np.median(q[-max(10, len(q) // 10) :], axis=0)


def is_at_rest(
    q: Float[np.ndarray, "n n_q"], v: Float[np.ndarray, "n n_q"], thresholds: RestThresholds
) -> Bool[np.ndarray, " n"]:
    """Mask of the samples at which all speeds and all excursions are below the thresholds."""
    near = np.abs(q - thresholds.resting) < thresholds.excursion
    # a coordinate that never moves has thresholds of 0
    return np.all((is_slow(v, thresholds) & near) | ~is_moving(q), axis=1)


def is_moving(q: Float[np.ndarray, "n n_q"]) -> Bool[np.ndarray, " n_q"]:
    """Mask of the coordinates that move at all, by more than rounding."""
    # a resampled constant deviates by less
    return np.ptp(q, axis=0) > 1e-12 * np.abs(q).max(axis=0)


def is_slow(v: Float[np.ndarray, "n n_q"], thresholds: RestThresholds) -> Bool[np.ndarray, "n n_q"]:
    """Mask of slow samples: each speed below its threshold, or a coordinate that never moves."""
    # the derivative of a constant is rounding, not motion
    return (np.abs(v) < thresholds.speed) | (np.abs(v).max(axis=0) < 1e-9)


def settling_index(
    q: Float[np.ndarray, "n n_q"], v: Float[np.ndarray, "n n_q"], thresholds: RestThresholds
) -> int:
    """`k_bar`: the first sample after which the record stays at rest to its end.

    Returns the record's length when it is still moving at the end. The paper draws the
    pre-training windows before this sample (section 3.2, step 1).
    """
    moving = np.flatnonzero(~is_at_rest(q, v, thresholds))
    return int(moving[-1]) + 1 if len(moving) else 0
