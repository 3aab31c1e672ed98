"""How many integration steps a sampling period needs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.contract import ContinuousModel
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.simulate.batches import batches
from tustinnet.simulate.drive import drives_of
from tustinnet.simulate.simulation import simulated
from tustinnet.simulate.starts import DERIVED, default_start, start_states

PROBED_SECONDS = 2.0  # of each record
_MOST_SUBSTEPS = 64


def choose_substeps(
    model: ContinuousModel, experiments: Sequence[Experiment], tolerance: float
) -> int:
    """How many Runge-Kutta steps a sampling period needs.

    The first 2 s of every record are simulated with 1, 2, 4, ... substeps until the positions are
    within the tolerance.

    Args:
        model: the model.
        experiments: records that show the speeds it is to be simulated at.
        tolerance: the error target, largest position error within these 2 s [rad or m].

    Returns:
        A power of two, at most 64.
    """
    if not tolerance > 0:
        raise InputError("choose_substeps", f"tolerance {tolerance:g}", "a positive number")
    probed = _probed(experiments)
    return max(
        _enough(own, [probed[i] for i in rows], tolerance) for own, rows in batches(model, probed)
    )


def fewest_substeps(model: Discretised, experiments: Sequence[Experiment], share: float) -> int:
    """As few Runge-Kutta steps in a period as the errors of the model itself hide.

    The first 2 s of every record are simulated with 1, 2, 4, ... substeps, until for every
    coordinate the steps change the positions by less than a share of what the model misses (root
    mean squares over all records).

    Args:
        model: the model, with as many steps as it needs to be exact.
        experiments: records that show how wrong it is.
        share: how much of its error integration may make.

    Returns:
        Fewer than the model has, or as many.
    """
    probed = [e for e in _probed(experiments) if len(e) >= DERIVED]
    if not probed:
        return model.substeps
    start = default_start(probed)

    runs = []
    for own, rows in batches(model, probed):
        some = [probed[i] for i in rows]
        runs.append((own, some, start_states(own, some, start), drives_of(own, some)))

    def positions(substeps: int) -> np.ndarray:
        found = []
        for own, some, x0, drive in runs:
            run = simulated(replace(own, substeps=substeps), x0, drive)
            found += [x[: len(e), own.channels.position] for x, e in zip(run, some, strict=True)]
        return np.concatenate(found)

    exact = positions(model.substeps)
    measured = np.concatenate([e.q for _, some, _, _ in runs for e in some])
    allowed = share**2 * np.mean((exact - measured) ** 2, axis=0)
    for doublings in range(math.ceil(math.log2(model.substeps))):
        changed = np.mean((positions(2**doublings) - exact) ** 2, axis=0)
        if (changed <= allowed).all():  # False of what is no number
            return 2**doublings
    return model.substeps


def _probed(experiments: Sequence[Experiment]) -> list[Experiment]:
    """The first 2 s of records."""
    steps = max(1, round(PROBED_SECONDS / experiments[0].dt))
    return [e[: steps + 1] for e in experiments]


def _enough(model: ContinuousModel, probed: Sequence[Experiment], tolerance: float) -> int:
    """Of records that share a model."""
    dt = probed[0].dt
    stepped = discretise(model, dt, inputs=probed[0].inputs)
    x0 = start_states(stepped, probed, default_start(probed))
    drive = drives_of(stepped, probed)

    def positions(substeps: int) -> np.ndarray:
        run = simulated(replace(stepped, substeps=substeps), x0, drive)
        return run[..., model.channels.position]

    return enough_substeps(positions, tolerance)


def enough_substeps(positions: Callable[[int], np.ndarray], tolerance: float) -> int:
    """The least power of two whose positions are within a tolerance, at most 64.

    Positions that stay infinite whatever the number get 1: more steps would not mend them.

    Compared with twice as many; a fourth-order method leaves 15/16 of that difference to the
    coarser one's error.

    Args:
        positions: simulates with a number of substeps.
        tolerance: largest error allowed [rad or m].
    """
    substeps, coarse = 1, positions(1)
    while substeps < _MOST_SUBSTEPS:
        fine = positions(2 * substeps)
        error = float(np.max(np.abs(fine - coarse))) * 16 / 15
        if math.isfinite(error) and error < tolerance:
            return substeps
        substeps, coarse = 2 * substeps, fine
    return substeps if np.isfinite(coarse).all() else 1
