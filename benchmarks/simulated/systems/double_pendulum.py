"""A free double pendulum; the lower angle is relative to the upper link, 0 hangs down."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

GRAVITY = 9.81  # m/s^2
LENGTH = 0.24  # m, between the joints
SLOW = 0.05  # rad/s, width of the smoothed sign in the dry friction


def kinetic(q, v, p):
    """Both links [J]."""
    lower = v[0] + v[1]
    elbow = p["mass2"] * LENGTH**2 * v[0] ** 2 / 2
    coupling = p["mass2"] * LENGTH * p["centre2"] * jnp.cos(q[1]) * v[0] * lower
    return p["inertia1"] * v[0] ** 2 / 2 + elbow + coupling + p["inertia2"] * lower**2 / 2


def potential(q, p):
    """Heights of both links [J]."""
    upper = (p["moment1"] + p["mass2"] * LENGTH) * jnp.cos(q[0])
    return -GRAVITY * (upper + p["mass2"] * p["centre2"] * jnp.cos(q[0] + q[1]))


def dissipation(q, v, p):
    """Viscous and dry friction in both joints [N m]."""
    viscous = jnp.stack([p["viscous1"], p["viscous2"]])
    dry = jnp.stack([p["dry1"], p["dry2"]])
    return forces.viscous(v, viscous) + forces.coulomb(v, dry, SLOW)


SYSTEM = tn.LagrangianSystem(
    name="double-pendulum-free",
    coordinates=(tn.Coordinate("upper", "angular"), tn.Coordinate("lower", "angular")),
    inputs=(),
    parameters=(
        tn.Parameter("inertia1", "kg m^2", 0.03, 0.002, 0.2),
        tn.Parameter("moment1", "kg m", 0.08, 0.01, 0.5),
        tn.Parameter("mass2", "kg", 0.25, 0.1, 0.5, fixed=True),
        tn.Parameter("inertia2", "kg m^2", 0.004, 0.0005, 0.05),
        tn.Parameter("centre2", "m", 0.11, 0.02, 0.3),
        tn.Parameter("viscous1", "N m s/rad", 1e-3, 1e-5, 0.1),
        tn.Parameter("viscous2", "N m s/rad", 1e-3, 1e-5, 0.1),
        tn.Parameter("dry1", "N m", 2e-3, 1e-5, 0.1),
        tn.Parameter("dry2", "N m", 2e-3, 1e-5, 0.1),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
)
