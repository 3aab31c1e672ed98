"""The cost of a motion: squared deviations from a goal, and penalties beyond limits of states."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Expansion(NamedTuple):
    """The cost about a motion to second order, by Gauss-Newton.

    Attributes:
        gradients: of all steps by [z, u], (N, n_zu).
        hessians: of all steps, (N, n_zu, n_zu).
        end_gradient: of the end, (n_z,).
        end_hessian: of the end, (n_z, n_z).
    """

    gradients: Float[np.ndarray, "N n_zu"]
    hessians: Float[np.ndarray, "N n_zu n_zu"]
    end_gradient: Float[np.ndarray, " n_z"]
    end_hessian: Float[np.ndarray, "n_z n_z"]


@dataclass(frozen=True)
class Cost:
    """The cost of a motion: half of the sum of weighted squares.

    Of errors, of inputs, of what is beyond limits of the states, and of the end.

    Attributes:
        x: the goal, (n_x,), or one for each sample, (N + 1, n_x).
        u: the inputs there, (n_u,), or those of each step, (N, n_u).
        states: weights of the errors, (n_x,).
        inputs: weights of the inputs, (n_u,).
        end: matrix of the end's cost, `z' end z`, of differences from the goal, (n_z, n_z).
        lower: states below which the penalty counts, (n_x,); -inf for none.
        upper: states above which it does, (n_x,).
        penalty: weights of what is beyond, (n_x,).
    """

    x: Float[np.ndarray, "*samples n_x"]
    u: Float[np.ndarray, "*steps n_u"]
    states: Float[np.ndarray, " n_x"]
    inputs: Float[np.ndarray, " n_u"]
    end: Float[np.ndarray, "n_z n_z"]
    lower: Float[np.ndarray, " n_x"]
    upper: Float[np.ndarray, " n_x"]
    penalty: Float[np.ndarray, " n_x"]

    @property
    def goal(self) -> Float[np.ndarray, " n_x"]:
        """The state at the end, (n_x,)."""
        return self.x if self.x.ndim == 1 else self.x[-1]

    def end_error(self, z: Float[np.ndarray, "*runs n_z"]) -> Float[np.ndarray, "*runs n_z"]:
        """Last states as differences from the goal, previous inputs from its inputs."""
        n_x, n_u = self.states.size, self.inputs.size
        u = self.u if self.u.ndim == 1 else self.u[-1]
        return z - np.concatenate([self.goal, np.tile(u, (z.shape[-1] - n_x) // n_u)])

    def _beyond(self, x: Float[np.ndarray, "*rows n_x"]) -> Float[np.ndarray, "*rows n_x"]:
        """The part of a state beyond its limits, with its sign."""
        return np.maximum(x - self.upper, 0.0) - np.maximum(self.lower - x, 0.0)

    def total(
        self, z: Float[np.ndarray, "runs samples n_z"], u: Float[np.ndarray, "runs N n_u"]
    ) -> Float[np.ndarray, " runs"]:
        """The cost of motions, (runs,); infinite where they are not finite."""
        x = z[..., : self.states.size]
        error = x - self.x
        beyond = self._beyond(x)
        final = self.end_error(z[:, -1])
        with np.errstate(over="ignore", invalid="ignore"):
            sums = (
                (error[:, :-1] ** 2).sum(axis=1) @ self.states
                + ((u - self.u) ** 2).sum(axis=1) @ self.inputs
                + (beyond**2).sum(axis=1) @ self.penalty
                + np.einsum("ri,ij,rj->r", final, self.end, final)
            )
        return np.where(np.isfinite(sums), sums / 2, np.inf)

    def expand(
        self, z: Float[np.ndarray, "samples n_z"], u: Float[np.ndarray, "N n_u"]
    ) -> Expansion:
        """The cost about a motion to second order."""
        n_x, n_z, n_u = self.states.size, z.shape[1], u.shape[1]
        x = z[:, :n_x]
        beyond = self._beyond(x)
        count = len(u)
        gradients = np.zeros((count, n_z + n_u))
        gradients[:, :n_x] = (self.states * (x - self.x) + self.penalty * beyond)[:-1]
        gradients[:, n_z:] = self.inputs * (u - self.u)
        hessians = np.zeros((count, n_z + n_u, n_z + n_u))
        of_states, of_inputs = np.arange(n_x), np.arange(n_z, n_z + n_u)
        steep = self.penalty * (beyond != 0)
        hessians[:, of_states, of_states] = self.states + steep[:-1]
        hessians[:, of_inputs, of_inputs] = self.inputs
        end_gradient = self.end @ self.end_error(z[-1])
        end_gradient[:n_x] += self.penalty * beyond[-1]
        end_hessian = self.end.copy()
        end_hessian[of_states, of_states] += steep[-1]
        return Expansion(gradients, hessians, end_gradient, end_hessian)
