"""Controllers for machines in simulators that others wrote, from logs to 20 starts.

    python benchmarks/control_foreign.py OUT [NAME...] [--budget 60s]

Each machine is logged through encoders (MuJoCo's, gymnasium's own integrators; an acrobot and a
pendubot, with dry friction and without, by their equations), fitted by plain `tustinnet fit`, or
by the recipe `mechanism` without a budget, and given a controller as `tustinnet control` designs
it. A row says what the table promises, and what came of it on the machine with a sample of delay.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import jax
import mujoco
import numpy as np
from scipy.integrate import solve_ivp

import tustinnet as tn
from tustinnet.channels import Channels
from tustinnet.control.design import ControlTask, design_controller, find_rest
from tustinnet.control.sampled_plant import PlantOptions, SampledPlant
from tustinnet.control.trial import try_design
from tustinnet.simulate.range import Range
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.store.header import read_header

STARTS, RECORDS, SECONDS = 20, 8, 8.0
COUNTS = {"angular": 2 * np.pi / 4096, "linear": 1e-4}
ARM = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="shoulder" axis="0 1 0"
damping="0.3" frictionloss="0.4" armature="0.05"/><geom type="capsule" fromto="0 0 0 0.4 0 0"
size="0.03" mass="2"/><body pos="0.4 0 0"><joint name="elbow" axis="0 1 0" damping="0.2"
frictionloss="0.2" armature="0.03"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.025"
mass="1"/></body></body></worldbody><actuator><motor joint="shoulder"/><motor joint="elbow"/>
</actuator></mujoco>"""
GRAVITY = 9.81

Advance = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Foreign:
    """A machine in a simulator of others.

    Attributes:
        channels: its coordinates, inputs with their limits, and the period.
        advance: the state a period later.
        rest: positions about which records begin.
        at: positions that the controller holds.
        swings: whether it swings up to them from rest.
        centred: gains by which inputs keep coordinates near `rest` while records are made.
    """

    channels: Channels
    advance: Advance
    rest: tuple[float, ...]
    at: dict[str, float]
    swings: bool = False
    centred: tuple[tuple[float, ...], ...] = ()


class ForeignPlant(SampledPlant):
    """A foreign machine as a plant."""

    def __init__(self, machine: Foreign, options: PlantOptions) -> None:
        super().__init__(machine.channels, options, "foreign")
        self._machine = machine

    def restart(self, q: np.ndarray) -> np.ndarray:
        """The state at rest."""
        return np.concatenate([q, np.zeros(len(q))])

    def advance(self, u: np.ndarray) -> np.ndarray:
        """The state a period later."""
        return self._machine.advance(self.state, u)


def channels(kinds: dict[str, str], inputs: dict[str, float], dt: float) -> Channels:
    """Channels of some coordinates by kind, and inputs by their limit."""
    return Channels(
        tuple(tn.Coordinate(n, k, resolution=COUNTS[k]) for n, k in kinds.items()),  # pyright: ignore[reportArgumentType]
        tuple(tn.Input(n, "", limits=(-limit, limit)) for n, limit in inputs.items()),
        dt,
    )


def by_mujoco(model: mujoco.MjModel, dt: float) -> Advance:
    """MuJoCo's own steps; inputs are controls."""
    data, substeps = mujoco.MjData(model), round(dt / model.opt.timestep)

    def advance(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:] = np.split(x, 2)
        data.ctrl[:] = u
        for _ in range(substeps):
            mujoco.mj_step(model, data)
        return np.concatenate([data.qpos, data.qvel])

    return advance


def from_gymnasium(name: str) -> mujoco.MjModel:
    """A MuJoCo model of gymnasium, its joints without ends."""
    file = Path(gymnasium.__file__).parent / "envs/mujoco/assets" / name
    spec = mujoco.MjSpec.from_file(str(file))
    for joint in spec.joints:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    return spec.compile()


def cart_pole_of_gymnasium() -> Foreign:
    """Gymnasium's cart-pole, by its own Euler steps and any force."""
    cart = gymnasium.make("CartPole-v1").unwrapped
    cart.reset()

    def advance(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        cart.state = (x[0], x[2], x[1], x[3])
        cart.force_mag = abs(float(u[0]))
        cart.steps_beyond_terminated = None
        cart.step(int(u[0] > 0))
        s, v, angle, w = cart.state
        return np.array([s, angle, v, w], float)

    names = channels({"cart": "linear", "pole": "angular"}, {"force": 10.0}, cart.tau)
    at = {"cart": 0.0, "pole": 0.0}
    return Foreign(names, advance, (0.0, np.pi), at, True, ((5.0, 0.0),))


def two_links(driven: int, dry: float) -> Foreign:
    """Two links with a torque at one joint: a pendubot (0) or an acrobot (1), by Spong (1994)."""
    m, length, centre, inertia, viscous = 0.3, 0.3, 0.16, 2.5e-3, 2e-3

    def rate(_: float, x: np.ndarray, u: float) -> np.ndarray:
        (q1, q2), v = np.split(x, 2)
        a = m * centre**2 + m * (length**2 + centre**2) + 2 * inertia
        b, c = m * length * centre, m * centre**2 + inertia
        mass = np.array([[a + 2 * b * np.cos(q2), c + b * np.cos(q2)], [c + b * np.cos(q2), c]])
        swing = b * np.sin(q2) * np.array([-(2 * v[0] + v[1]) * v[1], v[0] ** 2])
        second = m * centre * GRAVITY * np.sin(q1 + q2)
        weight = np.array([m * (centre + length) * GRAVITY * np.sin(q1) + second, second])
        rubbing = viscous * v + dry * np.tanh(v / 0.01)
        torque = u * (np.arange(2) == driven)
        return np.concatenate([v, np.linalg.solve(mass, torque - swing - weight - rubbing)])

    def advance(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return solve_ivp(rate, (0, 0.01), x, args=(float(u[0]),), rtol=1e-7, atol=1e-8).y[:, -1]

    names = channels({"upper": "angular", "lower": "angular"}, {"torque": 3.0}, 0.01)
    return Foreign(names, advance, (0.0, 0.0), {"upper": np.pi, "lower": 0.0})


def machines() -> dict[str, Callable[[], Foreign]]:
    """The machines by name."""

    def inverted(file: str, poles: int) -> Foreign:
        kinds = {"cart": "linear"} | {f"pole{i + 1}": "angular" for i in range(poles)}
        limit = 1.0
        return Foreign(
            channels(kinds, {"control": limit}, 0.02 if poles == 1 else 0.01),
            by_mujoco(from_gymnasium(file), 0.02 if poles == 1 else 0.01),
            (0.0, np.pi, 0.0)[: poles + 1],
            dict.fromkeys(kinds, 0.0),
            centred=((0.3, 0.0, 0.0)[: poles + 1],),
        )

    def arm() -> Foreign:
        return Foreign(
            channels({"shoulder": "angular", "elbow": "angular"}, {"m1": 30.0, "m2": 10.0}, 0.01),
            by_mujoco(mujoco.MjModel.from_xml_string(ARM), 0.01),
            (np.pi / 2, 0.0),
            {"shoulder": 0.3, "elbow": 0.8},
            centred=((20.0, 0.0), (0.0, 5.0)),
        )

    return {
        "inverted-pendulum": lambda: inverted("inverted_pendulum.xml", 1),
        "inverted-double-pendulum": lambda: inverted("inverted_double_pendulum.xml", 2),
        "cart-pole": cart_pole_of_gymnasium,
        "pendubot": lambda: two_links(0, 1e-6),
        "pendubot-dry": lambda: two_links(0, 5e-3),
        "acrobot": lambda: two_links(1, 1e-6),
        "arm": arm,
    }


def make_records(machine: Foreign) -> tn.DataSet:
    """Records under smooth random inputs, through encoders."""
    generator, names = np.random.default_rng(0), machine.channels
    steps = round(SECONDS / names.dt)
    t, rest = names.dt * np.arange(steps), np.array(machine.rest)
    limits = np.array([i.limits for i in names.inputs])[:, 1]
    records = []
    for k in range(RECORDS):
        spread = np.where(names.angular, 0.6, 0.05)
        x = np.concatenate([rest + spread * generator.uniform(-1, 1, len(rest)), 0 * rest])
        rates = generator.uniform(0.2, 3.0, (4, len(limits)))
        phases = generator.uniform(0, 2 * np.pi, rates.shape)
        wave = np.sin(2 * np.pi * rates * t[:, None, None] + phases).sum(axis=1) / 4
        q, u = np.zeros((steps, len(rest))), np.zeros((steps, len(limits)))
        counts = np.array(names.resolution)
        for i in range(steps):
            q[i] = counts * np.round(x[: len(rest)] / counts)
            centring = np.array(machine.centred) @ (rest - q[i]) if machine.centred else 0.0
            u[i] = np.clip((0.3 + 0.06 * k) * limits * wave[i] + centring, -limits, limits)
            x = machine.advance(x, u[i])
        records.append(
            tn.from_arrays(
                q, u, dt=names.dt, coordinates=names.coordinates, inputs=names.inputs, name=f"r{k}"
            )
        )
    return tn.DataSet("foreign", tuple(records))


def play(name: str, machine: Foreign, out: Path, budget: str | None) -> str:
    """A row of the table."""
    logs, run = out / name / "logs", out / name / "run"
    if not logs.exists():
        write_data_set(make_records(machine), logs, "Simulated by others")
    file = run / "model.safetensors"
    if not file.is_file():
        how = ["--budget", budget] if budget else ["--recipe", "mechanism"]
        words = ["fit", str(logs), *how, "--out", str(run), "--no-report", "-q"]
        subprocess.run([sys.executable, "-m", "tustinnet", *words], check=True)
    model, header, data = tn.load_model(file), read_header(file), tn.load(logs)
    names, limits = machine.channels, {i.name: i.limits for i in machine.channels.inputs}
    start = find_rest(model, machine.at, limits) if machine.swings else None
    task = ControlTask(machine.at, start, limits=limits, trust_beyond=True, delay=1)
    ranges = Range.from_header(header, model)
    try:
        design = design_controller(model, task, range=ranges, records=[*data][:4])
    except tn.InputError as error:
        return f"{name:<26} refused: {error}"
    options = PlantOptions(
        counts=names.resolution, delay=1, limits=[limits[i.name] for i in names.inputs]
    )
    plant = ForeignPlant(machine, options)
    alone = try_design(design, header, count=STARTS).robustness
    tried = try_design(design, plants={"foreign": plant}, variants=False, count=STARTS)
    row = tried.robustness.rows[-1]
    promised = ", ".join(f"{r.kind} {r.successes}" for r in alone.rows)
    verdict = f"not written: {alone.problem}" if alone.problem else "written"
    return (
        f"{name:<26} {header['kind']}, {verdict}; on the machine {row.successes} of {STARTS} "
        f"({row.failures or 'none fails'}); on its model: {promised}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--budget", help="of plain fit; without one the recipe mechanism")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    for which in arguments.names or machines():
        print(play(which, machines()[which](), arguments.out, arguments.budget), flush=True)
