"""Trajectories planned on a model by iterative LQR."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Plan:
    """States and inputs of a planned motion.

    Attributes:
        x: states at all samples, (N + 1, n_x).
        u: inputs from each sample to the next, (N, n_u).
        cost: the cost that was minimised.
        converged: whether the search ended because nothing improved any more.
        iterations: how many there were.
        dt: sampling period [s].
    """

    x: Float[np.ndarray, "samples n_x"]
    u: Float[np.ndarray, "N n_u"]
    cost: float
    converged: bool
    iterations: int
    dt: float
