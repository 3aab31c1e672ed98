"""A mass on a spring that stiffens, driven by a voltage."""

import tustinnet as tn
from tustinnet.models import forces


def kinetic(q, v, p):
    """The mass [J]."""
    return p["mass"] * v[0] ** 2 / 2


def potential(q, p):
    """The spring [J]."""
    return forces.linear_spring(q[0], p["stiffness"]) + forces.cubic_spring(q[0], p["cubic"])


def dissipation(q, v, p):
    """Viscous friction [N]."""
    return forces.viscous(v, p["damping"])


def input_map(q, v, u, p):
    """The voltage pushes the mass [N]."""
    return p["gain"] * u


SYSTEM = tn.LagrangianSystem(
    name="duffing-fast",
    coordinates=(tn.Coordinate("deflection", "linear"),),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        tn.Parameter("mass", "kg", 1.0, 0.5, 2.0, fixed=True),
        tn.Parameter("stiffness", "N/m", 1.2e5, 1e4, 1e6),
        tn.Parameter("cubic", "N/m^3", 3e5, 0.0, 1e7),
        tn.Parameter("damping", "N s/m", 25.0, 1.0, 400.0),
        tn.Parameter("gain", "N/V", 1.2e5, 1e4, 1e6),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
