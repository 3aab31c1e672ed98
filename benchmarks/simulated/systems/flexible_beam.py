"""A clamped beam as two masses; sensor and shaker are at the first, the second is not measured."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces


def kinetic(q, v, p):
    """The mass at the sensor [J]."""
    return p["mass"] * v[0] ** 2 / 2


def potential(q, p):
    """The beam between clamp and sensor [J]."""
    return forces.linear_spring(q[0], p["stiffness"])


def dissipation(q, v, p):
    """Friction in the clamp [N]."""
    return forces.viscous(v, p["damping"])


def input_map(q, v, u, p):
    """The shaker's force [N]."""
    return u


def bending(q, v, z, p):
    """The force between both masses [N]; z is deflection and speed of the second."""
    return p["bend"] * (q[0] - z[0]) + p["inner"] * (v[0] - z[1])


SYSTEM = tn.LagrangianSystem(
    name="flexible-beam",
    coordinates=(tn.Coordinate("deflection", "linear"),),
    inputs=(tn.Input("force", "N"),),
    parameters=(
        tn.Parameter("mass", "kg", 0.3, 0.05, 2.0),
        tn.Parameter("stiffness", "N/m", 300.0, 20.0, 5000.0),
        tn.Parameter("damping", "N s/m", 0.1, 0.001, 10.0),
        tn.Parameter("tip", "kg", 0.2, 0.02, 1.0),
        tn.Parameter("bend", "N/m", 350.0, 20.0, 5000.0),
        tn.Parameter("inner", "N s/m", 0.1, 0.001, 5.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    memory=tn.Memory(
        names=("tip", "tip_speed"),
        rate=lambda q, v, z, p: jnp.stack([z[1], bending(q, v, z, p) / p["tip"]]),
        force=lambda q, v, z, p: -bending(q, v, z, p)[None],
        initial=lambda q, v, p: jnp.stack([q[0], v[0]]),
    ),
)
