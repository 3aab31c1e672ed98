"""Continuous models stepped by adaptive solvers, where the package diffrax is installed."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from tustinnet.data.experiment import Coordinate, Input
from tustinnet.errors import InputError
from tustinnet.models.base import ContinuousModel, DiscreteModel, State
from tustinnet.simulation.integrators import Discretised, Drive, at


class Adaptive(DiscreteModel):
    """A continuous model stepped from sample to sample by an adaptive method (Tsitouras 5/4).

    Every period is solved by itself, so no step of the solver crosses a change of a held input.
    Needs the package diffrax (`pip install 'tustinnet[adaptive]'`).

    Attributes:
        continuous: the model.
        coordinates: its coordinates.
        inputs: its inputs.
        dt: sampling period [s].
        tolerance: relative and absolute tolerance of the local error.

    References:
        Tsitouras (2011), Runge-Kutta pairs of order 5(4) satisfying only the first column
        simplifying assumption, Computers and Mathematics with Applications 62.
    """

    continuous: ContinuousModel
    coordinates: tuple[Coordinate, ...] = eqx.field(static=True)
    inputs: tuple[Input, ...] = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)

    @property
    def memory(self) -> tuple[str, ...]:
        """What the internal states of the continuous model are called."""
        return self.continuous.memory

    drive = Discretised.drive

    def step(self, x: State, u: Drive) -> State:
        """One period, in as many steps as the tolerance asks for; arguments as `Discretised`."""
        diffrax = _diffrax()

        def derivative(t: Any, state: State, model: ContinuousModel) -> State:
            return model.derivative(state, at(u, t / self.dt))

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(derivative),
            diffrax.Tsit5(),
            t0=0.0,
            t1=self.dt,
            dt0=self.dt / 4,
            y0=x,
            args=self.continuous,
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=self.tolerance, atol=self.tolerance),
        )
        return jnp.asarray(solution.ys)[0]


def discretise_adaptively(model: ContinuousModel, dt: float, tolerance: float = 1e-9) -> Adaptive:
    """A continuous model as a discrete one, by an adaptive solver of the package diffrax.

    Args:
        model: the model.
        dt: sampling period [s].
        tolerance: relative and absolute tolerance of the local error.

    Raises:
        InputError: diffrax is not installed, or numbers that are not positive.
    """
    if not dt > 0 or not tolerance > 0:
        raise InputError(
            "discretise_adaptively", f"period {dt} s, tolerance {tolerance}", "positive numbers"
        )
    _diffrax()
    return Adaptive(
        continuous=model,
        coordinates=model.coordinates,
        inputs=model.inputs,
        dt=dt,
        tolerance=tolerance,
    )


def _diffrax():  # noqa: ANN202 (a module)
    try:
        import diffrax
    except ImportError:
        raise InputError(
            "adaptive integration",
            "the package diffrax is not installed",
            "diffrax",
            "pip install 'tustinnet[adaptive]', or use fixed steps (discretise)",
        ) from None
    return diffrax
