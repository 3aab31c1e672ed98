"""Folders of logs in the styles of laboratories and machines, with what a card should say of them.

Every folder has habits of its own: names, units, clocks, commands beside measured values. A truth
says what a person who knows the machine would declare.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import scipy.io

import tustinnet as tn

Signal = np.ndarray  # (records, samples) or (records, samples, channels)


@dataclass(frozen=True)
class Truth:
    """What a card of a folder should declare.

    Attributes:
        time: the column of times, None without one.
        time_unit: its unit.
        dt: the period [s].
        coordinates: kind and unit of each position column.
        inputs: unit of each input column.
        velocities: velocity column of each position column; empty where the card has none.
        counts: counts in a turn of each position column in counts that the logs say.
        records: number of records.
        kinds: prefixes of files of which each has records in train and validation.
        together: sets of files that are in one split.
    """

    time: str | None
    dt: float
    coordinates: Mapping[str, tuple[str, str]]
    inputs: Mapping[str, str] = field(default_factory=dict)
    velocities: Mapping[str, str] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    time_unit: str = "s"
    records: int = 0
    kinds: Sequence[str] = ("",)
    together: Sequence[frozenset[str]] = ()


def differences(card: dict[str, Any], truth: Truth, data: tn.DataSet) -> list[str]:
    """What a card says otherwise than the truth, a sentence each."""
    declared = {
        "time": (str(card.get("time", {}).get("column")), card.get("time", {}).get("unit")),
        "coordinates": {str(c["column"]): (c["kind"], c["unit"]) for c in card["coordinates"]},
        "inputs": {str(i["column"]): i["unit"] for i in card.get("inputs", [])},
        "velocities": {
            str(c["column"]): str(c["velocity"]["column"])
            for c in card["coordinates"]
            if "velocity" in c
        },
    }
    expected = {
        "time": (str(truth.time), truth.time_unit if truth.time else None),
        "coordinates": dict(truth.coordinates),
        "inputs": dict(truth.inputs),
        "velocities": dict(truth.velocities),
    }
    found = [
        f"{key}: {declared[key]}, not {expected[key]}"
        for key in expected
        if declared[key] != expected[key]
    ]
    counts = {c["column"]: c.get("counts_per_revolution") for c in card["coordinates"]}
    found += [
        f"counts of {c}: {counts.get(c)}" for c, n in truth.counts.items() if counts.get(c) != n
    ]
    if abs(card["dt"] / truth.dt - 1) > 1e-3:
        found.append(f"dt: {card['dt']}, not {truth.dt}")
    enough = len(data) == truth.records if truth.records > 0 else len(data) >= -truth.records
    if not enough:
        found.append(f"{len(data)} records, not {truth.records}")
    for kind in truth.kinds:
        splits = {e.split for e in data if e.name.startswith(kind)}
        if not {"train", "validation"} <= splits:
            found.append(f"splits of '{kind}': {splits}")
    for names in truth.together:
        if len({e.split for e in data if e.name in names}) != 1:
            found.append(f"{sorted(names)} in several splits")
    return found


# --- signals and mechanisms ---


def levels(rng: np.random.Generator, records: int, samples: int, size: float, hold: int) -> Signal:
    """Inputs held at random levels."""
    values = rng.uniform(-size, size, (records, samples // hold + 1))
    return np.repeat(values, hold, axis=1)[:, :samples]


def sines(rng: np.random.Generator, records: int, t: np.ndarray, size: float, top: float) -> Signal:
    """Inputs of six sines up to a frequency [Hz]."""
    phases = rng.uniform(0, 2 * np.pi, (records, 6, 1))
    waves = np.sin(2 * np.pi * np.linspace(0.15, top, 6)[:, None] * t + phases)
    return size * waves.sum(axis=1) / 2.5


def noise(rng: np.random.Generator, records: int, samples: int, size: float) -> Signal:
    """Inputs of white noise."""
    return rng.normal(0, size, (records, samples))


def simulate(
    acceleration: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    u: Signal,
    dt: float,
    q: np.ndarray,
    steps: int = 2,
) -> tuple[Signal, Signal]:
    """Positions and velocities of records side by side, (records, samples, coordinates)."""
    u = u[..., None] if u.ndim == 2 else u
    q, v = np.array(q, float), np.zeros_like(q, float)
    positions, velocities = [], []
    for k in range(u.shape[1]):
        positions.append(q.copy())
        velocities.append(v.copy())
        for _ in range(steps):
            v = v + dt / steps * acceleration(q, v, u[:, k])
            q = q + dt / steps * v
    return np.stack(positions, axis=1), np.stack(velocities, axis=1)


def arm(q, v, u):
    """A hanging arm on a motor."""
    return -30 * np.sin(q) - 1.2 * v - 0.8 * np.tanh(v / 0.05) + 12 * u


def slide(q, v, u):
    """A slide on a motor, with friction."""
    return 2.0 * u - 6.0 * v - 0.4 * np.tanh(v / 0.01)


def wheel(q, v, u):
    """A wheel on a motor."""
    return 9.0 * u - 1.6 * v - 0.8 * np.tanh(v)


def chain(q, v, u):
    """Two links; an input acts on the first one, or on each."""
    c = np.cos(q[:, 0] - q[:, 1])
    s = np.sin(q[:, 0] - q[:, 1])
    first = -2 * 45 * np.sin(q[:, 0]) - s * v[:, 1] ** 2 + 20 * u[:, 0] - 0.5 * v[:, 0]
    second = -45 * np.sin(q[:, 1]) + s * v[:, 0] ** 2 - 0.3 * v[:, 1]
    if u.shape[1] > 1:
        second = second + 20 * u[:, 1]
    below = 2 - c**2
    return np.stack([(first - c * second) / below, (2 * second - c * first) / below], axis=1)


def cart_and_pole(q, v, u):
    """A cart with a hanging pole."""
    a = 3 * u[:, 0] - 5 * v[:, 0] - 0.3 * np.tanh(v[:, 0] / 0.01)
    return np.stack([a, -25 * np.sin(q[:, 1]) - 0.2 * v[:, 1] - 2.5 * a * np.cos(q[:, 1])], axis=1)


def two_masses(q, v, u):
    """Motor and load with an elastic shaft."""
    shaft = 600 * (q[:, 0] - q[:, 1]) + 2 * (v[:, 0] - v[:, 1])
    return np.stack([40 * u[:, 0] - shaft - v[:, 0], shaft - 3 * v[:, 1]], axis=1)


def joints(q, v, u):
    """Joints of a robot, each with gravity."""
    return -10 * np.sin(q) - 3 * v - np.tanh(v / 0.05) + 15 * u


def follow(reference: Signal, dt: float, gain: float = 12.0) -> Signal:
    """Positions that follow a reference as a servo drive does, a little late."""
    q = np.array(reference[:, 0], float)
    v = np.zeros_like(q)
    positions = []
    for k in range(reference.shape[1]):
        positions.append(q.copy())
        v = v + dt * (gain**2 * (reference[:, k] - q) - 1.6 * gain * v)
        q = q + dt * v
    return np.stack(positions, axis=1)


def moves(rng: np.random.Generator, records: int, t: np.ndarray, size: float) -> Signal:
    """Smooth motions from point to point, with rests between."""
    dt = float(t[1] - t[0])
    targets = levels(rng, records, len(t), size, round(1.6 / dt))
    width = round(0.9 / dt)
    window = np.hanning(width + 2)[1:-1]
    window /= window.sum()
    padded = np.concatenate([np.zeros((records, width)), targets], axis=1)
    return np.stack([np.convolve(row, window)[width : width + len(t)] for row in padded])


def rounded(values: Signal, step: float, sensor: float = 0.0) -> Signal:
    """Values in whole steps, as encoders and files have them."""
    return np.round(values / step) * step if not sensor else np.round(values / step)


def write(
    folder: Path, names: Sequence[str], columns: Mapping[str, Signal], digits: int = 9
) -> None:
    """Writes a CSV file (or .tsv, .parquet) for each record."""
    for k, name in enumerate(names):
        frame = pl.DataFrame({c: np.asarray(v[k] if v.ndim > 1 else v) for c, v in columns.items()})
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".parquet":
            frame.write_parquet(path)
            continue
        text = {c: [f"{x:.{digits}g}" for x in frame[c]] for c in frame.columns}
        separator = "\t" if path.suffix == ".tsv" else ","
        pl.DataFrame(text).write_csv(path, separator=separator, quote_style="necessary")


def stamps(
    rng: np.random.Generator, records: int, samples: int, dt: float, jitter: float
) -> Signal:
    """Times of each record [s], early or late by up to `jitter`."""
    return dt * np.arange(samples) + rng.uniform(-jitter, jitter, (records, samples))


# --- twenty laboratories ---


def without_header(folder: Path) -> Truth:
    """A rotary pendulum whose logger writes no names: input, angles, time, computed velocities."""
    rng, dt, n = np.random.default_rng(1), 0.01, 700
    u = np.concatenate([np.zeros((4, n)), noise(rng, 4, n, 0.6)])
    start = np.concatenate([rng.uniform(1, 2.5, (4, 2)), np.zeros((4, 2))])
    q, _ = simulate(chain, u, dt, start)
    q = rounded(q, 2 * np.pi / 2048)
    v = np.gradient(q, dt, axis=1)
    names = [f"fall{k}.csv" for k in range(1, 5)] + [f"wN_{k}.csv" for k in range(1, 5)]
    for k, name in enumerate(names):
        table = np.column_stack([u[k], q[k], dt * np.arange(n), v[k]])
        np.savetxt(folder / name, table, "%.9g", ",")
    rad = ("angular", "rad")
    return Truth(
        "4",
        dt,
        {"2": rad, "3": rad},
        {"1": "1"},
        {"2": "5", "3": "6"},
        records=8,
        kinds=("fall", "wN"),
    )


def arduino(folder: Path) -> Truth:
    """A motor on an Arduino: `micros()`, encoder counts, PWM of the motor bridge."""
    rng, dt, n = np.random.default_rng(2), 0.005, 1500
    pwm = np.round(levels(rng, 5, n, 255, 90))
    q, _ = simulate(wheel, pwm / 40, dt, np.zeros((5, 1)))
    t = np.round(1e6 * (stamps(rng, 5, n, dt, 8e-5) + 3.1))
    counts = np.round(q[..., 0] * 1440 / (2 * np.pi))
    write(
        folder,
        [f"LOG{k:03d}.CSV".lower() for k in range(5)],
        {"micros": t, "enc": counts, "pwm": pwm},
    )
    return Truth(
        "micros", dt, {"enc": ("angular", "counts")}, {"pwm": "1"}, time_unit="us", records=5
    )


def plc(folder: Path) -> Truth:
    """An axis of a PLC in German: set points, actual values, following error, release."""
    rng, dt, n = np.random.default_rng(3), 0.004, 2200
    t = dt * np.arange(n)
    soll = 400 * (moves(rng, 4, t, 0.5) + 0.5)
    ist = follow(soll, dt, 25.0)
    v = np.gradient(ist, dt, axis=1)
    strom = np.gradient(v, dt, axis=1) / 900 + v / 300 + 0.4 * np.tanh(v)
    t_on = np.ones((4, n))
    t_on[:, :40] = 0
    write(
        folder,
        [f"Verfahrprofil_{k}.csv" for k in range(1, 5)],
        {
            "Zeit [ms]": 1000 * t,
            "Lage_Soll [mm]": soll,
            "Lage_Ist [mm]": np.round(ist, 3),
            "Geschw_Ist [mm/s]": np.round(v, 2),
            "Schleppfehler [mm]": soll - np.round(ist, 3),
            "Strom_Soll [A]": strom,
            "Strom_Ist [A]": strom + rng.normal(0, 0.03, strom.shape),
            "Freigabe": t_on,
        },
    )
    return Truth(
        "Zeit [ms]",
        dt,
        {"Lage_Ist [mm]": ("linear", "mm")},
        {"Strom_Soll [A]": "A"},
        {"Lage_Ist [mm]": "Geschw_Ist [mm/s]"},
        time_unit="ms",
        records=4,
    )


def ros(folder: Path) -> Truth:
    """Joint states of ROS: paths of topics as names, epoch seconds with jitter."""
    rng, dt, n = np.random.default_rng(4), 0.01, 900
    u = np.stack([sines(rng, 6, dt * np.arange(n), 1.2, 2.0) for _ in range(2)], axis=2)
    q, v = simulate(joints, u, dt, np.zeros((6, 2)))
    v = v + rng.normal(0, 0.01, v.shape)
    t = stamps(rng, 6, n, dt, 8e-4) + 1.7e9
    columns = {"__time": t}
    for kind, values in (("position", q), ("velocity", v), ("effort", 6 * u)):
        for j, joint in enumerate(("shoulder", "elbow")):
            columns[f"/joint_states/{kind}/{joint}"] = values[..., j]
    write(folder, [f"sines_{k}.csv" for k in range(6)], columns, digits=14)
    path = "/joint_states/{}/{}".format
    return Truth(
        "__time",
        dt,
        {path("position", j): ("angular", "rad") for j in ("shoulder", "elbow")},
        {path("effort", j): "N m" for j in ("shoulder", "elbow")},
        {path("position", j): path("velocity", j) for j in ("shoulder", "elbow")},
        records=6,
    )


def matlab(folder: Path) -> Truth:
    """Files of MATLAB with matrices q, dq and tau."""
    rng, dt, n = np.random.default_rng(5), 0.002, 2500
    u = np.stack([levels(rng, 3, n, 1.5, 150) for _ in range(2)], axis=2)
    q, v = simulate(joints, u, dt, np.zeros((3, 2)))
    for k in range(3):
        content = {"t": dt * np.arange(n)[:, None], "q": q[k], "dq": v[k], "tau": 8 * u[k]}
        scipy.io.savemat(folder / f"exp{k + 1}.mat", {**content, "Kp": 40.0, "comment": "ok"})
    return Truth(
        "t",
        dt,
        {"q[1]": ("angular", "rad"), "q[2]": ("angular", "rad")},
        {"tau[1]": "N m", "tau[2]": "N m"},
        {"q[1]": "dq[1]", "q[2]": "dq[2]"},
        records=3,
    )


def matlab_cells(folder: Path) -> Truth:
    """One MAT file with a cell array of structs, a struct for each record."""
    rng, dt, n = np.random.default_rng(6), 0.01, 800
    u = sines(rng, 6, dt * np.arange(n), 1.5, 2.5)
    q, _ = simulate(arm, u[..., None], dt, rng.uniform(-0.5, 0.5, (6, 1)))
    cells = np.empty(6, object)
    for k in range(6):
        cells[k] = {
            "t": dt * np.arange(n),
            "theta": rounded(q[k, :, 0], 2 * np.pi / 4096),
            "u": u[k],
        }
    scipy.io.savemat(folder / "experiments.mat", {"logs": cells})
    return Truth("logs.t", dt, {"logs.theta": ("angular", "rad")}, {"logs.u": "V"}, records=6)


def wrapped_counter(folder: Path) -> Truth:
    """A counter of 16 bits that starts again, times in ms, bits of the drive."""
    rng, dt, n = np.random.default_rng(7), 0.01, 1200
    u = levels(rng, 5, n, 10, 60)
    q, _ = simulate(wheel, u * 3, dt, rng.uniform(0, 50, (5, 1)))
    counts = np.round(q[..., 0] * 4096 / (2 * np.pi)) % 65536
    write(
        folder,
        [f"run{k}.csv" for k in range(1, 6)],
        {
            "t_ms": 10 * np.arange(n),
            "cnt": counts,
            "u_V": np.round(u, 3),
            "status": np.full((5, n), 3),
        },
    )
    return Truth(
        "t_ms", dt, {"cnt": ("angular", "counts")}, {"u_V": "V"}, time_unit="ms", records=5
    )


def german_disc(folder: Path) -> Truth:
    """An unbalanced disc: angle within 0 and 360 degrees, German names, releases beside steps."""
    rng, dt, n = np.random.default_rng(8), 0.02, 600
    u = np.concatenate([levels(rng, 4, n, 3.5, 40), np.zeros((3, n))])
    q, _ = simulate(arm, u, dt, np.concatenate([np.zeros((4, 1)), rng.uniform(1, 2.8, (3, 1))]), 4)
    angle = np.round(np.degrees(q[..., 0]) % 360 / 0.15) * 0.15 % 360
    names = [f"sprung{k}.csv" for k in range(1, 5)] + [f"frei{k}.csv" for k in range(1, 4)]
    write(folder, names, {"zeit_s": dt * np.arange(n), "winkel_deg": angle, "spannung_V": u})
    return Truth(
        "zeit_s",
        dt,
        {"winkel_deg": ("angular", "deg")},
        {"spannung_V": "V"},
        records=7,
        kinds=("sprung", "frei"),
    )


def cart_pole(folder: Path) -> Truth:
    """A cart-pole with the names of a simulator, repetitions of each experiment."""
    rng, dt, n = np.random.default_rng(9), 0.01, 700
    force = np.repeat(sines(rng, 3, dt * np.arange(n), 1.0, 1.5), 2, axis=0)
    start = np.zeros((6, 2))
    start[:, 1] = rng.uniform(-0.05, 0.05, 6)
    q, v = simulate(cart_and_pole, force, dt, start)
    names = [f"sweep{a}_rep{b}.csv" for a in (1, 2, 3) for b in (1, 2)]
    write(
        folder,
        names,
        {
            "time": dt * np.arange(n),
            "x": q[..., 0],
            "x_dot": v[..., 0],
            "theta": q[..., 1],
            "theta_dot": v[..., 1],
            "force": force,
        },
    )
    return Truth(
        "time",
        dt,
        {"x": ("linear", "m"), "theta": ("angular", "rad")},
        {"force": "N"},
        {"x": "x_dot", "theta": "theta_dot"},
        records=6,
        together=[frozenset({f"sweep{a}_rep1", f"sweep{a}_rep2"}) for a in (1, 2, 3)],
    )


def gantry(folder: Path) -> Truth:
    """A crane in German with units in brackets."""
    rng, dt, n = np.random.default_rng(10), 0.02, 600
    u = levels(rng, 4, n, 2.5, 55)
    q, _ = simulate(cart_and_pole, u, dt, np.zeros((4, 2)))
    write(
        folder,
        [f"Fahrt{k}.csv" for k in range(1, 5)],
        {
            "t [s]": dt * np.arange(n),
            "x_Katze [m]": np.round(q[..., 0], 4),
            "phi [°]": np.round(np.degrees(q[..., 1]), 2),
            "F_Antrieb [N]": 20 * u,
            "Temperatur [°C]": 21 + 0.001 * np.arange(n),
        },
    )
    return Truth(
        "t [s]",
        dt,
        {"x_Katze [m]": ("linear", "m"), "phi [°]": ("angular", "deg")},
        {"F_Antrieb [N]": "N"},
        records=4,
    )


def propeller(folder: Path) -> Truth:
    """A quadrotor's arm on a flight controller: pitch in degrees, gyroscope, throttle, battery."""
    rng, dt, n = np.random.default_rng(11), 0.004, 2000
    u = 0.5 + levels(rng, 5, n, 0.25, 260)
    q, v = simulate(
        lambda q, v, u: 60 * (u - 0.5) - 14 * np.sin(q) - 2 * v, u, dt, np.zeros((5, 1))
    )
    t = np.round(1e6 * (stamps(rng, 5, n, dt, 1e-4) + 55.0))
    write(
        folder,
        [f"flight_{k}.csv" for k in range(1, 6)],
        {
            "timestamp_us": t,
            "pitch_deg": np.degrees(q[..., 0]) + rng.normal(0, 0.02, (5, n)),
            "gyro_y_dps": np.degrees(v[..., 0]) + rng.normal(0, 0.8, (5, n)),
            "acc_x": rng.normal(0, 0.3, (5, n)) + 9.81 * np.sin(q[..., 0]),
            "throttle": np.round(u, 3),
            "vbat": 11.8 - 1e-4 * np.arange(n) + rng.normal(0, 0.01, (5, n)),
            "armed_flag": np.ones((5, n)),
        },
    )
    return Truth(
        "timestamp_us",
        dt,
        {"pitch_deg": ("angular", "deg")},
        {"throttle": "1"},
        {"pitch_deg": "gyro_y_dps"},
        time_unit="us",
        records=5,
    )


def servo_axis(folder: Path) -> Truth:
    """A positioning axis under control: references, position, current; one record."""
    rng, dt, n = np.random.default_rng(12), 0.002, 12000
    t = dt * np.arange(n)
    reference = moves(rng, 1, t, 0.1) + 0.12
    q = follow(reference, dt, 30.0)
    v = np.gradient(q, dt, axis=1)
    current = np.gradient(v, dt, axis=1) / 3 + 5 * v + 0.5 * np.tanh(v / 0.005)
    write(
        folder,
        ["axis.csv"],
        {
            "Time (s)": t,
            "Position Reference (m)": reference,
            "Velocity Reference (m/s)": np.gradient(reference, dt, axis=1),
            "Position (m)": rounded(q, 5e-6),
            "Current (A)": current,
        },
    )
    return Truth(
        "Time (s)", dt, {"Position (m)": ("linear", "m")}, {"Current (A)": "A"}, records=-2
    )


def capital_names(folder: Path) -> Truth:
    """A disc with the angle within -pi and pi; names without units."""
    rng, dt, n = np.random.default_rng(13), 0.025, 500
    u = sines(rng, 5, dt * np.arange(n), 4.0, 1.2)
    q, _ = simulate(arm, u, dt, np.zeros((5, 1)), 6)
    angle = (q[..., 0] + np.pi) % (2 * np.pi) - np.pi
    write(
        folder,
        [f"Test{k}.csv" for k in range(1, 6)],
        {"Time": dt * np.arange(n), "Angle": angle, "Voltage": u},
    )
    return Truth("Time", dt, {"Angle": ("angular", "rad")}, {"Voltage": "V"}, records=5)


def three_joints(folder: Path) -> Truth:
    """A robot: q, dq, commanded and measured torques of three joints, in Parquet files."""
    rng, dt, n = np.random.default_rng(14), 0.005, 1000
    u = np.stack([sines(rng, 6, dt * np.arange(n), 1.0, 2.5) for _ in range(3)], axis=2)
    q, v = simulate(joints, u, dt, np.zeros((6, 3)))
    columns = {"timestamp": dt * np.arange(n) + 12.5}
    for j in range(3):
        columns |= {
            f"q{j + 1}": q[..., j],
            f"dq{j + 1}": v[..., j] + rng.normal(0, 0.004, (6, n)),
            f"tau{j + 1}_cmd": 20 * u[..., j],
            f"tau{j + 1}_meas": 20 * u[..., j] + rng.normal(0, 0.4, (6, n)),
        }
    write(folder, [f"traj_{k}.parquet" for k in range(6)], columns)
    return Truth(
        "timestamp",
        dt,
        {f"q{j}": ("angular", "rad") for j in (1, 2, 3)},
        {f"tau{j}_cmd": "N m" for j in (1, 2, 3)},
        {f"q{j}": f"dq{j}" for j in (1, 2, 3)},
        records=6,
    )


def free_double_pendulum(folder: Path) -> Truth:
    """A double pendulum without inputs."""
    rng, dt, n = np.random.default_rng(15), 0.01, 900
    q, _ = simulate(chain, np.zeros((6, n)), dt, rng.uniform(-1.6, 1.6, (6, 2)), 3)
    write(
        folder,
        [f"release_{k}.csv" for k in range(1, 7)],
        {"t": dt * np.arange(n), "theta1": q[..., 0], "theta2": q[..., 1]},
        digits=7,
    )
    rad = ("angular", "rad")
    return Truth("t", dt, {"theta1": rad, "theta2": rad}, records=6)


def tachometer(folder: Path) -> Truth:
    """A drive in German of which only the speed is measured; armature voltage."""
    rng, dt, n = np.random.default_rng(16), 0.01, 900
    u = levels(rng, 5, n, 12, 70)
    _, v = simulate(wheel, u * 2, dt, np.zeros((5, 1)))
    write(
        folder,
        [f"hochlauf{k}.csv" for k in range(1, 6)],
        {"Zeit/s": dt * np.arange(n), "n_ist [1/min]": v[..., 0] * 30 / np.pi, "u_a [V]": u},
    )
    return Truth("Zeit/s", dt, {"n_ist [1/min]": ("linear", "rpm")}, {"u_a [V]": "V"}, records=5)


def twins(folder: Path) -> list[str]:
    """Logs in which either of two columns may have moved the position, and the names of the files.

    A person would ask, so that no truth belongs to them.
    """
    n, dt = 1500, 0.01
    for k in range(3):
        rng = np.random.default_rng(k)
        u = levels(rng, 1, n, 2.0, 60)
        q, _ = simulate(arm, u, dt, np.zeros((1, 1)))
        near = u + 0.02 * rng.normal(size=(2, n))
        table = np.column_stack([dt * np.arange(n), q[0, :, 0], *near])
        np.savetxt(
            folder / f"r{k}.csv", table, "%.6g", ",", header="t,phi_rad,one,two", comments=""
        )
    return [f"r{k}.csv" for k in range(3)]


def episodes(folder: Path) -> Truth:
    """Episodes of a learnt robot in one file: states and actions in degrees, indices."""
    rng, dt, n = np.random.default_rng(17), 1 / 30, 300
    t = dt * np.arange(n)
    action = np.stack([40 * moves(rng, 6, t, 1.0) for _ in range(2)], axis=2)
    state = np.stack([follow(action[..., j], dt, 9.0) for j in range(2)], axis=2)
    whole = {
        "observation.state.shoulder_pan": state[..., 0],
        "observation.state.elbow_flex": state[..., 1],
        "action.shoulder_pan": action[..., 0],
        "action.elbow_flex": action[..., 1],
        "timestamp": np.tile(t, (6, 1)),
        "frame_index": np.tile(np.arange(n), (6, 1)),
        "episode_index": np.repeat(np.arange(6)[:, None], n, axis=1),
        "index": np.arange(6 * n).reshape(6, n),
        "task_index": np.zeros((6, n)),
    }
    write(
        folder, ["episodes.csv"], {name: values.reshape(1, -1) for name, values in whole.items()}, 8
    )
    state_of = "observation.state.{}".format
    return Truth(
        "timestamp",
        dt,
        {state_of("shoulder_pan"): ("angular", "deg"), state_of("elbow_flex"): ("angular", "deg")},
        {"action.shoulder_pan": "1", "action.elbow_flex": "1"},
        records=6,
    )


def long_with_rests(folder: Path) -> Truth:
    """One long record: a motor is moved again and again, and rests between."""
    rng, dt = np.random.default_rng(18), 0.01
    bursts = []
    for _ in range(6):
        t = dt * np.arange(700)
        bursts += [sines(rng, 1, t, 4.0, 2.0)[0], np.zeros(600)]
    u = np.concatenate(bursts)[None]
    q, _ = simulate(arm, u, dt, np.zeros((1, 1)))
    write(
        folder,
        ["day.csv"],
        {
            "time": dt * np.arange(u.shape[1]),
            "motor_cnt": np.round(q[..., 0] * 4096 / 2 / np.pi),
            "volts": u,
        },
    )
    return Truth("time", dt, {"motor_cnt": ("angular", "counts")}, {"volts": "V"}, records=6)


def elastic_drive(folder: Path) -> Truth:
    """Two masses with an elastic shaft: positions of both, commanded and actual torque."""
    rng, dt, n = np.random.default_rng(19), 0.002, 2000
    t = dt * np.arange(n)
    u = np.concatenate([levels(rng, 4, n, 2.0, 200), sines(rng, 4, t, 2.0, 8.0)])
    q, v = simulate(two_masses, u, dt, np.zeros((8, 2)))
    names = [f"steps_{k}.csv" for k in range(4)] + [f"multisine_{k}.csv" for k in range(4)]
    lagged = np.apply_along_axis(lambda row: np.convolve(row, np.full(5, 0.2))[:n], 1, u)
    write(
        folder,
        names,
        {
            "t": t,
            "motor_pos": rounded(q[..., 0], 2 * np.pi / 8192),
            "motor_vel": v[..., 0] + rng.normal(0, 0.02, (8, n)),
            "load_pos": rounded(q[..., 1], 2 * np.pi / 8192),
            "torque_cmd": u,
            "torque_act": lagged + rng.normal(0, 0.02, (8, n)),
        },
    )
    return Truth(
        "t",
        dt,
        {"motor_pos": ("angular", "rad"), "load_pos": ("angular", "rad")},
        {"torque_cmd": "N m"},
        records=8,
        kinds=("steps", "multisine"),
    )


def labview(folder: Path) -> Truth:
    """A log of LabVIEW: X_Value, a potentiometer in volts, drive in volts, tabs."""
    rng, dt, n = np.random.default_rng(20), 0.005, 1600
    u = levels(rng, 5, n, 2.0, 130)
    q, _ = simulate(slide, u, dt, np.zeros((5, 1)))
    poti = 5 + 8 * q[..., 0] + rng.normal(0, 0.002, (5, n))
    write(
        folder,
        [f"meas_{k}.tsv" for k in range(1, 6)],
        {"X_Value": dt * np.arange(n), "Poti (V)": np.round(poti, 4), "Drive (V)": np.round(u, 3)},
    )
    return Truth("X_Value", dt, {"Poti (V)": ("linear", "V")}, {"Drive (V)": "V"}, records=5)


LABORATORIES: tuple[Callable[[Path], Truth], ...] = (
    without_header,
    arduino,
    plc,
    ros,
    matlab,
    matlab_cells,
    wrapped_counter,
    german_disc,
    cart_pole,
    gantry,
    propeller,
    servo_axis,
    capital_names,
    three_joints,
    free_double_pendulum,
    tachometer,
    episodes,
    long_with_rests,
    elastic_drive,
    labview,
)


# --- eight more, written when the drafts of those above were right, and not looked at before ---


def hydraulics(folder: Path) -> Truth:
    """A hydraulic cylinder in German: piston, two pressures, voltage of the valve."""
    rng, dt, n = np.random.default_rng(31), 0.005, 1600
    u = levels(rng, 5, n, 5, 110)
    q, v = simulate(slide, u * 0.5, dt, np.zeros((5, 1)))
    pressure = 60 + 8 * np.gradient(v[..., 0], dt, axis=1)
    write(
        folder,
        [f"Zylinder_{k}.csv" for k in range(1, 6)],
        {
            "Zeit [s]": dt * np.arange(n),
            "Kolbenweg [mm]": np.round(1000 * q[..., 0] + 200, 2),
            "Druck A [bar]": pressure + rng.normal(0, 0.4, (5, n)),
            "Druck B [bar]": 110 - pressure + rng.normal(0, 0.4, (5, n)),
            "Ventilspannung [V]": u,
        },
    )
    return Truth(
        "Zeit [s]", dt, {"Kolbenweg [mm]": ("linear", "mm")}, {"Ventilspannung [V]": "V"}, records=5
    )


def field_oriented(folder: Path) -> Truth:
    """A brushless drive: mechanical angle, filtered speed, currents of field-oriented control."""
    rng, dt, n = np.random.default_rng(32), 0.001, 3000
    t = dt * np.arange(n)
    u = np.concatenate([levels(rng, 3, n, 4, 300), sines(rng, 3, t, 4, 5.0)])
    q, v = simulate(wheel, u * 2, dt, np.zeros((6, 1)))
    rpm = np.apply_along_axis(
        lambda row: np.convolve(row, np.full(12, 1 / 12))[:n], 1, v[..., 0] * 30 / np.pi
    )
    write(
        folder,
        [f"{kind}_{k}.csv" for kind in ("step", "chirp") for k in range(3)],
        {
            "t_us": np.round(1e6 * t),
            "mech_angle_rad": q[..., 0] % (2 * np.pi),
            "speed_rpm": rpm + rng.normal(0, 1, rpm.shape),
            "iq_ref_A": u,
            "iq_A": u + rng.normal(0, 0.1, u.shape),
            "id_A": rng.normal(0, 0.1, u.shape),
            "vbus_V": 48 + rng.normal(0, 0.05, u.shape),
            "temp_C": np.tile(31 + 0.001 * t, (6, 1)),
        },
    )
    return Truth(
        "t_us",
        dt,
        {"mech_angle_rad": ("angular", "rad")},
        {"iq_ref_A": "A"},
        {"mech_angle_rad": "speed_rpm"},
        time_unit="us",
        records=6,
        kinds=("step", "chirp"),
    )


def simulink(folder: Path) -> Truth:
    """Parquet files with names in camel case and units at their end."""
    rng, dt, n = np.random.default_rng(33), 0.01, 900
    t = dt * np.arange(n)
    reference = moves(rng, 4, t, 0.8)
    theta = follow(reference, dt, 10.0)
    dot = np.gradient(theta, dt, axis=1)
    volts = np.gradient(dot, dt, axis=1) / 12 + dot / 8 + 2 * np.sin(theta)
    write(
        folder,
        [f"exp_{k}.parquet" for k in range(4)],
        {
            "Time": t,
            "Theta_rad": theta,
            "ThetaDot_rad_s": dot,
            "ThetaRef_rad": reference,
            "MotorVoltage_V": volts,
        },
    )
    return Truth(
        "Time",
        dt,
        {"Theta_rad": ("angular", "rad")},
        {"MotorVoltage_V": "V"},
        {"Theta_rad": "ThetaDot_rad_s"},
        records=4,
    )


def ball_on_plate(folder: Path) -> Truth:
    """A ball on a plate: its place by a camera, the angles that two servos are told."""
    rng, dt, n = np.random.default_rng(34), 0.02, 800
    u = np.stack([levels(rng, 5, n, 6.0, 35) for _ in range(2)], axis=2)
    q, _ = simulate(lambda q, v, u: 7 * np.radians(u) - 0.6 * v - 2 * q, u, dt, np.zeros((5, 2)))
    q = 1000 * q + rng.normal(0, 0.3, q.shape)
    write(
        folder,
        [f"ball{k}.csv" for k in range(5)],
        {
            "t": dt * np.arange(n),
            "ball_x_mm": q[..., 0],
            "ball_y_mm": q[..., 1],
            "servo_x_deg": u[..., 0],
            "servo_y_deg": u[..., 1],
        },
    )
    return Truth(
        "t",
        dt,
        {"ball_x_mm": ("linear", "mm"), "ball_y_mm": ("linear", "mm")},
        {"servo_x_deg": "deg", "servo_y_deg": "deg"},
        records=5,
    )


def furuta(folder: Path) -> Truth:
    """A rotary pendulum in folders for training and test; the pendulum's angle wraps."""
    rng, dt, n = np.random.default_rng(35), 0.01, 800
    u = sines(rng, 6, dt * np.arange(n), 1.5, 2.0)
    q, _ = simulate(chain, u, dt, np.zeros((6, 2)))
    degrees = np.degrees(q)
    names = [f"train/swing{k}.csv" for k in range(1, 5)] + [f"val/swing{k}.csv" for k in (5, 6)]
    write(
        folder,
        names,
        {
            "time": dt * np.arange(n),
            "theta_deg": np.round(degrees[..., 0] / 0.17578125) * 0.17578125,
            "alpha_deg": np.round(degrees[..., 1] / 0.17578125) * 0.17578125 % 360,
            "motor_pwm": np.round(u * 40),
        },
    )
    return Truth(
        "time",
        dt,
        {"theta_deg": ("angular", "deg"), "alpha_deg": ("angular", "deg")},
        {"motor_pwm": "1"},
        counts={"theta_deg": 2048, "alpha_deg": 2048},
        records=6,
    )


def industrial_robot(folder: Path) -> Truth:
    """Two axes of an industrial robot in German, without times: actual and set angles, currents."""
    rng, dt, n = np.random.default_rng(36), 0.01, 900
    t = dt * np.arange(n)
    columns = {"Sample": np.arange(n)}
    for axis, size in (("A1", 60), ("A2", 35)):
        soll = size * moves(rng, 5, t, 1.0)
        ist = follow(soll, dt, 14.0)
        v = np.gradient(ist, dt, axis=1)
        strom = (
            np.gradient(v, dt, axis=1) / 400 + v / 60 + 0.5 * np.tanh(v) + np.sin(np.radians(ist))
        )
        columns |= {
            f"{axis}_Soll_Grad": soll,
            f"{axis}_Ist_Grad": np.round(ist, 3),
            f"{axis}_Strom_A": strom + rng.normal(0, 0.05, strom.shape),
        }
    write(folder, [f"Bahn{k}.csv" for k in range(1, 6)], columns)
    return Truth(
        None,
        dt,
        {f"{a}_Ist_Grad": ("angular", "deg") for a in ("A1", "A2")},
        {f"{a}_Strom_A": "A" for a in ("A1", "A2")},
        records=5,
    )


def exoskeleton(folder: Path) -> Truth:
    """A knee exoskeleton: angle, gyroscope, torque, electromyogram, phase of the gait."""
    rng, dt, n = np.random.default_rng(37), 0.01, 1000
    t = dt * np.arange(n)
    u = sines(rng, 4, t, 1.5, 1.4)
    q, v = simulate(arm, u, dt, np.zeros((4, 1)))
    write(
        folder,
        [f"subject1_walk{k}.csv" for k in range(1, 5)],
        {
            "Time [s]": t,
            "Knee angle [°]": np.degrees(q[..., 0]),
            "Knee velocity [°/s]": np.degrees(v[..., 0]) + rng.normal(0, 1, (4, n)),
            "Knee torque [Nm]": 10 * u,
            "EMG_1 [mV]": rng.normal(0, 0.2, (4, n)),
            "Gait phase": np.tile((t % 1.2) / 1.2, (4, 1)),
        },
    )
    return Truth(
        "Time [s]",
        dt,
        {"Knee angle [°]": ("angular", "deg")},
        {"Knee torque [Nm]": "N m"},
        {"Knee angle [°]": "Knee velocity [°/s]"},
        records=4,
    )


def lift(folder: Path) -> Truth:
    """A lift: height in cm, duty of the motor, a limit switch, load; gaps in its only log."""
    rng, dt, n = np.random.default_rng(38), 0.02, 3000
    u = levels(rng, 1, n, 0.9, 75)
    q, _ = simulate(slide, u, dt, np.zeros((1, 1)))
    t = 1000 * dt * np.arange(n)
    for begin in (800, 1500, 2300):
        t[begin:] += 4000
    height = np.round(100 * q[..., 0] + 120, 1)
    write(
        folder,
        ["lift_log.csv"],
        {
            "millis": t[None],
            "height_cm": height,
            "motor_duty": np.round(u, 3),
            "limit_sw": (height > 140).astype(float),
            "load_kg": np.full((1, n), 12.5),
        },
    )
    return Truth(
        "millis",
        dt,
        {"height_cm": ("linear", "cm")},
        {"motor_duty": "1"},
        time_unit="ms",
        records=4,
    )


FURTHER: tuple[Callable[[Path], Truth], ...] = (
    hydraulics,
    field_oriented,
    simulink,
    ball_on_plate,
    furuta,
    industrial_robot,
    exoskeleton,
    lift,
)
EVERY = (*LABORATORIES, *FURTHER)
