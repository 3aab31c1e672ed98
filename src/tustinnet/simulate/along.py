"""States along records: what a model's state is while positions and velocities are measured."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.models.contract import Model
from tustinnet.signals.stacking import stack_padded
from tustinnet.simulate.batches import map_in_batches
from tustinnet.simulate.input_signal import InputSignal, initial_inputs, input_signals
from tustinnet.simulate.rollout import rollout
from tustinnet.simulate.simulation import initial_states, simulate_runs


def states_along(
    model: Model, experiments: Sequence[Experiment], velocity: VelocitySource = "auto"
) -> list[Float[np.ndarray, "_ n_x"]]:
    """States [q, v, z] along each record, (n, n_x).

    Internal states begin as the model expects and step with it; its positions and velocities are
    put back to the measured ones at every sample.

    Args:
        model: the model.
        experiments: the records.
        velocity: where the velocities come from, see `Experiment.velocities`.
    """
    measured = [e.measured_states(velocity) for e in experiments]
    if not model.internal:
        return measured

    def internal_states(
        model: Model, batch: Sequence[Experiment]
    ) -> Float[np.ndarray, "records n n_z"]:
        # all of one length, so that one program serves them; nobody reads what follows a record's
        # end
        rows = stack_padded([e.measured_states(velocity) for e in batch])
        signal = input_signals(model, batch)
        start = initial_states(model, rows[:, 0], initial_inputs(model, signal))
        runs = simulate_runs(model, start, signal, rows)
        return runs[..., model.channels.internal]

    internal = map_in_batches(model, experiments, internal_states)
    return [
        np.concatenate([x, z[: len(x)]], axis=1) for x, z in zip(measured, internal, strict=True)
    ]


@eqx.filter_jit
def predictions_along(
    model: Model, measured: Float[Array, "records n n_measured"], signal: InputSignal
) -> Float[Array, "records n n_x"]:
    """Predictions of every sample of records from the measured sample before it.

    Internal states begin as the model expects.

    Args:
        model: the model.
        measured: positions and velocities, (records, n, 2 n_q).
        signal: what acts between the samples.
    """

    def predict(rows: Array, signal: InputSignal, u: Any) -> Array:
        return rollout(model, model.initial_state(rows[0], u), signal, rows)

    return jax.vmap(predict)(measured, signal, initial_inputs(model, signal))
