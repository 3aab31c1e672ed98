"""A controller in the loop: a system whose inputs are the set points of the controller."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from tustinnet.channels import Channels, PDController, PDLoop
from tustinnet.errors import InputError
from tustinnet.models.lagrangian import (
    FeedbackLaw,
    LagrangianSystem,
    Parameter,
    Values,
    takes_inputs,
)


def gain_name(loop: PDLoop, gain: str) -> str:
    """The name of the parameter of a gain: `elbow.kp`."""
    return f"{loop.coordinate}.{gain}"


@dataclass(frozen=True)
class PDFeedback(FeedbackLaw):
    """Proportional and derivative feedback to set points; attributes are those of `FeedbackLaw`."""

    @property
    def controller(self) -> PDController:
        """The controller."""
        assert self.channels.controller is not None
        return self.channels.controller

    @property
    def size(self) -> int:
        """Number of inputs that are computed."""
        return len(self.controller.loops)

    def outputs(self, q: Any, v: Any, w: Any, p: Values) -> Float[Array, " loops"]:
        """The inputs of the system that are computed, in the order of the loops.

        Args:
            q: positions, (n_q,).
            v: velocities, (n_q,).
            w: inputs of the closed loop, (n_w,).
            p: values of the parameters by name.
        """
        coordinates = [c.name for c in self.channels.coordinates]
        names = [i.name for i in self.channels.inputs]
        inputs = {i.name: i for i in self.controller.inputs}
        computed = []
        for loop in self.controller.loops:
            j = coordinates.index(loop.coordinate)
            wanted = w[names.index(loop.velocity)] if loop.velocity else 0.0
            u = p[gain_name(loop, "kp")] * (w[names.index(loop.position)] - q[j])
            u = u + p[gain_name(loop, "kd")] * (wanted - v[j])
            if loop.feedforward:
                u = u + w[names.index(loop.feedforward)]
            if limits := inputs[loop.input].limits:
                u = jnp.clip(u, *limits)
            computed.append(u)
        return jnp.stack(computed)

    def plant_inputs(self, outputs: Any, w: Any) -> Float[Array, " n_u"]:
        """All inputs of the system.

        Args:
            outputs: those that are computed, (loops,).
            w: inputs of the closed loop, (n_w,), others of the system among them.
        """
        computed = {loop.input: k for k, loop in enumerate(self.controller.loops)}
        names = [i.name for i in self.channels.inputs]
        return jnp.stack([
            outputs[computed[i.name]] if i.name in computed else w[names.index(i.name)]
            for i in self.controller.inputs
        ])  # fmt: skip


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
        gains: the gains, `COORDINATE.kp` and `COORDINATE.kd` of each loop.

    Raises:
        InputError: a parameter that the system has already.
    """
    controller = channels.controller
    if controller is None:
        return plant
    if twice := sorted({p.name for p in gains} & {p.name for p in plant.parameters}):
        raise InputError(
            f"system '{plant.name}'", f"a parameter '{twice[0]}', as the controller has a gain",
            "another name",
        )  # fmt: skip
    set_points = {name for loop in controller.loops for name in loop.set_points}
    holds = {i.hold for i in channels.inputs if i.name in set_points}
    feedback = PDFeedback(plant, replace(channels, dt=0.0), holds == {"zero-order"})

    def closed(function: Callable[..., Any] | None, arguments: str) -> Any:
        """A function of a system that may take the inputs, as one of the closed loop."""
        if function is None or not takes_inputs(function, arguments):
            return function
        n_before = len(arguments) - 1

        @wraps(function)
        def of_set_points(*others: Any) -> Any:
            *before, w, p = others
            q, v = before[:2]
            u = feedback.plant_inputs(feedback.outputs(q, v, w, p), w)
            return function(*before[:n_before], u, p)

        return of_set_points

    memory = plant.memory
    return replace(
        plant,
        inputs=channels.inputs,
        parameters=(*plant.parameters, *gains),
        input_map=closed(plant.input_map, "qvp"),
        memory=memory
        and replace(
            memory,
            rate=closed(memory.rate, "qvzp"),
            force=closed(memory.force, "qvzp"),
            initial=closed(memory.initial, "qvp"),
        ),
        feedback=feedback,
    )


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
    own = {p.name for p in system.plant.parameters}
    gains = tuple(p for p in system.parameters if p.name not in own)
    return with_controller(change(system.plant), system.feedback.channels, gains)
