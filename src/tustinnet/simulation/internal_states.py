"""Internal states along a record."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.models.base import DiscreteModel


def known_states(
    model: DiscreteModel, experiment: Experiment, velocity: VelocitySource
) -> Float[np.ndarray, "n n_x"]:
    """The states [q, v, z] along a record, internal ones as they follow it, (n, n_x)."""
    known = np.concatenate([experiment.q, experiment.velocities(velocity)], axis=1)
    followed = internal_states(model, known, model.drive(experiment))
    return np.concatenate([known, followed], axis=1)


def internal_states(
    model: DiscreteModel,
    known: Float[np.ndarray, "n n_known"],
    drive: Float[np.ndarray, "steps *drive"],
) -> Float[np.ndarray, "n n_z"]:
    """What a model's internal states are while positions and velocities are the measured ones.

    They begin at 0 and step with the model, whose positions and velocities are put back to the
    measured ones at every sample. Windows that begin within a record begin with these.

    Args:
        model: the model.
        known: positions and velocities, (n, 2 n_q).
        drive: what acts between the samples, (n - 1, ...).

    Returns:
        (n, n_z).
    """
    n_z = len(model.memory)
    if not n_z:
        return np.zeros((len(known), 0))
    return np.asarray(_followed(model, jnp.asarray(known), jnp.asarray(drive)))


@eqx.filter_jit
def _followed(
    model: DiscreteModel, known: Float[Array, "n n_known"], drive: Float[Array, "steps *drive"]
) -> Float[Array, "n n_z"]:
    n_z = len(model.memory)

    def advance(z: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        x, u = now
        following = model.step(jnp.concatenate([x, z]), u)[-n_z:]
        return following, following

    first = jnp.zeros(n_z, known.dtype)
    _, states = jax.lax.scan(advance, first, (known[:-1], drive))
    return jnp.concatenate([first[None], states])
