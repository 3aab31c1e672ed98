"""Chains of links that hang and swing in a plane, a torque at the first joint.

Each angle is relative to the link before, as encoders in the joints measure it; at 0 all links hang
in a straight line.
"""

from typing import Any

import jax.numpy as jnp

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin

GRAVITY = 9.81  # m/s^2


def make_link_chain(count: int) -> LagrangianSystem:
    """A chain of links that hang and swing in a plane.

    Args:
        count: number of links; link i has the coordinate `joint<i>`, from 1 on.
    """
    numbers = range(1, count + 1)

    def points(angles: list[Any], p: Values) -> list[tuple[list[Any], list[Any]]]:
        """Lengths from joint to joint, then to the centre, and angles, for each link's centre."""
        lengths = [p[f"length{i}"] for i in numbers]
        return [([*lengths[:k], p[f"centre{k + 1}"]], angles[: k + 1]) for k in range(count)]

    def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
        """Links move with their centres and turn [J]."""
        speeds, energy = jnp.cumsum(v), jnp.zeros(())
        for i, (lengths, angles) in zip(numbers, points(list(jnp.cumsum(q)), p), strict=True):
            pairs = list(zip(lengths, angles, speeds[:i], strict=True))
            along = sum(length * jnp.cos(a) * w for length, a, w in pairs)
            up = sum(length * jnp.sin(a) * w for length, a, w in pairs)
            energy = energy + p[f"mass{i}"] * (along**2 + up**2) / 2
            energy = energy + p[f"inertia{i}"] * speeds[i - 1] ** 2 / 2
        return energy

    def potential(q: Coordinates, p: Values) -> Scalar:
        """Height of the centres [J]."""
        energy = jnp.zeros(())
        for i, (lengths, angles) in zip(numbers, points(list(jnp.cumsum(q)), p), strict=True):
            drop = sum(length * jnp.cos(a) for length, a in zip(lengths, angles, strict=True))
            energy = energy - p[f"mass{i}"] * GRAVITY * drop
        return energy

    def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
        """Viscous friction of the joints [N m]."""
        return forces.viscous(v, jnp.stack([p[f"viscous{i}"] for i in numbers]))

    def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
        """The torque turns the first link [N m]."""
        return jnp.concatenate([u, jnp.zeros(count - 1)])

    parameters = [
        parameter
        for i in numbers
        for parameter in (
            Parameter(f"mass{i}", "kg", 0.3, 0.01, 10.0, fixed=True),
            Parameter(f"length{i}", "m", 0.3, 0.02, 2.0, fixed=True),
            Parameter(f"centre{i}", "m", 0.15, 0.005, 1.0),
            Parameter(f"inertia{i}", "kg m^2", 2e-3, 1e-5, 1.0),
            Parameter(f"viscous{i}", "N m s/rad", 2e-3, 1e-6, 0.2),
        )
    ]
    return LagrangianSystem(
        name=f"{count}-link-chain",
        coordinates=tuple(Coordinate(f"joint{i}", "angular") for i in numbers),
        inputs=(Input("torque", "N m"),),
        parameters=tuple(parameters),
        kinetic=kinetic,
        potential=potential,
        dissipation=dissipation,
        input_map=input_map,
        links=tuple(Link(f"joint{i}", (0.0, -1.0, 0.0), (0.0, 0.0, -0.3)) for i in numbers),
    )


TWO_LINKS, THREE_LINKS = make_link_chain(2), make_link_chain(3)
TWIN = Twin(
    TWO_LINKS,
    {
        "centre1": 0.17,
        "inertia1": 2.7e-3,
        "viscous1": 4e-3,
        "centre2": 0.13,
        "inertia2": 1.5e-3,
        "viscous2": 1.2e-3,
    },
    resolution=(1.5e-3, 1.5e-3),
    amplitude=(0.15,),
    band=(0.3, 2.0),
    rest=(0.0, 0.0),
    spread=(0.5, 0.5),
    seconds=4.0,
)
