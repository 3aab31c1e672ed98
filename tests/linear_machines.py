"""Linear models to control, whose answers are known."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import tustinnet as tn


class LinearMachine(tn.Model):
    """`x[k+1] = a x[k] + b u[k]`, of any number of coordinates, angles or not."""

    a: np.ndarray
    b: np.ndarray
    channels: tn.Channels = eqx.field(static=True)

    def step(self, x, u):
        return jnp.asarray(self.a) @ x + jnp.asarray(self.b) @ u


def double_integrator(limit: float = 2.0, dt: float = 0.1, delay: float = 0.0) -> LinearMachine:
    """A mass that a force moves."""
    channels = tn.Channels(
        (tn.Coordinate("s", "linear"),),
        (tn.Input("force", "N", "zero-order", (-limit, limit), delay),),
        dt,
    )
    return LinearMachine(np.array([[1.0, dt], [0.0, 1.0]]), np.array([[dt**2 / 2], [dt]]), channels)


def two_masses(limit: float = 5.0, dt: float = 0.1) -> LinearMachine:
    """Two masses joined by a spring, a force on each; both forces act a little on both."""
    channels = tn.Channels(
        (tn.Coordinate("first", "linear"), tn.Coordinate("second", "linear")),
        tuple(tn.Input(f"force_{i}", "N", "zero-order", (-limit, limit)) for i in (1, 2)),
        dt,
    )
    stiffness = np.array([[-1.0, 1.0], [1.0, -1.0]])
    a = np.block([[np.eye(2), dt * np.eye(2)], [dt * stiffness, np.eye(2)]])
    b = np.concatenate([np.zeros((2, 2)), dt * np.array([[1.0, 0.6], [0.6, 1.0]])])
    return LinearMachine(a, b, channels)
