"""A controller in the loop: a system whose inputs are the set points of the controller."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.errors import InputError
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.feedback import PDFeedback
from tustinnet.models.internal_states import Memory, Values
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, solve_positive

_LEAST_RIDGE = 1e-12  # of the forces by the inputs, where several inputs do the same


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
    feedback = PDFeedback(channels, holds == {"zero-order"})
    if not (states := feedback.states):
        feedback = replace(feedback, channels=replace(channels, dt=0.0))
    measured, unmeasured = channels.position, plant.unmeasured

    def inputs(q: Any, v: Any, s: Any, w: Any, p: Values) -> Any:
        return feedback.plant_inputs(feedback.compute(q, v, s, w, p)[: feedback.size], w)

    def initial(q: Any, v: Any, w: Any, p: Values) -> Any:
        q, v = q[measured], v[measured]
        has_integrals = any("ki" in loop.gains for loop in controller.loops)
        holding = _holding_inputs(plant, feedback, q, v, w, p) if has_integrals else None
        return feedback.initial(q, v, w, p, holding)

    memory = Memory(
        states,
        lambda q, v, s, w, p: feedback.compute(q, v, s, w, p)[feedback.size :],
        initial=initial if states else None,
        spread=feedback.spread if states else None,
        searched=states,
    )

    def initial_unmeasured(q: Any, v: Any, w: Any, p: Values) -> Any:
        assert unmeasured is not None
        u = inputs(q, v, memory.compute_initial(q, v, w, p), w, p)
        return unmeasured.initial_states(q, v, u, p)

    return replace(
        plant,
        inputs=channels.inputs,
        parameters=(*plant.parameters, *gains),
        feedback=feedback,
        alone=plant,
        unmeasured=unmeasured and replace(unmeasured, initial=initial_unmeasured),
        **plant.inside(memory, inputs),
    )


def without_controller_states(system: LagrangianSystem) -> LagrangianSystem:
    """A closed loop whose controller remembers nothing: without integrals, filters and delays.

    Its parameters stay. Any other system is returned as it is.

    Args:
        system: the system.
    """
    feedback = system.feedback
    if feedback is None or not feedback.states:
        return system
    controller = feedback.controller
    loops = (replace(x, ki=0.0, velocity_filter=0.0, delay=0) for x in controller.loops)
    channels = replace(feedback.channels, controller=replace(controller, loops=tuple(loops)))
    return with_controller(system.plant, channels, gains_of(system))


def gains_of(system: LagrangianSystem) -> tuple[Parameter, ...]:
    """The gains among the parameters of a closed loop."""
    own = {p.name for p in system.plant.parameters}
    return tuple(p for p in system.parameters if p.name not in own)


def _holding_inputs(
    plant: LagrangianSystem, feedback: PDFeedback, q: Any, v: Any, w: Any, p: Values
) -> Float[Array, " loops"]:
    """Computed inputs with which the system is not accelerated, in least squares."""
    model = rigid_system(plant).model(p)

    def force(outputs: Any) -> Any:
        u = feedback.plant_inputs(outputs, w)
        z = model.balanced_internal(q, v, u)
        return model.applied(q, v, z, u) + model.conservative(q, v)

    none = jnp.zeros(feedback.size, q.dtype)
    rest, by_output = force(none), jax.jacfwd(force)(none)
    square = by_output.T @ by_output
    ridge = _LEAST_RIDGE * jnp.trace(square) + jnp.finfo(q.dtype).tiny
    return -solve_positive(square + ridge * jnp.eye(feedback.size), by_output.T @ rest)
