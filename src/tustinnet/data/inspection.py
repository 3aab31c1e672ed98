"""Properties of records that fits and simulations depend on."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment, moving_coordinates
from tustinnet.signals import transients
from tustinnet.signals.derivatives import differentiate
from tustinnet.signals.equilibria import HeldEquilibrium, find_held_equilibrium
from tustinnet.signals.timescales import Timescales, correlation_time, timescales

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


def correlation_times(experiments: Sequence[Experiment]) -> dict[str, float]:
    """Samples in which each velocity that moves loses its correlation, by the coordinate's name."""
    moving = moving_coordinates(experiments)
    velocities = [e.velocities("wiener") for e in experiments]
    return {
        c.name: correlation_time([v[:, j] for v in velocities])
        for j, c in enumerate(experiments[0].coordinates)
        if moving[j]
    }


def smooth_velocities(experiment: Experiment) -> Float[np.ndarray, "n n_q"]:
    """Velocities of a record without its noise, whatever its sensors are declared to be.

    Sizes of motion follow from them: differences of a noisy sensor are larger than any motion.
    """
    return differentiate(experiment.q, experiment.dt, "wiener")


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


def held_equilibrium(experiment: Experiment) -> HeldEquilibrium | None:
    """The unstable equilibrium that an input holds to a record's end, None where there is none."""
    if not experiment.forced:
        return None
    angular = tuple(c.kind == "angular" for c in experiment.coordinates)
    v = experiment.velocities("stencil")
    return find_held_equilibrium(experiment.q, v, experiment.u, angular, experiment.dt)


def saturated_share(u: Float[np.ndarray, " n"], limits: tuple[float, float] | None) -> float:
    """Share of an input's samples at a declared limit; without limits, stuck at an extreme value.

    Args:
        u: the input.
        limits: the limits of its actuator, None where they are not declared.
    """
    if limits is not None:
        return float(np.mean((u <= limits[0]) | (u >= limits[1])))
    # an input of many levels that stays at an extreme one was probably limited there; a grid makes
    # more of few levels, by means over the steps between them
    _, counts = np.unique(np.round(u / max(np.abs(u).max(), 1e-300), 9), return_counts=True)
    levels = 1 + int(np.searchsorted(np.cumsum(np.sort(counts)[::-1]), 0.9 * len(u)))
    if levels <= 10:  # it takes more of them for most of the samples
        return 0.0
    extreme, next_ones = (float(counts[k] + counts[-1 - k]) / len(u) for k in (0, 1))
    # and is there three times as often as at the next ones: a sine is not
    return extreme if extreme > max(0.02, 3 * next_ones) else 0.0
