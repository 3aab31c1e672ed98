"""A cart with a pole, driven by a motor; the pole's angle is 0 upright."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

GRAVITY = 9.81  # m/s^2
SLOW = 0.01  # m/s, width of the smoothed sign in the dry friction


def kinetic(q, v, p):
    """Cart and pole [J]."""
    moment = p["pole"] * p["length"]
    about = p["inertia"] + moment * p["length"]
    both = (p["cart"] + p["pole"]) * v[0] ** 2 / 2
    return both + moment * jnp.cos(q[1]) * v[0] * v[1] + about * v[1] ** 2 / 2


def potential(q, p):
    """Height of the pole's centre [J]."""
    return p["pole"] * GRAVITY * p["length"] * jnp.cos(q[1])


def dissipation(q, v, p):
    """Friction and back EMF of the cart, friction of the pivot [N, N m]."""
    cart = forces.viscous(v[0], p["viscous"]) + forces.coulomb(v[0], p["dry"], SLOW)
    return jnp.stack([cart, forces.viscous(v[1], p["pivot"])])


def input_map(q, v, u, p):
    """The motor pulls the cart [N]."""
    return jnp.stack([p["gain"] * u[0], 0.0 * u[0]])


SYSTEM = tn.LagrangianSystem(
    name="cart-pole",
    coordinates=(tn.Coordinate("cart", "linear"), tn.Coordinate("pole", "angular")),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        tn.Parameter("cart", "kg", 0.5, 0.1, 2.0),
        tn.Parameter("pole", "kg", 0.14, 0.05, 0.5, fixed=True),
        tn.Parameter("length", "m", 0.3, 0.1, 0.6),
        tn.Parameter("inertia", "kg m^2", 0.003, 0.0003, 0.03),
        tn.Parameter("gain", "N/V", 1.2, 0.2, 10.0),
        tn.Parameter("viscous", "N s/m", 3.0, 0.1, 50.0),
        tn.Parameter("dry", "N", 0.2, 0.001, 5.0),
        tn.Parameter("pivot", "N m s/rad", 1e-3, 1e-5, 0.05),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
