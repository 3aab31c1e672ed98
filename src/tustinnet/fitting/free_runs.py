"""Free runs of records as arrays, which rank and refine models while they are fitted."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import Model
from tustinnet.signals.stacking import stack_padded
from tustinnet.simulate.horizon import horizon_samples, pieces
from tustinnet.simulate.input_signal import input_signals
from tustinnet.simulate.starts import Start


class FreeRuns(eqx.Module):
    """Free runs to compare with, in float32.

    A record is one segment, or several end to end over a horizon; records with fewer than others
    repeat their first, which then weighs nothing.

    Attributes:
        start: where they start.
        start_data: what the start needs of the segments, arrays (records, segments, ...).
        u: what drives them from the start on, (records, segments, steps, ...), 0 after the end.
        q: measured positions from the start on, (records, segments, steps + 1, n_q).
        weight: 1 / length of the record within a segment, else 0, (records, segments, steps + 1).
    """

    start: Start = eqx.field(static=True)
    start_data: Any
    u: Float[Array, "records segments steps *drive"]
    q: Float[Array, "records segments samples n_q"]
    weight: Float[Array, "records segments samples"]


def make_free_runs(
    model: Model, experiments: Sequence[Experiment], start: Start, horizon: float | None = None
) -> FreeRuns:
    """Prepares the free runs of records from a start, over a horizon [s] or as a whole.

    Raises:
        InputError: a horizon that is too short or too long, see `horizon_samples`.
    """
    samples = horizon_samples(horizon, experiments, start)
    by_record = [pieces(e, samples, start) for e in experiments]
    most = max(map(len, by_record))
    segments, weights = [], []
    for e, own in zip(experiments, by_record, strict=True):
        for i in range(most):
            segments.append(own[i] if i < len(own) else own[0])
            weights.append(1.0 / (len(e) - start.first) * (i < len(own)))
    tails = [segment[start.first :] for segment in segments]
    arrays = (
        start.start_data(model, segments),
        input_signals(model, segments, slice(start.first, None)).u,
        stack_padded([e.q for e in tails]),
        stack_padded([np.full(len(e), w) for e, w in zip(tails, weights, strict=True)]),
    )

    def arrange(a: Array | np.ndarray) -> Array:
        return jnp.asarray(a, jnp.float32).reshape(len(by_record), most, *np.shape(a)[1:])

    return FreeRuns(start, *jax.tree.map(arrange, arrays))
