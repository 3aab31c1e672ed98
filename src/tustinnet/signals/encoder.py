"""The count of an encoder, estimated from the positions that it gave."""

import numpy as np
from jaxtyping import Float


def encoder_count(q: Float[np.ndarray, " n"]) -> float | None:
    """The step of which all changes of a position are multiples, None where there is none.

    The smallest steps give a first value; larger and larger distances, each within the reach of
    the value so far, refine it, so that the rounding of the file (1e-6 is usual) averages out.
    """
    levels = np.unique(q)
    # the sum of an angle and turns, or a unit's factor, makes several numbers of one level
    is_new = np.diff(levels, prepend=-np.inf) > 1e-12 * np.abs(levels).max(initial=0.0)
    levels = levels[is_new]
    if len(levels) < 3:
        return None
    steps, distance = np.diff(levels), levels - levels[0]
    # far below the usual step lies what the rounding of the file makes of two equal levels; how
    # far depends on how many counts the position moves between two samples
    for share in (0.2, 0.05, 0.01):
        smallest = steps[steps > share * np.median(steps)].min()
        # steps of one count, give or take the rounding of the file
        count = float(np.median(steps[steps < 1.5 * smallest]))
        reach = 8.0 * count
        while True:
            near = distance[distance <= reach]
            multiples = np.round(near / count)
            if multiples.any():
                count = float(near @ multiples / (multiples @ multiples))
            if reach >= distance[-1]:
                break
            reach *= 4.0
        error = np.abs(distance - np.round(distance / count) * count)
        if np.max(error) < 0.1 * count:
            return count
    return None
