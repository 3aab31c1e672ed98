"""Free runs of records as arrays: what judges and refines models while they are fitted."""

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
        material: what the start needs of the segments, arrays (records, segments, ...).
        u: what drives them from the start on, (records, segments, steps, ...), 0 after the end.
        q: measured positions from the start on, (records, segments, steps + 1, n_q).
        weight: 1 / length of the record within a segment, else 0, (records, segments, steps + 1).
    """

    start: Start = eqx.field(static=True)
    material: Any
    u: Float[Array, "records segments steps *drive"]
    q: Float[Array, "records segments samples n_q"]
    weight: Float[Array, "records segments samples"]


def free_runs(
    model: Model, experiments: Sequence[Experiment], start: Start, horizon: float | None = None
) -> FreeRuns:
    """Prepares the free runs of records from a start, over a horizon [s] or as a whole.

    Raises:
        InputError: a horizon that is too short or too long, see `horizon_samples`.
    """
    samples = horizon_samples(horizon, experiments, start)
    cut = [pieces(e, samples, start) for e in experiments]
    most = max(map(len, cut))
    filled = [piece for of in cut for piece in [*of, *of[:1] * (most - len(of))]]
    counted = [1.0 / (len(e) - start.first) * (i < len(of))
               for e, of in zip(experiments, cut, strict=True) for i in range(most)]  # fmt: skip
    material = start.start_data(model, filled)
    tails = [piece[start.first :] for piece in filled]
    u = input_signals(model, filled, slice(start.first, None)).u
    q = stack_padded([e.q for e in tails])
    weight = stack_padded([np.full(len(e), w) for e, w in zip(tails, counted, strict=True)])
    arrays = (material, u, q, weight)

    def by_record(a: Array | np.ndarray) -> Array:
        return jnp.asarray(a, jnp.float32).reshape(len(cut), most, *np.shape(a)[1:])

    return FreeRuns(start, *jax.tree.map(by_record, arrays))
