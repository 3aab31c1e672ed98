"""Model predictive control by iterative LQR, warm-started from sample to sample."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from tustinnet.control.cost import Cost
from tustinnet.control.dynamics import Limits, controlled, input_limits, require_vector
from tustinnet.control.ilqr import Motion, Solver, make_cost, shift, turns_to
from tustinnet.control.lqr import gains_along
from tustinnet.control.plan import Plan
from tustinnet.control.weights import Deviations, Weights
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.simulate.range import Range


class Mpc:
    """A controller that plans some steps ahead at every sample, and applies the first input.

    Each plan begins with the one before, shifted by a sample and corrected by its own feedback, and
    is improved by a fixed number of iterations of `ilqr`. Its end costs what linear feedback needs
    to hold the goal ever after. It can also follow a plan: the goal moves along it, then stays.

    Args:
        model: a model that steps from sample to sample.
        x: the goal, (n_x,), an equilibrium.
        u: the inputs that hold it, (n_u,).
        steps: how many steps it plans ahead.
        iterations: iterations at every sample.
        plan: a plan that leads to the goal, to be followed first.
        deviations: acceptable deviations of states and inputs by name, as in `lqr`.
        range: the range of the training records.
        within: limits of states by name, as in `ilqr`.
        limits: limits of inputs by name, instead of those that the model declares.
        delay: samples from when an input is computed to when it acts.

    Attributes:
        motion: the motion that was planned at the last sample, None before the first.

    Raises:
        InputError: an input without limits, other shapes, names that the model does not have, a
            goal that no feedback can hold, a plan of another model, period or delay.
    """

    def __init__(
        self,
        model: Model,
        x: ArrayLike,
        u: ArrayLike,
        *,
        steps: int = 40,
        iterations: int = 1,
        plan: Plan | None = None,
        deviations: Deviations | None = None,
        range: Range | None = None,
        within: Limits | None = None,
        limits: Limits | None = None,
        delay: int = 0,
    ) -> None:
        if steps < 1 or iterations < 1:
            raise InputError("Mpc", f"{steps} steps, {iterations} iterations", "at least 1 of each")
        system, bounds = controlled(model, delay), input_limits(model, limits)
        x_end = require_vector(x, system.n_x, "Mpc, x")
        u_end = bounds.clip(require_vector(u, system.n_u, "Mpc, u"))
        if plan is not None:
            plan.require_for(system.n_x, system.n_u, system.dt, delay, "Mpc")
            x_end = x_end + turns_to(system, x_end, plan.goal)
        self._system, self._limits, self._plan = system, bounds, plan
        self._steps, self._iterations = steps, iterations
        self._cost = make_cost(
            system, bounds, x_end, u_end, deviations=deviations, range=range, within=within
        )
        if plan is not None:
            weights = Weights(self._cost.states, self._cost.inputs)
            self._ends = gains_along(system, plan, self._cost.end, weights)[1]
        self._solver = Solver(system, bounds, self._cost)
        self.reset()
        # all machine code is made now, not at the first sample
        self.inputs(0, x_end)
        self.reset()

    def reset(self) -> None:
        """Forgets the plan of the last sample and previous commands."""
        self.motion: Motion | None = None
        self._gain = np.zeros((self._steps, self._system.n_u, self._system.size))
        before = self._limits.clip(np.zeros(self._system.n_u))
        if self._plan is not None:
            before = self._plan.before
        self._previous = np.tile(before, self._system.previous)

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,).

        Args:
            k: the sample, from 0 on.
            x: the estimated state, (n_x,).
        """
        solver = self._solver
        solver.cost = self._cost_at(k)
        target = solver.cost.x if solver.cost.x.ndim == 1 else solver.cost.x[0]
        near = x + turns_to(self._system, x, target)
        start = np.concatenate([near, self._previous])
        if self.motion is None:
            u = np.broadcast_to(solver.cost.u, (self._steps, self._system.n_u))
            motion = solver.begin(start, np.array(u))
        else:
            # the plan of the last sample, turned as the state is: a step does not depend on turns
            states = shift(self.motion.z)
            states[:, : len(x)] += turns_to(self._system, states[0, : len(x)], near)
            reference = Motion(states, shift(self.motion.u), np.inf)
            kept = solver.without_feedback(self._steps)._replace(gain=shift(self._gain))
            motion = solver.roll_out(start, reference, kept, np.ones(1))
        for _ in range(self._iterations):
            policy = solver.policy(motion, 0.0)
            better = solver.improve(motion, policy)
            motion, self._gain = better or motion, policy.gain
        self.motion = motion
        command = motion.u[0].copy()
        self._previous = np.concatenate([command, self._previous])[: len(self._previous)]
        return command

    def _cost_at(self, k: int) -> Cost:
        """The cost of the steps from sample k on."""
        if self._plan is None or k >= len(self._plan.u):
            return self._cost
        x, u = self._plan.x[k : k + self._steps + 1], self._plan.u[k : k + self._steps]
        missing = self._steps - len(u)
        if missing:
            # beyond the plan's end the goal; the sample at its end is the goal, too
            x = np.concatenate([x[:-1], np.tile(self._cost.x, (missing + 1, 1))])
            u = np.concatenate([u, np.tile(self._cost.u, (missing, 1))])
        return replace(
            self._cost, x=x, u=u, end=self._ends[min(k + self._steps, len(self._ends) - 1)]
        )
