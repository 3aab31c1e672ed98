"""The system file of the campaign: a pendulum with friction, driven by a torque."""

import jax.numpy as jnp

import tustinnet as tn

SYSTEM = tn.LagrangianSystem(
    name="small-pendulum",
    coordinates=(tn.Coordinate("angle", "angular"),),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(
        tn.Parameter("inertia", "kg m^2", 1.0, 0.1, 10.0, fixed=True),
        tn.Parameter("gravity", "N m", 10.0, 1.0, 100.0),
        tn.Parameter("damping", "N m s/rad", 0.3, 0.01, 10.0),
        tn.Parameter("gain", "1", 2.0, 0.1, 40.0),
    ),
    kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
    potential=lambda q, p: -p["gravity"] * jnp.cos(q[0]),
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: p["gain"] * u,
)
