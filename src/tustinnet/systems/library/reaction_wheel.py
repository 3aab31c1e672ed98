"""Reaction wheel pendulum: a pendulum with a motor at its end that turns a wheel.

The pendulum hangs at 0; the wheel's angle is that of the motor, relative to the pendulum.
"""

import jax.numpy as jnp

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin

SLOW = 0.5  # rad/s, width of the smoothed sign in the wheel's Coulomb friction


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The pendulum with the wheel's mass, and the wheel's turn [J]."""
    return (p["pendulum_inertia"] * v[0] ** 2 + p["wheel_inertia"] * (v[0] + v[1]) ** 2) / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """Height of the centre of mass of both [J]."""
    return -p["weight_moment"] * jnp.cos(q[0])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Friction of the pivot and of the motor's bearing [N m]."""
    dry = forces.coulomb(v[1], p["wheel_coulomb"], SLOW)
    viscous = forces.viscous(v, jnp.stack([p["pendulum_viscous"], p["wheel_viscous"]]))
    return viscous + jnp.stack([jnp.zeros_like(dry), dry])


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The motor's torque between pendulum and wheel [N m]."""
    return jnp.stack([jnp.zeros_like(u[0]), p["torque_constant"] * u[0]])


SYSTEM = LagrangianSystem(
    name="reaction-wheel",
    coordinates=(Coordinate("pendulum", "angular"), Coordinate("wheel", "angular")),
    inputs=(Input("current", "A"),),
    parameters=(
        Parameter("pendulum_inertia", "kg m^2", 0.015, 5e-4, 0.5),
        Parameter("wheel_inertia", "kg m^2", 2e-4, 1e-5, 1e-2),
        Parameter("weight_moment", "N m", 0.4, 0.02, 10.0),
        Parameter("torque_constant", "N m/A", 0.025, 1e-3, 1.0, fixed=True),
        Parameter("pendulum_viscous", "N m s/rad", 5e-4, 1e-6, 0.05),
        Parameter("wheel_viscous", "N m s/rad", 5e-5, 1e-7, 0.01),
        Parameter("wheel_coulomb", "N m", 1e-3, 1e-6, 0.1),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(
        Link("pendulum", (0.0, -1.0, 0.0), (0.0, 0.0, -0.2)),
        Link("wheel", (0.0, -1.0, 0.0), (0.05, 0.0, 0.0), shape="wheel"),
    ),
)
TWIN = Twin(
    SYSTEM,
    {
        "pendulum_inertia": 0.0117,
        "wheel_inertia": 2.8e-4,
        "weight_moment": 0.52,
        "pendulum_viscous": 8e-4,
        "wheel_viscous": 3e-5,
        "wheel_coulomb": 1.7e-3,
    },
    resolution=(1.5e-3, 3e-3),
    amplitude=(0.6,),
    band=(0.3, 3.0),
    rest=(0.0, 0.0),
    spread=(0.8, 0.0),
)
