"""Propeller pendulum: an arm that a propeller at its end lifts; the propeller follows its command.

The arm hangs at 0. The propeller's speed is an internal state, in units of the command.
"""

import jax.numpy as jnp

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector, Internal
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Memory, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The arm with the motor [J]."""
    return p["inertia"] * v[0] ** 2 / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """Height of the centre of mass [J]."""
    return -p["weight_moment"] * jnp.cos(q[0])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Friction of the pivot [N m]."""
    return forces.viscous(v, p["viscous"])


def spin_rate(q: Coordinates, v: Coordinates, z: Internal, u: InputVector, p: Values) -> Internal:
    """The propeller follows its command."""
    return forces.lag_rate(u, z, p["lag"])


def thrust(q: Coordinates, v: Coordinates, z: Internal, p: Values) -> Coordinates:
    """The torque of the thrust grows with the square of the speed [N m]."""
    return p["thrust"] * z * jnp.abs(z)


def first_spin(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Internal:
    """The command was there before the record."""
    return u


SYSTEM = LagrangianSystem(
    name="propeller-pendulum",
    coordinates=(Coordinate("arm", "angular"),),
    inputs=(Input("command", "1"),),
    parameters=(
        # motion shows only the ratios of torques to the inertia
        Parameter("inertia", "kg m^2", 0.02, 1e-3, 1.0, fixed=True),
        Parameter("weight_moment", "N m", 0.3, 0.01, 10.0),
        Parameter("viscous", "N m s/rad", 3e-3, 1e-5, 0.5),
        Parameter("thrust", "N m", 0.3, 0.01, 10.0),
        Parameter("lag", "s", 0.05, 5e-3, 1.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    memory=Memory(("spin",), spin_rate, thrust, first_spin),
    links=(Link("arm", (0.0, -1.0, 0.0), (0.0, 0.0, -0.3), shape="propeller"),),
)
TWIN = Twin(
    SYSTEM,
    {"weight_moment": 0.42, "viscous": 7e-3, "thrust": 0.36, "lag": 0.09},
    resolution=(1.5e-3,),
    amplitude=(0.35,),
    band=(0.3, 2.0),
    rest=(0.0,),
    spread=(0.4,),
    dt=0.02,
)
