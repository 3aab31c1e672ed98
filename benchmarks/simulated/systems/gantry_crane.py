"""A crane's trolley and the load on its rope, whose angle is 0 where it hangs down."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

GRAVITY = 9.81  # m/s^2
SLOW = 0.01  # m/s, width of the smoothed sign in the dry friction


def kinetic(q, v, p):
    """Trolley and load [J]."""
    both = (p["trolley"] + p["load"]) * v[0] ** 2 / 2
    swing = p["length"] * v[1]
    return both + p["load"] * (jnp.cos(q[1]) * v[0] * swing + swing**2 / 2)


def potential(q, p):
    """Height of the load [J]."""
    return -p["load"] * GRAVITY * p["length"] * jnp.cos(q[1])


def dissipation(q, v, p):
    """Friction of the trolley and of the rope [N, N m]."""
    trolley = forces.viscous(v[0], p["viscous"]) + forces.coulomb(v[0], p["dry"], SLOW)
    return jnp.stack([trolley, forces.viscous(v[1], p["air"])])


def input_map(q, v, u, p):
    """The motor pulls the trolley [N]."""
    return jnp.stack([p["gain"] * u[0], 0.0 * u[0]])


SYSTEM = tn.LagrangianSystem(
    name="gantry-crane",
    coordinates=(tn.Coordinate("trolley", "linear"), tn.Coordinate("load", "angular")),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        tn.Parameter("trolley", "kg", 3.0, 0.5, 20.0),
        tn.Parameter("load", "kg", 1.4, 0.5, 5.0, fixed=True),
        tn.Parameter("length", "m", 0.8, 0.3, 2.0),
        tn.Parameter("gain", "N/V", 6.0, 1.0, 50.0),
        tn.Parameter("viscous", "N s/m", 10.0, 0.5, 200.0),
        tn.Parameter("dry", "N", 2.0, 0.01, 30.0),
        tn.Parameter("air", "N m s/rad", 0.005, 1e-4, 0.5),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
