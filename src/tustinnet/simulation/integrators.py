"""Continuous models made discrete."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Coordinate, Experiment, Input
from tustinnet.errors import InputError
from tustinnet.models.base import ContinuousModel, DiscreteModel, InputVector, State

Drive = Float[Array, "*ends n_u"]

# the classical method: where along the step each stage looks, and what it counts
_REACH = (0.0, 0.5, 0.5, 1.0)
_SHARE = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


class Discretised(DiscreteModel):
    """A continuous model stepped from sample to sample by the classical Runge-Kutta method.

    Inputs are held over the period (zero-order hold), so no stage of the method looks at the next
    sample; or they follow a straight line (first-order hold), when a step is given both ends.

    Attributes:
        continuous: the model.
        coordinates: its coordinates.
        inputs: its inputs.
        dt: sampling period [s].
        substeps: Runge-Kutta steps in a period.
    """

    continuous: ContinuousModel
    coordinates: tuple[Coordinate, ...] = eqx.field(static=True)
    inputs: tuple[Input, ...] = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    substeps: int = eqx.field(static=True)

    @property
    def memory(self) -> tuple[str, ...]:
        """What the internal states of the continuous model are called."""
        return self.continuous.memory

    def drive(self, experiment: Experiment) -> Float[np.ndarray, "steps *drive"]:
        """Held inputs, or both ends of every period where an input is held to first order."""
        if any(i.hold == "first-order" for i in self.inputs):
            return experiment.input_ends
        return experiment.held_inputs

    def step(self, x: State, u: Drive) -> State:
        """One period: `substeps` Runge-Kutta steps of fourth order.

        Args:
            x: the state, (n_x,).
            u: the held inputs, (n_u,), or their values at both ends of the period, (2, n_u).
        """
        h = self.dt / self.substeps

        def advance(state: State, i: Array) -> tuple[State, None]:
            return substep(self.continuous, state, u, i, self.substeps, h, looped=True), None

        return jax.lax.scan(advance, x, jnp.arange(self.substeps, dtype=x.dtype))[0]


def discretise(model: ContinuousModel, dt: float, substeps: int = 1) -> Discretised:
    """A continuous model as a discrete one, by fixed Runge-Kutta steps.

    Args:
        model: the model.
        dt: sampling period [s].
        substeps: Runge-Kutta steps in a period; `choose_substeps` says how many are needed.
    """
    if not dt > 0 or substeps < 1:
        raise InputError("discretise", f"period {dt} s, {substeps} substeps", "positive numbers")
    return Discretised(
        continuous=model,
        coordinates=model.coordinates,
        inputs=model.inputs,
        dt=dt,
        substeps=substeps,
    )


def substep(
    model: ContinuousModel,
    x: State,
    u: Drive,
    i: Array | int,
    parts: Array | int,
    h: Array | float,
    *,
    looped: bool = False,
) -> State:
    """The i-th of so many Runge-Kutta steps of length `h` [s] that make up a period."""
    stages = (at(u, i / parts), at(u, (i + 0.5) / parts), at(u, (i + 1) / parts))
    return runge_kutta_4(model, x, stages, h, looped=looped)


def at(u: Drive, part: Array | float) -> InputVector:
    """Inputs at a part of the period, 0..1: held, or on the line between both ends."""
    return u if u.ndim == 1 else u[0] + part * (u[1] - u[0])


def runge_kutta_4(
    model: ContinuousModel,
    x: State,
    u: tuple[InputVector, InputVector, InputVector],
    h: Array | float,
    *,
    looped: bool = False,
) -> State:
    """One classical Runge-Kutta step of length `h` [s].

    Args:
        model: the model.
        x: the state, (n_x,).
        u: the inputs at the beginning, the middle and the end of the step.
        h: length of the step [s].
        looped: whether the four stages are a loop of the compiled program. That compiles three
            times as fast; written out they run faster where the derivatives by many parameters
            are carried along.
    """

    def stage(carry: tuple[State, State], now: tuple[Any, ...]) -> tuple[tuple[State, State], None]:
        slope, mean = carry
        reach, share, held = now
        slope = model.derivative(x + h * reach * slope, held)
        return (slope, mean + share * slope), None

    begin, middle, end = u
    inputs = [begin, middle, middle, end]
    carry = jnp.zeros_like(x), jnp.zeros_like(x)
    if looped:
        tableau = jnp.asarray(_REACH, x.dtype), jnp.asarray(_SHARE, x.dtype)
        carry, _ = jax.lax.scan(stage, carry, (*tableau, jnp.stack(inputs)))
    else:
        for now in zip(_REACH, _SHARE, inputs, strict=True):
            carry, _ = stage(carry, now)
    _, mean = carry
    return x + h * mean
