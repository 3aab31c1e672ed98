"""A pendulum balanced on a motor's arm, and records of it under its own controller."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

import tustinnet as tn

DT = 0.01
COUNT = 2 * np.pi / 4096
TRUTH = {
    "mass": 0.1,
    "length": 0.13,
    "radius": 0.15,
    "arm_inertia": 2e-3,
    "arm_damping": 8e-3,
    "pendulum_damping": 1e-3,
    "gain": 0.03,
}
_LIMIT = 10.0  # V
_FILTER = 0.5  # of the controller's velocities: share of the newest difference


def _kinetic(q, v, p):
    """The rod's mass moves with the arm's end and about it."""
    across = p["radius"] * v[0] + p["length"] * v[1] * jnp.cos(q[1])
    upwards = p["length"] * v[1] * jnp.sin(q[1])
    return (p["arm_inertia"] * v[0] ** 2 + p["mass"] * (across**2 + upwards**2)) / 2


SYSTEM = tn.LagrangianSystem(
    name="balanced arm",
    coordinates=(
        tn.Coordinate("arm", "angular", COUNT),
        tn.Coordinate("pendulum", "angular", COUNT),
    ),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        tn.Parameter("mass", "kg", TRUTH["mass"], 0.01, 1.0, fixed=True),
        tn.Parameter("length", "m", 0.1, 0.02, 0.5),
        tn.Parameter("radius", "m", TRUTH["radius"], 0.02, 0.5, fixed=True),
        tn.Parameter("arm_inertia", "kg m^2", 4e-3, 1e-4, 0.1),
        tn.Parameter("arm_damping", "N m s", 4e-3, 1e-5, 0.1),
        tn.Parameter("pendulum_damping", "N m s", 5e-4, 1e-5, 0.1),
        tn.Parameter("gain", "N m/V", 0.02, 1e-3, 1.0),
    ),
    kinetic=_kinetic,
    potential=lambda q, p: 9.81 * p["mass"] * p["length"] * jnp.cos(q[1]),  # 0 is upright
    dissipation=lambda q, v, p: jnp.stack([p["arm_damping"] * v[0], p["pendulum_damping"] * v[1]]),
    input_map=lambda q, v, u, p: jnp.stack([p["gain"] * u[0], 0.0 * u[0]]),
)


def balanced(count: int, seconds: float, seed: int = 0, push: float = 2.0) -> list[tn.Experiment]:
    """Records of a pendulum that a controller holds upright, read by encoders.

    Args:
        count: how many.
        seconds: length of each [s].
        seed: of disturbances and of the encoders' places.
        push: standard deviation of the voltage that disturbs, held for 50 ms [V].
    """
    generator = np.random.default_rng(seed)
    samples = round(seconds / DT)
    model = tn.discretise(SYSTEM.model({k: jnp.asarray(v) for k, v in TRUTH.items()}), DT, 8)
    moment = tn.linearize(model, np.zeros(4), np.zeros(1))
    cost, price = np.diag([1.0, 1.0, 0.01, 0.01]), np.eye(1) * 0.01
    value = scipy.linalg.solve_discrete_are(moment.a, moment.b, cost, price)
    gain = np.linalg.solve(price + moment.b.T @ value @ moment.b, moment.b.T @ value @ moment.a)
    pushes = push * generator.normal(size=(count, -(-samples // 5), 1)).repeat(5, axis=1)
    wanted = 0.5 * generator.choice([-1.0, 1.0], (count, -(-samples // 200))).repeat(200, axis=1)
    x0 = generator.uniform(-0.05, 0.05, (count, 4))
    place = generator.uniform(-0.5, 0.5, (count, 1, 2)) * COUNT
    q, u = map(
        np.asarray,
        _closed_loop(model, gain, x0, place[:, 0], pushes[:, :samples], wanted[:, :samples]),
    )
    return [
        tn.from_arrays(
            q[i],
            u[i],
            dt=DT,
            name=f"hold{i + 1}",
            coordinates=SYSTEM.coordinates,
            inputs=SYSTEM.inputs,
        )
        for i in range(count)
    ]


@jax.jit
@partial(jax.vmap, in_axes=(None, None, 0, 0, 0, 0))
def _closed_loop(model, gain, x0, place, pushes, wanted):
    """Positions as read, and voltages: state feedback on what was read and its differences."""

    def sample(carried, now):
        x, before, v = carried
        push, reference = now
        q = jnp.round((x[:2] - place) / COUNT) * COUNT + place
        v = v + _FILTER * ((q - before) / DT - v)
        error = jnp.concatenate([q - jnp.stack([reference, 0.0]), v])
        u = jnp.clip(push - gain @ error, -_LIMIT, _LIMIT)
        return (model.step(x, u), q, v), (q, u)

    return jax.lax.scan(sample, (x0, x0[:2], x0[2:]), (pushes, wanted))[1]
