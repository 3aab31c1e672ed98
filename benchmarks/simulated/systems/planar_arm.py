"""An arm of four links in a vertical plane, a motor in every joint; 0 hangs down.

Lengths, centres of mass and radii of gyration are those of the drawings; masses and friction are
identified. Joint angles are relative to the link before.
"""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces

GRAVITY = 9.81  # m/s^2
LENGTHS = (0.30, 0.26, 0.22, 0.15)  # m
CENTRE = 0.45  # of the length, from the joint
GYRATION = 0.1  # of mass times squared length, the inertia about the centre
SLOW = 0.05  # rad/s, width of the smoothed sign in the dry friction
LINKS = range(len(LENGTHS))


def values(p, name):
    """A parameter of every joint or link."""
    return jnp.stack([p[f"{name}{i + 1}"] for i in LINKS])


def kinetic(q, v, p):
    """Translation and rotation of every link [J]."""
    angle, speed, total = jnp.cumsum(q), jnp.cumsum(v), 0.0
    x, y = 0.0, 0.0  # velocity of the joint
    for i, length in enumerate(LENGTHS):
        mass = p[f"mass{i + 1}"]
        right, up = jnp.cos(angle[i]) * speed[i], jnp.sin(angle[i]) * speed[i]
        centre_x, centre_y = x + CENTRE * length * right, y + CENTRE * length * up
        total += mass * (centre_x**2 + centre_y**2 + GYRATION * (length * speed[i]) ** 2) / 2
        x, y = x + length * right, y + length * up
    return total


def potential(q, p):
    """Heights of the centres of mass [J]."""
    down, total = 0.0, 0.0
    for i, (length, angle) in enumerate(zip(LENGTHS, jnp.cumsum(q), strict=True)):
        total -= p[f"mass{i + 1}"] * GRAVITY * (down + CENTRE * length * jnp.cos(angle))
        down += length * jnp.cos(angle)
    return total


def dissipation(q, v, p):
    """Viscous and dry friction of every joint [N m]."""
    return forces.viscous(v, values(p, "viscous")) + forces.coulomb(v, values(p, "dry"), SLOW)


def input_map(q, v, u, p):
    """The motors' torques [N m]."""
    return u


SYSTEM = tn.LagrangianSystem(
    name="planar-arm",
    coordinates=tuple(tn.Coordinate(f"joint{i + 1}", "angular") for i in LINKS),
    inputs=tuple(tn.Input(f"torque{i + 1}", "N m") for i in LINKS),
    parameters=(
        *[tn.Parameter(f"mass{i + 1}", "kg", 1.5, 0.2, 10.0) for i in LINKS],
        *[tn.Parameter(f"viscous{i + 1}", "N m s/rad", 0.3, 0.01, 10.0) for i in LINKS],
        *[tn.Parameter(f"dry{i + 1}", "N m", 0.2, 0.005, 5.0) for i in LINKS],
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
)
