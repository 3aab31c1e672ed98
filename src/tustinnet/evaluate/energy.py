"""Mechanical energy along records and their free runs."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.simulate.batches import in_batches


def energy_along(
    model: Model,
    experiments: Sequence[Experiment],
    runs: Sequence[Float[np.ndarray, "_ n_x"]],
) -> list[Float[np.ndarray, " _"]] | None:
    """Kinetic and potential energy `T + V` at states of records, by a model's equations of motion.

    Args:
        model: the model.
        experiments: the records.
        runs: of each record states [q, v, ...], measured or simulated, (n, n_x).

    Returns:
        Of each record the energy at its states, (n,) [J]; None of a model without equations of
        motion.
    """
    if family_of(model).equations(model) is None:
        return None
    states = {e.name: x[:, e.channels.measured] for e, x in zip(experiments, runs, strict=True)}

    def of_batch(own: Model, some: Sequence[Experiment]) -> list[np.ndarray]:
        equations = family_of(own).equations(own)
        assert equations is not None
        every = [states[e.name] for e in some]
        energy = np.asarray(_energies(equations, jnp.asarray(np.concatenate(every))))
        return np.split(energy, np.cumsum([len(x) for x in every])[:-1])

    return in_batches(model, experiments, of_batch)


@eqx.filter_jit
def _energies(equations: LagrangianModel, x: Float[Array, "states n"]) -> Float[Array, " states"]:
    return jax.vmap(equations.energy)(x)
