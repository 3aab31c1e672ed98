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

    def of_links(name: str, p: Values) -> Any:
        """A parameter of all links, (count,)."""
        return jnp.stack([p[f"{name}{i}"] for i in numbers])

    def to_centres(directions: Any, p: Values) -> Any:
        """Sums along the chain up to the centre of each link, of a direction of each, (count,)."""
        lengths = of_links("length", p)
        return jnp.cumsum(lengths * directions) - (lengths - of_links("centre", p)) * directions

    def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
        """Links move with their centres and turn [J]."""
        angles, speeds = jnp.cumsum(q), jnp.cumsum(v)
        along, up = (to_centres(f(angles) * speeds, p) for f in (jnp.cos, jnp.sin))
        moving = of_links("mass", p) * (along**2 + up**2)
        return jnp.sum(moving + of_links("inertia", p) * speeds**2) / 2

    def potential(q: Coordinates, p: Values) -> Scalar:
        """Height of the centres [J]."""
        drops = to_centres(jnp.cos(jnp.cumsum(q)), p)
        return -GRAVITY * jnp.sum(of_links("mass", p) * drops)

    def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
        """Viscous friction of the joints [N m]."""
        return forces.viscous(v, of_links("viscous", p))

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
