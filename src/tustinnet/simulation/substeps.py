"""How many integration steps a sampling period needs."""

import math
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.base import ContinuousModel, State
from tustinnet.simulation.initial_state import default_start, initial_state, padded_state
from tustinnet.simulation.integrators import discretise, substep

PROBED_SECONDS = 2.0  # of each record
_MOST_SUBSTEPS = 64


def choose_substeps(
    model: ContinuousModel, experiments: Sequence[Experiment], tolerance: float
) -> int:
    """How many Runge-Kutta steps a sampling period needs.

    The first 2 s of every record are simulated with 1, 2, 4, ... substeps until the positions are
    within the tolerance.

    Args:
        model: the model.
        experiments: records that show the speeds it is to be simulated at.
        tolerance: the error target, largest position error within these 2 s [rad or m].

    Returns:
        A power of two, at most 64.
    """
    if not tolerance > 0:
        raise InputError("choose_substeps", f"tolerance {tolerance:g}", "a positive number")
    fixed = discretise(model, experiments[0].dt)
    start = default_start(list(experiments))
    longest = max(len(e) for e in experiments) - 1
    steps = min(max(1, round(PROBED_SECONDS / fixed.dt)), longest)
    x0 = jnp.asarray(np.stack([padded_state(fixed, initial_state(e, start)) for e in experiments]))
    drives = [fixed.drive(e)[:steps] for e in experiments]
    # a shorter record goes on under its last input
    ends = [[(0, steps - len(d)), *[(0, 0)] * (d.ndim - 1)] for d in drives]
    u = jnp.asarray(np.stack([np.pad(d, p, "edge") for d, p in zip(drives, ends, strict=True)]))

    def positions(substeps: int) -> np.ndarray:
        return np.asarray(_positions(model, x0, u, fixed.dt, jnp.asarray(substeps)))

    return enough_substeps(positions, tolerance)


def enough_substeps(positions: Callable[[int], np.ndarray], tolerance: float) -> int:
    """The least power of two whose positions are within a tolerance, at most 64.

    Positions that stay infinite whatever the number get 1: more steps would not mend them.

    Compared with twice as many; a fourth-order method leaves 15/16 of that difference to the
    coarser one's error.

    Args:
        positions: simulates with a number of substeps.
        tolerance: largest error allowed [rad or m].
    """
    substeps, coarse = 1, positions(1)
    while substeps < _MOST_SUBSTEPS:
        fine = positions(2 * substeps)
        error = float(np.max(np.abs(fine - coarse))) * 16 / 15
        if math.isfinite(error) and error < tolerance:
            return substeps
        substeps, coarse = 2 * substeps, fine
    return substeps if np.isfinite(coarse).all() else 1


@eqx.filter_jit
def _positions(
    model: ContinuousModel,
    x0: Float[Array, "records n_x"],
    u: Float[Array, "records steps *drive"],
    dt: float,
    parts: Array,
) -> Float[Array, "records samples n_q"]:
    """Positions at all samples; the number of substeps is not compiled in."""
    n_q = len(model.coordinates)

    def run(x: State, drive: Array) -> Array:
        def advance(state: State, u_k: Array) -> tuple[State, Array]:
            state = jax.lax.fori_loop(
                0, parts, lambda i, s: substep(model, s, u_k, i, parts, dt / parts), state
            )
            return state, state[:n_q]

        return jax.lax.scan(advance, x, drive)[1]

    return jax.vmap(run)(x0, u)
