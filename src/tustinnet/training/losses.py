"""What training minimises."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.training.recipe import LossName


def window_loss(
    simulated: Float[Array, "samples n_x"],
    target: Float[Array, "samples n_x"],
    angular: np.ndarray,
    kind: LossName,
) -> Float[Array, ""]:
    """Mean over the steps k = 1..T of a window of the distance to the recorded state.

    Angles are compared periodically, `2 (1 - cos(difference))`; linear positions and, for the
    kind `state`, velocities by their squared difference. The sum over components is unweighted.

    Args:
        simulated: states of the rollout, (T + 1, n_x); the first is the given start.
        target: recorded states, (T + 1, n_x).
        angular: which coordinates are angles, (n_q,) of bool.
        kind: `state` or `position`.

    References:
        van Esch, Bonassi, Schön, equations of the periodic distance and of the state loss.
    """
    n_q = len(angular)
    difference = (simulated - target)[1:]
    position = difference[:, :n_q]
    distance = jnp.where(angular, 2.0 * (1.0 - jnp.cos(position)), position**2)
    total = jnp.sum(distance, axis=1)
    if kind == "state":
        total = total + jnp.sum(difference[:, n_q : 2 * n_q] ** 2, axis=1)
    return jnp.mean(total)
