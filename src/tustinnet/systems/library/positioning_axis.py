"""Positioning axis: a carriage on a screw, with friction that is highest at the onset of motion."""

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin

SLOW = 2e-3  # m/s, width of the smoothed sign in the friction


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The carriage and what turns with it, as a mass [J]."""
    return p["mass"] * v[0] ** 2 / 2


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Viscous and Stribeck friction [N]."""
    level, breakaway = p["coulomb"], p["coulomb"] + p["breakaway"]
    dry = forces.stribeck(v, level, breakaway, p["stribeck_speed"], SLOW)
    return forces.viscous(v, p["viscous"]) + dry


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The motor's force by its current [N]."""
    return p["force_constant"] * u


SYSTEM = LagrangianSystem(
    name="positioning-axis",
    coordinates=(Coordinate("carriage", "linear"),),
    inputs=(Input("current", "A"),),
    parameters=(
        Parameter("mass", "kg", 40.0, 2.0, 500.0),
        Parameter("viscous", "N s/m", 40.0, 0.1, 2000.0),
        Parameter("coulomb", "N", 20.0, 0.1, 500.0),
        # what the friction at the onset of motion is above that at speed
        Parameter("breakaway", "N", 10.0, 0.1, 500.0),
        Parameter("stribeck_speed", "m/s", 0.03, 5e-3, 0.5),
        Parameter("force_constant", "N/A", 30.0, 1.0, 1000.0, fixed=True),
    ),
    kinetic=kinetic,
    dissipation=dissipation,
    input_map=input_map,
    links=(Link("carriage", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),),
)
TWIN = Twin(
    SYSTEM,
    {"mass": 53.0, "viscous": 75.0, "coulomb": 14.0, "breakaway": 9.0, "stribeck_speed": 0.045},
    resolution=(1e-6,),
    amplitude=(1.6,),
    band=(0.3, 4.0),
    rest=(0.0,),
    spread=(0.0,),
    dt=0.005,
    seconds=4.0,
)
