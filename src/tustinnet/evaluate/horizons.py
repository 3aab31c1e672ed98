"""Errors over longer and longer free runs, and how long a model follows a record."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.reference import Reference, find_reference, unseen
from tustinnet.evaluate.scores import Score, mean_rmse_by_unit, score_runs
from tustinnet.finding import Finding, make_finding
from tustinnet.models.contract import Model
from tustinnet.simulate.horizon import FOLLOWED
from tustinnet.simulate.starts import start_named

HORIZONS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # [s], as far as records go


@dataclass(frozen=True)
class HorizonError:
    """The errors of free runs over a horizon.

    Attributes:
        horizon: how long a free run lasts at most [s], None for whole records.
        rmse: mean RMSE over the records by unit.
        reference: what the trivial predictor is off by.
    """

    horizon: float | None
    rmse: dict[str, float]
    reference: Reference


def errors_over_horizons(
    model: Model, records: Sequence[Experiment], start: str, whole: Sequence[Score]
) -> list[HorizonError]:
    """The errors of free runs of records over each of `HORIZONS` that they reach, then of all.

    Args:
        model: the model.
        records: the records.
        start: where the free runs start.
        whole: scores of the free runs of whole records.
    """
    dt, longest = records[0].dt, max(len(e) for e in records)
    fewest = 2 * start_named(start).samples
    errors = []
    for horizon in HORIZONS:
        if fewest <= round(horizon / dt) < longest:
            scores = score_runs(model, records, start, horizon=horizon)
            errors.append(_horizon_error(horizon, records, scores))
    return [*errors, _horizon_error(None, records, whole)]


def _horizon_error(
    horizon: float | None, records: Sequence[Experiment], scores: Sequence[Score]
) -> HorizonError:
    rmse = mean_rmse_by_unit(scores, records[0].channels)
    return HorizonError(horizon, rmse, find_reference(records, horizon))


def seconds_followed(records: Sequence[Experiment], whole: Sequence[Score]) -> list[float]:
    """Durations for which the free runs of whole records follow them [s]; to their ends at most.

    A run follows as long as the errors of all coordinates, their root mean squares from the
    beginning on, are within `FOLLOWED` of the coordinates' standard deviations in the record, or
    within what the sensor does not see, even where a shorter part is not.

    Args:
        records: the records.
        whole: scores of their free runs as a whole.
    """
    position, seconds = records[0].channels.position, []
    for e, score in zip(records, whole, strict=True):
        first = start_named(score.start).first
        with np.errstate(over="ignore", invalid="ignore"):  # of runs that diverge
            squares = np.cumsum((score.simulated[first:, position] - e.q[first:]) ** 2, 0)
        rms = np.sqrt(squares / np.arange(1, len(squares) + 1)[:, None])
        spread = np.std(e.q, axis=0)
        moves = (spread > 0) | ~spread.any()
        follows = (rms <= np.maximum(FOLLOWED * spread, unseen(e)))[:, moves].all(axis=1)
        seconds.append(float(e.dt * max(np.flatnonzero(follows), default=0)))
    return seconds


def describe_followed(records: Sequence[Experiment], whole: Sequence[Score]) -> Finding:
    """The finding on how long free runs of whole records follow them."""
    seconds = seconds_followed(records, whole)
    lengths = [
        e.dt * (len(e) - 1 - start_named(s.start).first)
        for e, s in zip(records, whole, strict=True)
    ]
    shorter = [a for a, b in zip(seconds, lengths, strict=True) if a < b]
    return make_finding(
        "follows for" if shorter else "follows to the end",
        records=len(records),
        limit=FOLLOWED,
        seconds=np.median(shorter) if shorter else None,
        to_the_end=len(records) - len(shorter),
    )
