"""Scores of a simulated record; figures of no samples are NaN."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from tustinnet.signals.transients import is_moving

Trajectory = Float[np.ndarray, "n n_q"]
PerCoordinate = Float[np.ndarray, " n_q"]
Key = TypeVar("Key")

# logarithms of the errors of a machine's records usually spread so much; counts as so many records
_PRIOR_SPREAD, _PRIOR_RECORDS = 0.7, 2


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


@dataclass(frozen=True)
class ErrorRange:
    """The error that a new record is expected to have, from those of other records.

    Attributes:
        typical: the geometric mean of the errors: as many records are above it as below.
        low: lower end of the range.
        high: its upper end.
        level: share of new records of these kinds that have an error within the range.
    """

    typical: float
    low: float
    high: float
    level: float


def expected_range(errors: Iterable[float], level: float = 0.9) -> ErrorRange | None:
    """The range in which the error of a new record lies, where those of some records are known.

    Errors of records differ by factors rather than by sums, so their logarithms are taken as
    normally distributed: the prediction interval of one more value, by Student's t. Their spread is
    estimated with that of usual machines as a prior: a few errors that are alike by chance say as
    little of it as a few that are far apart.

    Args:
        errors: of records of the same kinds [rad or m], none of which a model was fitted to.
        level: the share of new records that the range is for.

    Returns:
        None of no records, and where an error is not finite or 0.
    """
    values = np.array(list(errors))
    if not (len(values) and np.isfinite(values).all() and (values > 0).all()):
        return None
    from scipy.special import stdtrit  # few calls need it, and SciPy takes time to load

    logs, n = np.log(values), len(values)
    centre, freedom = logs.mean(), n - 1 + _PRIOR_RECORDS
    variance = (_PRIOR_RECORDS * _PRIOR_SPREAD**2 + np.sum((logs - centre) ** 2)) / freedom
    half = stdtrit(freedom, (1 + level) / 2) * np.sqrt(variance * (1 + 1 / n))
    low, typical, high = np.exp(centre + np.array([-half, 0.0, half])).tolist()
    return ErrorRange(typical, low, high, level)


def mean_and_error(values: Iterable[float]) -> tuple[float, float]:
    """Mean, NaN of no value, and its standard error, NaN of one or where one is not finite."""
    array, error = np.array(list(values)), np.nan
    if len(array) > 1 and np.isfinite(array).all():
        error = float(array.std(ddof=1) / np.sqrt(len(array)))
    return float(array.mean()) if len(array) else np.nan, error


def mean_by_key(pairs: Iterable[tuple[Key, float]]) -> dict[Key, float]:
    """Mean of the values of each key, in the order of first appearance."""
    values: dict[Key, list[float]] = {}
    for key, value in pairs:
        values.setdefault(key, []).append(value)
    return {key: float(np.mean(of_key)) for key, of_key in values.items()}
