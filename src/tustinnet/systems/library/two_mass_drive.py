"""Two-mass drive: a motor turns a load through an elastic shaft with backlash.

Both have an encoder; their angles are relative to the shaft without a twist, in the middle of the
backlash.
"""

import jax.numpy as jnp

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import BASE, Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin

SLOW = 0.2  # rad/s, width of the smoothed sign in the Coulomb friction


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """Motor and load turn [J]."""
    return (p["motor_inertia"] * v[0] ** 2 + p["load_inertia"] * v[1] ** 2) / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """The shaft's twist beyond the backlash [J]."""
    return forces.backlash_spring(q[0] - q[1], p["stiffness"], p["half_backlash"])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Friction of both bearings, and damping between both [N m]."""
    shaft = p["shaft_viscous"] * (v[0] - v[1])
    viscous = forces.viscous(v, jnp.stack([p["motor_viscous"], p["load_viscous"]]))
    dry = forces.coulomb(v, jnp.stack([p["motor_coulomb"], p["load_coulomb"]]), SLOW)
    return viscous + dry + jnp.stack([shaft, -shaft])


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The torque acts on the motor [N m]."""
    return jnp.stack([u[0], jnp.zeros_like(u[0])])


SYSTEM = LagrangianSystem(
    name="two-mass-drive",
    coordinates=(Coordinate("motor", "angular"), Coordinate("load", "angular")),
    inputs=(Input("torque", "N m"),),
    parameters=(
        Parameter("motor_inertia", "kg m^2", 4e-4, 1e-5, 1e-2),
        Parameter("load_inertia", "kg m^2", 1.5e-3, 1e-5, 0.1),
        Parameter("stiffness", "N m/rad", 2.0, 0.05, 100.0),
        Parameter("half_backlash", "rad", 0.02, 0.0, 0.2),
        Parameter("shaft_viscous", "N m s/rad", 1e-3, 1e-6, 0.1),
        Parameter("motor_viscous", "N m s/rad", 5e-4, 1e-6, 0.05),
        Parameter("load_viscous", "N m s/rad", 5e-4, 1e-6, 0.05),
        Parameter("motor_coulomb", "N m", 5e-3, 1e-5, 0.2),
        Parameter("load_coulomb", "N m", 5e-3, 1e-5, 0.2),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(
        Link("motor", (1.0, 0.0, 0.0), (0.0, 0.0, 0.1), parent=BASE, shape="wheel"),
        Link(
            "load",
            (1.0, 0.0, 0.0),
            (0.0, 0.0, 0.15),
            parent=BASE,
            at=(0.3, 0.0, 0.0),
            shape="wheel",
        ),
    ),
)
TWIN = Twin(
    SYSTEM,
    {
        "motor_inertia": 3.1e-4,
        "load_inertia": 1.9e-3,
        "stiffness": 2.6,
        "half_backlash": 0.035,
        "shaft_viscous": 1.7e-3,
        "motor_viscous": 8e-4,
        "load_viscous": 3e-4,
        "motor_coulomb": 7e-3,
        "load_coulomb": 3e-3,
    },
    resolution=(1.5e-3, 1.5e-3),
    amplitude=(0.4,),
    band=(0.7, 12.0),
    rest=(0.0, 0.0),
    spread=(0.0, 0.0),
    dt=0.005,
    seconds=4.0,
)
