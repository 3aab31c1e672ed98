"""Internal states along records."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.models.base import DiscreteModel
from tustinnet.signals.stacking import stacked


def known_states(
    model: DiscreteModel, experiments: Sequence[Experiment], velocity: VelocitySource
) -> list[Float[np.ndarray, "_ n_x"]]:
    """Of each record the states [q, v, z] along it, internal ones as they follow it, (n, n_x)."""
    known = [np.concatenate([e.q, e.velocities(velocity)], axis=1) for e in experiments]
    followed = internal_states(model, known, [model.drive(e) for e in experiments])
    return [np.concatenate(of, axis=1) for of in zip(known, followed, strict=True)]


def internal_states(
    model: DiscreteModel,
    known: Sequence[Float[np.ndarray, "_ n_known"]],
    drives: Sequence[Float[np.ndarray, "_ *drive"]],
) -> list[Float[np.ndarray, "_ n_z"]]:
    """What a model's internal states are while positions and velocities are the measured ones.

    They begin at 0 and step with the model, whose positions and velocities are put back to the
    measured ones at every sample. Windows that begin within a record begin with these.

    Args:
        model: the model.
        known: of each record positions and velocities, (n, 2 n_q).
        drives: of each record what acts between the samples, (n - 1, ...).

    Returns:
        Of each record (n, n_z).
    """
    n_z = len(model.memory)
    if not n_z:
        return [np.zeros((len(x), 0)) for x in known]
    # all of one length, so that one program serves them; nobody reads what follows a record's end
    states, drive = jnp.asarray(stacked(known)), jnp.asarray(stacked(drives))
    found = np.asarray(_followed(model, states, drive))
    return [z[: len(x)] for z, x in zip(found, known, strict=True)]


@eqx.filter_jit
def _followed(
    model: DiscreteModel,
    known: Float[Array, "records n n_known"],
    drive: Float[Array, "records steps *drive"],
) -> Float[Array, "records n n_z"]:
    n_z = len(model.memory)

    def follow(known: Array, drive: Array) -> Array:
        def advance(z: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
            x, u = now
            following = model.step(jnp.concatenate([x, z]), u)[-n_z:]
            return following, following

        first = jnp.zeros(n_z, known.dtype)
        _, states = jax.lax.scan(advance, first, (known[:-1], drive))
        return jnp.concatenate([first[None], states])

    return jax.vmap(follow)(known, drive)
