"""Scores of a simulated record; figures of no samples are NaN."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from tustinnet.signals.transients import is_moving

Trajectory = Float[np.ndarray, "n n_q"]
PerCoordinate = Float[np.ndarray, " n_q"]


def rmse(simulated: Trajectory, measured: Trajectory) -> float:
    """Root mean square over samples of the 2-norm of the position error, not wrapped [rad or m].

    The paper sums T + 1 samples and divides by T; this is the mean over all samples.

    References:
        van Esch, Bonassi, Schön, section 4, definition of the RMSE.
    """
    squares = np.sum((simulated - measured) ** 2, axis=1)
    return float(np.sqrt(np.mean(squares))) if len(squares) else np.nan


def coordinate_rmse(simulated: Trajectory, measured: Trajectory) -> PerCoordinate:
    """Root mean square error of each coordinate, (n_q,) [rad or m]."""
    if not len(measured):
        return np.full(measured.shape[1], np.nan)
    return np.sqrt(np.mean((simulated - measured) ** 2, axis=0))


def nrmse(simulated: Trajectory, measured: Trajectory) -> PerCoordinate:
    """RMSE of each coordinate over the standard deviation of its measurement, (n_q,).

    NaN for a coordinate that did not move.
    """
    error = coordinate_rmse(simulated, measured)
    if not len(measured):
        return error
    nothing = np.full_like(error, np.nan)
    return np.divide(error, measured.std(axis=0), out=nothing, where=is_moving(measured))


def fit_percent(simulated: Trajectory, measured: Trajectory) -> PerCoordinate:
    """`100 (1 - NRMSE)` of each coordinate, (n_q,): 100 is perfect, 0 no better than the mean."""
    return 100.0 * (1.0 - nrmse(simulated, measured))


def mean_and_error(values: Iterable[float]) -> tuple[float, float]:
    """Mean, NaN of no value, and its standard error, NaN of one or where one is not finite."""
    array, error = np.array(list(values)), np.nan
    if len(array) > 1 and np.isfinite(array).all():
        error = float(array.std(ddof=1) / np.sqrt(len(array)))
    return float(array.mean()) if len(array) else np.nan, error
