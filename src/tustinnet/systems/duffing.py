"""A fast Duffing oscillator: a mass on a spring that stiffens, driven by a voltage.

The values are like those of an electronic circuit that behaves as such a mass: resonance at 68 Hz,
light damping, a deflection of some centimetres.

References:
    Wigren, Schoukens (2013), Three free data sets for development and benchmarking in nonlinear
    system identification, European Control Conference (a circuit of this kind).
"""

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The mass moves."""
    return p["mass"] * v[0] ** 2 / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """The spring stiffens with the deflection, to both sides alike."""
    return forces.linear_spring(q[0], p["stiffness"]) + forces.cubic_spring(q[0], p["cubic"])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Viscous friction."""
    return forces.viscous(v, p["damping"])


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The voltage pushes the mass."""
    return p["gain"] * u


SYSTEM = LagrangianSystem(
    name="duffing",
    coordinates=(Coordinate("deflection", "linear"),),
    inputs=(Input("voltage", "V"),),
    parameters=(
        Parameter("mass", "kg", 1.0, 0.5, 2.0, fixed=True),
        Parameter("stiffness", "N/m", 1.8e5, 1e4, 1e6),
        Parameter("cubic", "N/m^3", 5e5, 0.0, 5e6),
        Parameter("damping", "N s/m", 40.0, 1.0, 400.0),
        Parameter("gain", "N/V", 1.8e5, 1e4, 1e6),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(Link("deflection", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),),
)
