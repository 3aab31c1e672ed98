"""The backward pass of iterative LQR: feedback at every step under limits of the inputs."""

from collections.abc import Callable
from functools import lru_cache
from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Float

from tustinnet.control.cost import Expansion
from tustinnet.engine.engines import simulate
from tustinnet.engine.equations import Equations
from tustinnet.engine.runs import Runs

_MOST_COMPILED = 12  # states and inputs up to which a step is written out as machine code, in 5 s
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
    start = np.concatenate([cost.end_hessian.ravel(), cost.end_gradient])
    rows = np.concatenate(
        [a.reshape(count, -1) for a in (derivatives, cost.hessians, cost.gradients, *room)], axis=1
    )[::-1]
    if n_zu <= _MOST_COMPILED:
        results = _by_machine_code(n_z, n_u, start, rows, damping)
    else:
        results = _by_numpy(n_z, n_u, start, rows, damping)
    gain, feedforward, decrease = np.split(results[::-1], [n_u * n_z, n_u * n_z + n_u], axis=1)
    slope, curvature = decrease.sum(axis=0)
    return Policy(feedforward, gain.reshape(count, n_u, n_z), float(slope), float(curvature))


def _by_machine_code(
    n_z: int, n_u: int, start: np.ndarray, rows: np.ndarray, damping: np.ndarray
) -> Float[np.ndarray, "N results"]:
    """Results of all steps, from the last to the first, as a simulation backwards in time."""
    equations = _equations(n_z, n_u)
    count, size = len(rows), equations.n_x - len(start)
    drive = np.zeros((count + 1, 1, equations.n_u))
    drive[:count, 0] = rows
    runs = Runs(
        start=np.concatenate([start, np.zeros(size)])[None],
        parameters=damping[None],
        steps=np.array([count]),
        first=np.array([0]),
        drive=drive,
        periods=np.ones(count + 1),
    )
    return simulate(equations, runs)[1:, len(start) :]


@lru_cache
def _equations(n_z: int, n_u: int) -> Equations:
    """A step backwards in time as equations for the engine."""
    n_zu, size = n_z + n_u, n_z * n_z + n_z
    return Equations(
        lambda state, row, none, damping: jnp.concatenate(
            _backward_step(jnp, _solve_with_jax, n_z, n_u, state[:size], row, damping)
        ),
        n_x=size + n_u * (n_z + 1) + 2,
        n_u=(n_z + n_zu + 1) * n_zu + 2 * n_u,
        n_c=n_u,
        continuous=False,
        where="the backward pass",
    )


def _solve_with_jax(matrix: Any, right: Any) -> Any:
    return jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(matrix), True), right)


def _by_numpy(
    n_z: int, n_u: int, start: np.ndarray, rows: np.ndarray, damping: np.ndarray
) -> Float[np.ndarray, "N results"]:
    results, value = [], start
    for row in rows:
        *value, gain, feedforward, decrease = _backward_step(
            np, np.linalg.solve, n_z, n_u, value, row, damping
        )
        value = np.concatenate(value)
        results.append(np.concatenate([gain, feedforward, decrease]))
    return np.stack(results)


def _backward_step(
    xp: ModuleType,
    solve: Callable[[Any, Any], Any],
    n_z: int,
    n_u: int,
    value: Any,
    row: Any,
    damping: Any,
) -> list[Any]:
    """The cost to go one step earlier and the policy there.

    Args:
        xp: NumPy, or JAX's.
        solve: of a system of linear equations, symmetric and positive definite.
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
    damped = q_uu + xp.diag(damping)
    near = _bounded_minimum(xp, damped, q_u, least, most)
    free = (near > least) & (near < most)
    rest = q_u + damped @ xp.where(free, xp.zeros(n_u), near)
    right = xp.concatenate([q_ux, rest[:, None]], axis=1)
    solution = -solve(
        xp.where(free[:, None] & free[None, :], damped, xp.eye(n_u)),
        xp.where(free[:, None], right, xp.zeros((n_u, n_z + 1))),
    )
    gain = solution[:, :n_z]
    exact = xp.minimum(xp.maximum(solution[:, n_z], least), most)
    feedforward = xp.where(free, exact, near)
    new_hessian = q_xx + gain.T @ (q_uu @ gain) + gain.T @ q_ux + q_ux.T @ gain
    new_gradient = q_1[:n_z] + gain.T @ (q_uu @ feedforward + q_u) + q_ux.T @ feedforward
    slope, curvature = feedforward @ q_u, feedforward @ (q_uu @ feedforward) / 2
    new_hessian = (new_hessian + new_hessian.T) / 2
    return [
        new_hessian.reshape(-1),
        new_gradient,
        gain.reshape(-1),
        feedforward,
        xp.stack([slope, curvature]),
    ]


def _bounded_minimum(xp: ModuleType, matrix: Any, vector: Any, least: Any, most: Any) -> Any:
    """The minimum of `x' matrix x / 2 + vector' x` within limits, one number after the other."""
    n, smaller, larger = len(vector), xp.minimum, xp.maximum
    if xp is np:
        free = np.linalg.solve(matrix, -vector)
        if ((least < free) & (free < most)).all():
            return free
        # one by one numbers of Python take a fifth of the time that those of NumPy take
        matrix, vector, least, most = (a.tolist() for a in (matrix, vector, least, most))
        smaller, larger = min, max
    x = [smaller(larger(least[i] * 0.0, least[i]), most[i]) for i in range(n)]
    for _ in range(SWEEPS if n > 1 else 1):
        for i in range(n):
            rest = vector[i] + sum(matrix[i][j] * x[j] for j in range(n) if j != i)
            x[i] = smaller(larger(-rest / matrix[i][i], least[i]), most[i])
    return xp.stack(x)
