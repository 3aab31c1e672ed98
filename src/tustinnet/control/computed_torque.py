"""Computed torque: motions of fully driven machines by their inverse dynamics."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from tustinnet.control.dynamics import Limits, controlled, input_limits
from tustinnet.control.lqr import AccelerationGains, Feedback, Tracking
from tustinnet.control.plan import Plan
from tustinnet.control.reference import checked_reference
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel

_SAME = 1e-6  # relative, of forces by inputs at different states; of the inputs of a motion
_STATES_COMPARED = 8  # at which they are compared

Required = Callable[[Array, Array], Array]


def inverse_dynamics(model: Model) -> Required:
    """The inputs that a state and accelerations need, `u(x, a)`, written with JAX.

    Args:
        model: the model.

    Raises:
        InputError: a model that is not fully driven: other than equations of motion, forces with
            memory or other internal states, not as many inputs as coordinates, inputs whose forces
            depend on the state or do not move each coordinate, or that act late.
    """
    equations = model.continuous if isinstance(model, Discretised) else None
    if not isinstance(equations, LagrangianModel):
        raise _refused("a model that is not only equations of motion", "equations of motion")
    channels = equations.channels
    n, lagrangian = channels.n_q, equations
    if equations.internal:
        names = ", ".join(equations.internal)
        raise _refused(f"internal states ({names})", "forces without memory, encoders at all links")
    if channels.n_u != n:
        raise _refused(f"{channels.n_u} inputs, {n} coordinates", "as many inputs as coordinates")
    if controlled(model).previous:
        raise _refused("inputs that act late", "inputs that act at once")

    def balance(point: Array) -> Array:
        return lagrangian.imbalance(point[: 2 * n], point[2 * n :], jnp.zeros(n))

    formula = Formula(balance, 3 * n, where="the forces of inputs")
    points = np.random.default_rng(0).uniform(-1, 1, (_STATES_COMPARED, 3 * n))
    slopes = evaluate(formula, points, derivatives=True).reshape(_STATES_COMPARED, n, -1)[
        ..., 2 * n :
    ]
    matrix = -slopes[0]
    if not np.abs(slopes + matrix).max() <= _SAME * np.abs(matrix).max():
        raise _refused("inputs whose forces depend on the state", "forces in proportion to inputs")
    if np.linalg.matrix_rank(matrix) < n:
        raise _refused("coordinates that no input moves", "an input for each coordinate")
    inverse = np.linalg.inv(matrix)

    def required(x: Array, a: Array) -> Array:
        return jnp.asarray(inverse) @ lagrangian.imbalance(x, jnp.zeros(n), a)

    return required


def _refused(found: str, expected: str) -> InputError:
    return InputError("computed torque", found, expected, "plan by `ilqr` or `follow`")


def computed_torque(
    model: Model, reference: ArrayLike, feedback: Feedback, *, limits: Limits | None = None
) -> Tracking:
    """Follows a reference of a fully driven machine by its inverse dynamics.

        u = required(q_r, v_r, a_r + kp e + kd de/dt + ki integral(e))

    Positions and velocities are those of the reference: noise of encoders meets gains that are
    constant in time, and friction is that of the motion as it should be. All errors decay alike,
    with three equal poles, however the machine stands. After its end the last state is held.

    Args:
        model: the model, see `inverse_dynamics`.
        reference: a state for each sample, (N + 1, n_x); the last is an equilibrium.
        feedback: feedback about the last, of which limits and safe inputs are taken.
        limits: of inputs by name along the reference, instead of those that the model declares;
            the rest is for errors.

    Raises:
        InputError: another shape, a machine that is not fully driven, or a motion that the limits
            do not allow.

    References:
        Siciliano, Sciavicco, Villani, Oriolo (2009), Robotics, section 8.5: PD control with
        feedforward of the inverse dynamics.
    """
    required = inverse_dynamics(model)
    n, dt = model.channels.n_q, float(model.dt)
    x = checked_reference(reference, 2 * n, "computed torque")
    middle, a = _between(x, dt)

    def with_slope(point: Array) -> Array:
        state, rate = point[: 2 * n], point[2 * n :]
        slope = jax.jacfwd(lambda rate: required(state, rate))(rate)
        return jnp.concatenate([required(state, rate), slope.ravel()])

    formula = Formula(with_slope, 3 * n, where="the inverse dynamics")
    # the last row is the hold: at rest, where the reference ends
    points = np.concatenate([np.hstack([middle, a]), np.hstack([x[-1, :n], np.zeros(2 * n)])[None]])
    values = evaluate(formula, points)
    u, slopes = values[:, :n], values[:, n:].reshape(-1, n, n)
    bounds = input_limits(model, limits)
    beyond = np.max([u - bounds.upper, bounds.lower - u])
    if beyond > _SAME * np.max(bounds.upper - bounds.lower):
        raise InputError(
            "computed torque",
            f"inputs beyond their limits by {beyond:.3g}",
            "a motion that they allow",
            "a slower one",
        )
    # inputs that act two samples late cost 40 degrees, and joints of arms give at 60 to 150 rad/s
    pole = min(0.125 / dt, 20.0)
    own = AccelerationGains(3 * pole**2, 3 * pole, pole**3)
    gains = np.concatenate(
        [factor * slopes for factor in (own.proportional, own.derivative, own.integral)], axis=2
    )
    final = replace(feedback, gain=gains[-1], x0=x[-1], u0=u[-1], integral=tuple(range(n)), delay=0)
    plan = Plan(
        x=x,
        u=u[:-1],
        cost=0.0,
        converged=True,
        reached=True,
        iterations=0,
        dt=dt,
        goal=x[-1],
        before=u[0],
    )
    return Tracking(plan, gains[:-1], final, by_acceleration=own)


def _between(x: Any, dt: float) -> tuple[Any, Any]:
    """States halfway between samples, and the accelerations there, of a reference."""
    n = x.shape[1] // 2
    return (x[1:] + x[:-1]) / 2, np.diff(x[:, n:], axis=0) / dt


def smooth_motion(
    start: Float[np.ndarray, " n_q"], end: Float[np.ndarray, " n_q"], steps: int, dt: float
) -> Float[np.ndarray, "samples n_x"]:
    """States of the motion of least jerk from rest to rest, at each sample.

    Args:
        start: positions, (n_q,).
        end: positions, (n_q,).
        steps: how many periods it lasts.
        dt: the period [s].

    References:
        Flash, Hogan (1985), The coordination of arm movements, Journal of Neuroscience 5(7).
    """
    s = np.linspace(0.0, 1.0, steps + 1)[:, None]
    way = s**3 * (10 - 15 * s + 6 * s**2)
    speed = 30 * (s * (1 - s)) ** 2 / (steps * dt)
    return np.hstack([start + way * (end - start), speed * (end - start)])
