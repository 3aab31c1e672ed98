"""Controllers by linear feedback: about an operating point, and along a plan."""

import numpy as np
from jaxtyping import Float

from tustinnet.control.lqr import Feedback, Tracking


def wrap(error: Float[np.ndarray, " n_x"], periodic: tuple[int, ...]) -> Float[np.ndarray, " n_x"]:
    """An error whose periodic angles are brought into -pi..pi."""
    wrapped = np.array(error, np.float64)
    for i in periodic:
        wrapped[i] = (wrapped[i] + np.pi) % (2 * np.pi) - np.pi
    return wrapped


class LinearFeedback:
    """A controller by linear feedback about an operating point.

    Args:
        feedback: the feedback.
    """

    def __init__(self, feedback: Feedback) -> None:
        self.feedback = feedback
        self.reset()

    def reset(self, previous: Float[np.ndarray, " previous"] | None = None) -> None:
        """Sets integrals to 0, and previous commands, the latest first; by default to `u0`."""
        feedback = self.feedback
        self._integral = np.zeros(len(feedback.integral))
        rest = np.tile(feedback.u0, feedback.previous)
        self._previous = rest if previous is None else np.array(previous, np.float64)
        self._rest = rest

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,)."""
        feedback = self.feedback
        error = wrap(x - feedback.x0, feedback.periodic)
        z = np.concatenate([error, self._integral, self._previous - self._rest])
        wanted = feedback.u0 - feedback.gain @ z
        command = np.clip(wanted, feedback.lower, feedback.upper)
        if np.array_equal(command, wanted):
            self._integral = self._integral + feedback.dt * error[list(feedback.integral)]
        self._previous = np.concatenate([command, self._previous])[: len(self._rest)]
        return command


class TrackingFeedback:
    """A controller that follows a plan by time-varying feedback, then holds its end.

    Args:
        tracking: the plan, its gains and the feedback that holds the end.
    """

    def __init__(self, tracking: Tracking) -> None:
        self.tracking = tracking
        self._balance = LinearFeedback(tracking.final)
        # as long as z is; of steps without previous commands (N, 0)
        self._reference = tracking.plan.previous_inputs(tracking.final.previous)
        self.reset()

    def reset(self) -> None:
        """Forgets the commands and integrals of an earlier run."""
        self._previous = np.tile(self.tracking.plan.before, self.tracking.final.previous)

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,)."""
        plan, final = self.tracking.plan, self.tracking.final
        if k >= len(plan.u):
            if k == len(plan.u):
                self._balance.reset(self._previous)
            return self._balance.inputs(k, x)
        error = wrap(x - plan.x[k], final.periodic)
        z = np.concatenate([error, self._previous - self._reference[k]])
        command = np.clip(plan.u[k] - self.tracking.gains[k] @ z, final.lower, final.upper)
        self._previous = np.concatenate([command, self._previous])[: len(self._previous)]
        return command
