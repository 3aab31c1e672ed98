"""Twins of robots: records in a closed loop, with encoders and noise of the torques."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.channels import Channels, PDController, PDLoop
from tustinnet.models.chains import Body, body_inertia, inertial_parameters
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.lagrangian import LagrangianSystem

COUNT = 2 * np.pi / 2**16

# an arm of two driven joints that gravity pulls down
LINK = """<link name="{0}"><inertial><origin xyz="{1} 0 0.01"/><mass value="{2}"/>
  <inertia ixx="0.002" iyy="0.02" izz="0.02"/></inertial></link>
  <joint name="{3}" type="continuous"><parent link="{4}"/><child link="{0}"/>
  <origin xyz="{5} 0 0"/><axis xyz="0 1 0"/><dynamics damping="0.8" friction="1.0"/>
  <limit effort="60" velocity="5"/></joint>"""
ARM = (
    '<robot name="arm"><link name="base"/>'
    + LINK.format("upper", 0.15, 2.5, "shoulder", "base", 0)
    + LINK.format("lower", 0.12, 1.2, "elbow", "upper", 0.3)
    + "</robot>"
)


def true_values(system: LagrangianSystem, seed: int, change: float = 0.3) -> dict[str, float]:
    """Values of a robot that is not just as its file says.

    Args:
        system: the robot.
        seed: seed of the differences.
        change: largest difference, in standard deviations of what the file says, or as a share.
    """
    rng, values = np.random.default_rng(seed), system.nominal()
    for p in system.parameters:
        kind = p.name.rpartition(".")[2]
        if p.fixed:
            continue
        if kind == "armature":
            # behind an elastic gear it begins at what is usual, and its range is wide
            size = 0.1 * p.upper if p.prior else p.nominal
            values[p.name] = p.nominal + size * rng.uniform(0.5, 1)
        elif kind == "offset":
            values[p.name] = 0.02 * p.upper * rng.uniform(-1, 1)
        elif kind == "breakaway":
            values[p.name] = values[p.name.replace(kind, "coulomb")] * rng.uniform(0.3, 0.8)
        elif kind == "load_friction":
            values[p.name] = rng.uniform(0.03, 0.1)
        elif p.lower >= 0:
            values[p.name] = p.nominal * np.exp(change * rng.uniform(-1, 1))
        else:
            values[p.name] = p.nominal + change * (p.prior or 0.0) * rng.uniform(-1, 1)
    return values


def with_payload(
    values: Mapping[str, float], link: str, mass: float, center: np.ndarray, radius: float = 0.02
) -> dict[str, float]:
    """Values of a robot one of whose links carries a ball.

    Args:
        values: the robot's values without it.
        link: the link.
        mass: mass of the ball [kg].
        center: its centre in the frame of the link, (3,) [m].
        radius: its radius of gyration about any axis [m].
    """
    rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    body = Body(link, None, "angular", rows[2], rows, (0.0, 0.0, 0.0), 0)
    own = body_inertia(body, values)
    whole = float(own.mass) + mass
    middle = (np.asarray(own.moment) + mass * center) / whole
    tensor = np.asarray(own.tensor) + mass * radius**2 * np.eye(3)
    for m, r in ((mass, center), (-whole, middle)):
        tensor = tensor + m * (r @ r * np.eye(3) - np.outer(r, r))
    changed = inertial_parameters(whole, middle, tensor)
    return dict(values) | {f"{link}.{name}": x for name, x in changed.items()}


def record_in_loop(
    system: LagrangianSystem,
    values: Mapping[str, float],
    count: int,
    seconds: float = 5.0,
    dt: float = 0.005,
    noise: float | np.ndarray = 0.02,
    seed: int = 0,
    amplitude: float = 0.6,
    motions: Sequence[tuple[np.ndarray, np.ndarray]] = (),
    *,
    knows_controller: bool = False,
    knows_gains: bool = True,
    substeps: int = 5,
    begins_moving: bool = False,
    resolution: float = COUNT,
) -> tn.DataSet:
    """Records of a robot that a PD controller moves along sums of sines, or other motions.

    Args:
        system: the robot; each input is the force at a joint, other joints swing freely.
        values: its parameters.
        count: number of records; the last is for validation.
        seconds: length of each [s].
        dt: sampling period [s].
        noise: standard deviation of the torques' noise, relative to that of the torques of the
            record; or that of each input, (n_u,) [N m or N].
        seed: seed of set points and noise.
        amplitude: size of the set points [rad or m].
        motions: positions and velocities that the first records follow instead, (n, n_q) each.
        knows_controller: whether the records have the set points of the controller as inputs.
        knows_gains: whether they have its gains, too.
        substeps: integration steps in a sampling period.
        begins_moving: whether the robot moves for a second before each record begins, so that its
            internal states are those of a motion.
        resolution: of the encoders [rad or m].
    """
    model = system.model({name: jnp.asarray(x) for name, x in values.items()})
    step = tn.compiled_step(tn.discretise(model, dt, substeps, inputs=system.inputs))
    n, rng, t = len(system.coordinates), np.random.default_rng(seed), np.arange(0, seconds, dt)
    # gains by the inertia that a joint sees, 3 Hz and well damped; more where friction is large
    before = dt * np.arange(-round(1 / dt), 0) if begins_moving else t[:0]
    rigid = rigid_system(system)
    inertia = np.diag(np.asarray(rigid.model(model.values).mass_matrix(jnp.zeros(n))))
    assert rigid.input_map is not None
    driven = [
        int(np.argmax(rigid.input_map(jnp.zeros(n), jnp.zeros(n), jnp.asarray(one), values)))
        for one in np.eye(len(system.inputs))
    ]
    friction = np.array([values[f"{c.name}.coulomb"] for c in system.coordinates])
    stiffness = inertia * 20.0**2 + 10.0 * friction / amplitude
    damping = 2 * 0.8 * np.sqrt(inertia * stiffness)
    coordinates = [tn.Coordinate(c.name, c.kind, resolution) for c in system.coordinates]
    inputs = [tn.Input(i.name, i.unit, "zero-order", is_delay_declared=True) for i in system.inputs]
    gains = [
        (float(stiffness[j]), float(damping[j])) if knows_gains else (None, None) for j in driven
    ]
    names = [coordinates[j].name for j in driven]
    loops = [
        PDLoop(i.name, name, f"{name}_setpoint", f"{name}_velocity_setpoint", kp=kp, kd=kd)
        for i, name, (kp, kd) in zip(inputs, names, gains, strict=True)
    ]
    points = [
        tn.Input(name, coordinates[j].unit + per, "zero-order", is_delay_declared=True)
        for loop, j in zip(loops, driven, strict=True)
        for name, per in zip(loop.set_points, ("", "/s"), strict=True)
    ]
    channels = Channels(
        tuple(coordinates), tuple(points), dt, PDController(tuple(inputs), tuple(loops))
    )
    records = []
    for k in range(count):
        omega = 2 * np.pi * rng.uniform(0.1, 1.2, (5, n))
        size, phase = amplitude * rng.uniform(0.2, 0.5, (5, n)), rng.uniform(0, 2 * np.pi, (5, n))
        middle = rng.uniform(-0.5, 0.5, n)
        angle = omega * np.concatenate([before, t])[:, None, None] + phase
        wanted = middle + np.sum(size * np.sin(angle), axis=1)
        speed = np.sum(size * omega * np.cos(angle), axis=1)
        if k < len(motions):
            wanted, speed = motions[k]
        measured = jnp.concatenate([wanted[0], speed[0]])
        x = np.asarray(model.initial_state(measured, jnp.zeros(len(driven))))
        states, torques = np.empty((len(wanted), len(x))), np.empty((len(wanted), len(driven)))
        for i in range(len(wanted)):
            states[i] = x
            force = stiffness * (wanted[i] - x[:n]) + damping * (speed[i] - x[n : 2 * n])
            torques[i] = force[driven]
            x = step(x, torques[i])
        states, torques, wanted, speed = (
            a[len(before) :] for a in (states, torques, wanted, speed)
        )
        level = noise if isinstance(noise, np.ndarray) else noise * torques.std(axis=0)
        measured = torques + level * rng.normal(size=torques.shape)
        record = tn.from_arrays(
            np.round(states[:, :n] / resolution) * resolution,
            measured,
            dt=dt,
            coordinates=coordinates,
            inputs=inputs,
            name=f"run{k}",
            split="train" if k < count - 1 else "validation",
        )
        if knows_controller:
            u = np.stack([wanted[:, driven], speed[:, driven]], axis=2).reshape(len(t), -1)
            record = replace(record, u=u, channels=channels, outputs=record.u)
        records.append(record)
    return tn.DataSet("robot", tuple(records))
