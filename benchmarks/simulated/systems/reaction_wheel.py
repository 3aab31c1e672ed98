"""A pendulum that hangs at 0, with a wheel whose angle is relative to the pendulum."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

SLOW = 0.5  # rad/s, width of the smoothed sign in the dry friction of the wheel


def kinetic(q, v, p):
    """The pendulum with the mass of the wheel, and the wheel's rotation [J]."""
    return p["pendulum"] * v[0] ** 2 / 2 + p["wheel"] * (v[0] + v[1]) ** 2 / 2


def potential(q, p):
    """Height of the centre of mass [J]."""
    return -p["gravity"] * jnp.cos(q[0])


def dissipation(q, v, p):
    """Friction of the pivot, and of the wheel in its bearing [N m]."""
    wheel = forces.viscous(v[1], p["bearing"]) + forces.coulomb(v[1], p["dry"], SLOW)
    return jnp.stack([forces.viscous(v[0], p["pivot"]), wheel])


def input_map(q, v, u, p):
    """The motor's torque between both [N m]."""
    return jnp.stack([0.0 * u[0], p["gain"] * u[0]])


SYSTEM = tn.LagrangianSystem(
    name="reaction-wheel",
    coordinates=(tn.Coordinate("pendulum", "angular"), tn.Coordinate("wheel", "angular")),
    inputs=(tn.Input("current", "A"),),
    parameters=(
        tn.Parameter("pendulum", "kg m^2", 0.015, 0.001, 0.1),
        tn.Parameter("wheel", "kg m^2", 2e-4, 2e-5, 5e-3),
        tn.Parameter("gravity", "N m", 0.4, 0.05, 5.0),
        tn.Parameter("pivot", "N m s/rad", 5e-4, 1e-5, 0.05),
        tn.Parameter("bearing", "N m s/rad", 5e-5, 1e-6, 0.01),
        tn.Parameter("gain", "N m/A", 0.021, 0.01, 0.05, fixed=True),
        tn.Parameter("dry", "N m", 1e-3, 1e-5, 0.05),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
