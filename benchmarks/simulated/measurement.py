"""Simulation of machines with fine steps, and what their sensors make of the motion.

Arrays of a simulation have the runs of a machine as their last axis: all runs are simulated at
once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simulated.signals import Signal
from tustinnet.channels import Hold, Kind

# rate(t, x, u, warmth): dx/dt of the states (n_x, R), from inputs (n_u, R) and warmth (R,)
Rate = Callable[[float, Any, Any, Any], np.ndarray]
# controller(readings, references): inputs (n_u, R) from readings (n_q, R) and references (n_r, R)
Controller = Callable[[np.ndarray, np.ndarray], np.ndarray]
ACCEPTED = 0.008  # periods, standard deviation of instants that need no key in a data card


@dataclass(frozen=True)
class Sensor:
    """A sensor of one coordinate, and its column in the logs.

    Attributes:
        name: name of the coordinate.
        kind: `angular` or `linear`.
        column: name of its column.
        unit: unit of the column.
        step: smallest difference that it shows, in the column's unit.
        counts: encoder counts in one turn, None where it is no rotary encoder.
        wraps: whether the column begins again after a turn.
        noise: standard deviation of its noise, in the column's unit.
        eccentricity: amplitude of an error that repeats every turn [rad].
    """

    name: str
    kind: Kind
    column: str
    unit: str
    step: float = 1.0
    counts: int | None = None
    wraps: bool = False
    noise: float = 0.0
    eccentricity: float = 0.0

    @property
    def factor(self) -> float:
        """The column's reading for 1 rad or 1 m."""
        if self.counts and self.unit == "counts":
            return self.counts / (2 * np.pi)
        return {"rad": 1.0, "deg": 180 / np.pi, "m": 1.0, "mm": 1e3}[self.unit]

    def read(self, q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The readings of some positions [rad or m], in the column's unit and not wrapped."""
        exact = (q + self.eccentricity * np.sin(q + 0.7)) * self.factor
        return np.round((exact + self.noise * rng.normal(size=q.shape)) / self.step) * self.step

    def card(self) -> str:
        """The lines of its coordinate in a data card."""
        lines = ["[[coordinates]]", f'name = "{self.name}"', f'kind = "{self.kind}"']
        lines += [f'column = "{self.column}"', f'unit = "{self.unit}"']
        if self.counts:
            lines.append(f"counts_per_revolution = {self.counts}")
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Actuator:
    """An input, and its column in the logs.

    Attributes:
        name: name of the input and its column.
        unit: unit of the column.
        noise: standard deviation of the noise of an analog reading, in the unit; 0 for a number
            that the controller wrote.
        hold: what the input does between samples, as in a data card.
    """

    name: str
    unit: str
    noise: float = 0.0
    hold: Hold = "zero-order"

    def card(self) -> str:
        """The lines of its input in a data card."""
        lines = ["[[inputs]]", f'name = "{self.name}"', f'column = "{self.name}"']
        lines.append(f'unit = "{self.unit}"')
        if self.hold != "zero-order":
            lines.append(f'hold = "{self.hold}"')
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Run:
    """A run of a machine, which becomes one record.

    Attributes:
        name: name of the record.
        seconds: duration [s].
        initial: initial values of the first states; the others begin at 0.
        command: the inputs, or the references of the controller.
    """

    name: str
    seconds: float
    initial: Sequence[float] = ()
    command: tuple[Signal, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine with sensors and actuators.

    Attributes:
        name: its name, and that of its folder.
        dt: sampling period [s].
        substeps: integration steps in a period.
        states: number of states: positions, velocities, others.
        sensors: one for every position.
        rate: derivative of the states.
        runs: the runs for fitting and the held-out ones, from a generator.
        truth: the parameters of the system file that describe it without its further effects.
        actuators: its inputs.
        make_controller: makes a controller; None for inputs that do not depend on the motion.
        delay: periods after which an input acts.
        jitter: standard deviation of the sampling instants [s], which the timestamps show.
        comparable: time over which a simulation with the true parameters stays close [s].
    """

    name: str
    dt: float
    substeps: int
    states: int
    sensors: tuple[Sensor, ...]
    rate: Rate
    runs: Callable[[np.random.Generator], tuple[list[Run], list[Run]]]
    truth: dict[str, float]
    actuators: tuple[Actuator, ...] = ()
    make_controller: Callable[[], Controller] | None = None
    delay: int = 0
    jitter: float = 0.0
    comparable: float = 4.0


@dataclass(frozen=True)
class Motion:
    """The true motion of a run at the sampling instants.

    Attributes:
        x: states, (n, n_x) [SI units].
        u: inputs as the controller or the generator wrote them, (n, n_u).
    """

    x: np.ndarray
    u: np.ndarray


def simulate(
    machine: Machine, runs: Sequence[Run], rng: np.random.Generator, effects: bool = True
) -> list[Motion]:
    """Simulates the runs of a machine by Runge-Kutta steps of fourth order.

    Args:
        machine: the machine.
        runs: its runs.
        rng: generator of each run's warmth, and of the sensors' noise that a controller reads.
        effects: whether friction drifts from run to run: each run has a warmth from 0 to 1.
    """
    lengths = [round(run.seconds / machine.dt) + 1 for run in runs]
    n, h, n_q = max(lengths), machine.dt / machine.substeps, len(machine.sensors)
    x = np.zeros((machine.states, len(runs)))
    for r, run in enumerate(runs):
        x[: len(run.initial), r] = run.initial
    warmth = rng.uniform(size=len(runs)) * effects
    # signals that move between the samples are needed in the middle of the steps, too
    moving = any(a.hold == "band-limited" for a in machine.actuators)
    points = 2 * machine.substeps if moving else 1
    times = np.arange(n * points + 1) * machine.dt / points
    commands = np.stack(
        [np.reshape([s(times) for s in run.command], (-1, len(times))) for run in runs], axis=-1
    )  # (n_c, times, R)
    controller = machine.make_controller() if machine.make_controller else None
    waiting = [np.zeros((len(machine.actuators), len(runs)))] * machine.delay
    states, inputs = np.empty((n, *x.shape)), np.empty((n, len(machine.actuators), len(runs)))
    for k in range(n):
        command = commands[:, k * points]
        if controller is not None:
            readings = [s.read(p, rng) / s.factor for s, p in zip(machine.sensors, x, strict=False)]
            command = controller(np.stack(readings[:n_q]), command)
        states[k], inputs[k] = x, command
        waiting.append(command)
        held = waiting.pop(0)
        for s in range(machine.substeps):
            t = k * machine.dt + s * h
            at = [commands[:, k * points + 2 * s + i] if moving else held for i in range(3)]
            k1 = machine.rate(t, x, at[0], warmth)
            k2 = machine.rate(t + h / 2, x + h / 2 * k1, at[1], warmth)
            k3 = machine.rate(t + h / 2, x + h / 2 * k2, at[1], warmth)
            k4 = machine.rate(t + h, x + h * k3, at[2], warmth)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return [Motion(states[:m, :, r], inputs[:m, :, r]) for r, m in enumerate(lengths)]


def measure(
    machine: Machine, motion: Motion, rng: np.random.Generator
) -> tuple[list[str], np.ndarray]:
    """The columns of a record: names, and readings (n, columns) in their units."""
    n, n_q = len(motion.x), len(machine.sensors)
    late = machine.jitter * np.clip(rng.normal(size=n), -3, 3)
    columns = {"time": np.arange(n) * machine.dt + late - late[0]}
    for i, sensor in enumerate(machine.sensors):
        # over a fraction of a period the motion is straight
        reading = sensor.read(motion.x[:, i] + late * motion.x[:, n_q + i], rng)
        if sensor.wraps:
            turn = 2 * np.pi * sensor.factor
            reading = np.mod(reading, turn)
        columns[sensor.column] = reading
    for i, actuator in enumerate(machine.actuators):
        columns[actuator.name] = motion.u[:, i] + actuator.noise * rng.normal(size=n)
    return list(columns), np.column_stack(list(columns.values()))


def write_records(
    machine: Machine, runs: Sequence[Run], folder: Path, rng: np.random.Generator
) -> None:
    """Simulates runs and writes their records as CSV, with a data card."""
    folder.mkdir(parents=True, exist_ok=True)
    for run, motion in zip(runs, simulate(machine, runs, rng), strict=True):
        names, table = measure(machine, motion, rng)
        np.savetxt(
            folder / f"{run.name}.csv", table, "%.9g", ",", header=",".join(names), comments=""
        )
    parts = [f'name = "{machine.name}"\ndt = {machine.dt:.9g}\n', '[time]\ncolumn = "time"\n']
    if machine.jitter > ACCEPTED * machine.dt:
        parts[-1] += 'irregular = "resample"\n'
    parts += [part.card() for part in (*machine.sensors, *machine.actuators)]
    (folder / "dataset.toml").write_text("\n".join(parts), encoding="utf-8")


@dataclass
class StateFeedback:
    """A controller: gains on positions and on speeds from filtered differences.

    Attributes:
        gain: (n_u, 2 n_q), for positions and speeds.
        dt: sampling period [s].
        limit: largest input; nothing larger is written.
        filter: share of the newest difference in the speed.
        target: positions that a reference adds to, (n_q, n_r).
    """

    gain: np.ndarray
    dt: float
    limit: float
    filter: float
    target: np.ndarray
    last: np.ndarray | None = field(default=None, init=False)
    speed: np.ndarray | None = field(default=None, init=False)

    def __call__(self, readings: np.ndarray, references: np.ndarray) -> np.ndarray:
        """The inputs (n_u, R); the last n_u references are added to them as they are."""
        n_r = self.target.shape[1]
        if self.last is None or self.speed is None:
            self.last, self.speed = readings, np.zeros_like(readings)
        self.speed = self.speed + self.filter * ((readings - self.last) / self.dt - self.speed)
        self.last = readings
        error = np.concatenate([readings - self.target @ references[:n_r], self.speed])
        u = -self.gain @ error
        if len(references) > n_r:
            u = u + references[n_r:]
        return np.clip(u, -self.limit, self.limit)


def regulator_gain(
    rate: Rate, states: int, dt: float, weights: Sequence[float], effort: float
) -> np.ndarray:
    """The gain of a linear-quadratic regulator about 0, (1, n_x), for a machine with one input.

    The linearisation is by secants, of 0.1 in the states and of 1 in the input: dry friction counts
    as moderate damping, and a dead zone as a loss of gain.
    """
    from scipy.linalg import solve_discrete_are
    from scipy.signal import cont2discrete

    cold = np.zeros(1)
    columns = []
    for i in range(states + 1):
        size = 1.0 if i == states else 0.1
        point = np.zeros((states + 1, 1))
        point[i] = size
        up, down = (rate(0.0, s * point[:-1], s * point[-1:], cold)[:, 0] for s in (1, -1))
        columns.append((up - down) / (2 * size))
    jacobian = np.stack(columns, axis=1)
    a, b = jacobian[:, :-1], jacobian[:, -1:]
    a, b, *_ = cont2discrete((a, b, np.eye(states), np.zeros((states, 1))), dt)
    p = solve_discrete_are(a, b, np.diag(weights), np.array([[effort]]))
    return np.linalg.solve(effort + b.T @ p @ b, b.T @ p @ a)
