"""Properties of records that fits and simulations depend on."""

from collections.abc import Sequence

import numpy as np

from tustinnet.data.experiment import Experiment, moving_coordinates
from tustinnet.signals import transients
from tustinnet.signals.timescales import Timescales, timescales

_MOST_OF_A_TURN = 1.5 * np.pi  # rad; a link that falls from upright ends short of a full turn


def still_coordinates(experiments: Sequence[Experiment]) -> list[str]:
    """Names of the coordinates that move in none of some records of a system."""
    moving = moving_coordinates(experiments)
    return [c.name for c, m in zip(experiments[0].coordinates, moving, strict=True) if not m]


def coordinate_timescales(experiments: Sequence[Experiment]) -> dict[str, Timescales]:
    """The time scales of each coordinate that moves, by its name."""
    moving = moving_coordinates(experiments)
    return {
        c.name: timescales([e.q[:, j] for e in experiments])
        for j, c in enumerate(experiments[0].coordinates)
        if moving[j]
    }


def rotating_coordinates(experiments: Sequence[Experiment]) -> set[str]:
    """Names of the angles that cover most of a turn in the records: no spring holds them."""
    q = np.concatenate([e.q for e in experiments])
    return {
        c.name
        for c, span in zip(experiments[0].coordinates, np.ptp(q, axis=0), strict=True)
        if c.kind == "angular" and span > _MOST_OF_A_TURN
    }


def transient_end(experiment: Experiment) -> int:
    """`k_bar`: the end of a record's transient, as a sample index.

    The declared one where there is one; the record's end where an input changes; else the first
    sample after which all speeds and all excursions from the resting value stay below the
    thresholds of `rest_thresholds` to the end.
    """
    if experiment.k_bar is not None:
        return experiment.k_bar
    if experiment.forced:
        return len(experiment)
    v = experiment.velocities("stencil")
    thresholds = transients.rest_thresholds(
        experiment.q, v, experiment.channels.resolution, experiment.dt
    )
    return transients.settling_index(experiment.q, v, thresholds)
