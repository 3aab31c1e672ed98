"""A disc with a mass off its centre, on a motor's shaft; 0 hangs down."""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

SLOW = 0.1  # rad/s, width of the smoothed sign in the dry friction


def kinetic(q, v, p):
    """Disc and rotor [J]."""
    return p["inertia"] * v[0] ** 2 / 2


def potential(q, p):
    """Height of the mass [J]."""
    return -p["gravity"] * jnp.cos(q[0])


def dissipation(q, v, p):
    """Friction and back EMF [N m]."""
    return forces.viscous(v, p["damping"]) + forces.coulomb(v, p["dry"], SLOW)


def input_map(q, v, u, p):
    """The motor's torque [N m]."""
    return p["gain"] * u


SYSTEM = tn.LagrangianSystem(
    name="unbalanced-disc",
    coordinates=(tn.Coordinate("disc", "angular"),),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        # forces are those for 1 kg m^2: motion shows only their ratios to the inertia
        tn.Parameter("inertia", "kg m^2", 1.0, 0.5, 2.0, fixed=True),
        tn.Parameter("gravity", "N m", 80.0, 5.0, 500.0),
        tn.Parameter("damping", "N m s/rad", 1.0, 0.01, 30.0),
        tn.Parameter("dry", "N m", 1.0, 0.01, 30.0),
        tn.Parameter("gain", "N m/V", 30.0, 2.0, 200.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
