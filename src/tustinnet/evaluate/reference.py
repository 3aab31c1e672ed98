"""The reference of free runs: the trivial predictors that any model has to beat."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.scores import Score, evaluate, mean_rmse, mean_rmse_by_unit, rmse_by_record
from tustinnet.models.contract import Model, State
from tustinnet.models.step_layout import StepInput
from tustinnet.simulate.starts import default_start


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


def find_reference(records: Sequence[Experiment], horizon: float | None) -> Reference:
    """The reference of free runs of records, from their default start.

    Args:
        records: the records, one at least.
        horizon: how long a free run lasts at most [s], None for whole records.
    """
    channels, start = records[0].channels, default_start(records)
    # no input moves them, whatever is known of when it acts
    holds = ["zero-order" if i.hold == "unknown" else i.hold for i in channels.inputs]
    inputs = [replace(i, hold=h, delay=0.0) for i, h in zip(channels.inputs, holds, strict=True)]
    channels = replace(channels, inputs=tuple(inputs))
    references = [
        Reference(
            moves,
            tuple(evaluate(Persistence(channels, moves), records, start, horizon=horizon)),
            channels,
        )
        for moves in (False, True)
    ]
    return min(references, key=lambda reference: reference.mean)
