"""The number of integration steps that a sampling period needs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.contract import ContinuousModel
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.simulate.batches import batches
from tustinnet.simulate.input_signal import input_signals
from tustinnet.simulate.simulation import simulate_runs
from tustinnet.simulate.start_rules import PARABOLA_SAMPLES
from tustinnet.simulate.starts import measured_start, start_states

PROBED_SECONDS = 2.0  # of each record
MOST_CHOSEN = 64  # integration steps in a period


def choose_substeps(
    model: ContinuousModel, experiments: Sequence[Experiment], tolerance: float
) -> int:
    """The number of Runge-Kutta steps that a sampling period needs.

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
    heads = _heads(experiments)

    def substeps_of_batch(model: ContinuousModel, batch: Sequence[Experiment]) -> int:
        discrete = discretise(model, batch[0].dt, inputs=batch[0].inputs)
        x0 = start_states(discrete, batch, measured_start(batch))
        signal = input_signals(discrete, batch)

        def positions(substeps: int) -> np.ndarray:
            run = simulate_runs(replace(discrete, substeps=substeps), x0, signal)
            return run[..., model.channels.position]

        return enough_substeps(positions, tolerance)

    return max(
        substeps_of_batch(shared, [heads[i] for i in rows])
        for shared, rows in batches(model, heads)
    )


@np.errstate(all="ignore")  # of few steps that diverge
def fewest_substeps(model: Discretised, experiments: Sequence[Experiment], share: float) -> int:
    """The smallest number of Runge-Kutta steps in a period whose error the model's own errors hide.

    The first 2 s of every record are simulated with 1, 2, 4, ... substeps, until for every
    coordinate the steps change the positions by less than a share of the model's error (root mean
    squares over all records).

    Args:
        model: the model, with as many steps as it needs to be exact.
        experiments: records that show how wrong it is.
        share: share of its error that integration may make.

    Returns:
        Fewer than the model has, or as many.
    """
    heads = [e for e in _heads(experiments) if len(e) >= PARABOLA_SAMPLES]
    if not heads:
        return model.substeps
    start = measured_start(heads)

    runs = []
    for shared, rows in batches(model, heads):
        batch = [heads[i] for i in rows]
        x0 = start_states(shared, batch, start)
        runs.append((shared, batch, x0, input_signals(shared, batch)))

    def positions(substeps: int) -> np.ndarray:
        parts = []
        for shared, batch, x0, signal in runs:
            run = simulate_runs(replace(shared, substeps=substeps), x0, signal)
            at = shared.channels.position
            parts += [x[: len(e), at] for x, e in zip(run, batch, strict=True)]
        return np.concatenate(parts)

    exact = positions(model.substeps)
    measured = np.concatenate([e.q for _, batch, _, _ in runs for e in batch])
    allowed = share**2 * np.mean((exact - measured) ** 2, axis=0)
    for doublings in range(math.ceil(math.log2(model.substeps))):
        changed = np.mean((positions(2**doublings) - exact) ** 2, axis=0)
        if (changed <= allowed).all():  # False of what is no number
            return 2**doublings
    return model.substeps


def _heads(experiments: Sequence[Experiment]) -> list[Experiment]:
    """The first 2 s of records."""
    steps = max(1, round(PROBED_SECONDS / experiments[0].dt))
    return [e[: steps + 1] for e in experiments]


def enough_substeps(positions: Callable[[int], np.ndarray], tolerance: float) -> int:
    """The least power of two whose positions are within a tolerance, at most 64.

    Positions that diverge whatever the number get 1: more steps would not help.

    Compared with twice as many; a fourth-order method leaves 15/16 of that difference to the
    coarser one's error.

    Args:
        positions: positions that are simulated with a number of substeps.
        tolerance: largest error allowed [rad or m].
    """
    substeps, coarse = 1, positions(1)
    while substeps < MOST_CHOSEN:
        fine = positions(2 * substeps)
        error = float(np.max(np.abs(fine - coarse))) * 16 / 15
        if math.isfinite(error) and error < tolerance:
            return substeps
        substeps, coarse = 2 * substeps, fine
    return substeps if np.isfinite(coarse).all() else 1
