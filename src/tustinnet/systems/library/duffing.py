"""Duffing oscillator: a driven mass on a spring that stiffens.

Motion shows only ratios, so that the mass is fixed; a force in N has no gain to be found.
"""

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The mass moves [J]."""
    return p["mass"] * v[0] ** 2 / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """The spring, its force linear and cubic in the deflection [J]."""
    return forces.linear_spring(q[0], p["stiffness"]) + forces.cubic_spring(q[0], p["cubic"])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Viscous friction [N]."""
    return forces.viscous(v, p["damping"])


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The voltage pushes the mass [N]."""
    return p["gain"] * u


SYSTEM = LagrangianSystem(
    name="duffing",
    coordinates=(Coordinate("deflection", "linear"),),
    inputs=(Input("voltage", "V"),),
    parameters=(
        Parameter("mass", "kg", 1.0, 0.1, 10.0, fixed=True),
        Parameter("stiffness", "N/m", 100.0, 1.0, 1e7),
        Parameter("cubic", "N/m^3", 1e4, -1e9, 1e9),
        Parameter("damping", "N s/m", 1.0, 1e-3, 1e4),
        Parameter("gain", "N/V", 1.0, 1e-3, 1e7),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(Link("deflection", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), shape="spring"),),
)
TWIN = Twin(
    SYSTEM,
    {"stiffness": 140.0, "cubic": 2.3e4, "damping": 0.7, "gain": 1.6},
    resolution=(1e-4,),
    amplitude=(3.0,),
    band=(0.5, 5.0),
    rest=(0.0,),
    spread=(0.02,),
)
