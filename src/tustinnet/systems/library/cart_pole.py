"""Cart-pole: a pole that swings on a cart, which a motor pulls along a rail.

The pole's angle is 0 upright and grows as the pole leans towards positive positions of the cart.
"""

import jax.numpy as jnp

from tustinnet.channels import Coordinate, Input
from tustinnet.models import forces
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.kinematics import Link
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.twin import Twin

GRAVITY = 9.81  # m/s^2
SLOW = 0.01  # m/s, width of the smoothed sign in the cart's Coulomb friction


def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
    """The cart slides; the pole moves with it and turns [J]."""
    along = v[0] + p["pole_centre"] * jnp.cos(q[1]) * v[1]
    up = p["pole_centre"] * jnp.sin(q[1]) * v[1]
    pole = p["pole_mass"] * (along**2 + up**2) + p["pole_inertia"] * v[1] ** 2
    return (p["cart_mass"] * v[0] ** 2 + pole) / 2


def potential(q: Coordinates, p: Values) -> Scalar:
    """Height of the pole's centre [J]."""
    return p["pole_mass"] * GRAVITY * p["pole_centre"] * jnp.cos(q[1])


def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
    """Friction of the rail, back EMF included, and of the pivot [N, N m]."""
    dry = forces.coulomb(v[0], p["cart_coulomb"], SLOW)
    return jnp.stack([forces.viscous(v[0], p["cart_viscous"]) + dry, p["pole_viscous"] * v[1]])


def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
    """The motor pulls the cart [N]."""
    return jnp.stack([p["gain"] * u[0], jnp.zeros_like(u[0])])


SYSTEM = LagrangianSystem(
    name="cart-pole",
    coordinates=(Coordinate("cart", "linear"), Coordinate("pole", "angular")),
    inputs=(Input("voltage", "V"),),
    parameters=(
        Parameter("cart_mass", "kg", 0.6, 0.1, 5.0),
        # weight and balance of the pole set the scale of all forces
        Parameter("pole_mass", "kg", 0.15, 0.02, 1.0, fixed=True),
        Parameter("pole_centre", "m", 0.3, 0.05, 1.0, fixed=True),
        Parameter("pole_inertia", "kg m^2", 3e-3, 1e-4, 0.1),
        Parameter("gain", "N/V", 1.5, 0.1, 20.0),
        Parameter("cart_viscous", "N s/m", 3.0, 0.05, 100.0),
        Parameter("cart_coulomb", "N", 0.3, 1e-3, 10.0),
        Parameter("pole_viscous", "N m s/rad", 1e-3, 1e-6, 0.1),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(
        Link("cart", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        Link("pole", (0.0, 1.0, 0.0), (0.0, 0.0, 0.5)),
    ),
)
TWIN = Twin(
    SYSTEM,
    {
        "cart_mass": 0.52,
        "pole_inertia": 4.2e-3,
        "gain": 1.7,
        "cart_viscous": 4.1,
        "cart_coulomb": 0.4,
        "pole_viscous": 1.6e-3,
    },
    resolution=(2e-5, 1.5e-3),
    amplitude=(2.5,),
    band=(0.3, 3.0),
    rest=(0.0, 3.14),
    spread=(0.1, 1.5),
)
