"""Gantry crane: a trolley on a rail with a load on a rope of constant length.

The rope's angle is 0 where the load hangs down and grows towards positive positions of the trolley.
"""

import jax.numpy as jnp

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin

GRAVITY = 9.81  # m/s^2
SLOW = 0.01  # m/s, width of the smoothed sign in the trolley's Coulomb friction


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The trolley, and the load as a point at the rope's end [J]."""
    swing = p["rope_length"] * v[1]
    load = v[0] ** 2 + 2 * jnp.cos(q[1]) * v[0] * swing + swing**2
    return (p["trolley_mass"] * v[0] ** 2 + p["load_mass"] * load) / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """Height of the load [J]."""
    return -p["load_mass"] * GRAVITY * p["rope_length"] * jnp.cos(q[1])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Friction of the trolley, and of the swinging rope [N, N m]."""
    dry = forces.coulomb(v[0], p["trolley_coulomb"], SLOW)
    return jnp.stack([forces.viscous(v[0], p["trolley_viscous"]) + dry, p["rope_viscous"] * v[1]])


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The motor pulls the trolley [N]."""
    return jnp.stack([p["gain"] * u[0], jnp.zeros_like(u[0])])


SYSTEM = LagrangianSystem(
    name="crane",
    coordinates=(Coordinate("trolley", "linear"), Coordinate("rope", "angular")),
    inputs=(Input("voltage", "V"),),
    parameters=(
        Parameter("trolley_mass", "kg", 3.0, 0.3, 30.0),
        Parameter("load_mass", "kg", 1.5, 0.1, 20.0, fixed=True),
        Parameter("rope_length", "m", 0.8, 0.2, 5.0),
        Parameter("gain", "N/V", 6.0, 0.5, 100.0),
        Parameter("trolley_viscous", "N s/m", 10.0, 0.1, 500.0),
        Parameter("trolley_coulomb", "N", 2.0, 1e-2, 50.0),
        Parameter("rope_viscous", "N m s/rad", 5e-3, 1e-5, 1.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(
        Link("trolley", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        Link("rope", (0.0, -1.0, 0.0), (0.0, 0.0, -0.8), shape="rope"),
    ),
)
TWIN = Twin(
    SYSTEM,
    {
        "trolley_mass": 2.4,
        "rope_length": 0.67,
        "gain": 7.3,
        "trolley_viscous": 13.0,
        "trolley_coulomb": 1.4,
        "rope_viscous": 8e-3,
    },
    resolution=(1e-4, 1.5e-3),
    amplitude=(3.0,),
    band=(0.2, 2.0),
    rest=(0.0, 0.0),
    spread=(0.2, 0.3),
    dt=0.02,
    seconds=12.0,
)
