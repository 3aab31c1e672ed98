"""Controllers by linear feedback: about an operating point, and along a plan."""

from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from tustinnet.control.lqr import Feedback, Tracking, wrap

Phase = Literal["plan", "hold", "settle"]


class LinearFeedback:
    """A controller by linear feedback about an operating point.

    Args:
        feedback: the feedback.
    """

    def __init__(self, feedback: Feedback) -> None:
        self.feedback = feedback
        self.reset()

    def reset(
        self,
        previous: Float[np.ndarray, " previous"] | None = None,
        integral: Float[np.ndarray, " integrals"] | None = None,
    ) -> None:
        """Sets integrals, by default to 0, and previous commands, the latest first, to `u0`."""
        feedback = self.feedback
        self._integral = np.zeros(len(feedback.integral)) if integral is None else integral
        rest = np.tile(feedback.u0, feedback.previous)
        self._previous = rest if previous is None else np.array(previous, np.float64)
        self._rest = rest

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,)."""
        feedback = self.feedback
        error = wrap(x - feedback.x0, feedback.periodic)
        z = np.concatenate([error, self._integral, self._previous - self._rest])
        unlimited = feedback.u0 - feedback.gain @ z
        command = feedback.command(unlimited)
        if np.array_equal(command, unlimited):
            self._integral = self._integral + feedback.dt * error[list(feedback.integral)]
        self._previous = np.concatenate([command, self._previous])[: len(self._rest)]
        return command

    def correct(self, command: Float[np.ndarray, " n_u"]) -> None:
        """Remembers that other inputs were commanded at the last sample."""
        self._previous = replace_latest(self._previous, command)


class TrackingFeedback:
    """A controller that follows a plan by time-varying feedback, then holds its end.

    With a `Recovery` it begins again after a fall: plan, hold, and when the state has fallen,
    settle about the plan's start, then plan again. While the state is lost a plan waits, or begins
    again if it can.

    Args:
        tracking: the plan, its gains, the feedback that holds the end, and the recovery.

    Attributes:
        phase: `plan`, `hold` or `settle`, of the last sample.
        step: the step of the plan at the last sample; after its end, and while the motion settles,
            how many there are.
        previous: the commands before the next sample, the latest first.
    """

    phase: Phase

    def __init__(self, tracking: Tracking) -> None:
        self.tracking = tracking
        recovery = tracking.recovery
        self._hold = LinearFeedback(tracking.final)
        settle = tracking.final if recovery is None else recovery.feedback
        self._settle = LinearFeedback(replace(settle, safe=tracking.final.safe))
        # as long as z is; of steps without previous commands (N, 0)
        self._reference = tracking.plan.previous_inputs(tracking.final.previous)
        self.reset()

    def reset(self) -> None:
        """Forgets the commands and integrals of an earlier run, and begins with the plan."""
        self.previous = np.tile(self.tracking.plan.before, self.tracking.final.previous)
        self._integral = np.zeros(len(self.tracking.integral))
        self.phase, self._begin, self.step = "plan", 0, 0

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,)."""
        self._choose_phase(k, x)
        plan, final = self.tracking.plan, self.tracking.final
        self.step = step = k - self._begin if self.phase == "plan" else len(plan.u)
        if self.phase == "hold":
            command = self._hold.inputs(k, x)
        elif self.phase == "settle":
            command = self._settle.inputs(k, x)
        else:
            error = wrap(x - plan.x[step], final.periodic)
            z = np.concatenate([error, self._integral, self.previous - self._reference[step]])
            unlimited = plan.u[step] - self.tracking.gains[step] @ z
            command = final.command(unlimited)
            if np.array_equal(command, unlimited):
                own = error[list(self.tracking.integral)]
                self._integral = self._integral + final.dt * own
            self._begin += not np.isfinite(x).all()  # the plan waits
        self.previous = np.concatenate([command, self.previous])[: len(self.previous)]
        return command

    def correct(self, command: Float[np.ndarray, " n_u"]) -> None:
        """Remembers that other inputs were commanded at the last sample."""
        self.previous = replace_latest(self.previous, command)
        self._hold.correct(command)

    def _choose_phase(self, k: int, x: Float[np.ndarray, " n_x"]) -> None:
        """Goes on to the next phase where that is due at a sample."""
        plan, final, recovery = self.tracking.plan, self.tracking.final, self.tracking.recovery
        if self.phase == "plan" and k - self._begin >= len(plan.u):
            self.phase = "hold"
            self._hold.reset(self.previous, self._integral if self.tracking.integral else None)
        if recovery is None:
            return
        # after a while without a state the device is somewhere else
        is_off = self.phase == "plan" and not np.isfinite(x).all()
        if self.phase == "hold":
            fallen, error = recovery.fallen_beyond, wrap(x - final.x0, final.periodic)
            is_off = ((fallen > 0) & (np.abs(error) > fallen)).any()
        if is_off:
            self.phase = "settle"
            self._settle.reset(self.previous)
        if self.phase == "settle":
            near, error = recovery.settled_within, wrap(x - plan.x[0], final.periodic)
            if ((near == 0) | (np.abs(error) <= near)).all():
                self.phase, self._begin = "plan", k


def feedback_controller(gains: Feedback | Tracking) -> LinearFeedback | TrackingFeedback:
    """A controller by feedback about a point, or along a plan."""
    return TrackingFeedback(gains) if isinstance(gains, Tracking) else LinearFeedback(gains)


def replace_latest(
    previous: Float[np.ndarray, " previous"], command: Float[np.ndarray, " n_u"]
) -> Float[np.ndarray, " previous"]:
    """Previous commands with another one as the latest; none where there are none."""
    return np.concatenate([command, previous[len(command) :]])[: len(previous)]
