"""The backward pass of iterative LQR: feedback at every step under limits of the inputs."""

from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Float

from tustinnet.control.cost import Expansion
from tustinnet.engine import by_jax
from tustinnet.engine.engines import simulate
from tustinnet.engine.equations import Equations
from tustinnet.engine.runs import Runs

# states and inputs up to which a step is written out as machine code: a pass takes less than a
# third of JAX's time then; with more of them JAX is quicker, and compiles in less time
_MOST_WRITTEN_OUT = 10
SWEEPS = 12  # over the inputs, which find the minimum under limits of several


class Policy(NamedTuple):
    """Changes of the inputs along a motion: `du[k] = feedforward[k] + gain[k] dz[k]`.

    Attributes:
        feedforward: (N, n_u).
        gain: (N, n_u, n_z); rows of 0 for inputs at a limit.
        slope: how the cost falls with the first share of the feedforward (negative).
        curvature: half of its second derivative by that share.
    """

    feedforward: Float[np.ndarray, "N n_u"]
    gain: Float[np.ndarray, "N n_u n_z"]
    slope: float
    curvature: float

    @property
    def expected(self) -> float:
        """The expected change of the cost (negative)."""
        return self.slope + self.curvature


def backward_pass(
    derivatives: Float[np.ndarray, "N n_z n_zu"],
    cost: Expansion,
    room: tuple[Float[np.ndarray, "N n_u"], Float[np.ndarray, "N n_u"]],
    damping: Float[np.ndarray, " n_u"],
) -> Policy:
    """The policy that minimises the cost to second order, inputs within their limits.

    Args:
        derivatives: of every step by [z, u].
        cost: the cost about the motion.
        room: least and greatest change of each input at every step.
        damping: what is added to the second derivatives by the inputs.

    References:
        Tassa, Mansard and Todorov (2014), Control-limited differential dynamic programming, ICRA.
    """
    count, n_z, n_zu = derivatives.shape
    n_u = n_zu - n_z
    equations = _equations(n_z, n_u)
    value = np.concatenate([cost.end_hessian.ravel(), cost.end_gradient])
    rows = np.concatenate(
        [a.reshape(count, -1) for a in (derivatives, cost.hessians, cost.gradients, *room)], axis=1
    )
    drive = np.zeros((count + 1, 1, equations.n_u))
    drive[:count, 0] = rows[::-1]
    runs = Runs(
        start=np.pad(value, (0, equations.n_x - len(value)))[None],
        parameters=damping[None],
        steps=np.array([count]),
        first=np.array([0]),
        drive=drive,
        periods=np.ones(count + 1),
    )
    # a simulation backwards in time
    is_small = n_zu <= _MOST_WRITTEN_OUT
    states = simulate(equations, runs) if is_small else by_jax.simulate(equations, runs, 1)
    results = states[:0:-1, len(value) :]
    gain, feedforward, decrease = np.split(results, [n_u * n_z, n_u * n_z + n_u], axis=1)
    slope, curvature = decrease.sum(axis=0)
    return Policy(feedforward, gain.reshape(count, n_u, n_z), float(slope), float(curvature))


@lru_cache
def _equations(n_z: int, n_u: int) -> Equations:
    """A step backwards in time as equations for the engine."""
    n_zu, size = n_z + n_u, n_z * n_z + n_z
    return Equations(
        lambda state, row, none, damping: jnp.concatenate(
            _backward_step(n_z, n_u, state[:size], row, damping)
        ),
        n_x=size + n_u * (n_z + 1) + 2,
        n_u=(n_z + n_zu + 1) * n_zu + 2 * n_u,
        n_c=n_u,
        continuous=False,
        where="the backward pass",
    )


def _backward_step(n_z: int, n_u: int, value: Array, row: Array, damping: Array) -> list[Array]:
    """The cost to go one step earlier and the policy there.

    Args:
        n_z: number of states.
        n_u: number of inputs.
        value: Hessian and gradient of the cost to go, flattened.
        row: derivatives of the step, Hessian and gradient of its cost, room of the inputs.
        damping: what is added to the second derivatives by the inputs, (n_u,).

    Returns:
        Hessian and gradient of the cost to go, gain, feedforward, and the slope and curvature of
        the cost, all flattened.
    """
    n_zu = n_z + n_u
    hessian, gradient = value[: n_z * n_z].reshape(n_z, n_z), value[n_z * n_z :]
    ends = np.cumsum([n_z * n_zu, n_zu * n_zu, n_zu, n_u, n_u]).tolist()
    begins = [0, *ends[:-1]]
    derivative, own_hessian, own_gradient, least, most = (
        row[begin:end] for begin, end in zip(begins, ends, strict=True)
    )
    derivative = derivative.reshape(n_z, n_zu)
    q = own_hessian.reshape(n_zu, n_zu) + derivative.T @ (hessian @ derivative)
    q_1 = own_gradient + derivative.T @ gradient
    q_xx, q_ux, q_uu = q[:n_z, :n_z], q[n_z:, :n_z], q[n_z:, n_z:]
    q_u = q_1[n_z:]
    damped = q_uu + jnp.diag(damping)
    near = _bounded_minimum(damped, q_u, least, most)
    free = (near > least) & (near < most)
    rest = q_u + damped @ jnp.where(free, 0.0, near)
    right = jnp.concatenate([q_ux, rest[:, None]], axis=1)
    root = jnp.linalg.cholesky(jnp.where(free[:, None] & free[None, :], damped, jnp.eye(n_u)))
    solution = -jax.scipy.linalg.cho_solve((root, True), jnp.where(free[:, None], right, 0.0))
    gain = solution[:, :n_z]
    feedforward = jnp.where(free, jnp.clip(solution[:, n_z], least, most), near)
    new_hessian = q_xx + gain.T @ (q_uu @ gain) + gain.T @ q_ux + q_ux.T @ gain
    new_gradient = q_1[:n_z] + gain.T @ (q_uu @ feedforward + q_u) + q_ux.T @ feedforward
    slope, curvature = feedforward @ q_u, feedforward @ (q_uu @ feedforward) / 2
    new_hessian = (new_hessian + new_hessian.T) / 2
    return [
        new_hessian.reshape(-1),
        new_gradient,
        gain.reshape(-1),
        feedforward,
        jnp.stack([slope, curvature]),
    ]


def _bounded_minimum(matrix: Array, vector: Array, least: Array, most: Array) -> Array:
    """The minimum of `x' matrix x / 2 + vector' x` within limits, one number after the other."""
    n = len(vector)
    x = [*jnp.clip(jnp.zeros(n), least, most)]
    for _ in range(SWEEPS if n > 1 else 1):
        for i in range(n):
            rest = vector[i] + sum(matrix[i][j] * x[j] for j in range(n) if j != i)
            x[i] = jnp.clip(-rest / matrix[i][i], least[i], most[i])
    return jnp.stack(x)
