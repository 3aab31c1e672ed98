"""A controller in the loop: a system whose inputs are the set points of the controller."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels, PDController, PDLoop
from tustinnet.errors import InputError
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.internal_states import Memory, Values
from tustinnet.models.lagrangian import (
    FeedbackLaw,
    LagrangianSystem,
    Parameter,
    solve_positive,
)

_LEAST_RIDGE = 1e-12  # of the forces by the inputs, where several inputs do the same


def gain_name(loop: PDLoop, gain: str) -> str:
    """The name of the parameter of a gain: `elbow.kp`."""
    return f"{loop.coordinate}.{gain}"


@dataclass(frozen=True)
class PDFeedback(FeedbackLaw):
    """Proportional, integral and derivative feedback to set points, with a filter and a delay.

    Sampled controllers compute at each sample: what they remember changes from one to the next as
    if at constant rates, so that it is simulated with everything else.

    Attributes are those of `FeedbackLaw`. The channels have a sampling period where there are
    internal states: of each loop the integral, the filtered velocity, and what is still to act.
    """

    @property
    def controller(self) -> PDController:
        """The controller."""
        assert self.channels.controller is not None
        return self.channels.controller

    @property
    def size(self) -> int:
        """Number of inputs that are computed."""
        return len(self.controller.loops)

    @property
    def memory(self) -> Memory:
        """Its internal states, which are searched for where a record begins."""
        return Memory(
            self.states,
            lambda q, v, s, w, p: self.compute(q, v, s, w, p)[self.size :],
            initial=self.initial if self.states else None,
            spread=self.spread if self.states else None,
            searched=self.states,
        )

    def computed_inputs(self, q: Any, v: Any, s: Any, w: Any, p: Values) -> Float[Array, " n_u"]:
        """Inputs of the system, by the arguments of `compute`."""
        return self.plant_inputs(self.compute(q, v, s, w, p)[: self.size], w)

    def compute(self, q: Any, v: Any, s: Any, w: Any, p: Values) -> Float[Array, " computed"]:
        """The inputs of the system that are computed, then the rates of the internal states.

        Args:
            q: positions.
            v: velocities.
            s: internal states, (n_s,).
            w: inputs of the closed loop, (n_w,).
            p: values of the parameters by name.
        """
        acting, rates, remaining = [], [], list(s)
        for loop in self.controller.loops:
            error, rate, speed, extra = self._signals(loop, q, v, w)
            integral = remaining.pop(0) if "ki" in loop.gains else None
            slowing = None
            if loop.velocity_filter:
                speed, slowing = self._filter(loop, speed, remaining.pop(0))
            u = _without_integral(loop, error, rate - speed, extra, p)
            limits = self._limits(loop)
            if integral is not None:
                u, growth = u + integral, p[gain_name(loop, "ki")] * error
                if limits:
                    low, high = limits
                    is_stopped = ((u >= high) & (growth > 0)) | ((u <= low) & (growth < 0))
                    growth = jnp.where(is_stopped, 0.0, growth)
                rates.append(growth)
            if slowing is not None:
                rates.append(slowing)
            if limits:
                u = jnp.clip(u, *limits)
            for _ in range(loop.delay):
                later = remaining.pop(0)
                rates.append((u - later) / self.channels.dt)
                u = later
            acting.append(u)
        return jnp.stack([*acting, *(jnp.asarray(rate, q.dtype) for rate in rates)])

    def _filter(self, loop: PDLoop, speed: Any, before: Any) -> tuple[Any, Any]:
        """The filtered velocity that a loop uses, and the rate of the state that has it."""
        if not self.is_sampled:
            return before, (speed - before) / loop.velocity_filter
        period = self.channels.dt
        change = -np.expm1(-period / loop.velocity_filter) * (speed - before)
        return before + change, change / period

    def initial(self, q: Any, v: Any, w: Any, p: Values) -> Float[Array, " n_s"]:
        """The internal states where a record begins: those with which nothing is accelerated."""
        measured = self.channels.position
        q, v, states = q[measured], v[measured], []
        has_integrals = any("ki" in loop.gains for loop in self.controller.loops)
        holding = self._holding_inputs(q, v, w, p) if has_integrals else None
        for k, loop in enumerate(self.controller.loops):
            error, rate, speed, extra = self._signals(loop, q, v, w)
            u = _without_integral(loop, error, rate - speed, extra, p)
            if "ki" in loop.gains:
                assert holding is not None
                states.append(holding[k] - u)
                u = holding[k]
            if loop.velocity_filter:
                states.append(speed)
            limits = self._limits(loop)
            states += [jnp.clip(u, *limits) if limits else u] * loop.delay
        return jnp.stack(states)

    def spread(self, p: Values) -> Float[Array, " n_s"]:
        """Standard deviations of the internal states: of forces, what a deviation of 1 causes."""
        spreads: list[Any] = []
        for loop in self.controller.loops:
            force = jnp.maximum(p[gain_name(loop, "kp")], 1e-9)
            spreads += [force] if "ki" in loop.gains else []
            spreads += [1.0] if loop.velocity_filter else []
            spreads += [force] * loop.delay
        return jnp.stack([jnp.asarray(x) for x in spreads])

    def _signals(self, loop: PDLoop, q: Any, v: Any, w: Any) -> tuple[Any, Any, Any, Any]:
        """Deviation, set point of the velocity, velocity, and feed-forward or None of a loop."""
        j = [c.name for c in self.channels.coordinates].index(loop.coordinate)
        names = [i.name for i in self.channels.inputs]
        rate = w[names.index(loop.velocity)] if loop.velocity else 0.0
        extra = w[names.index(loop.feedforward)] if loop.feedforward else None
        return w[names.index(loop.position)] - q[j], rate, v[j], extra

    def _limits(self, loop: PDLoop) -> tuple[float, float] | None:
        """The limits of the input that a loop computes."""
        return next(i.limits for i in self.controller.inputs if i.name == loop.input)

    def _holding_inputs(self, q: Any, v: Any, w: Any, p: Values) -> Float[Array, " loops"]:
        """Computed inputs with which the system is not accelerated, in least squares."""
        model = rigid_system(self.plant).model(p)

        def force(outputs: Any) -> Any:
            u = self.plant_inputs(outputs, w)
            z = model.balanced_internal(q, v, u)
            return model.applied(q, v, z, u) + model.conservative(q, v)

        none = jnp.zeros(self.size, q.dtype)
        rest, by_output = force(none), jax.jacfwd(force)(none)
        square = by_output.T @ by_output
        ridge = _LEAST_RIDGE * jnp.trace(square) + jnp.finfo(q.dtype).tiny
        return -solve_positive(square + ridge * jnp.eye(self.size), by_output.T @ rest)

    def plant_inputs(self, outputs: Any, w: Any) -> Float[Array, " n_u"]:
        """Inputs of the system, computed ones and others.

        Args:
            outputs: those that are computed, (loops,).
            w: inputs of the closed loop, (n_w,), others of the system among them.
        """
        computed = {loop.input: k for k, loop in enumerate(self.controller.loops)}
        names = [i.name for i in self.channels.inputs]
        return jnp.stack(
            [
                outputs[computed[i.name]] if i.name in computed else w[names.index(i.name)]
                for i in self.controller.inputs
            ]
        )


@lru_cache(maxsize=64)  # so that the same system serves the same compiled programs
def with_controller(
    plant: LagrangianSystem, channels: Channels, gains: tuple[Parameter, ...]
) -> LagrangianSystem:
    """The system with a controller in the loop, and the controller's gains among its parameters.

    Its inputs are the set points. A controller whose set points are held from sample to sample
    (`zero-order`) computes at each sample what it holds until the next; other ones compute all the
    time.

    Args:
        plant: the system, in the coordinates and inputs of the controller.
        channels: channels of records, with their controller; without one the system is returned.
        gains: the gains, `COORDINATE.kp`, `COORDINATE.kd` of each loop, and `COORDINATE.ki` of one
            with an integral.

    Raises:
        InputError: a parameter that the system has already.
    """
    controller = channels.controller
    if controller is None:
        return plant
    if twice := sorted({p.name for p in gains} & {p.name for p in plant.parameters}):
        raise InputError(
            f"system '{plant.name}'",
            f"a parameter '{twice[0]}', as the controller has a gain",
            "another name",
        )
    set_points = {name for loop in controller.loops for name in loop.set_points}
    holds = {i.hold for i in channels.inputs if i.name in set_points}
    states = tuple(name for loop in controller.loops for name in _loop_states(loop))
    feedback = PDFeedback(
        plant, channels if states else replace(channels, dt=0.0), holds == {"zero-order"}, states
    )
    memory, unmeasured = feedback.memory, plant.unmeasured

    def initial_unmeasured(q: Any, v: Any, w: Any, p: Values) -> Any:
        assert unmeasured is not None
        u = feedback.computed_inputs(q, v, memory.compute_initial(q, v, w, p), w, p)
        return unmeasured.initial_states(q, v, u, p)

    return replace(
        plant,
        inputs=channels.inputs,
        parameters=(*plant.parameters, *gains),
        feedback=feedback,
        unmeasured=unmeasured and replace(unmeasured, initial=initial_unmeasured),
        **plant.inside(memory, feedback.computed_inputs),
    )


def _without_integral(loop: PDLoop, error: Any, rate_error: Any, extra: Any, p: Values) -> Any:
    """The input that a loop computes by deviations of position and velocity, and feed-forward."""
    u = p[gain_name(loop, "kp")] * error + p[gain_name(loop, "kd")] * rate_error
    return u if extra is None else u + extra


def _loop_states(loop: PDLoop) -> list[str]:
    """Names of the internal states of a loop."""
    states = [f"{loop.coordinate}.integral"] if "ki" in loop.gains else []
    if loop.velocity_filter:
        states.append(f"{loop.coordinate}.filtered_velocity")
    return [*states, *(f"{loop.input}.delayed{k + 1}" for k in range(loop.delay))]


def with_changed_plant(
    system: LagrangianSystem, change: Callable[[LagrangianSystem], LagrangianSystem]
) -> LagrangianSystem:
    """A closed loop of which only the system inside is changed; any other system is changed itself.

    Args:
        system: the system.
        change: the function that changes a system without a controller.
    """
    if system.feedback is None:
        return change(system)
    return with_controller(change(system.plant), system.feedback.channels, _gains_of(system))


def without_controller_states(system: LagrangianSystem) -> LagrangianSystem:
    """A closed loop whose controller remembers nothing: without integrals, filters and delays.

    Its parameters stay. Any other system is returned as it is.

    Args:
        system: the system.
    """
    feedback = system.feedback
    if feedback is None or not feedback.states:
        return system
    controller = feedback.channels.controller
    assert controller is not None
    loops = (replace(x, ki=0.0, velocity_filter=0.0, delay=0) for x in controller.loops)
    channels = replace(feedback.channels, controller=replace(controller, loops=tuple(loops)))
    return with_controller(system.plant, channels, _gains_of(system))


def _gains_of(system: LagrangianSystem) -> tuple[Parameter, ...]:
    """The gains among the parameters of a closed loop."""
    own = {p.name for p in system.plant.parameters}
    return tuple(p for p in system.parameters if p.name not in own)
