"""EMPS, an electro-mechanical positioning system: a carriage on a screw, driven by a motor.

Force balance: M a = gain u - viscous - Coulomb friction - offset. Use it with the card emps.toml:

    tustinnet fit FOLDER --card examples/emps.toml \
        --system examples/emps.py --out my-emps

References:
    Janot, Gautier, Brunot (2019), Data set and reference models of EMPS, Workshop on nonlinear
    system identification benchmarks (gain and ranges).
"""

import tustinnet as tn
from tustinnet.models import forces

SLOW = 1e-3  # m/s, width of the smoothed sign in the Coulomb friction


def kinetic(q, v, p):
    """All that moves, as a mass of the carriage [J]."""
    return p["mass"] * v[0] ** 2 / 2


def dissipation(q, v, p):
    """Viscous and Coulomb friction and a constant force [N]."""
    return forces.viscous(v, p["viscous"]) + forces.coulomb(v, p["dry"], SLOW) + p["offset"]


def input_map(q, v, u, p):
    """The motor's force [N]."""
    return p["gain"] * u


SYSTEM = tn.LagrangianSystem(
    name="emps",
    coordinates=(tn.Coordinate("position", "linear"),),
    inputs=(tn.Input("control", "V"),),
    parameters=(
        tn.Parameter("mass", "kg", 80.0, 20.0, 300.0),
        tn.Parameter("viscous", "N s/m", 150.0, 1.0, 1000.0),
        tn.Parameter("dry", "N", 20.0, 0.1, 100.0),
        tn.Parameter("offset", "N", 0.0, -30.0, 30.0),
        tn.Parameter("gain", "N/V", 35.15, 30.0, 40.0, fixed=True),
    ),
    kinetic=kinetic,
    dissipation=dissipation,
    input_map=input_map,
    links=(tn.Link("position", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),),
)
