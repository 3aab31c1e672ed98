"""What a controller in the loop computes: feedback to set points, and what it remembers."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels, PDController, PDLoop
from tustinnet.models.internal_states import Values


def gain_name(loop: PDLoop, gain: str) -> str:
    """The name of the parameter of a gain: `elbow.kp`."""
    return f"{loop.coordinate}.{gain}"


@dataclass(frozen=True)
class PDFeedback:
    """Proportional, integral and derivative feedback to set points, with a filter and a delay.

    Sampled controllers compute at each sample: what they remember changes from one to the next as
    if at constant rates, so that it is simulated with everything else.

    Attributes:
        channels: coordinates and inputs of the closed loop, with the controller, and a sampling
            period where there are internal states.
        is_sampled: whether what it computes at a sample is held until the next.
    """

    channels: Channels
    is_sampled: bool

    @property
    def controller(self) -> PDController:
        """The controller."""
        assert self.channels.controller is not None
        return self.channels.controller

    @property
    def size(self) -> int:
        """Number of inputs that are computed."""
        return len(self.controller.loops)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Internal states: of each loop the integral, the filtered velocity, what is to act."""
        names: list[str] = []
        for loop in self.controller.loops:
            names += [f"{loop.coordinate}.integral"] if "ki" in loop.gains else []
            names += [f"{loop.coordinate}.filtered_velocity"] if loop.velocity_filter else []
            names += [f"{loop.input}.delayed{k + 1}" for k in range(loop.delay)]
        return tuple(names)

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

    def initial(self, q: Any, v: Any, w: Any, p: Values, holding: Any) -> Float[Array, " n_s"]:
        """The internal states where a record begins.

        Args:
            q: positions.
            v: velocities.
            w: inputs of the closed loop, (n_w,).
            p: values of the parameters by name.
            holding: inputs with which nothing is accelerated, (loops,), for loops with an integral.
        """
        states: list[Any] = []
        for k, loop in enumerate(self.controller.loops):
            error, rate, speed, extra = self._signals(loop, q, v, w)
            u = _without_integral(loop, error, rate - speed, extra, p)
            if "ki" in loop.gains:
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


def _without_integral(loop: PDLoop, error: Any, rate_error: Any, extra: Any, p: Values) -> Any:
    """The input that a loop computes by deviations of position and velocity, and feed-forward."""
    u = p[gain_name(loop, "kp")] * error + p[gain_name(loop, "kd")] * rate_error
    return u if extra is None else u + extra
