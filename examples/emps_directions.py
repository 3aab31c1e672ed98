"""EMPS with friction that depends on the direction of travel.

As emps.py, but friction at speed, viscous and quadratic, differs between the two directions: that
is most of what a single coefficient and a constant force leave (docs/explanation/accuracy.md). Use
it with the card emps_cut.toml:

    tustinnet fit FOLDER --card examples/emps_cut.toml \
        --system examples/emps_directions.py --out my-emps

References:
    Janot, Gautier, Brunot (2019), Data set and reference models of EMPS, Workshop on nonlinear
    system identification benchmarks (gain and ranges).
"""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

SLOW = 1e-3  # m/s, width of the smoothed sign in the Coulomb friction


def kinetic(q, v, p):
    """All that moves, as a mass of the carriage [J]."""
    return p["mass"] * v[0] ** 2 / 2


def dissipation(q, v, p):
    """Viscous and quadratic friction of each direction, Coulomb friction, a constant force [N]."""
    forward = (1 + jnp.tanh(v / SLOW)) / 2
    damping = p["viscous_forward"] * forward + p["viscous_backward"] * (1 - forward)
    curve = p["curve_forward"] * forward + p["curve_backward"] * (1 - forward)
    dry = forces.coulomb(v, p["dry"], SLOW) + p["offset"]
    return forces.viscous(v, damping) + curve * v * jnp.abs(v) + dry


def input_map(q, v, u, p):
    """The motor's force [N]."""
    return p["gain"] * u


SYSTEM = tn.LagrangianSystem(
    name="emps-directions",
    coordinates=(tn.Coordinate("position", "linear"),),
    inputs=(tn.Input("control", "V"),),
    parameters=(
        tn.Parameter("mass", "kg", 80.0, 20.0, 300.0),
        tn.Parameter("viscous_forward", "N s/m", 150.0, 1.0, 1000.0),
        tn.Parameter("viscous_backward", "N s/m", 150.0, 1.0, 1000.0),
        tn.Parameter("curve_forward", "N s^2/m^2", 0.0, -2000.0, 2000.0),
        tn.Parameter("curve_backward", "N s^2/m^2", 0.0, -2000.0, 2000.0),
        tn.Parameter("dry", "N", 20.0, 0.1, 100.0),
        tn.Parameter("offset", "N", 0.0, -30.0, 30.0),
        tn.Parameter("gain", "N/V", 35.15, 30.0, 40.0, fixed=True),
    ),
    kinetic=kinetic,
    dissipation=dissipation,
    input_map=input_map,
)
