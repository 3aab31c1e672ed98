"""A double pendulum with both joints driven; the second angle is relative to the first link.

Use it with the card double_pendulum_dfki.toml:

    tustinnet fit FOLDER --card examples/double_pendulum_dfki.toml \
        --system examples/double_pendulum.py --out my-pendulum

References:
    github.com/dfki-ric-underactuated-lab/double_pendulum (dimensions, ranges).
"""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

GRAVITY = 9.81  # m/s^2
LENGTH = 0.2  # m, from shoulder to elbow
SLOW = 0.1  # rad/s, width of the smoothed sign in the Coulomb friction
GEAR = 6.0


def kinetic(q, v, p):
    """Both links about the shoulder, and the rotors that turn GEAR times as fast [J]."""
    second = v[0] + v[1]  # speed of the second link
    elbow = p["mass2"] * LENGTH**2 * v[0] ** 2 / 2
    coupling = p["mass2"] * LENGTH * p["centre2"] * jnp.cos(q[1]) * v[0] * second
    links = p["inertia1"] * v[0] ** 2 / 2 + elbow + coupling + p["inertia2"] * second**2 / 2
    # the elbow's motor sits at the shoulder and drives the second link by a belt
    rotors = p["rotor"] * ((GEAR * v[0]) ** 2 + (v[0] + GEAR * v[1]) ** 2) / 2
    return links + rotors


def potential(q, p):
    """Heights of both centres of mass, 0 hangs down [J]."""
    first = p["moment1"] + p["mass2"] * LENGTH
    second = p["mass2"] * p["centre2"]
    return -GRAVITY * (first * jnp.cos(q[0]) + second * jnp.cos(q[0] + q[1]))


def dissipation(q, v, p):
    """Viscous and Coulomb friction in both joints [N m]."""
    damping = jnp.stack([p["viscous1"], p["viscous2"]])
    dry = jnp.stack([p["dry1"], p["dry2"]])
    return forces.viscous(v, damping) + forces.coulomb(v, dry, SLOW)


def input_map(q, v, u, p):
    """Both motors' torques [N m]."""
    return u


SYSTEM = tn.LagrangianSystem(
    name="double-pendulum",
    coordinates=(tn.Coordinate("shoulder", "angular"), tn.Coordinate("elbow", "angular")),
    inputs=(tn.Input("shoulder_torque", "N m"), tn.Input("elbow_torque", "N m")),
    parameters=(
        tn.Parameter("inertia1", "kg m^2", 0.03, 0.005, 0.15),
        tn.Parameter("moment1", "kg m", 0.1, 0.02, 0.4),
        tn.Parameter("mass2", "kg", 0.63, 0.3, 1.2),
        tn.Parameter("centre2", "m", 0.256, 0.1, 0.4, fixed=True),
        tn.Parameter("inertia2", "kg m^2", 0.05, 0.01, 0.15),
        tn.Parameter("rotor", "kg m^2", 6.29e-5, 1e-6, 5e-4),
        tn.Parameter("viscous1", "N m s/rad", 1e-2, 1e-5, 0.5),
        tn.Parameter("viscous2", "N m s/rad", 1e-2, 1e-5, 0.5),
        tn.Parameter("dry1", "N m", 0.1, 1e-3, 0.5),
        tn.Parameter("dry2", "N m", 0.1, 1e-3, 0.5),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(
        tn.Link("shoulder", (0.0, -1.0, 0.0), (0.0, 0.0, -LENGTH)),
        tn.Link("elbow", (0.0, -1.0, 0.0), (0.0, 0.0, -0.3)),
    ),
)
