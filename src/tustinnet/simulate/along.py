"""States along records: what a model's state is while positions and velocities are measured."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.models.contract import Model
from tustinnet.signals.stacking import stacked
from tustinnet.simulate.batches import in_batches
from tustinnet.simulate.drive import Drive, drives_of
from tustinnet.simulate.rollout import rollout
from tustinnet.simulate.simulation import beginnings, simulated


def states_along(
    model: Model, experiments: Sequence[Experiment], velocity: VelocitySource = "auto"
) -> list[Float[np.ndarray, "_ n_x"]]:
    """Of each record the states [q, v, z] along it, (n, n_x).

    Internal states begin as the model expects and step with it; its positions and velocities are
    put back to the measured ones at every sample.

    Args:
        model: the model.
        experiments: the records.
        velocity: where the velocities come from, see `Experiment.velocities`.
    """
    known = [e.measured_states(velocity) for e in experiments]
    if not model.internal:
        return known
    internal = in_batches(model, experiments, lambda own, some: _internal(own, some, velocity))
    return [np.concatenate([x, z[: len(x)]], axis=1) for x, z in zip(known, internal, strict=True)]


def _internal(
    model: Model, experiments: Sequence[Experiment], velocity: VelocitySource
) -> Float[np.ndarray, "records n n_z"]:
    # all of one length, so that one program serves them; nobody reads what follows a record's end
    known = stacked([e.measured_states(velocity) for e in experiments])
    start = beginnings(model, known[:, 0])
    runs = simulated(model, start, drives_of(model, experiments), known)
    return runs[..., model.channels.internal]


@eqx.filter_jit
def followed(
    model: Model, known: Float[Array, "records n n_measured"], drive: Drive
) -> Float[Array, "records n n_x"]:
    """What a model says of every sample from the measured one before it.

    Internal states begin as the model expects.

    Args:
        model: the model.
        known: positions and velocities, (records, n, 2 n_q).
        drive: what acts between the samples.
    """

    def one(known: Array, drive: Drive) -> Array:
        return rollout(model, model.initial_state(known[0]), drive, known)

    return jax.vmap(one)(known, drive)
