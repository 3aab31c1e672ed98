"""A motor that turns a load through an elastic shaft; both have encoders."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

SLOW = 0.2  # rad/s, width of the smoothed sign in the dry friction


def kinetic(q, v, p):
    """Motor and load [J]."""
    return p["motor"] * v[0] ** 2 / 2 + p["load"] * v[1] ** 2 / 2


def potential(q, p):
    """The twist of the shaft [J]."""
    return forces.linear_spring(q[0] - q[1], p["stiffness"])


def dissipation(q, v, p):
    """Friction of both bearings, and within the shaft [N m]."""
    viscous = jnp.stack([p["viscous1"], p["viscous2"]])
    dry = jnp.stack([p["dry1"], p["dry2"]])
    shaft = p["shaft"] * (v[0] - v[1])
    return forces.viscous(v, viscous) + forces.coulomb(v, dry, SLOW) + jnp.stack([shaft, -shaft])


def input_map(q, v, u, p):
    """The torque acts on the motor [N m]."""
    return jnp.stack([u[0], 0.0 * u[0]])


SYSTEM = tn.LagrangianSystem(
    name="two-mass-drive",
    coordinates=(tn.Coordinate("motor", "angular"), tn.Coordinate("load", "angular")),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(
        tn.Parameter("motor", "kg m^2", 4e-4, 5e-5, 5e-3),
        tn.Parameter("load", "kg m^2", 1.5e-3, 1e-4, 1e-2),
        tn.Parameter("stiffness", "N m/rad", 0.6, 0.1, 10.0),
        tn.Parameter("shaft", "N m s/rad", 5e-4, 1e-5, 5e-2),
        tn.Parameter("viscous1", "N m s/rad", 5e-4, 1e-5, 5e-2),
        tn.Parameter("viscous2", "N m s/rad", 5e-4, 1e-5, 5e-2),
        tn.Parameter("dry1", "N m", 5e-3, 1e-4, 0.1),
        tn.Parameter("dry2", "N m", 5e-3, 1e-4, 0.1),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
