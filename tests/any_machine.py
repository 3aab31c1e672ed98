"""Machines of every kind, simulated and logged: what a fit may meet."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

Array = npt.NDArray[np.float64]

Kinds = Literal["linear", "angular", "mixed"]
Trait = Literal[
    "plain",
    "stiff",
    "lightly damped",
    "unstable",
    "at rest",
    "still coordinate",
    "still input",
    "nan",
]
Hold = Literal["zero-order", "first-order", "band-limited", "unknown", "undeclared"]

DT = 0.01  # s
_JITTER = 0.01  # of a period
_SINE = 9.0  # 1/s^2, the restoring acceleration of an angle


@dataclass(frozen=True)
class Machine:
    """Properties of a machine and of its logs.

    Attributes:
        inputs: their number.
        coordinates: their number.
        kinds: kinds of the coordinates.
        has_validation: whether a quarter of the records is of the split `validation`.
        has_velocities: whether the logs have columns of velocities.
        has_time: whether the logs have timestamps, with jitter.
        records: their number.
        samples: of each record.
        hold: of the inputs in the card.
        is_delay_unknown: whether the card says so of the delays of the inputs.
        trait: what is special about the machine or a record.
    """

    inputs: int = 1
    coordinates: int = 1
    kinds: Kinds = "linear"
    has_validation: bool = False
    has_velocities: bool = False
    has_time: bool = False
    records: int = 4
    samples: int = 300
    hold: Hold = "undeclared"
    is_delay_unknown: bool = False
    trait: Trait = "plain"

    @property
    def name(self) -> str:
        """The properties in a few letters, for folders and for the names of tests."""
        return "-".join(
            [
                f"{self.inputs}u{self.coordinates}q",
                self.kinds,
                f"{self.records}x{self.samples}",
                *(["validation"] if self.has_validation else []),
                *(["velocities"] if self.has_velocities else []),
                *(["time"] if self.has_time else []),
                self.hold,
                *(["delay"] if self.is_delay_unknown else []),
                self.trait.replace(" ", "_"),
            ]
        )

    @property
    def coordinate_kinds(self) -> list[str]:
        """The kind of each coordinate."""
        mixed = ["angular" if i % 2 else "linear" for i in range(self.coordinates)]
        return mixed if self.kinds == "mixed" else [self.kinds] * self.coordinates


def write_logs(machine: Machine, folder: Path) -> None:
    """Writes the records of a machine as CSV files, and their card."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    n, count = machine.coordinates, machine.inputs
    for k in range(machine.records):
        q, v, u = _simulate(machine, rng, k)
        time = DT * np.arange(len(q)) + _JITTER * DT * rng.uniform(-1, 1, len(q))
        q = 1e-4 * np.round(q / 1e-4)
        if machine.trait == "nan" and k == machine.records // 2:
            q[len(q) // 3] = np.nan
        columns = [*([time] if machine.has_time else []), *q.T, *u.T]
        names = [
            *(["time"] if machine.has_time else []),
            *(f"q{i}" for i in range(n)),
            *(f"u{i}" for i in range(count)),
        ]
        if machine.has_velocities:
            columns += [*v.T]
            names += [f"v{i}" for i in range(n)]
        np.savetxt(
            folder / f"run{k:02d}.csv",
            np.column_stack(columns),
            "%.6g",
            ",",
            header=",".join(names),
            comments="",
        )
    (folder / "dataset.toml").write_text(_card(machine))


def _card(machine: Machine) -> str:
    lines = ['name = "machine"', f"dt = {DT}"]
    lines += ["[time]", 'column = "time"'] if machine.has_time else []
    for i, kind in enumerate(machine.coordinate_kinds):
        lines += [
            "[[coordinates]]",
            f'name = "q{i}"',
            f'kind = "{kind}"',
            f'column = "q{i}"',
            "resolution = 1e-4",
        ]
        lines += [f'velocity = {{ column = "v{i}" }}'] if machine.has_velocities else []
    for i in range(machine.inputs):
        lines += ["[[inputs]]", f'name = "u{i}"', f'column = "u{i}"', 'unit = "V"']
        lines += [] if machine.hold == "undeclared" else [f'hold = "{machine.hold}"']
        lines += ['delay = "unknown"'] if machine.is_delay_unknown else []
    names = [f"run{k:02d}.csv" for k in range(machine.records)]
    held_out = names[-max(1, len(names) // 4) :] if machine.has_validation else []
    train = [name for name in names if name not in held_out]
    lines += ["[splits]", f"train = {train}".replace("'", '"')]
    lines += [f"validation = {held_out}".replace("'", '"')] if held_out else []
    return "\n".join(lines) + "\n"


def _simulate(machine: Machine, rng: np.random.Generator, k: int) -> tuple[Array, Array, Array]:
    """Positions, velocities and inputs of a record."""
    n, count, steps = machine.coordinates, machine.inputs, machine.samples
    a, b = _linear_part(machine)
    angular = np.array([kind == "angular" for kind in machine.coordinate_kinds])
    step = expm(np.block([[a, b], [np.zeros((count, 2 * n + count))]]) * DT)
    u = _signals(rng, steps, count)
    if machine.trait == "still input" and count:
        u[:, -1] = 0.5 if count > 1 else 0.0
    x = np.concatenate([0.5 * rng.standard_normal(n), np.zeros(n)])
    if machine.trait == "unstable":
        x *= 0.2 if count else 1e-3
    resting = steps // 2 if machine.trait == "at rest" else 0
    if resting:
        u[:resting] = 0.0
    begins = np.concatenate([np.zeros(n), 5.0 * x[:n]])  # a blow
    x = np.zeros(2 * n) if resting else x
    states = np.zeros((steps, 2 * n))
    for t in range(steps):
        if resting and t == resting:
            x = begins
        states[t] = x
        if machine.trait == "unstable" and count:
            u[t, 0] += -6.0 * x[0] - 1.0 * x[n]
        kick = np.where(angular, -_SINE * DT * np.sin(x[:n]), 0.0)
        if machine.trait == "unstable":
            kick[0] -= 0.2 * math.tanh(x[0]) * DT + 30.0 * DT * x[0] ** 3
        x = (step @ np.concatenate([x, u[t]]))[: 2 * n]
        x[n:] += kick
        if machine.trait == "still coordinate":
            x[n - 1] = x[-1] = 0.0
    if machine.trait == "still coordinate":
        states[:, n - 1] = states[:, -1] = 0.0
    return states[:, :n], states[:, n:], u


def _linear_part(machine: Machine) -> tuple[Array, Array]:
    """Matrices of states and of inputs of the linear part of the equations of motion."""
    n, count = machine.coordinates, machine.inputs
    stiffness = np.diag(20.0 + 15.0 * np.arange(n)) - 5.0 * (np.eye(n, k=1) + np.eye(n, k=-1))
    damping = 1.0 * np.eye(n)
    if machine.trait == "stiff":
        stiffness[-1, -1], damping[-1, -1] = 4e5, 500.0
    if machine.trait == "lightly damped":
        damping *= 0.005
    if machine.trait == "unstable":
        stiffness[0, 0] = -15.0
    effect = np.array([[10.0 / (1 + abs(i - j)) for j in range(count)] for i in range(n)])
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    return a, np.vstack([np.zeros((n, count)), effect.reshape(n, count)])


def _signals(rng: np.random.Generator, steps: int, count: int) -> Array:
    """Inputs that hold a level for a while."""
    u = np.zeros((steps, count))
    for i in range(count):
        levels = rng.uniform(-2, 2, steps // 25 + 1)
        u[:, i] = np.repeat(levels, 25)[:steps]
    return u


def cover_pairs(
    levels: dict[str, Sequence[object]], rng: np.random.Generator, most: int
) -> list[Machine]:
    """Machines that together have every pair of levels of two properties, `most` at most."""
    keys = list(levels)
    missing = {
        (a, x, b, y)
        for i, a in enumerate(keys)
        for b in keys[i + 1 :]
        for x in levels[a]
        for y in levels[b]
    }

    def pairs(row: dict[str, object]) -> set[tuple[str, object, str, object]]:
        return {(a, row[a], b, row[b]) for i, a in enumerate(keys) for b in keys[i + 1 :]}

    machines = []
    while missing and len(machines) < most:
        rows = [
            {key: levels[key][int(rng.integers(len(levels[key])))] for key in keys}
            for _ in range(300)
        ]
        row = max(rows, key=lambda row: len(pairs(row) & missing))
        missing -= pairs(row)
        machines.append(Machine(**row))  # pyright: ignore[reportArgumentType]
    return machines
