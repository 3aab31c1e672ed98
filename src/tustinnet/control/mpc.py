"""Model predictive control by iterative LQR, warm-started from sample to sample."""

import itertools
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tustinnet.control.controller import Controller
from tustinnet.control.controllers import TrackingFeedback, feedback_controller
from tustinnet.control.dynamics import InputLimits, Limits, controlled
from tustinnet.control.ilqr import SHARES, Motion, Solver, make_cost, shift, turns_to
from tustinnet.control.lqr import Feedback, Tracking, as_tracking, gains_along, wrap
from tustinnet.control.weights import Deviations, Weights
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.simulate.range import Range

LONGEST = 100  # steps ahead: a microcontroller keeps their states, inputs and gains
# by which the cost may grow, as a share of it: near the minimum all that is left is rounding
ROUNDING = 1e-12

_WHOLE = np.ones(1)


class Mpc:
    """A controller that plans some steps ahead at every sample, and applies the first inputs.

    Each plan begins with the better of two: the one before, shifted by a sample and corrected by
    its own feedback; and what given feedback would do. A fixed number of iterations of `ilqr`
    improves it. Its end costs what linear feedback needs to hold the goal ever after. With a
    motion, the goal moves along it, and stays at its end. Inputs are those of the given feedback
    where the state is lost, where the motion settles after a fall, and where every plan diverges.
    An export in C computes the same.

    Args:
        model: a model that steps from sample to sample.
        gains: feedback about the goal (`lqr`), or along a motion to it (`time_varying_lqr`). It
            has the goal, the limits of the inputs, the delay and the safe inputs.
        steps: how many steps it plans ahead, 1 to 100.
        iterations: iterations at every sample.
        deviations: acceptable deviations of states and inputs by name, those of the feedback.
        range: the range of the training records.
        within: limits of states by name. What is beyond costs as in `ilqr`: they are exceeded a
            little where that spares much, and more where the inputs cannot help it.

    Attributes:
        gains: the feedback.
        final: the feedback about the goal.
        steps: how many steps it plans ahead.
        iterations: iterations at every sample.
        cost: what a plan costs, without its end where a motion is followed.
        ends: matrices of the end's cost, at every sample of the motion and after it,
            (N + 1, n_z, n_z); (1, n_z, n_z) without a motion.
        goal: the goal with the whole turns of the motion, (n_x,).
        motion: the motion that was planned at the last sample, None where there was none.

    Raises:
        InputError: no step, or more than 100; feedback with integrals, which plans do not have;
            names that the model does not have, a plan of another model, period or delay.

    References:
        Tassa, Mansard and Todorov (2014), Control-limited differential dynamic programming, ICRA;
        Diehl, Bock and Schlöder (2005), A real-time iteration scheme, SIAM J. Control Optim. 43(5).
    """

    def __init__(
        self,
        model: Model,
        gains: Feedback | Tracking,
        *,
        steps: int = 40,
        iterations: int = 1,
        deviations: Deviations | None = None,
        range: Range | None = None,
        within: Limits | None = None,
    ) -> None:
        if not 1 <= steps <= LONGEST or iterations < 1:
            raise InputError(
                "Mpc",
                f"{steps} steps, {iterations} iterations",
                f"1 to {LONGEST} steps, at least 1 iteration",
            )
        tracking = as_tracking(gains)
        plan, final = tracking.plan, tracking.final
        if final.integral:
            raise InputError(
                "Mpc", "feedback with integrals", "one without", "a plan has no integrals"
            )
        system = controlled(model, final.delay)
        plan.require_for(system.n_x, system.n_u, system.dt, final.delay, "Mpc")
        self.gains, self.final, self.steps, self.iterations = gains, final, steps, iterations
        self.goal = final.x0 + turns_to(system, final.x0, plan.goal)
        limits = InputLimits(final.lower, final.upper)
        self.cost, _ = make_cost(
            system,
            limits,
            self.goal,
            final.u0,
            deviations=deviations,
            range=range,
            within=within,
        )
        self.ends = self.cost.end[None]
        if len(plan.u):
            weights = Weights(self.cost.states, self.cost.inputs)
            _, self.ends = gains_along(system, plan, self.cost.end, weights)
        # what is followed, and the feedback about it: along the motion, then at the goal
        along = np.hstack([plan.x[:-1], plan.previous_inputs(system.previous)])
        self._z = np.concatenate([along, system.augment(self.goal, final.u0)[None]])
        self._u = np.concatenate([plan.u, final.u0[None]])
        self._about = -np.concatenate([tracking.gains, final.gain[None]])
        self._feedback = TrackingFeedback(tracking)
        self._solver = Solver(system, limits, self.cost)
        self.reset()
        # all machine code is made now, not at the first sample
        self.inputs(0, plan.x[0])
        self.inputs(1, plan.x[0])
        self.reset()

    def reset(self) -> None:
        """Forgets the plan of the last sample and previous commands."""
        self._feedback.reset()
        self.motion: Motion | None = None

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,).

        Args:
            k: the sample, from 0 on.
            x: the estimated state, (n_x,).
        """
        previous = self._feedback.previous
        command = self._feedback.inputs(k, x)
        self.motion = (
            self._plan(self._feedback.step, x, previous)
            if np.isfinite(x).all() and self._feedback.phase != "settle"
            else None
        )
        if self.motion is None:
            return command
        command = self.motion.u[0].copy()
        self._feedback.correct(command)
        return command

    def _plan(
        self, step: int, x: Float[np.ndarray, " n_x"], previous: Float[np.ndarray, " previous"]
    ) -> Motion | None:
        """A new plan, None where all motions diverge.

        Args:
            step: of the motion that is followed.
            x: the state, (n_x,).
            previous: the commands before, the latest first.
        """
        solver, n_x = self._solver, len(x)
        at = np.minimum(step + np.arange(self.steps + 1), len(self._u) - 1)
        z, u, gain = self._z[at], self._u[at[:-1]], self._about[at[:-1]]
        solver.cost = replace(self.cost, x=z[:, :n_x], u=u, end=self.ends[at[-1]])
        periodic = solver.system.periodic
        start = np.concatenate([z[0, :n_x] + wrap(x - z[0, :n_x], periodic), previous])
        kept = solver.without_feedback(self.steps)
        motion = solver.roll_out(start, Motion(z, u, np.inf), kept._replace(gain=gain), _WHOLE)
        if self.motion is not None:
            # the plan of the last sample, turned as the state is: a step does not depend on turns
            states, own = shift(self.motion.z), shift(self._gain)
            error = start[:n_x] - states[0, :n_x]
            states[:, :n_x] += error - wrap(error, periodic)
            before = Motion(states, shift(self.motion.u), np.inf)
            shifted = solver.roll_out(start, before, kept._replace(gain=own), _WHOLE)
            motion = min(motion, shifted, key=lambda each: each.cost)
        if not np.isfinite(motion.cost):
            return None
        for _ in itertools.repeat(None, self.iterations):
            policy = solver.policy(motion, 0.0)
            most, self._gain = motion.cost * (1 + ROUNDING), policy.gain
            tries = (solver.roll_out(start, motion, policy, s * _WHOLE) for s in SHARES)
            motion = next((better for better in tries if better.cost <= most), motion)
        return motion


def make_controller(designed: Feedback | Tracking | Mpc) -> Controller:
    """A controller in Python: a new one by feedback, predictive control itself."""
    return designed if isinstance(designed, Mpc) else feedback_controller(designed)
