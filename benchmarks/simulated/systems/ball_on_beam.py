"""A ball that rolls on a beam with a motor in its pivot; at the angle 0 the beam is level."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

GRAVITY = 9.81  # m/s^2


def kinetic(q, v, p):
    """The rolling ball and the beam with it [J]."""
    turning = p["beam"] + p["ball"] * q[0] ** 2
    return p["rolling"] * p["ball"] * v[0] ** 2 / 2 + turning * v[1] ** 2 / 2


def potential(q, p):
    """Height of the ball [J]."""
    return p["ball"] * GRAVITY * q[0] * jnp.sin(q[1])


def dissipation(q, v, p):
    """Rolling friction, friction and back EMF in the pivot [N, N m]."""
    return forces.viscous(v, jnp.stack([p["friction"], p["damping"]]))


def input_map(q, v, u, p):
    """The motor turns the beam [N m]."""
    return jnp.stack([0.0 * u[0], p["gain"] * u[0]])


SYSTEM = tn.LagrangianSystem(
    name="ball-on-beam",
    coordinates=(tn.Coordinate("ball", "linear"), tn.Coordinate("beam", "angular")),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        tn.Parameter("ball", "kg", 0.11, 0.05, 0.5, fixed=True),
        tn.Parameter("rolling", "1", 1.5, 1.1, 3.0),
        tn.Parameter("beam", "kg m^2", 0.03, 0.005, 0.2),
        tn.Parameter("gain", "N m/V", 0.1, 0.01, 1.0),
        tn.Parameter("damping", "N m s/rad", 0.02, 1e-4, 1.0),
        tn.Parameter("friction", "N s/m", 0.03, 1e-4, 1.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
