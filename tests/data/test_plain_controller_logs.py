"""Logs of controllers without names: errors, counters, clocks and names behind a colon."""

from pathlib import Path

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.data.drafting.draft import Draft, draft_card
from tustinnet.data.drafting.files import list_logs
from tustinnet.data.readers import read_columns

RNG = np.random.default_rng(0)


def drafted(folder: Path, rows: np.ndarray, header: str = "", name: str = "log.csv") -> Draft:
    """The draft for one log of numbers."""
    lines = [",".join(f"{x:.7g}" for x in row) for row in rows]
    (folder / name).write_text("\n".join([*header.splitlines(), *lines]) + "\n")
    return draft_card(*list_logs([folder]))


def stepped(samples: int = 1500) -> tuple[np.ndarray, ...]:
    """Set points, angle, error and voltage of a motor in a loop, by times [s]."""
    dt, q, v = 0.005, 0.0, 0.0
    goal = np.repeat(RNG.uniform(20, 90, samples // 300), 300)
    rows = []
    for r in goal:
        u = np.clip(4.0 * (r - q) - 0.1 * v, -60, 60)
        rows.append((r, q, r - q, u))
        q, v = q + dt * v, v + dt * (20.0 * u - 15.0 * v)
    return dt * np.arange(samples), *np.array(rows).T


def roles(draft: Draft) -> dict[str, str]:
    return {column.name: column.role for column in draft.columns}


@pytest.mark.parametrize("is_constant", [False, True])
def test_a_control_error_is_no_position(is_constant, tmp_path):
    t, r, q, e, u = stepped()
    if is_constant:  # of which only the error tells
        t, r, q, e, u = (x[:300] for x in (t, r, q, e, u))
    found = roles(drafted(tmp_path, np.column_stack([t, r, q, e, u])))
    assert found["column 3"] == "position"
    assert found["column 4"] == "other"
    assert found["column 2"] == ("constant" if is_constant else "set point")
    if is_constant:  # else nothing tells the voltage of a damped motor from its speed
        assert found["column 5"] == "input"


def test_columns_that_are_one_signal_have_no_error_among_them(tmp_path):
    t, _, q, _, u = stepped()
    left, right = 50 + u / 20, 50 - u / 20
    found = roles(drafted(tmp_path, np.column_stack([t, q, left, right, left - right])))
    assert found["column 2"] == "position"
    assert "position" not in {found[f"column {k}"] for k in (3, 4, 5)}


def test_a_clock_that_jitters_comes_before_a_counter(tmp_path):
    samples = 400
    t = np.cumsum(0.005 * RNG.uniform(0.75, 1.25, samples))
    q = np.sin(9 * t)
    draft = drafted(tmp_path, np.column_stack([2000 + np.arange(samples), t, q, 3 * q[::-1]]))
    assert draft.clock.column == "column 2"
    assert draft.dt == pytest.approx(0.005, rel=0.03)


def test_joints_that_rise_are_no_clocks(tmp_path):
    s = np.linspace(0, 1, 150)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    joints = np.column_stack([0.3 + 0.5 * way, -0.2 + (0.4 + 0.1 * way) * s, 0.8 * way])
    draft = drafted(tmp_path, joints[30:120].round(5))
    assert draft.clock.column is None
    assert not {"time", "counter"} & {*roles(draft).values()}


def test_names_stand_behind_a_colon_in_a_comment(tmp_path):
    t, r, q, _, u = stepped()
    (tmp_path / "log.txt").write_text(
        "# Rig of 2025\n# Columns: t angle ref u\n#\n"
        + "\n".join("\t".join(f"{x:.6g}" for x in row) for row in zip(t, q, r, u, strict=True))
    )
    assert read_columns(tmp_path / "log.txt").names == ("t", "angle", "ref", "u")
    (tmp_path / "log.txt").write_text("# of a rig that stood: in a hall\n1 2 3\n2 3 4\n3 4 6\n")
    assert read_columns(tmp_path / "log.txt").names != ("in", "a", "hall")


def test_the_pressure_of_the_air_is_no_input(tmp_path):
    t = np.arange(0, 60, 0.5)
    height = 30 * np.sin(t / 8) ** 2
    rows = np.column_stack([t, 1013 - 0.12 * height, height])
    found = roles(drafted(tmp_path, rows, "Time (s),Pressure (hPa),Altitude (m)"))
    assert found == {"Time (s)": "time", "Pressure (hPa)": "other", "Altitude (m)": "position"}


def test_speeds_of_one_machine_are_in_one_unit(tmp_path):
    t = np.arange(0, 4, 0.01)
    u = np.sign(np.sin(3 * t)) * 60
    left, right = (
        np.convolve(u, np.exp(-np.arange(100) / n) / n)[: len(t)] * 5.6 for n in (20, 16)
    )
    rows = np.column_stack([t, left, u, 0.7 * right, 0.7 * u])
    header = "time,leftSpeed,leftCommand,rightSpeed,rightCommand"
    draft = drafted(tmp_path, rows, header)
    assert [c.unit for c in draft.choice.coordinates] == ["rpm", "rpm"]


def test_a_clock_may_be_late_at_times_and_slower_at_first(tmp_path):
    late = np.where(RNG.random(200) < 0.1, 0.05, 0.006)
    t = np.cumsum(np.where(np.arange(200) < 20, 0.5, 1.0) * late * RNG.uniform(0.85, 1.15, 200))
    q = np.sin(4 * t)
    draft = drafted(tmp_path, np.column_stack([np.full(200, 60), t, 4 * np.cos(4 * t), q]))
    assert draft.clock.column == "column 2"
    assert roles(draft)["column 4"] == "position"


def test_what_steps_back_a_little_is_no_clock(tmp_path):
    k = np.arange(250)
    way = np.round(2.5 * k * np.minimum(1, k / 60)) - 8.0 * (k == 130)
    found = roles(drafted(tmp_path, np.column_stack([k, np.where(k > 0, 64, 0), way])))
    assert found == {"column 1": "counter", "column 2": "input", "column 3": "position"}


def test_times_that_repeat_say_the_usual_period(tmp_path):
    t = np.concatenate([0.04 + 0.002 * (np.arange(26) // 3), 0.06 + 0.005 * np.arange(140)])
    rows = np.column_stack([t.round(3), 20 + 5 * np.sin(5 * t), 100 * np.cos(3 * t)])
    draft = drafted(tmp_path, rows, "time,angle,pwm")
    assert (draft.clock.column, draft.dt) == (None, 0.005)
    assert "repeat" in draft.text


def test_names_say_which_column_is_the_error(tmp_path):
    """A record that ends before the error is small."""
    t = 0.002 * np.arange(150)
    u = 5 * np.sign(np.sin(20 * t)) + RNG.normal(0, 0.1, 150)
    v = np.convolve(u, np.exp(-0.05 * np.arange(150)))[:150] * 10
    q = np.cumsum(v) * 0.002
    rows = np.column_stack([t, q, v, 180 - q, u])
    found = roles(drafted(tmp_path, rows, "Time,Position,Velocity,Position Error,Torque"))
    assert found["Position"] == "position"
    assert found["Position Error"] == "other"


def test_one_sensor_in_volts_and_in_millimetres_is_no_input(tmp_path):
    t = 0.01 * np.arange(300)
    force = 100 * np.sign(np.sin(3 * t)) + RNG.normal(0, 5, 300)
    place = 20 + np.cumsum(np.cumsum(force)) * 1e-4
    volts = (place / 13.5 + RNG.normal(0, 0.002, 300)).round(3)
    rows = np.column_stack([t, volts, place, force])
    found = roles(drafted(tmp_path, rows, "t,Laser (in V),Laser (in mm),Force (in N)"))
    assert [found[n] for n in ("Laser (in mm)", "Laser (in V)")] == ["position", "other"]
    assert found["Force (in N)"] == "input"


def test_joints_at_rest_are_none_of_the_motion(tmp_path):
    """Their encoders flicker, and so do their velocities."""
    t = 0.01 * np.arange(300)
    names = [f"ODrive {k} {what}" for what in ("Position", "Velocity", "Current") for k in range(3)]
    noise = RNG.normal(0, 1e-4, (300, 9))
    u = np.sign(np.sin(2 * t))
    v = np.convolve(u, 0.05 * np.exp(-0.05 * np.arange(300)))[:300]
    noise[:, [1, 4, 7]] += np.column_stack([np.cumsum(v) * 0.01, 0 * v, u])
    found = roles(drafted(tmp_path, np.column_stack([t, noise]), ",".join(["time", *names])))
    assert {n for n, role in found.items() if role == "position"} == {"ODrive 1 Position"}
    assert {n for n, role in found.items() if role == "input"} == {"ODrive 1 Current"}


def test_files_of_as_many_rows_are_one_table(tmp_path):
    """Times, a block of joints with their velocities, and torques, each in a file of its own."""
    t = 0.004 * np.arange(400)
    u = RNG.normal(0, 1, (3, 400)).cumsum(axis=1) * 0.1
    v = np.array([np.convolve(x, 0.004 * 20 * np.exp(-0.02 * np.arange(400)))[:400] for x in u])
    q = np.cumsum(v, axis=1) * 0.004
    for name, columns in {"time": [t], "states": [*q, *v], "input": u}.items():
        rows = np.column_stack([*columns])
        np.savetxt(tmp_path / f"{name}.csv", rows, fmt="%.7g", delimiter=",")
    draft = draft_card(*list_logs([tmp_path]))
    assert draft.clock.column == "time/column 1"
    found = roles(draft)
    assert [found[f"column {k}"] for k in range(1, 7)] == ["position"] * 3 + ["velocity"] * 3
    assert {found[f"input/column {k}"] for k in (1, 2, 3)} == {"input"}
    (tmp_path / "dataset.toml").write_text(draft.text)
    (record,) = tn.load(tmp_path)
    assert (record.dt, len(record)) == (pytest.approx(0.004), 400)
