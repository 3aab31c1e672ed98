"""How far from its goal dry friction may hold a coordinate against linear feedback."""

import numpy as np

from tustinnet.control.dynamics import controlled
from tustinnet.control.equilibrium import tangent_of_held_inputs
from tustinnet.control.lqr import Feedback
from tustinnet.models.contract import Model

_SLOWER = 4  # speeds, each a quarter of the one before, by which dry friction is told
_SAME = 1.2  # times that of a slower motion: dry friction is the same at any speed


def sticking_distances(model: Model, feedback: Feedback, delay: int = 0) -> dict[str, float]:
    """The errors up to which feedback gives less than the dry friction, by coordinate.

    Models smooth dry friction, so that in their simulations a coordinate creeps on to its goal
    where that of a machine sticks. What is dry shows at the usual speeds for which the feedback was
    designed: the part of an acceleration that changes its sign with the velocity, and not its size.
    The machine rests wherever that of all coordinates together is as large as what restores them,
    as of two that a shaft joins.

    Args:
        model: the model.
        feedback: the feedback about an equilibrium.
        delay: samples from when a command is computed to when it acts.

    Returns:
        The distances [rad or m]; nothing of coordinates with integral action, or without usual
        speeds.
    """
    system, channels = controlled(model, delay), model.channels
    x, u, n_x = feedback.x0[: model.state_size], feedback.u0, model.state_size
    n_q, speeds = channels.n_q, np.asarray(feedback.speeds)
    states = np.arange(n_x)
    q, v, internal = (states[s] for s in (channels.position, channels.velocity, channels.internal))
    a, b = tangent_of_held_inputs(system, x, u, feedback.speeds)
    # internal states, as the lag of an actuator, have come to rest
    settled = a[np.ix_(v, internal)] @ np.linalg.pinv(
        np.eye(len(internal)) - a[np.ix_(internal, internal)]
    )
    effect = b[v] + settled @ b[internal]
    stiffness = a[np.ix_(v, q)] + settled @ a[np.ix_(internal, q)] - effect @ feedback.gain[:, q]
    dry = np.zeros((n_q, n_q))  # what dry friction at each coordinate is to all of them
    for j in np.flatnonzero(speeds > 0).tolist():

        def dry_part(speed: float, j: int = j) -> np.ndarray:
            """The part of all changes that has the sign of a velocity, and not its size."""
            at = np.tile(system.augment(x, u), (4, 1))
            at[:, v[j]] += speed * np.array([1.0, 2.0, -1.0, -2.0])
            changes = (system.steps(at, np.tile(u, (4, 1))) - at)[:, v]
            return np.array([2.0, -1.0, -2.0, 1.0]) @ changes / 2

        # of slower motions it is the same, unlike that of a servo's damping up to its largest force
        parts = [dry_part(speeds[j] / 4**k) for k in range(_SLOWER)]
        sizes = [float(np.linalg.norm(part)) for part in parts]
        same = (k for k in range(_SLOWER - 1) if sizes[k] <= _SAME * sizes[k + 1])
        dry[:, j] = parts[next(same, _SLOWER - 1)]
    farthest = np.abs(np.linalg.pinv(stiffness) @ dry).sum(axis=1)
    return {
        c.name: float(farthest[j])
        for j, c in enumerate(channels.coordinates)
        if speeds[j] > 0 and j not in feedback.integral
    }
