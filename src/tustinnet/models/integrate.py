"""Continuous models made discrete by fixed steps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from tustinnet.channels import Channels, Input, merge_timing
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.contract import (
    ContinuousModel,
    Directions,
    InputVector,
    Model,
    State,
    StepAlong,
)
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.models.sizes import MOST_SUBSTEPS, MOST_UNROLLED
from tustinnet.models.step_layout import StepInput, StepLayout

# the classical method: the stages' places along the step, and their weights
_NODES = (0.0, 0.5, 0.5, 1.0)
_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


class FromContinuous(Model):
    """A continuous model stepped from sample to sample.

    Inputs are held over the period (zero-order hold), so no stage of a method looks at the next
    sample; or they follow the polynomial whose coefficients a step is given (other holds).

    Attributes:
        continuous: the model.
        channels: its channels, with a sampling period.
    """

    continuous: ContinuousModel
    channels: Channels = eqx.field(static=True)

    @property
    def inner_models(self) -> tuple[ContinuousModel, ...]:
        """The continuous model."""
        return (self.continuous,)

    def for_record(self, experiment: Experiment) -> "FromContinuous":
        """The model with the values of the record's groups."""
        chosen = self.continuous.for_record(experiment)
        return self if chosen is self.continuous else replace(self, continuous=chosen)

    @property
    def step_layout(self) -> StepLayout:
        """The polynomials of every period; held inputs are a single row."""
        return StepLayout(polynomial=True)

    def step(self, x: State, u: StepInput) -> State:
        """The state one sampling period after `x`."""
        return self.advance(x, u, self.dt)


class Discretised(FromContinuous):
    """A continuous model stepped by the classical Runge-Kutta method.

    Attributes:
        continuous: the model.
        channels: its channels, with a sampling period.
        substeps: Runge-Kutta steps in a period.
        unrolled: whether steps and stages are written out in the compiled program. As loops they
            compile three times as fast, which is what equations of motion from energies need;
            networks, which are small programs, run faster written out.
    """

    substeps: int = eqx.field(static=True)
    unrolled: bool = eqx.field(static=True, default=False)

    def advance(self, x: State, u: StepInput, period: Array | float) -> State:
        """The state after a period [s]: `substeps` Runge-Kutta steps of fourth order."""
        x, model = self.continuous.between_samples(x, input_at(u, 0.0))
        return self._integrate(model, x, u, period)

    @property
    def step_along(self) -> StepAlong | None:
        """The step with derivatives of equations of motion, where nothing happens at samples."""
        model = self.continuous
        if not isinstance(model, LagrangianModel) or model.changes_at_samples:
            return None

        def step(x: State, u: InputVector, dx: Directions, du: Directions) -> Array:
            along = jnp.concatenate([x[:, None], dx], axis=1)
            return self._integrate(_Along(model, du), along, u, self.dt)

        return step

    def _integrate(self, model: Any, x: Array, u: StepInput, period: Array | float) -> Array:
        n, h = self.substeps, period / self.substeps
        if self.unrolled:
            for i in range(n):
                x = runge_kutta_4(model, x, stage_inputs(u, i, n), h)
            return x

        def substep(state: Array, i: Array) -> tuple[Array, None]:
            return runge_kutta_4(model, state, stage_inputs(u, i, n), h, looped=True), None

        return jax.lax.scan(substep, x, jnp.arange(n, dtype=x.dtype))[0]


@dataclass(frozen=True)
class _Along:
    """Equations of motion of a state and of its derivatives along directions behind it, by columns.

    Attributes:
        model: the equations of motion.
        inputs: the directions of the inputs, (n_u, directions).
    """

    model: LagrangianModel
    inputs: Directions

    def derivative(self, x: Array, u: InputVector) -> Array:
        """The derivative of the columns, (n_x, 1 + directions)."""
        rate, along = self.model.derivative_along(x[:, 0], u, x[:, 1:], self.inputs)
        return jnp.concatenate([rate[:, None], along], axis=1)


def discretise(
    model: ContinuousModel,
    dt: float,
    substeps: int = 1,
    *,
    inputs: Sequence[Input] | None = None,
    unrolled: bool = False,
) -> Discretised:
    """A continuous model as a discrete one, by fixed Runge-Kutta steps.

    Args:
        model: the model.
        dt: sampling period [s].
        substeps: Runge-Kutta steps in a period; `choose_substeps` computes how many are needed.
        inputs: the inputs of records, or of a model file, whose delays and holds are taken; the
            model's own holds where these have none. By default the model's own inputs.
        unrolled: whether the steps are written out in the compiled program, see `Discretised`.
    """
    most = MOST_UNROLLED if unrolled else MOST_SUBSTEPS
    if not dt > 0 or not 1 <= substeps <= most:
        raise InputError(
            "discretise",
            f"period {dt} s, {substeps} substeps",
            f"a positive period and 1 to {most} substeps",
        )
    of_model = model.channels.inputs
    of_records = of_model if inputs is None else inputs
    # a hold that a search has found is in the records' inputs, whatever the system's file says
    channels = replace(
        model.channels,
        dt=dt,
        inputs=tuple(
            replace(i, hold=merged.hold, delay=recorded.delay)
            for i, recorded, merged in zip(
                of_model, of_records, merge_timing(of_records, of_model), strict=True
            )
        ),
    )
    return Discretised(model, channels, substeps, unrolled)


def stage_inputs(
    u: StepInput, i: Array | int, n: Array | int
) -> tuple[InputVector, InputVector, InputVector]:
    """Inputs at the beginning, the middle and the end of the i-th of n substeps of a period."""
    return input_at(u, i / n), input_at(u, (i + 0.5) / n), input_at(u, (i + 1) / n)


def input_at(u: StepInput, part: Array | float) -> InputVector:
    """Inputs at a part of the period, 0..1: held, or on the polynomials of the period."""
    if u.ndim == 1:
        return u
    value = u[-1]
    for coefficient in u[-2::-1]:
        value = coefficient + part * value
    return value


def runge_kutta_4(
    model: Any,
    x: Array,
    u: tuple[InputVector, InputVector, InputVector],
    h: Array | float,
    *,
    looped: bool = False,
) -> Array:
    """One classical Runge-Kutta step of length `h` [s].

    Args:
        model: the model, or another object with `derivative(x, u)`.
        x: the state, (n_x,), or an array of another shape.
        u: the inputs at the beginning, the middle and the end of the step.
        h: length of the step [s].
        looped: whether the four stages are a loop of the compiled program. That compiles three
            times as fast; written out they run faster where the derivatives by many parameters
            are carried along.
    """

    def stage(carry: tuple[Array, Array], now: tuple[Any, ...]) -> tuple[tuple[Array, Array], None]:
        slope, mean = carry
        node, weight, inputs_now = now
        slope = model.derivative(x + h * node * slope, inputs_now)
        return (slope, mean + weight * slope), None

    begin, middle, end = u
    inputs = [begin, middle, middle, end]
    carry = jnp.zeros_like(x), jnp.zeros_like(x)
    if looped:
        tableau = jnp.asarray(_NODES, x.dtype), jnp.asarray(_WEIGHTS, x.dtype)
        carry, _ = jax.lax.scan(stage, carry, (*tableau, jnp.stack(inputs)))
    else:
        for now in zip(_NODES, _WEIGHTS, inputs, strict=True):
            carry, _ = stage(carry, now)
    _, mean = carry
    return x + h * mean
