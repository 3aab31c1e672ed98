"""A carriage on a screw, driven by a motor, with friction that is highest near standstill."""

import tustinnet as tn
from tustinnet.models import forces

SLOW = 0.002  # m/s, width of the smoothed sign in the dry friction


def kinetic(q, v, p):
    """All that moves, as a mass of the carriage [J]."""
    return p["mass"] * v[0] ** 2 / 2


def dissipation(q, v, p):
    """Viscous and Stribeck friction [N]."""
    dry = forces.stribeck(v, p["level"], p["breakaway"], p["slowing"], SLOW)
    return forces.viscous(v, p["viscous"]) + dry


def input_map(q, v, u, p):
    """The motor's force [N]."""
    return p["gain"] * u


SYSTEM = tn.LagrangianSystem(
    name="positioning-axis",
    coordinates=(tn.Coordinate("carriage", "linear"),),
    inputs=(tn.Input("control", "V"),),
    parameters=(
        tn.Parameter("mass", "kg", 40.0, 5.0, 200.0),
        tn.Parameter("viscous", "N s/m", 40.0, 1.0, 1000.0),
        tn.Parameter("level", "N", 20.0, 1.0, 100.0),
        tn.Parameter("breakaway", "N", 30.0, 1.0, 200.0),
        tn.Parameter("slowing", "m/s", 0.03, 0.005, 0.2),
        tn.Parameter("gain", "N/V", 30.0, 20.0, 40.0, fixed=True),
    ),
    kinetic=kinetic,
    dissipation=dissipation,
    input_map=input_map,
)
