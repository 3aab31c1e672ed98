"""Model predictive control by iterative LQR, warm-started from sample to sample."""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from tustinnet.control.dynamics import (
    Limits,
    controlled,
    input_limits,
    require_vector,
    safe_inputs,
)
from tustinnet.control.ilqr import Motion, Solver, make_cost, next_damping, shift, turns_to
from tustinnet.control.lqr import gains_along, hold
from tustinnet.control.plan import Plan
from tustinnet.control.weights import Deviations, Weights
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.simulate.range import Range

_ALL = np.ones(1)


class Mpc:
    """A controller that plans some steps ahead at every sample, and applies the first input.

    Each plan begins with the better of two: the one before, shifted by a sample and corrected by
    its own feedback; and what linear feedback to the goal would do. It is improved by a fixed
    number of iterations of `ilqr`. Its end costs what linear feedback needs to hold the goal ever
    after. It can also follow a plan: the goal moves along it, then stays.

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
        safe: inputs by name while the estimator has lost the state, as in `lqr`.

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
        safe: Mapping[str, float] | None = None,
    ) -> None:
        if steps < 1 or iterations < 1:
            raise InputError("Mpc", f"{steps} steps, {iterations} iterations", "at least 1 of each")
        system, bounds = controlled(model, delay), input_limits(model, limits)
        x_end = require_vector(x, system.n_x, "Mpc, x")
        u_end = bounds.clip(require_vector(u, system.n_u, "Mpc, u"))
        if plan is not None:
            plan.require_for(system.n_x, system.n_u, system.dt, delay, "Mpc")
            x_end = x_end + turns_to(system, x_end, plan.goal)
        self._system, self._limits = system, bounds
        self._safe = safe_inputs(model, bounds, safe)
        self._steps, self._iterations = steps, iterations
        self._cost = make_cost(
            system, bounds, x_end, u_end, deviations=deviations, range=range, within=within
        )
        weights, value = Weights(self._cost.states, self._cost.inputs), self._cost.end
        held = hold(system, x_end, u_end, weights).gain
        # what is followed, and the feedback about it: along the plan, then at the goal
        goal = np.tile(system.augment(x_end, u_end), (steps + 1, 1))
        rest, gains, ends = np.tile(u_end, (steps, 1)), np.tile(held, (steps, 1, 1)), value[None]
        self._before = bounds.clip(np.zeros(system.n_u))
        if plan is not None:
            along, values = gains_along(system, plan, value, weights)
            past = plan.previous_inputs(system.previous)
            goal = np.concatenate([np.hstack([plan.x[:-1], past]), goal])
            rest, gains = np.concatenate([plan.u, rest]), np.concatenate([along, gains])
            ends, self._before = values, plan.before
        self._followed, self._gains, self._ends = Motion(goal, rest, np.inf), -gains, ends
        self._solver = Solver(system, bounds, self._cost)
        self.reset()
        # all machine code is made now, not at the first sample
        self.inputs(0, x_end)
        self.inputs(1, x_end)
        self.reset()

    def reset(self) -> None:
        """Forgets the plan of the last sample and previous commands."""
        self.motion: Motion | None = None
        self._gain, self._damping = self._gains[: self._steps], 0.0
        self._previous = np.tile(self._before, self._system.previous)

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,).

        Args:
            k: the sample, from 0 on.
            x: the estimated state, (n_x,).
        """
        if np.isfinite(x).all():
            command = self._plan(k, x)
        else:
            command, self.motion = self._safe, None
        self._previous = np.concatenate([command, self._previous])[: len(self._previous)]
        return command

    def _plan(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The first inputs of a new plan, (n_u,)."""
        solver, steps, n_x = self._solver, self._steps, self._system.n_x
        first = min(k, len(self._followed.u) - steps)
        z = self._followed.z[first : first + steps + 1]
        u = self._followed.u[first : first + steps]
        end = self._ends[min(first + steps, len(self._ends) - 1)]
        solver.cost = replace(self._cost, x=z[:, :n_x], u=u, end=end)
        near = x + turns_to(self._system, x, z[0, :n_x])
        start = np.concatenate([near, self._previous])
        kept = solver.without_feedback(steps)
        motion = solver.roll_out(
            start,
            Motion(z, u, np.inf),
            kept._replace(gain=self._gains[first : first + steps]),
            _ALL,
        )
        if self.motion is not None:
            # the plan of the last sample, turned as the state is: a step does not depend on turns
            states = shift(self.motion.z)
            states[:, :n_x] += turns_to(self._system, states[0, :n_x], near)
            shifted = solver.roll_out(
                start,
                Motion(states, shift(self.motion.u), np.inf),
                kept._replace(gain=shift(self._gain)),
                _ALL,
            )
            motion = min(motion, shifted, key=lambda each: each.cost)
        for _ in itertools.repeat(None, self._iterations):
            policy = solver.policy(motion, self._damping)
            better = solver.improve(motion, policy)
            self._damping = next_damping(self._damping, is_better=better is not None)
            motion, self._gain = better or motion, policy.gain
        self.motion = motion
        return motion.u[0].copy()
