"""A pendulum with a propeller at its end, whose speed lags behind the command; 0 hangs down.

The propeller's speed is an internal state, in units of the command. A record may begin while the
propeller turns: it is expected at the command's first sample then.

    tustinnet fit LOGS --recipe grey --system propeller_pendulum.py --out my-pendulum
"""

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.models import forces


def kinetic(q, v, p):
    """The arm with its motor [J]."""
    return p["inertia"] * v[0] ** 2 / 2


def potential(q, p):
    """Height of the centre of mass [J]."""
    return -p["gravity"] * jnp.cos(q[0])


def dissipation(q, v, p):
    """Friction [N m]."""
    return forces.viscous(v, p["damping"])


def spin_rate(q, v, z, u, p):
    """The propeller's speed follows the command [1/s]."""
    return forces.lag_rate(u, z, p["lag"])


def thrust(q, v, z, p):
    """The thrust grows with the square of the propeller's speed [N m]."""
    return p["thrust"] * z * jnp.abs(z)


def spin_at_first(q, v, u, p):
    """The command was there before the record."""
    return u


SYSTEM = tn.LagrangianSystem(
    name="propeller-pendulum",
    coordinates=(tn.Coordinate("arm", "angular"),),
    inputs=(tn.Input("command", "1"),),
    parameters=(
        # torques are those for 1 kg m^2: motion shows only their ratios to the inertia
        tn.Parameter("inertia", "kg m^2", 1.0, 0.5, 2.0, fixed=True),
        tn.Parameter("gravity", "N m", 30.0, 2.0, 200.0),
        tn.Parameter("damping", "N m s/rad", 0.1, 0.005, 10.0),
        tn.Parameter("thrust", "N m", 9.0, 1.0, 100.0),
        tn.Parameter("lag", "s", 0.05, 0.005, 1.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    memory=tn.Memory(("spin",), spin_rate, thrust, spin_at_first),
    links=(tn.Link("arm", axis=(0, -1, 0), reach=(0, 0, -0.5)),),
)
