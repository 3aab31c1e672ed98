"""Ball and beam: a ball rolls along a beam, which a motor turns about its middle.

At the angle 0 the beam is level; a positive angle lifts its end at positive positions of the ball.
"""

import jax.numpy as jnp

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin

GRAVITY = 9.81  # m/s^2


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The ball rolls, and turns with the beam [J]."""
    rolling = p["rolling_ratio"] * p["ball_mass"] * v[0] ** 2
    return (rolling + (p["beam_inertia"] + p["ball_mass"] * q[0] ** 2) * v[1] ** 2) / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """Height of the ball; the beam is balanced [J]."""
    return p["ball_mass"] * GRAVITY * q[0] * jnp.sin(q[1])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Rolling friction, and friction of the pivot, back EMF included [N, N m]."""
    return forces.viscous(v, jnp.stack([p["ball_viscous"], p["beam_viscous"]]))


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The motor turns the beam [N m]."""
    return jnp.stack([jnp.zeros_like(u[0]), p["gain"] * u[0]])


SYSTEM = LagrangianSystem(
    name="ball-and-beam",
    coordinates=(Coordinate("ball", "linear"), Coordinate("beam", "angular")),
    inputs=(Input("voltage", "V"),),
    parameters=(
        Parameter("ball_mass", "kg", 0.1, 0.01, 1.0, fixed=True),
        # 1 + 2/5 for a solid ball on a flat beam, more where it rolls in a groove
        Parameter("rolling_ratio", "1", 1.4, 1.1, 3.0),
        Parameter("beam_inertia", "kg m^2", 0.03, 1e-3, 1.0),
        Parameter("gain", "N m/V", 0.1, 5e-3, 5.0),
        Parameter("ball_viscous", "N s/m", 0.02, 1e-4, 1.0),
        Parameter("beam_viscous", "N m s/rad", 0.02, 1e-4, 5.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(
        Link("beam", (0.0, -1.0, 0.0), (0.4, 0.0, 0.0), shape="beam"),
        Link("ball", (1.0, 0.0, 0.0), (0.0, 0.0, 0.02), at=(0.0, 0.0, 0.0), shape="ball"),
    ),
)
# without a controller the ball soon leaves the beam, so records are short
TWIN = Twin(
    SYSTEM,
    {
        "rolling_ratio": 1.57,
        "beam_inertia": 0.042,
        "gain": 0.13,
        "ball_viscous": 0.034,
        "beam_viscous": 0.055,
    },
    resolution=(1e-4, 1.5e-3),
    amplitude=(1.2,),
    band=(0.7, 4.0),
    rest=(0.0, 0.0),
    spread=(0.15, 0.1),
    seconds=0.8,
)
