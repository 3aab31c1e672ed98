"""A pendulum on a motor, and records of it made with known values."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Memory, Parameter

DT = 0.02
TILT = 0.4  # of the direction that angles are counted from: the two sides differ
COUNT = 2 * np.pi / 4096
TRUTH = {"inertia": 0.05, "damping": 0.02, "gravity": 1.5, "gain": 0.15}
FAR = {"damping": 0.06, "gravity": 0.5, "gain": 0.45}  # a factor of 3 away

SWING = LagrangianSystem(
    name="swing",
    coordinates=(tn.Coordinate("angle", "angular"),),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        Parameter("inertia", "kg m^2", 0.05, 0.01, 0.2, fixed=True),
        Parameter("damping", "N m s", 0.04, 1e-3, 1.0),
        Parameter("gravity", "N m", 1.0, 0.1, 10.0),
        Parameter("gain", "N m/V", 0.1, 0.01, 1.0),
    ),
    kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
    potential=lambda q, p: -p["gravity"] * jnp.cos(q[0] - TILT),
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: p["gain"] * u,
)
_CREEP = Memory(
    ("creep",),
    lambda q, v, z, p: v - p["relaxation"] * z,
    lambda q, v, z, p: -p["stiffness"] * z,
)
CREEPING = replace(
    SWING,
    name="creeping swing",
    parameters=(
        *SWING.parameters,
        Parameter("offset", "N m", 0.05, -1.0, 1.0),
        Parameter("stiffness", "N m/rad", 0.4, 0.01, 10.0),
        Parameter("relaxation", "1/s", 3.0, 0.1, 100.0),
    ),
    input_map=lambda q, v, u, p: p["gain"] * u + p["offset"],
    memory=_CREEP,
)
# the same after it was turned: it remembers a part of the angle at which a record begins
TURNED = replace(
    CREEPING,
    name="turned swing",
    parameters=(*CREEPING.parameters, Parameter("turned", "1", 0.3, 0.0, 1.5)),
    memory=replace(_CREEP, initial=lambda q, v, p: p["turned"] * q),
)
# its motor lags behind the voltage; a record begins with a part of the lag over
LAGGING = replace(
    SWING,
    name="lagging swing",
    parameters=(
        *SWING.parameters,
        Parameter("lag", "s", 0.05, 5e-3, 1.0),
        Parameter("share", "1", 0.8, 0.0, 1.5),
    ),
    input_map=None,
    memory=Memory(
        ("drive",),
        lambda q, v, z, u, p: (u - z) / p["lag"],
        lambda q, v, z, p: p["gain"] * z,
        lambda q, v, u, p: p["share"] * u,
    ),
)
# a cart with a pendulum: both kinds of coordinates, an inertia between them
CART = LagrangianSystem(
    name="cart",
    coordinates=(tn.Coordinate("x", "linear"), tn.Coordinate("angle", "angular")),
    inputs=(tn.Input("force", "N"),),
    parameters=(Parameter("mass", "kg", 1.0, 0.1, 5.0),),
    kinetic=lambda q, v, p: p["mass"] * v[0] ** 2 + v[0] * v[1] * jnp.cos(q[1]) + v[1] ** 2,
    potential=lambda q, p: jnp.cos(q[1]) + q[0] ** 2,
    dissipation=lambda q, v, p: 0.1 * v,
    input_map=lambda q, v, u, p: jnp.stack([u[0], 0.0 * u[0]]),
)


def changed(name: str, system: LagrangianSystem = SWING, **changes) -> LagrangianSystem:
    """The system with one parameter declared otherwise."""
    parameters = tuple(replace(p, **changes) if p.name == name else p for p in system.parameters)
    return replace(system, parameters=parameters)


def swing_model(
    values: Mapping[str, float] = TRUTH, system: LagrangianSystem = SWING
) -> LagrangianModel:
    """The system with the values that the records are made with, or others."""
    everything = system.nominal() | TRUTH | dict(values)
    return system.model({k: jnp.asarray(v) for k, v in everything.items()})


def simulated(
    name: str,
    x0: list[float],
    u: np.ndarray,
    values: Mapping[str, float] = TRUTH,
    system: LagrangianSystem = SWING,
) -> tn.Experiment:
    """A record without noise, with its velocities."""
    model = tn.discretise(swing_model(values, system), DT, 8)
    drive = u[:-1, None]
    if system.inputs[0].hold == "first-order":
        drive = np.stack([u[:-1, None], np.diff(u)[:, None]], axis=1)
    x = np.asarray(tn.rollout(model, np.array(x0), drive))
    return tn.from_arrays(
        x[:, 0],
        u,
        v=x[:, 1],
        dt=DT,
        name=name,
        coordinates=system.coordinates,
        inputs=declared(system.inputs),
    )


def declared(inputs: Iterable[tn.Input]) -> tuple[tn.Input, ...]:
    """Inputs whose holds and delays are known, so that nothing is searched for."""
    return tuple(replace(i, hold=i.hold or "zero-order", is_delay_declared=True) for i in inputs)


def voltage(samples: int, seed: int) -> np.ndarray:
    """White noise."""
    return np.random.default_rng(seed).uniform(-5, 5, samples)


@cache
def falls() -> tuple[tn.Experiment, tn.Experiment]:
    """Two free swings."""
    still = np.zeros(200)
    return simulated("fall1", [2.5, 0.0], still), simulated("fall2", [-1.5, 3.0], still)


@cache
def noises() -> tuple[tn.Experiment, tn.Experiment]:
    """Two records under noise, the second shorter."""
    return (
        simulated("noise1", [0.1, 0.0], voltage(200, 1)),
        simulated("noise2", [0.5, -1.0], voltage(160, 2)),
    )


def records() -> list[tn.Experiment]:
    """All four; as many and as long as elsewhere, so that compiled programs serve again."""
    return [*falls(), *noises()]


def read_by_encoder(e: tn.Experiment) -> tn.Experiment:
    """The record as an encoder reads it."""
    return replace(
        e,
        q=np.round(e.q / COUNT) * COUNT,
        v=None,
        v_measured=False,
        channels=replace(
            e.channels, coordinates=tuple(replace(c, resolution=COUNT) for c in e.coordinates)
        ),
    )


def driven_again(
    system: LagrangianSystem, values: dict[str, float], by: Iterable[tn.Experiment] | None = None
) -> list[tn.Experiment]:
    """What another system does from the starts and voltages of records, through encoders."""
    model = tn.discretise(
        system.model({k: jnp.asarray(x) for k, x in (system.nominal() | TRUTH | values).items()}),
        DT,
        8,
    )
    made = []
    for e in by or records():
        begun = jnp.concatenate([jnp.asarray(e.q[0]), jnp.asarray(e.velocities()[0])])
        x0 = np.asarray(model.initial_state(begun, jnp.asarray(e.u[0])))
        x = np.asarray(tn.rollout(model, x0, e.u[:-1]))
        made.append(read_by_encoder(replace(e, q=x[:, :1], v=x[:, 1:2])))
    return made


def noisy(e: tn.Experiment, size: float, seed: int) -> tn.Experiment:
    """The record with white noise on its positions."""
    noise = size * np.random.default_rng(seed).normal(size=e.q.shape)
    return replace(e, q=e.q + noise, v=None, v_measured=False)


def data_set(experiments: list[tn.Experiment]) -> tn.DataSet:
    return tn.DataSet("swing", tuple(experiments))
