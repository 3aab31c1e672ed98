"""A fast Duffing oscillator: a mass on a spring that stiffens, driven by a voltage.

The values are like those of an electronic circuit that behaves as such a mass: resonance at 68 Hz,
light damping, a deflection of some centimetres. duffing_twin.py makes logs of it:

    python examples/duffing_twin.py LOGS
    tustinnet fit LOGS --system examples/duffing.py --out my-oscillator

References:
    Wigren, Schoukens (2013), Three free data sets for development and benchmarking in nonlinear
    system identification, European Control Conference (a circuit of this kind).
"""

import tustinnet as tn
from tustinnet.models import forces


def kinetic(q, v, p):
    """The mass moves [J]."""
    return p["mass"] * v[0] ** 2 / 2


def potential(q, p):
    """The spring stiffens with the deflection, to both sides alike [J]."""
    return forces.linear_spring(q[0], p["stiffness"]) + forces.cubic_spring(q[0], p["cubic"])


def dissipation(q, v, p):
    """Viscous friction [N]."""
    return forces.viscous(v, p["damping"])


def input_map(q, v, u, p):
    """The voltage pushes the mass [N]."""
    return p["gain"] * u


SYSTEM = tn.LagrangianSystem(
    name="duffing",
    coordinates=(tn.Coordinate("deflection", "linear"),),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        tn.Parameter("mass", "kg", 1.0, 0.5, 2.0, fixed=True),
        tn.Parameter("stiffness", "N/m", 1.8e5, 1e4, 1e6),
        tn.Parameter("cubic", "N/m^3", 5e5, 0.0, 5e6),
        tn.Parameter("damping", "N s/m", 40.0, 1.0, 400.0),
        tn.Parameter("gain", "N/V", 1.8e5, 1e4, 1e6),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(tn.Link("deflection", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),),
)
