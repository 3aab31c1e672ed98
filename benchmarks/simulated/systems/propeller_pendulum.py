"""A pendulum with a propeller at its end; 0 hangs down.

The propeller's speed is taken to follow the command at once; `model.forces = ["lag"]` adds its lag.
"""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces


def kinetic(q, v, p):
    """The arm with its motor [J]."""
    return p["inertia"] * v[0] ** 2 / 2


def potential(q, p):
    """Height of the centre of mass [J]."""
    return -p["gravity"] * jnp.cos(q[0])


def dissipation(q, v, p):
    """Friction [N m]."""
    return forces.viscous(v, p["damping"])


def input_map(q, v, u, p):
    """The thrust grows with the square of the speed [N m]."""
    return p["thrust"] * u * jnp.abs(u)


SYSTEM = tn.LagrangianSystem(
    name="propeller-pendulum",
    coordinates=(tn.Coordinate("arm", "angular"),),
    inputs=(tn.Input("command", "1"),),
    parameters=(
        # torques are those for 1 kg m^2: motion shows only their ratios to the inertia
        tn.Parameter("inertia", "kg m^2", 1.0, 0.5, 2.0, fixed=True),
        tn.Parameter("gravity", "N m", 30.0, 2.0, 200.0),
        tn.Parameter("damping", "N m s/rad", 0.1, 0.005, 10.0),
        tn.Parameter("thrust", "N m", 9.0, 1.0, 100.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
