"""Continuous models stepped by adaptive solvers, where the package diffrax is installed."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from tustinnet.errors import InputError, require_package
from tustinnet.models.contract import ContinuousModel, State
from tustinnet.models.integrate import FromContinuous, input_at
from tustinnet.models.step_layout import StepInput


class Adaptive(FromContinuous):
    """A continuous model stepped from sample to sample by an adaptive method (Tsitouras 5/4).

    Every period is solved by itself, so no step of the solver crosses a change of a held input.
    Needs the package diffrax (`pip install 'tustinnet[adaptive]'`).

    Attributes:
        continuous: the model.
        channels: its channels, with a sampling period.
        tolerance: relative and absolute tolerance of the local error.

    References:
        Tsitouras (2011), Runge-Kutta pairs of order 5(4) satisfying only the first column
        simplifying assumption, Computers and Mathematics with Applications 62.
    """

    tolerance: float = eqx.field(static=True)

    def advance(self, x: State, u: StepInput, period: Array | float) -> State:
        """The state a period later, in as many steps as the tolerance needs, see `Discretised`."""
        import diffrax

        x, model = self.continuous.between_samples(x, input_at(u, 0.0))

        def derivative(t: Any, state: State, model: ContinuousModel) -> State:
            return model.derivative(state, input_at(u, t / period))

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(derivative),
            diffrax.Tsit5(),
            t0=0.0,
            t1=period,
            dt0=period / 4,
            y0=x,
            args=model,
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
    require_package(
        "diffrax", "adaptive", "adaptive integration", ", or use fixed steps (discretise)"
    )
    return Adaptive(model, replace(model.channels, dt=dt), tolerance)
