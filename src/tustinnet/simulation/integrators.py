"""Continuous models made discrete."""

import equinox as eqx
import jax

from tustinnet.data.experiment import Coordinate, Input
from tustinnet.errors import InputError
from tustinnet.models.base import ContinuousModel, DiscreteModel, InputVector, State


class Discretised(DiscreteModel):
    """A continuous model stepped from sample to sample by the classical Runge-Kutta method.

    The input is held over the period (zero-order hold), so no stage of the method looks at the
    next sample.

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

    def step(self, x: State, u: InputVector) -> State:
        """One period: `substeps` Runge-Kutta steps of fourth order."""
        h = self.dt / self.substeps

        def advance(state: State, _: None) -> tuple[State, None]:
            return runge_kutta_4(self.continuous, state, u, h), None

        return jax.lax.scan(advance, x, None, length=self.substeps)[0]


def discretise(model: ContinuousModel, dt: float, substeps: int = 1) -> Discretised:
    """A continuous model as a discrete one.

    Args:
        model: the model.
        dt: sampling period [s].
        substeps: Runge-Kutta steps in a period.
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


def runge_kutta_4(model: ContinuousModel, x: State, u: InputVector, h: float) -> State:
    """One classical Runge-Kutta step of length `h` [s] under a held input."""
    first = model.derivative(x, u)
    second = model.derivative(x + h / 2 * first, u)
    third = model.derivative(x + h / 2 * second, u)
    fourth = model.derivative(x + h * third, u)
    return x + h / 6 * (first + 2 * second + 2 * third + fourth)
