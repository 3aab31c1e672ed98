"""How far from its goal dry friction may hold a coordinate against linear feedback."""

import numpy as np

from tustinnet.control.dynamics import controlled
from tustinnet.control.equilibrium import tangent_of_held_inputs
from tustinnet.control.lqr import Feedback
from tustinnet.models.contract import Model


def sticking_distances(model: Model, feedback: Feedback, delay: int = 0) -> dict[str, float]:
    """The errors up to which feedback gives less than the dry friction, by coordinate.

    Models smooth dry friction, so that in their simulations a coordinate creeps on to its goal
    where that of a machine sticks. What is dry shows at the usual speeds for which the feedback was
    designed: the part of an acceleration that changes its sign with the velocity, and not its size.

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
    internal = np.arange(channels.measured.stop, n_x)
    a, b = tangent_of_held_inputs(system, x, u, feedback.speeds)
    # internal states, as the lag of an actuator, have come to rest
    settled = np.linalg.pinv(np.eye(len(internal)) - a[np.ix_(internal, internal)]) @ b[internal]
    effect = b + a[:, internal] @ settled
    distances = {}
    for j, (c, speed) in enumerate(zip(channels.coordinates, feedback.speeds, strict=True)):
        v = channels.n_q + j
        if speed <= 0 or j in feedback.integral:
            continue
        at = np.tile(system.augment(x, u), (4, 1))
        at[:, v] += speed * np.array([1.0, 2.0, -1.0, -2.0])
        changes = (system.steps(at, np.tile(u, (4, 1))) - at)[:, v]
        dry = abs(changes @ np.array([2.0, -1.0, -2.0, 1.0])) / 2
        restoring = abs(effect[v] @ feedback.gain[:, j])
        if restoring > 0:
            distances[c.name] = float(dry / restoring)
    return distances
