"""Trivial predictors that any model has to beat, the reference of free runs; scores beside it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.scores import (
    Score,
    mean_rmse,
    mean_rmse_by_unit,
    rmse_by_record,
    score_runs,
)
from tustinnet.models.contract import Model, State
from tustinnet.models.step_layout import StepInput
from tustinnet.signals.outliers import white_noise
from tustinnet.simulate.starts import Start, measured_start


class Persistence(Model):
    """A record that stands still where a free run begins, or goes on at the speed it has there.

    Attributes:
        channels: coordinates, inputs and sampling period of the records.
        moves: whether it goes on.
    """

    channels: Channels = eqx.field(static=True)
    moves: bool = eqx.field(static=True)

    def step(self, x: State, u: StepInput) -> State:
        """`q[k+1] = q[k] + dt v[k]`; the velocity is constant, 0 of one that stands still."""
        q, v = x[self.channels.position], self.moves * x[self.channels.velocity]
        return jnp.concatenate([q + self.dt * v, v])


@dataclass(frozen=True)
class Reference:
    """The better of both predictors over free runs of records.

    Attributes:
        moves: whether it is the one that goes on at constant speed.
        scores: its scores, by record.
        channels: coordinates of the records.
    """

    moves: bool
    scores: tuple[Score, ...]
    channels: Channels

    @property
    def label(self) -> str:
        """The predictor in two words, as `standing still`."""
        return "constant speed" if self.moves else "standing still"

    @property
    def rmse(self) -> Mapping[str, float]:
        """RMSE of each record [rad or m]."""
        return rmse_by_record(self.scores)

    @property
    def mean(self) -> float:
        """Mean RMSE over the records [rad or m]."""
        return mean_rmse(self.scores)

    @property
    def mean_by_unit(self) -> dict[str, float]:
        """Mean RMSE over the records, by unit."""
        return mean_rmse_by_unit(self.scores, self.channels)

    def as_plain(self) -> dict[str, Any]:
        """The predictor and its errors as plain values."""
        by_unit = self.mean_by_unit
        return {"predictor": self.label, "mean": self.mean, "mean_by_unit": by_unit}

    def median_share(self, rmse: Mapping[str, float], records: Iterable[Experiment]) -> float:
        """Median over records of a model's error by that of the predictor; 0 of none.

        Records that move no further than sensors see tell nothing, unless none does.

        Args:
            rmse: the errors of the model, by record.
            records: the records.
        """
        own = self.rmse
        both = [e for e in records if e.name in rmse and e.name in own]
        moving = [e for e in both if own[e.name] > np.linalg.norm(unseen(e))]
        names = [e.name for e in moving or both]
        return median([rmse[n] / own[n] if own[n] else math.inf for n in names] or [0.0])

    def as_header(
        self, rmse: Mapping[str, float], records: Iterable[Experiment]
    ) -> dict[str, str | float]:
        """The entry of a model's file: the predictor, and the model's share of its error.

        Args:
            rmse: the errors of the model, by record.
            records: the records.
        """
        return {"predictor": self.label, "share": self.median_share(rmse, records)}


def unseen(record: Experiment) -> Float[np.ndarray, " n_q"]:
    """Distances that a sensor does not see: a step, or twice the deviation of its noise, (n_q,)."""
    return np.maximum(record.channels.resolution, 2 * white_noise(record.q))


def find_reference(records: Sequence[Experiment], horizon: float | None) -> Reference:
    """The reference of free runs of records, from what was measured alone.

    Args:
        records: the records, one at least.
        horizon: how long a free run lasts at most [s], None for whole records.
    """
    channels, start = records[0].channels, measured_start(records)
    # no input moves them, whatever is known of when it acts
    holds = ["zero-order" if i.hold == "unknown" else i.hold for i in channels.inputs]
    inputs = [replace(i, hold=h, delay=0.0) for i, h in zip(channels.inputs, holds, strict=True)]
    channels = replace(channels, inputs=tuple(inputs))
    references = [
        Reference(
            moves,
            tuple(score_runs(Persistence(channels, moves), records, start, horizon=horizon)),
            channels,
        )
        for moves in (False, True)
    ]
    return min(references, key=lambda reference: reference.mean)


def find_reference_if_possible(
    records: Sequence[Experiment], horizon: float | None
) -> Reference | None:
    """The reference of free runs of records; None of none, and of those too short to start in."""
    try:
        return find_reference(records, horizon) if records else None
    except InputError:
        return None


def evaluate(
    model: Model,
    experiments: Iterable[Experiment] | Experiment,
    start: str | Start | None = None,
    *,
    horizon: float | None = None,
) -> list[Score]:
    """Scores the free runs of records.

    Args:
        model: the model.
        experiments: records of any lengths, a data set of them, or one.
        start: where the free runs start, as `start_states` takes it; that of a fit is its `start`.
            By default a warm-up or `model-20` where internal states ask for it, else `file` where
            a sensor measured all velocities, else `model-20`, or `derived-6` of short records.
        horizon: how long a free run lasts at most [s], see `free_run`; a record's score is over
            all its segments. None for whole records.

    Returns:
        Per record RMSE, beside it that of a trivial predictor, per-coordinate figures and the
        simulation. A free run that diverges scores infinity.

    Raises:
        InputError: see `free_run`.
    """
    experiments = [experiments] if isinstance(experiments, Experiment) else [*experiments]
    if not experiments:
        raise InputError("evaluate", "no records", "at least one")
    scores = score_runs(model, experiments, start, horizon=horizon)
    reference = find_reference_if_possible(experiments, horizon)
    if reference is None:
        return scores
    trivial = [score.rmse for score in reference.scores]
    return [replace(s, reference=x) for s, x in zip(scores, trivial, strict=True)]
