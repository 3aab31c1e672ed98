"""Folders of logs with one planted fault each, and what the check should say of it.

The machines are logged once; a fault changes a copy of the logs or of the card. `FAULTS` were
written with the check, `LATE_FAULTS` after it was finished.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from simulated import machines
from simulated.measurement import Machine, Run, measure, simulate
from tustinnet.finding import Finding

MACHINES: dict[str, Callable[[], Machine]] = {
    "double-pendulum": machines.double_pendulum,
    "cart-pole": machines.cart_pole,
    "unbalanced-disc": machines.unbalanced_disc,
    "gantry-crane": machines.gantry_crane,
    "two-mass-drive": machines.two_mass_drive,
    "duffing": machines.duffing,
    "ball-on-beam": machines.ball_on_beam,
    "propeller-pendulum": machines.propeller_pendulum,
    "flexible-beam": machines.flexible_beam,
    "positioning-axis": machines.positioning_axis,
    "reaction-wheel": machines.reaction_wheel,
    "planar-arm": machines.planar_arm,
}


@dataclass
class Logs:
    """Logs in memory, with their card.

    Attributes:
        machine: the machine that was simulated.
        names: columns of every log.
        tables: samples of each log by its name.
        truth: positions and velocities of each log in SI units, for velocity columns.
        splits: names of the logs of each split.
        card: lines of the card, without splits.
        entries: lines of the card's splits that replace the names.
        newline: line end of each log that has another one.
        digits: significant digits of each log that has others.
    """

    machine: Machine
    names: list[str]
    tables: dict[str, np.ndarray]
    truth: dict[str, np.ndarray]
    splits: dict[str, list[str]]
    card: str
    entries: dict[str, str] = field(default_factory=dict)
    newline: dict[str, str] = field(default_factory=dict)
    digits: dict[str, int] = field(default_factory=dict)

    def column(self, log: str, name: str) -> np.ndarray:
        """A column of a log, which can be written to."""
        return self.tables[log][:, self.names.index(name)]

    def add_column(self, name: str, values: dict[str, np.ndarray]) -> None:
        """Adds a column to all logs."""
        self.names.append(name)
        for log, table in self.tables.items():
            self.tables[log] = np.column_stack([table, values[log]])

    def edit_card(self, old: str, new: str) -> None:
        """Replaces a text of the card, which it must have."""
        assert old in self.card, f"{old!r} is not in the card:\n{self.card}"
        self.card = self.card.replace(old, new)

    def add_key(self, channel: str, line: str) -> None:
        """Adds a line to the block of a coordinate or input."""
        self.edit_card(f'name = "{channel}"\n', f'name = "{channel}"\n{line}\n')

    def write(self, folder: Path) -> Path:
        """Writes logs and card into a new folder."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for log, table in self.tables.items():
            rows = [",".join(f"{x:.{self.digits.get(log, 9)}g}" for x in row) for row in table]
            end = self.newline.get(log, "\n")
            text = end.join([",".join(self.names), *rows]) + end
            (folder / f"{log}.csv").write_bytes(text.encode())
        lines = [f"{split} = [{self._listed(split)}]" for split in self.splits]
        (folder / "dataset.toml").write_text("\n".join([self.card, "[splits]", *lines, ""]))
        return folder

    def _listed(self, split: str) -> str:
        names = ", ".join(f'"{log}.csv"' for log in self.splits[split])
        return self.entries.get(split, names)


def make_card(machine: Machine) -> str:
    """The card of a machine without splits."""
    parts = [
        f'name = "{machine.name}"\ndt = {machine.dt:.9g}\n',
        '[time]\ncolumn = "time"\nirregular = "resample"\n',
    ]
    return "\n".join([*parts, *(c.card() for c in (*machine.sensors, *machine.actuators))])


def simulate_logs(
    name: str,
    seed: int = 0,
    fit: int = 6,
    held_out: int = 2,
    longest: float = 8.0,
    change: Callable[[dict[str, float]], None] | None = None,
) -> Logs:
    """Logs of some runs of a machine.

    Args:
        name: name of the machine.
        seed: everything random follows from it.
        fit: runs for the split `train`.
        held_out: runs for the split `test`.
        longest: duration of a run, at most [s].
        change: changes the parameters of the machine before it is simulated.
    """
    machine = MACHINES[name]()
    if change is not None:
        change(machine.truth)
    rng = np.random.default_rng(seed)
    train, test = machine.runs(rng)
    runs = [
        Run(r.name, min(r.seconds, longest), r.initial, r.command)
        for r in (*train[:fit], *test[:held_out])
    ]
    motions = simulate(machine, runs, rng)
    tables, names = {}, []
    for run, motion in zip(runs, motions, strict=True):
        names, tables[run.name] = measure(machine, motion, rng)
    return Logs(
        machine,
        names,
        tables,
        {r.name: m.x for r, m in zip(runs, motions, strict=True)},
        {"train": [r.name for r in train[:fit]], "test": [r.name for r in test[:held_out]]},
        make_card(machine),
    )


@cache
def _cached(name: str, longest: float) -> Logs:
    return simulate_logs(name, longest=longest)


def logs_of(name: str, longest: float = 8.0) -> Logs:
    """A copy of the logs of a machine, simulated once."""
    logs = _cached(name, longest)
    return replace(
        logs,
        names=[*logs.names],
        tables={k: v.copy() for k, v in logs.tables.items()},
        splits={k: [*v] for k, v in logs.splits.items()},
        entries={},
        newline={},
        digits={},
    )


def with_velocities(logs: Logs, noise: float = 0.005) -> Logs:
    """Logs with a velocity column of a sensor for each coordinate, in SI units."""
    rng = np.random.default_rng(1)
    n_q = len(logs.machine.sensors)
    for j, sensor in enumerate(logs.machine.sensors):
        column = f"{sensor.name}_rate"
        values = {}
        for log, x in logs.truth.items():
            v = x[:, n_q + j]
            values[log] = v + noise * v.std() * rng.normal(size=len(v))
        logs.add_column(column, values)
        unit = "rad/s" if sensor.kind == "angular" else "m/s"
        logs.add_key(
            sensor.name,
            f'velocity = {{ column = "{column}", unit = "{unit}", measured = true }}',
        )
    return logs


@dataclass(frozen=True)
class Fault:
    """A planted fault.

    Attributes:
        name: what it is.
        machine: the machine whose logs have it.
        plant: plants it into a copy of the logs.
        checks: names of the checks that find it.
        records: records that must be named; () where it concerns all.
        channels: coordinates or inputs one of which must be named; () where it concerns none.
    """

    name: str
    machine: str
    plant: Callable[[Logs], None]
    checks: tuple[str, ...]
    records: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()

    def write(self, folder: Path) -> Path:
        """Writes the logs with the fault."""
        logs = logs_of(self.machine)
        self.plant(logs)
        return logs.write(folder)

    def is_found(self, findings: Sequence[Finding]) -> bool:
        """Whether a finding names it at the right record and channel."""
        return any(self.is_named_by(f) for f in findings)

    def is_named_by(self, f: Finding) -> bool:
        """Whether a finding is about it."""
        is_right_record = not self.records or set(self.records) <= {*f.records}
        is_right_channel = (
            not self.channels
            or f.channel in self.channels
            or any(c in f.what for c in self.channels)
        )
        # a fault of one record that is said of several is not located
        is_located = len(self.records) != 1 or len(f.records) == 1
        return (
            f.code in self.checks
            and f.is_serious
            and is_right_record
            and is_right_channel
            and is_located
        )


def turn(logs: Logs, name: str) -> float:
    """A whole turn in the unit of a column."""
    return next(2 * np.pi * s.factor for s in logs.machine.sensors if s.column == name)


def unwrapped(logs: Logs, log: str, name: str) -> np.ndarray:
    """A column of a log without its wraps."""
    period = turn(logs, name)
    return np.unwrap(logs.column(log, name), period=period)


def wrap(logs: Logs, log: str, name: str, values: np.ndarray) -> None:
    """Writes values into a column as its sensor wraps."""
    sensor = next(s for s in logs.machine.sensors if s.column == name)
    logs.column(log, name)[:] = np.mod(values, turn(logs, name)) if sensor.wraps else values


# --- faults in a record ---


def _stretch_time(factor: float, *only: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        logs.edit_card('irregular = "resample"\n', "tolerance = 0.2\n")
        for log in only or logs.tables:
            logs.column(log, "time")[:] *= factor

    return plant


def _time_in_ms(logs: Logs) -> None:
    logs.edit_card(f"dt = {logs.machine.dt:.9g}\n", "")
    logs.edit_card('irregular = "resample"\n', "tolerance = 0.6\n")
    for log in logs.tables:
        logs.column(log, "time")[:] = np.round(1e3 * logs.column(log, "time"))


def _drop_rows(log: str, first: int, count: int) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        logs.tables[log] = np.delete(logs.tables[log], np.s_[first : first + count], axis=0)

    return plant


def _overflow(log: str, column: str, span: float) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        logs.column(log, column)[:] = np.mod(unwrapped(logs, log, column), span)

    return plant


def _set_card(old: str, new: str) -> Callable[[Logs], None]:
    return lambda logs: logs.edit_card(old, new)


def _scale_column(column: str, factor: float, *only: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        for log in only or logs.tables:
            logs.column(log, column)[:] *= factor

    return plant


def _freeze(log: str, column: str, first: int, last: int) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        values = logs.column(log, column)
        values[first:last] = values[first]

    return plant


def _clip(log: str, column: str, share: float) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        values = logs.column(log, column)
        middle, half = (values.max() + values.min()) / 2, np.ptp(values) / 2
        values[:] = np.clip(values, middle - share * half, middle + share * half)

    return plant


def _die(log: str, column: str, step: float) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        values = logs.column(log, column)
        flicker = np.random.default_rng(3).uniform(size=len(values)) < 0.02
        values[:] = values[0] + step * (np.cumsum(flicker) % 2)

    return plant


def _spike(log: str, column: str, row: int, size: float) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        logs.column(log, column)[row] += size

    return plant


def _shift_from(log: str, column: str, row: int, size: float) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        values = unwrapped(logs, log, column)
        values[row:] += size
        wrap(logs, log, column, values)

    return plant


def _edit_velocity(
    edit: Callable[[np.ndarray, float], np.ndarray], column: str, *only: str
) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        with_velocities(logs)
        for log in only or logs.tables:
            values = logs.column(log, column)
            values[:] = edit(values.copy(), logs.machine.dt)

    return plant


def _low_pass(seconds: float) -> Callable[[np.ndarray, float], np.ndarray]:
    def edit(values: np.ndarray, dt: float) -> np.ndarray:
        share, state, out = dt / (seconds + dt), values[0], []
        for value in values:
            state = state + share * (value - state)
            out.append(state)
        return np.array(out)

    return edit


def _late(samples: int) -> Callable[[np.ndarray, float], np.ndarray]:
    def edit(values: np.ndarray, dt: float) -> np.ndarray:
        return np.r_[np.full(samples, values[0]), values[:-samples]]

    return edit


def _pad(values: np.ndarray, dt: float) -> np.ndarray:
    values[:40] = 0
    return values


def _swap_velocities(a: str, b: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        with_velocities(logs)
        _swap_columns(a, b)(logs)

    return plant


def _decimate(step: int, *only: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        logs.edit_card(f"dt = {logs.machine.dt:.9g}", f"dt = {step * logs.machine.dt:.9g}")
        for log in only or logs.tables:
            logs.tables[log] = logs.tables[log][::step]

    return plant


def _still_input(column: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        for log in logs.tables:
            logs.column(log, column)[:] = 0.0

    return plant


# --- faults between records ---


def _reverse(log: str, column: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        if any(s.column == column for s in logs.machine.sensors):
            wrap(logs, log, column, -unwrapped(logs, log, column))
        else:
            logs.column(log, column)[:] *= -1

    return plant


def _gain(log: str, column: str, factor: float) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        if any(s.column == column for s in logs.machine.sensors):
            wrap(logs, log, column, factor * unwrapped(logs, log, column))
        else:
            logs.column(log, column)[:] *= factor

    return plant


def _offset(log: str, column: str, size: float) -> Callable[[Logs], None]:
    return lambda logs: wrap(logs, log, column, unwrapped(logs, log, column) + size)


def _lag(log: str, column: str, samples: int) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        values = logs.column(log, column)
        values[:] = _late(samples)(values.copy(), 0.0)

    return plant


def _swap_columns(a: str, b: str, *only: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        i, j = logs.names.index(a), logs.names.index(b)
        for log in only or logs.tables:
            logs.tables[log][:, [i, j]] = logs.tables[log][:, [j, i]]

    return plant


def _other_machine(log: str, change: Callable[[dict[str, float]], None]) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        logs.tables[log] = _changed(logs.machine.name, log, change)

    return plant


def _changed(name: str, log: str, change: Callable[[dict[str, float]], None]) -> np.ndarray:
    return simulate_logs(name, change=change).tables[log]


def _multiply(**factors: float) -> Callable[[dict[str, float]], None]:
    def change(parameters: dict[str, float]) -> None:
        for key, factor in factors.items():
            parameters[key] *= factor

    return change


def without_time(step: int, log: str) -> Callable[[Logs], None]:
    """A log of another period, in a card without a column of times."""

    def plant(logs: Logs) -> None:
        logs.edit_card('[time]\ncolumn = "time"\nirregular = "resample"\n', "")
        logs.tables[log] = logs.tables[log][::step]

    return plant


# --- faults between splits ---


def _copy_log(
    log: str,
    name: str,
    split: str,
    newline: str = "\n",
    digits: int = 9,
    first: int = 0,
    noise: float = 0.0,
    later: float = 0.0,
) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        table = logs.tables[log][first:].copy()
        table[:, 0] += later - table[0, 0]
        table += (
            noise
            * table.std(axis=0)
            * np.random.default_rng(5).normal(size=table.shape)
            * (np.arange(table.shape[1]) > 0)
        )
        logs.tables[name] = table
        logs.splits[split].append(name)
        logs.newline[name], logs.digits[name] = newline, digits

    return plant


def _entries(**lists: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        logs.entries |= lists

    return plant


def _same_column(channel: str, column: str) -> Callable[[Logs], None]:
    def plant(logs: Logs) -> None:
        block = next(s for s in logs.machine.sensors if s.name == channel)
        logs.edit_card(f'column = "{block.column}"', f'column = "{column}"')

    return plant


_deg = "disc_deg"
_falls = tuple(f"fall{i}" for i in range(6))

FAULTS: tuple[Fault, ...] = (
    # time
    Fault("log at 10.4 ms in a card of 10 ms", "cart-pole", _stretch_time(1.04), ("period",)),
    Fault(
        "one log at another period",
        "two-mass-drive",
        _stretch_time(1.02, "moves1"),
        ("period",),
        ("moves1",),
    ),
    Fault("times in ms declared as s", "positioning-axis", _time_in_ms, ("time unit",)),
    Fault("a gap", "double-pendulum", _drop_rows("fall3", 300, 12), ("gap",), ("fall3",)),
    Fault("a long gap", "gantry-crane", _drop_rows("travel2", 150, 40), ("gap",), ("travel2",)),
    Fault(
        "sampled too slowly",
        "flexible-beam",
        _decimate(10),
        ("sampling",),
        channels=("deflection",),
    ),
    # counters and units
    Fault(
        "a counter of 11 bits",
        "reaction-wheel",
        _overflow("levels1", "wheel_counts", 2048),
        ("counter",),
        ("levels1",),
        ("wheel",),
    ),
    Fault(
        "wraps that are kept",
        "double-pendulum",
        _set_card('column = "upper_counts"\n', 'column = "upper_counts"\nunwrap = false\n'),
        ("counter",),
        channels=("upper",),
    ),
    Fault(
        "another count than declared",
        "unbalanced-disc",
        _set_card(f'column = "{_deg}"\n', f'column = "{_deg}"\ncounts_per_revolution = 3600\n'),
        ("encoder count",),
        channels=("disc",),
    ),
    Fault(
        "degrees that wrap declared as radians",
        "unbalanced-disc",
        _set_card('unit = "deg"', 'unit = "rad"'),
        ("counter", "angle unit", "angle scale", "fast angle"),
        channels=("disc",),
    ),
    Fault(
        "degrees declared as radians",
        "gantry-crane",
        _set_card('unit = "deg"', 'unit = "rad"'),
        (
            "angle unit",
            "angle scale",
            "fast angle",
        ),
        channels=("load",),
    ),
    Fault(
        "radians declared as degrees",
        "unbalanced-disc",
        _scale_column(_deg, np.pi / 180),
        ("angle unit", "angle scale", "fast angle", "counter"),
        channels=("disc",),
    ),
    Fault(
        "half of the counts in a turn",
        "double-pendulum",
        _set_card("counts_per_revolution = 2400", "counts_per_revolution = 1200"),
        ("angle unit", "angle scale", "fast angle", "counter"),
        channels=("lower",),
    ),
    # sensors
    Fault(
        "a sensor that freezes",
        "cart-pole",
        _freeze("sines1", "cart_mm", 300, 340),
        ("frozen sensor",),
        ("sines1",),
        ("cart",),
    ),
    Fault(
        "a sensor that freezes to the end",
        "double-pendulum",
        lambda logs: _freeze("fall2", "upper_counts", _fastest(logs, "fall2", "upper_counts"), 801)(
            logs
        ),
        ("frozen sensor",),
        ("fall2",),
        ("upper",),
    ),
    Fault(
        "a clipped sensor",
        "gantry-crane",
        _clip("travel1", "load_deg", 0.6),
        ("clipped sensor",),
        ("travel1",),
        ("load",),
    ),
    Fault(
        "a dead encoder",
        "cart-pole",
        _die("sines2", "pole_counts", 1.0),
        ("dead sensor",),
        ("sines2",),
        ("pole",),
    ),
    Fault(
        "a column that never changes",
        "ball-on-beam",
        _scale_column("ball_mm", 0.0, "sines0"),
        ("dead sensor",),
        ("sines0",),
        ("ball",),
    ),
    Fault(
        "a spike of a position",
        "positioning-axis",
        _spike("moves2", "carriage_mm", 700, 5.0),
        ("jump",),
        ("moves2",),
        ("carriage",),
    ),
    Fault(
        "a spike of a few counts",
        "two-mass-drive",
        _spike("sines0", "motor_counts", 500, 60.0),
        ("jump",),
        ("sines0",),
        ("motor",),
    ),
    Fault(
        "a spike of an input",
        "unbalanced-disc",
        _spike("sines3", "voltage", 200, 400.0),
        ("spike",),
        ("sines3",),
        ("voltage",),
    ),
    Fault(
        "lost counts",
        "reaction-wheel",
        _shift_from("sines1", "pendulum_counts", 400, 150.0),
        ("jump",),
        ("sines1",),
        ("pendulum",),
    ),
    # velocity columns
    Fault(
        "a velocity of the opposite sign",
        "double-pendulum",
        _edit_velocity(lambda v, _: -v, "lower_rate"),
        ("velocity",),
        channels=("lower",),
    ),
    Fault(
        "a velocity in deg/s",
        "reaction-wheel",
        _edit_velocity(lambda v, _: np.rad2deg(v), "pendulum_rate"),
        ("velocity",),
        channels=("pendulum",),
    ),
    Fault(
        "a velocity that is late",
        "gantry-crane",
        _edit_velocity(_late(3), "trolley_rate"),
        ("velocity",),
        channels=("trolley",),
    ),
    Fault(
        "a velocity behind a filter",
        "cart-pole",
        _edit_velocity(_low_pass(0.05), "cart_rate"),
        ("velocity",),
        channels=("cart",),
    ),
    Fault(
        "velocities that are swapped",
        "double-pendulum",
        _swap_velocities("upper_rate", "lower_rate"),
        ("velocity",),
        channels=("upper", "lower"),
    ),
    Fault(
        "measured velocities that are padded",
        "unbalanced-disc",
        _edit_velocity(_pad, "disc_rate"),
        ("padded velocity",),
    ),
    # inputs
    Fault(
        "an input beyond its limits",
        "unbalanced-disc",
        lambda logs: logs.add_key("voltage", "limits = [-3.0, 3.0]"),
        ("limits",),
        channels=("voltage",),
    ),
    Fault(
        "an input that moves in no record",
        "propeller-pendulum",
        lambda logs: _still_input(logs.machine.actuators[0].name)(logs),
        ("still input",),
        channels=("command",),
    ),
    # records against one another
    Fault(
        "a reversed sensor",
        "cart-pole",
        _reverse("moves1", "pole_counts"),
        ("sign",),
        ("moves1",),
        ("pole",),
    ),
    Fault(
        "a reversed sensor of a free swing",
        "double-pendulum",
        _reverse("fall4", "upper_counts"),
        ("sign",),
        ("fall4",),
        ("upper", "lower"),
    ),
    Fault(
        "a reversed input",
        "unbalanced-disc",
        _reverse("sines2", "voltage"),
        ("sign",),
        ("sines2",),
        ("voltage", "disc"),
    ),
    Fault(
        "a reversed input under control",
        "cart-pole",
        _reverse("sines0", "voltage"),
        ("sign",),
        ("sines0",),
        ("voltage",),
    ),
    Fault(
        "an input of another gain",
        "gantry-crane",
        _gain("travel3", "voltage", 1.5),
        ("gain",),
        ("travel3",),
        ("voltage",),
    ),
    Fault(
        "a sensor of another gain",
        "double-pendulum",
        _gain("fall1", "lower_counts", 0.8),
        ("gain", "encoder count"),
        ("fall1",),
        ("lower",),
    ),
    Fault(
        "degrees in one record",
        "reaction-wheel",
        _gain("levels2", "pendulum_counts", 180 / np.pi),
        ("gain", "angle unit", "angle scale", "fast angle"),
        ("levels2",),
        ("pendulum",),
    ),
    Fault(
        "another zero",
        "unbalanced-disc",
        _offset("sines1", _deg, 20.0),
        ("offset",),
        ("sines1",),
        ("disc",),
    ),
    Fault(
        "another zero of a pole",
        "cart-pole",
        _offset("moves1", "pole_counts", 60.0),
        ("offset",),
        ("moves1",),
        ("pole",),
    ),
    Fault(
        "an input that is logged late",
        "reaction-wheel",
        _lag("sines1", "current", 5),
        ("lag",),
        ("sines1",),
        ("current",),
    ),
    Fault(
        "a sensor that is late",
        "gantry-crane",
        _lag("sines0", "load_deg", 4),
        ("lag",),
        ("sines0",),
        ("load", "trolley"),
    ),
    Fault(
        "swapped sensors",
        "two-mass-drive",
        _swap_columns("motor_counts", "load_counts", "sines1"),
        ("swap", "gain"),
        ("sines1",),
        ("motor", "load"),
    ),
    Fault(
        "swapped inputs",
        "planar-arm",
        _swap_columns("torque1", "torque2", "moves2"),
        ("swap",),
        ("moves2",),
        ("torque1", "torque2"),
    ),
    Fault(
        "another payload",
        "unbalanced-disc",
        _other_machine("sines4", _multiply(gravity=1.5, gain=0.7)),
        ("other machine", "gain"),
        ("sines4",),
    ),
    Fault(
        "another friction",
        "reaction-wheel",
        _other_machine("levels3", _multiply(pivot=12.0, bearing=4.0)),
        ("other machine",),
        ("levels3",),
    ),
    Fault(
        "a record of another period without times",
        "ball-on-beam",
        without_time(2, "moves1"),
        ("record period",),
        ("moves1",),
    ),
    # splits
    Fault(
        "a copy of a training record in the test",
        "cart-pole",
        _copy_log("moves0", "fresh", "test"),
        ("copy",),
        ("moves0", "fresh"),
    ),
    Fault(
        "a copy with other line ends and fewer digits",
        "positioning-axis",
        _copy_log("moves0", "fresh", "test", newline="\r\n", digits=6),
        ("copy",),
        ("moves0", "fresh"),
    ),
    Fault(
        "a part of a record under another name, later",
        "reaction-wheel",
        _copy_log("sines0", "fresh", "test", first=200, later=100.0),
        ("copy",),
        ("sines0", "fresh"),
    ),
    Fault(
        "rows in two splits",
        "gantry-crane",
        _entries(
            train='{ file = "travel0.csv", name = "head", rows = [0, 300] }, "travel1.csv", '
            '"travel2.csv", "travel3.csv"',
            test='{ file = "travel0.csv", name = "tail", rows = [250, 401] }',
        ),
        ("overlap",),
        ("head", "tail"),
    ),
    Fault(
        "two columns of one sensor",
        "two-mass-drive",
        lambda logs: (
            _same_column("load", "motor_counts")(logs),
            logs.edit_card("counts_per_revolution = 2400", "counts_per_revolution = 4096"),
        )[0],
        ("same sensor",),
        channels=("load",),
    ),
)


def _fastest(logs: Logs, log: str, column: str) -> int:
    """A row in the last third at which a column moves fastest."""
    values = unwrapped(logs, log, column)
    start = len(values) // 3
    return start + int(np.argmax(np.abs(np.diff(values[start : 2 * len(values) // 3]))))


LATE_FAULTS: tuple[Fault, ...] = (
    Fault(
        "a reversed sensor of a crane",
        "gantry-crane",
        _reverse("travel1", "load_deg"),
        ("sign",),
        ("travel1",),
        ("load",),
    ),
    Fault(
        "a reversed input of a wheel",
        "reaction-wheel",
        _reverse("levels0", "current"),
        ("sign",),
        ("levels0",),
        ("current",),
    ),
    Fault(
        "a load that is read in radians",
        "gantry-crane",
        _gain("travel2", "load_deg", np.pi / 180),
        ("gain", "encoder count"),
        ("travel2",),
        ("load",),
    ),
    Fault(
        "an input of half the gain",
        "cart-pole",
        _gain("moves1", "voltage", 0.5),
        ("gain",),
        ("moves1",),
        ("voltage",),
    ),
    Fault(
        "another zero of a ball",
        "ball-on-beam",
        _offset("sines2", "beam_counts", 150.0),
        ("offset",),
        ("sines2",),
        ("beam",),
    ),
    Fault("a log at 9.6 ms", "reaction-wheel", _stretch_time(0.96), ("period",)),
    Fault(
        "a frozen load",
        "two-mass-drive",
        _freeze("moves2", "motor_counts", 600, 680),
        ("frozen sensor", "jump"),
        ("moves2",),
        ("motor",),
    ),
    Fault(
        "a velocity in rpm",
        "cart-pole",
        _edit_velocity(lambda v, _: v * 30 / np.pi, "pole_rate"),
        ("velocity",),
        channels=("pole",),
    ),
    Fault(
        "a rounded copy in the test",
        "ball-on-beam",
        _copy_log("moves1", "fresh", "test", digits=4),
        ("copy", "near copy"),
        ("moves1", "fresh"),
    ),
    Fault(
        "swapped torques",
        "planar-arm",
        _swap_columns("torque3", "torque4", "moves1"),
        ("swap",),
        ("moves1",),
        ("torque3", "torque4"),
    ),
)
