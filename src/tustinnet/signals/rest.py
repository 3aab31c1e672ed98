"""Positions about which coordinates move."""

import numpy as np
from jaxtyping import Bool, Float


def usual_positions(
    q: Float[np.ndarray, "n n_q"], angular: Bool[np.ndarray, " n_q"]
) -> Float[np.ndarray, " n_q"]:
    """The median position of every coordinate, (n_q,) [rad or m].

    A mechanism that comes to rest again and again is there for most of the time. Of an angle that
    turns around, whole turns do not count: the median is taken of the way from its circular mean,
    and lies within half a turn of it.

    Args:
        q: positions [rad or m].
        angular: which coordinates are angles.
    """
    towards = np.arctan2(np.sin(q).mean(axis=0), np.cos(q).mean(axis=0))
    middle = np.where(angular, towards, 0.0)
    away = q - middle
    away = np.where(angular, np.arctan2(np.sin(away), np.cos(away)), away)
    return middle + np.median(away, axis=0)
