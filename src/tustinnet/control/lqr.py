"""Linear-quadratic feedback: about an operating point, and along a plan."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.control.ilqr import Plan


@dataclass(frozen=True, kw_only=True)
class Feedback:
    """Linear feedback about an operating point, `u = u0 - gain z`, within the input limits.

    `z` has the errors of the states `x - x0`, then the integrals of the errors [s times their
    units] of the coordinates in `integral`, then the previous inputs as differences from `u0`, the
    latest first. There are previous inputs where inputs act late, and where a step of the model
    depends on inputs before its sample.

    Attributes:
        gain: (n_u, n_z).
        x0: the state of the operating point, (n_x,).
        u0: the inputs there, (n_u,).
        lower: lower limits of the inputs, (n_u,).
        upper: upper limits of the inputs, (n_u,).
        dt: sampling period [s].
        integral: indices of the coordinates with integral action.
        delay: samples from when an input is computed to when it acts.
        periodic: indices of the angles whose errors are wrapped into -pi..pi: those that the model
            does not change by whole turns.
    """

    gain: Float[np.ndarray, "n_u n_z"]
    x0: Float[np.ndarray, " n_x"]
    u0: Float[np.ndarray, " n_u"]
    lower: Float[np.ndarray, " n_u"]
    upper: Float[np.ndarray, " n_u"]
    dt: float
    integral: tuple[int, ...] = ()
    delay: int = 0
    periodic: tuple[int, ...] = ()


@dataclass(frozen=True)
class Tracking:
    """Time-varying feedback along a plan, and the feedback that holds its end.

    Attributes:
        plan: the plan.
        gains: gains at every step, (N, n_u, n_z): `u = plan.u[k] - gains[k] z`, `z` as in
            `Feedback`, errors and previous inputs counted from the plan.
        final: the feedback after the last step.
    """

    plan: Plan
    gains: Float[np.ndarray, "N n_u n_z"]
    final: Feedback
