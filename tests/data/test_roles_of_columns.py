"""Evidence on the roles of columns, the assignment that follows from it, and its margins."""

import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from simulated.laboratories import twins

import tustinnet as tn
from tustinnet.data.drafting.draft import Draft, draft_card
from tustinnet.data.drafting.evidence import WEIGHTS, name_evidence
from tustinnet.data.drafting.names import read_name
from tustinnet.data.drafting.numbers import examine
from tustinnet.data.drafting.relations import find_copy

DT = 0.01
N = 1500


def levels(seed: int, hold: int = 60) -> np.ndarray:
    """An input that is held at random levels."""
    return np.repeat(np.random.default_rng(seed).uniform(-2, 2, N // hold + 1), hold)[:N]


def moved_by(u: np.ndarray, damping: float = 1.5, stiffness: float = 8.0) -> np.ndarray:
    """Positions and velocities of an oscillator that an input drives."""
    x = v = 0.0
    states = []
    for force in u:
        for _ in range(5):
            v += DT / 5 * (10 * force - damping * v - stiffness * x)
            x += DT / 5 * v
        states.append((x, v))
    return np.array(states).T


def draft(folder: Path, *records: Mapping[str, np.ndarray], clock: str = "t") -> Draft:
    """The draft for records of some columns at equal times; its card is in the folder and loads."""
    for k, columns in enumerate(records):
        t = {clock: DT * np.arange(N)} if clock else {}
        table = t | dict(columns)
        header = ",".join(table)
        np.savetxt(
            folder / f"r{k}.csv",
            np.column_stack([*table.values()]),
            "%.7g",
            ",",
            header=header,
            comments="",
        )
    made = draft_card(folder, [f"r{k}.csv" for k in range(len(records))])
    (folder / "dataset.toml").write_text(made.text, encoding="utf-8")
    tn.load(folder)
    return made


def uses(made: Draft) -> dict[str, str]:
    """What each column is used as in the card; of velocities, the column of the position."""
    of = {c.velocity.column: c.column for c in made.choice.coordinates if c.velocity}
    return {c.name: of.get(c.name, c.use) for c in made.columns if c.use != "time"}


# --- each kind of evidence by itself ---


def test_words_and_units_of_names_speak_for_roles_and_against_others() -> None:
    def points(name: str) -> dict[str, float]:
        sums: dict[str, float] = {}
        for e in name_evidence(read_name(name)):
            sums[e.role] = sums.get(e.role, 0.0) + e.points
        return sums

    for name, role in (
        ("theta", "position"),
        ("Drehzahl", "velocity"),
        ("torque [N m]", "input"),
        ("Sollposition", "set point"),
        ("reward", "other"),
        ("q_d", "set point"),
        ("Anregung [mm]", "input"),
    ):
        of = points(name)
        assert max(of, key=lambda r: of[r]) == role, name
    assert points("theta [deg]")["position"] > points("theta")["position"]
    assert points("theta")["velocity"] < 0
    assert points("i_A")["input"] < points("u_V")["input"]  # a voltage moves first


def test_names_decide_between_columns_that_move_alike(tmp_path: Path) -> None:
    angle, force = np.sin(np.arange(N) / 40), np.sin(np.arange(N) / 23)
    made = draft(tmp_path, {"force": angle, "angle": force})
    assert uses(made) == {"force": "input", "angle": "coordinate"}
    assert "'angle' in its name" in made.text


def test_units_decide_where_names_say_nothing(tmp_path: Path) -> None:
    a, b = np.sin(np.arange(N) / 40), np.sin(np.arange(N) / 23)
    assert uses(draft(tmp_path, {"ch1 [V]": a, "ch2 [deg]": b})) == {
        "ch1 [V]": "input",
        "ch2 [deg]": "coordinate",
    }


def test_held_levels_are_an_input_also_in_degrees(tmp_path: Path) -> None:
    tilt = np.round(10 * levels(1))
    ball, _ = moved_by(tilt / 40)
    made = draft(tmp_path, {"ball_mm": 100 * ball, "servo_deg": tilt})
    assert uses(made) == {"ball_mm": "coordinate", "servo_deg": "input"}


def test_a_slope_is_a_velocity(tmp_path: Path) -> None:
    u = levels(2)
    x, v = moved_by(u)
    rate = 180 / np.pi * v
    assert uses(draft(tmp_path, {"one": u, "two": x, "three": rate})) == {
        "one": "input",
        "two": "coordinate",
        "three": "two",
    }


def test_what_a_program_adds_up_is_no_position_for_that(tmp_path: Path) -> None:
    _, v = moved_by(levels(2))

    def margin(step: float) -> float:
        """The points by which the rate is the velocity of its sum; 0 where it is none."""
        made = draft(tmp_path, {"one": levels(2), "two": np.cumsum(v) * step, "three": v})
        (rate,) = (c for c in made.columns if c.name == "three")
        return rate.margin if rate.role == "velocity" else 0.0

    assert margin(1.0) < margin(DT)


def test_what_a_position_follows_one_to_one_is_its_set_point(tmp_path: Path) -> None:
    goal = np.sin(np.arange(N) / 40) + np.sin(np.arange(N) / 23)
    late = np.roll(goal, 9)
    late[:9] = goal[0]
    u, _ = moved_by(levels(4))
    made = draft(tmp_path, {"one": goal, "x_m": late + 1e-3 * u, "motor_V": u})
    assert uses(made) == {"one": "", "x_m": "coordinate", "motor_V": "input"}
    assert "'x_m' follows it, one to one" in made.choice.unused["one"]


def test_the_cause_comes_before_the_effect(tmp_path: Path) -> None:
    u = np.random.default_rng(5).normal(size=N)
    x, _ = moved_by(u)
    made = draft(tmp_path, {"V1": u, "V2": x}, clock="")
    assert uses(made) == {"V1": "input", "V2": "coordinate"}
    assert "it foretells 'V2'" in made.text


def test_a_p_behind_a_symbol_may_be_a_dash(tmp_path: Path) -> None:
    u = levels(3)
    x, v = moved_by(u)
    assert uses(draft(tmp_path, {"volts": u, "phi": x, "phi_p": v})) == {
        "volts": "input",
        "phi": "coordinate",
        "phi_p": "phi",
    }
    swing = {"volts": u, "theta_p": x}  # of a pendulum
    assert uses(draft(tmp_path, swing)) == {"volts": "input", "theta_p": "coordinate"}


def test_a_clock_without_a_name_may_stand_behind_others(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    u = levels(7)
    x, _ = moved_by(u)
    t = np.cumsum(DT * rng.uniform(0.8, 1.2, N))
    for k in range(2):
        np.savetxt(tmp_path / f"r{k}.csv", np.column_stack([u, x, t]), "%.7g", ",")
    card = tomllib.loads(draft_card(tmp_path, ["r0.csv", "r1.csv"]).text)
    assert card["time"]["column"] == 3
    assert card["dt"] == pytest.approx(DT, rel=0.02)


def test_without_names_a_turning_motor_is_no_second_clock_and_the_clock_is_in_doubt(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(0.006 * (1 + 0.1 * rng.normal(size=300)))
    turns = np.round(400 * (t - 0.1 * (1 - np.exp(-t / 0.1))) + 2 * np.sin(9 * t))
    np.savetxt(tmp_path / "run.csv", np.column_stack([t, turns]), delimiter=",")
    made = draft_card(tmp_path, ["run.csv"])
    assert made.clock.column == "column 1"
    assert "check that it is the time" in made.text
    assert uses(made) == {"column 2": "coordinate"}


def test_one_odd_interval_and_a_count_that_begins_anywhere_change_no_period(tmp_path: Path) -> None:
    x, _ = moved_by(levels(11))
    t = 0.01 * np.arange(N)
    t[1:] -= 0.0045  # the first interval alone is shorter
    np.savetxt(
        tmp_path / "a.csv", np.column_stack([t, x]), delimiter=",", header="t,x", comments=""
    )
    assert draft_card(tmp_path, ["a.csv"]).clock.dt == 0.01
    columns = np.column_stack([np.arange(N) + 108, x, levels(11)])
    np.savetxt(tmp_path / "b.csv", columns, delimiter=",")
    made = draft_card(tmp_path, ["b.csv"])
    assert made.clock.others == {"column 1": "counts the samples"}


def test_what_nothing_calls_an_angle_is_unwrapped_where_it_jumps_by_turns_alone(
    tmp_path: Path,
) -> None:
    u = levels(11)
    steps = np.where(np.arange(N) % 500 < 250, 4.0, -0.5) + 0.3 * moved_by(u)[0]
    assert "unwrap = false" in draft(tmp_path, {"one": steps, "volts": u}).text
    assert "unwrap" not in draft(tmp_path, {"angle": steps, "volts": u}).text


def test_a_record_of_which_a_quarter_rests_stays_whole(tmp_path: Path) -> None:
    u = np.where(np.arange(N) < 900, 0.0, 2.0)
    x, _ = moved_by(u, damping=6.0)
    made = draft(tmp_path, {"angle": x, "volts": u})
    assert "cut into" not in made.text
    made = draft(tmp_path, {"angle": moved_by(levels(11))[0], "volts": levels(11)})
    assert "one record, cut into four parts" in made.text


@pytest.mark.real
def test_the_clock_of_measured_records_without_a_header_is_found(real_data: Path) -> None:
    files = sorted(p.relative_to(real_data).as_posix() for p in real_data.glob("train/*.csv"))
    made = draft_card(real_data, files)
    assert (made.clock.column, made.dt) == ("column 4", pytest.approx(0.01, rel=1e-4))
    assert [c.column for c in made.choice.coordinates] == ["column 2", "column 3"]
    assert [i.column for i in made.choice.inputs] == ["column 1"]


@pytest.mark.parametrize(
    ("long", "share", "dt"), [(0.02, 0.02, 0.01), (0.02, 0.2, 0.012), (0.3, 0.1, 0.039)]
)
def test_few_long_intervals_are_gaps_and_many_are_none(
    long: float, share: float, dt: float, tmp_path: Path
) -> None:
    rng = np.random.default_rng(8)
    steps = np.where(rng.uniform(size=N) < share, long, rng.choice([0.008, 0.012], N))
    x, _ = moved_by(levels(8))
    table = np.column_stack([np.cumsum(steps), x, levels(8)])
    np.savetxt(tmp_path / "r.csv", table, "%.7g", ",", header="t,x_mm,u_V", comments="")
    made = draft_card(tmp_path, ["r.csv"])
    assert made.dt == pytest.approx(dt, rel=0.03)
    assert not any("gap" in record.piece.because for record in made.splits.records)


def test_an_input_may_be_constant_in_a_record_and_differ_between_them(tmp_path: Path) -> None:
    records = []
    for k in range(3):
        u = np.full(N, 0.5 * (k + 1))
        records.append({"duty": u, "angle": moved_by(u)[0], "mass": np.full(N, 1.0 + k)})
    made = draft(tmp_path, *records)
    assert uses(made) == {"duty": "input", "angle": "coordinate", "mass": ""}
    assert any(q.text.startswith("what is 'duty'") for q in made.questions)
    assert made.choice.unused["mass"] == "constant, another one in each record"


def test_a_bystander_of_two_neighbouring_values_is_no_input(tmp_path: Path) -> None:
    gain = 126.0 + (np.arange(N) % 97 < 40)
    made = draft(tmp_path, {"x_mm": moved_by(levels(9))[0], "agc": gain})
    assert uses(made) == {"x_mm": "coordinate", "agc": ""}


def test_a_count_of_interrupts_is_no_encoder(tmp_path: Path) -> None:
    counts = np.round(np.arange(N) * 1.7) + 40
    u = levels(9)
    made = draft(tmp_path, {"imu_int_count": counts, "x_mm": moved_by(u)[0], "u_V": u})
    assert uses(made) == {"imu_int_count": "", "x_mm": "coordinate", "u_V": "input"}
    assert made.clock.others["imu_int_count"] == "counts with the time"


def test_a_stale_sample_spoils_no_velocity(tmp_path: Path) -> None:
    u = levels(2)
    x, v = moved_by(u)
    stale = v.copy()
    stale[3] = 300.0
    assert uses(draft(tmp_path, {"u_V": u, "s": x, "d_s": stale}))["d_s"] == "s"


@pytest.mark.parametrize(("step", "unit"), [(1000, "us"), (10, "ms"), (10_000_000, "ns")])
def test_whole_numbers_of_a_clock_are_in_the_unit_of_a_usual_period(
    step: int, unit: str, tmp_path: Path
) -> None:
    u = levels(2)
    table = np.column_stack([step * np.arange(N), moved_by(u)[0], u])
    np.savetxt(tmp_path / "r.csv", table, "%.9g", ",", header="t,x_mm,u_V", comments="")
    assert draft_card(tmp_path, ["r.csv"]).clock.unit == unit


def test_the_sine_of_an_angle_is_no_control_error(tmp_path: Path) -> None:
    u = levels(9)
    angle = np.pi + moved_by(u)[0] / 100
    made = draft(tmp_path, {"u_V": u, "angle": angle, "angle_sin": np.sin(angle)})
    assert uses(made)["angle"] == "coordinate"
    assert "set point" not in made.text


def test_a_flag_is_no_input_though_it_is_of_a_control(tmp_path: Path) -> None:
    u = levels(9)
    flag = (np.arange(N) > 90).astype(float)
    made = draft(tmp_path, {"x_mm": moved_by(u)[0], "control_active": flag})
    assert uses(made) == {"x_mm": "coordinate", "control_active": ""}


def test_angles_of_one_machine_are_in_the_unit_of_the_one_that_wraps(tmp_path: Path) -> None:
    turn = 200 * np.sin(np.arange(N) / 200) % 360
    made = draft(tmp_path, {"yaw": turn, "roll": 2 * moved_by(levels(1))[0], "u_V": levels(1)})
    units = {c.name: (c.unit, c.assumed) for c in made.choice.coordinates}
    assert units == {"yaw": ("deg", ()), "roll": ("deg", ("unit",))}


def test_of_several_joints_one_family_drives_each(tmp_path: Path) -> None:
    columns: dict[str, np.ndarray] = {}
    for k in range(3):
        u = levels(20 + k)
        x, v = moved_by(u)
        noise = np.random.default_rng(k).normal(0, 0.3, N)
        columns |= {f"q_{k}": x, f"qd_{k}": v, f"output_{k}": u, f"target_current_{k}": u + noise}
    made = draft(tmp_path, columns)
    families = {i.column.rpartition("_")[0] for i in made.choice.inputs}
    assert (len(made.choice.inputs), len(families)) == (3, 1)


def test_what_no_name_says_is_asked_unless_it_is_plain(tmp_path: Path) -> None:
    x, _ = moved_by(levels(11))
    smooth, _ = moved_by(levels(11), damping=20.0, stiffness=3.0)

    def asked(force: np.ndarray, *names: str) -> list[str]:
        made = draft(tmp_path, dict(zip(names, (force, x), strict=True)))
        assert uses(made) == dict(zip(names, ("input", "coordinate"), strict=True))
        return [q.key for q in made.questions if q.key.startswith("role")]

    assert asked(smooth, "one", "two") == ["role one", "role two"]
    assert asked(smooth, "volts", "angle") == []
    assert asked(levels(11), "one", "two") == []


def test_a_smooth_column_is_not_caused_by_whatever_else_is_smooth(tmp_path: Path) -> None:
    t = DT * np.arange(N)
    waves = [np.sum([np.sin(f * t + k) for f in (1.1, 1.9, 3.2)], axis=0) for k in (0, 2)]
    made = draft(tmp_path, {"theta1": waves[0], "theta2": waves[1]})
    assert uses(made) == {"theta1": "coordinate", "theta2": "coordinate"}
    assert made.notes == ("no input was found: a fit takes the records for free motion",)


def test_joints_and_velocities_without_names_are_two_blocks_that_say_the_period(
    tmp_path: Path,
) -> None:
    """A short piece of a motion in which all joints of an arm move as one, logged without times."""
    dt, part = 0.004, np.linspace(0, 1, 130)
    course = 3 * part**2 - 2 * part**3
    swings = np.array([0.3, -0.15, 1e-5, 0.1, -0.05, 0.4])
    q = np.array([1.1, -0.8, -0.4, -0.7, 0.7, -0.85]) + np.outer(course, swings)
    v = np.gradient(q, dt, axis=0)
    v = np.stack([np.convolve(np.pad(x, 4, "edge"), np.ones(9) / 9, "valid") for x in v.T], axis=1)
    rng = np.random.default_rng(0)
    table = np.hstack([q + 1e-6 * rng.normal(size=q.shape), v + 1e-4 * rng.normal(size=v.shape)])
    np.savetxt(tmp_path / "trajectory.csv", table, "%.6g", ",")
    made = draft_card(tmp_path, ["trajectory.csv"])
    assert [c.column for c in made.choice.coordinates] == [f"column {k}" for k in range(1, 7)]
    velocities = [c.velocity.column if c.velocity else "" for c in made.choice.coordinates]
    assert velocities == [f"column {k}" for k in range(7, 13)]
    assert made.choice.inputs == []
    assert made.dt == pytest.approx(dt)


def test_a_third_block_of_columns_without_names_is_what_drives_the_joints(tmp_path: Path) -> None:
    u = np.stack([levels(k, 25) + 0.3 * levels(k + 9, 7) for k in range(3)])
    q, v = np.stack([moved_by(x) for x in u], axis=1)
    torques = u + 0.4 * np.sign(v)
    rows = {f"column {k}": x for k, x in enumerate([*q, *v, *torques], start=1)}
    np.savetxt(tmp_path / "log.csv", np.column_stack([*rows.values()]), "%.7g", ",")
    made = draft_card(tmp_path, ["log.csv"])
    assert [c.column for c in made.choice.coordinates] == [*rows][:3]
    assert [i.column for i in made.choice.inputs] == [*rows][6:]


def test_directions_of_a_circle_are_no_positions_beside_its_angle(tmp_path: Path) -> None:
    angle = 1.2 * np.sin(np.arange(N) / 40)
    x, y = 0.7 * np.sin(angle), -0.7 * np.cos(angle)
    assert uses(draft(tmp_path, {"x": x, "y": y, "angle": angle})) == {
        "x": "",
        "y": "",
        "angle": "coordinate",
    }


def test_without_another_input_an_acceleration_is_a_command(tmp_path: Path) -> None:
    a = levels(3) - 0.5 * moved_by(levels(3))[1]
    v = np.cumsum(a) * DT
    columns = {"x": np.cumsum(v) * DT, "theta": moved_by(-a)[0], "accel": a}
    expected = {"x": "coordinate", "theta": "coordinate"}
    assert uses(draft(tmp_path, columns)) == {**expected, "accel": "input"}
    driven = draft(tmp_path, {**columns, "u": levels(3)})
    assert uses(driven) == {**expected, "accel": "", "u": "input"}


# --- constraints ---


def test_a_family_of_numbered_columns_has_one_role_and_pairs_by_number(tmp_path: Path) -> None:
    columns: dict[str, np.ndarray] = {}
    for k in range(1, 5):
        u = levels(10 + k, 40 + 10 * k) * (0.02 if k == 4 else 1.0)
        columns[f"q{k}"], columns[f"w{k}"] = moved_by(u, stiffness=5.0 * k)
        columns[f"i{k}"] = u if k < 3 else u + 0.3 * columns[f"q{k}"]
    made = draft(tmp_path, columns)
    expected = {f"q{k}": "coordinate" for k in range(1, 5)}
    expected |= {f"w{k}": f"q{k}" for k in range(1, 5)} | {f"i{k}": "input" for k in range(1, 5)}
    assert uses(made) == expected


def test_of_the_stages_of_a_drive_the_first_is_the_input(tmp_path: Path) -> None:
    u = levels(6)
    x, v = moved_by(u)
    current = u - 0.2 * v + 0.01 * np.random.default_rng(0).normal(size=N)
    made = draft(tmp_path, {"x_m": x, "torque_Nm": 0.3 * current, "i_A": current, "u_V": u})
    assert [name for name, use in uses(made).items() if use == "input"] == ["u_V"]
    assert made.choice.unused["i_A"] == "an effect of 'u_V'"


@pytest.mark.parametrize("name", ["hand_torque_Nm", "interaction_force_N"])
def test_what_acts_from_outside_is_no_stage_of_the_drive(name: str, tmp_path: Path) -> None:
    current, hand = levels(6), levels(7, 35)
    x, _ = moved_by(current + hand)
    made = draft(tmp_path, {"x_m": x, name: hand, "motor_current_A": current})
    assert [c for c, use in uses(made).items() if use == "input"] == [name, "motor_current_A"]


def test_the_counts_of_a_drive_are_the_position_and_its_charge_is_none(tmp_path: Path) -> None:
    current = levels(9)
    x, v = moved_by(current)
    charge = np.cumsum(np.abs(current)) * 1e-4
    columns = {"tachometer": np.round(900 * x), "erpm": 500 * v, "amp_hours_used": charge}
    made = draft(tmp_path, columns | {"current_A": current})
    assert [c.column for c in made.choice.coordinates] == ["tachometer"]


def test_copies_and_filtered_values_are_used_once(tmp_path: Path) -> None:
    u = levels(7)
    x, v = moved_by(u)
    smooth = np.convolve(np.pad(x, 2, "edge"), np.ones(5) / 5, "valid")
    made = draft(tmp_path, {"pos": x, "pos_filt": smooth, "vel": v, "u": u, "u_cmd": 2 * u})
    assert uses(made) == {
        "pos": "coordinate",
        "pos_filt": "",
        "vel": "pos",
        "u": "",
        "u_cmd": "input",
    }
    assert made.choice.unused["u"] == "proportional to the input 'u_cmd'"


def test_a_torque_that_a_controller_makes_of_a_position_is_no_copy_of_it(tmp_path: Path) -> None:
    x, _ = moved_by(levels(7))
    made = draft(tmp_path, {"pos_deg": x.round(3), "torque_Nm": -14 * x.round(3)})
    assert uses(made) == {"pos_deg": "coordinate", "torque_Nm": "input"}


def test_a_velocity_of_no_position_is_not_used(tmp_path: Path) -> None:
    u = levels(8)
    x, _ = moved_by(u)
    made = draft(tmp_path, {"x_mm": 10 * x, "gyro_dps": moved_by(levels(9))[1], "u": u})
    assert uses(made)["gyro_dps"] == ""
    assert "the slope of no position" in made.choice.unused["gyro_dps"]


# --- margins ---


def test_near_assignments_are_a_question_whose_answer_holds(tmp_path: Path) -> None:
    files = twins(tmp_path)
    made = draft_card(tmp_path, files)
    keys = {q.key for q in made.questions if q.key.startswith("role")}
    assert keys <= {"role one", "role two"}
    assert keys
    (used,) = (i.column for i in made.choice.inputs)
    other = "two" if used == "one" else "one"
    assert any(
        x.startswith(f'# not used: "{other}"') and "check" in x for x in made.text.split("\n")
    )
    answered = draft_card(tmp_path, files, {f"role {other}": "input", f"role {used}": "none"})
    assert [i.column for i in answered.choice.inputs] == [other]
    assert not [q for q in answered.questions if q.key.startswith("role")]
    assert "as you say" in answered.text


@pytest.mark.parametrize("name", ["sway_angle_second_derivative", "sway_angle_ddot"])
def test_a_second_derivative_is_no_position(name: str) -> None:
    assert "position" not in read_name(name).quantities
    assert read_name(name).quantity == "acceleration"


@pytest.mark.parametrize(("name", "quantity"), [("u_roll", "control"), ("e_pitch", "error")])
def test_a_letter_before_an_axis_says_the_quantity(name: str, quantity: str) -> None:
    assert quantity in read_name(name).quantities
    assert "position" not in read_name(name).quantities


def test_a_derivative_is_the_velocity_of_the_position_in_its_name() -> None:
    assert [*read_name("trolley_position_first_derivative").quantities] == ["velocity"]
    assert "position" in read_name("tacho position").quantities


def test_that_nothing_else_could_be_the_motion_makes_an_acceleration_no_position(
    tmp_path: Path,
) -> None:
    made = draft(tmp_path, {"pwm": levels(1), "accY": moved_by(levels(1))[0]})
    assert uses(made)["accY"] == "coordinate"
    asked = [q.text for q in made.choice.questions]
    assert "what is 'accY': position, or acceleration (as its name says)?" in asked


def test_clear_columns_are_no_question(tmp_path: Path) -> None:
    u = levels(11)
    x, v = moved_by(u)
    made = draft(tmp_path, {"angle_rad": x, "rate_rad_s": v, "motor_V": u})
    assert made.questions == ()
    assert "check" not in made.text.split("\n", 1)[1]


def test_a_draft_from_python_has_margins_and_writes_nothing(tmp_path: Path) -> None:
    twins(tmp_path)
    before = sorted(tmp_path.iterdir())
    made = tn.draft(tmp_path)
    assert sorted(tmp_path.iterdir()) == before
    margins = {c.name: c.margin for c in made.columns}
    assert margins["one"] < WEIGHTS.near < margins["phi_rad"] < margins["t"]
    answered = tn.draft(tmp_path, {"role one": "input", "role two": "none"})
    assert "as you say" in answered.text
    with pytest.raises(tn.InputError, match="no such file or folder"):
        tn.draft(tmp_path / "nowhere")


# --- units ---


def test_angles_of_one_machine_are_in_one_unit(tmp_path: Path) -> None:
    roll, _ = moved_by(levels(15))
    yaw, _ = moved_by(levels(16), stiffness=0.5)
    columns = {
        "roll": 8 * roll / np.ptp(roll),
        "yaw": 70 * yaw / np.ptp(yaw),
        "motor_V": levels(15),
    }
    made = draft(tmp_path, columns)
    assert [c.unit for c in made.choice.coordinates] == ["deg", "deg"]


def test_an_output_y_is_no_length_and_y_beside_x_is(tmp_path: Path) -> None:
    u = levels(17)
    x, _ = moved_by(u)
    (output,) = draft(tmp_path, {"y": x, "u": u}).choice.coordinates
    assert "if it is an angle" in output.doubts[0]
    plane = draft(
        tmp_path, {"x": 0.1 * moved_by(levels(18))[0], "y": 0.1 * x, "u": u}
    ).choice.coordinates
    assert [c.kind for c in plane] == ["linear"] * 2
    assert not any("if it is an angle" in doubt for c in plane for doubt in c.doubts)


def test_loads_in_the_names_of_files_have_a_line(tmp_path: Path) -> None:
    u = levels(21)
    table = np.column_stack([DT * np.arange(N), moved_by(u)[0], u])
    files = [f"load_{mass}kg_{run}.csv" for mass in (0, 5) for run in (1, 2)]
    for file in files:
        np.savetxt(tmp_path / file, table, "%.7g", ",", header="t,x_m,u", comments="")
    assert any("differ by 0kg, 5kg" in note for note in draft_card(tmp_path, files).notes)
    assert not any("differ by" in note for note in draft_card(tmp_path, files[:2]).notes)


# --- times ---


def test_times_in_ticks_say_the_period(tmp_path: Path) -> None:
    x, _ = moved_by(levels(19))
    table = np.column_stack([500 * np.arange(N), x, levels(19)])
    header = "stamp [10us],angle_rad,u"
    np.savetxt(tmp_path / "r.csv", table, "%.7g", ",", header=header, comments="")
    card = tomllib.loads(draft_card(tmp_path, ["r.csv"]).text)
    assert (card["dt"], "time" in card) == (0.005, False)


def test_whole_times_that_fit_two_units_are_assumed(tmp_path: Path) -> None:
    x, _ = moved_by(levels(20))
    table = np.column_stack([1000 * np.arange(N), x, levels(20)])
    np.savetxt(tmp_path / "r.csv", table, "%.7g", ",", header="time,angle_rad,u", comments="")
    assert tomllib.loads(draft_card(tmp_path, ["r.csv"]).text)["time"]["assumed"] == ["unit"]


def test_times_of_few_digits_say_the_period(tmp_path: Path) -> None:
    t = np.arange(600) / 30
    for k in range(2):
        rows = [f"{a:.2E},{b:.4f}" for a, b in zip(t, np.sin(2 * t + k), strict=True)]
        (tmp_path / f"r{k}.csv").write_text("\n".join(["t,theta_rad", *rows]))
    card = tomllib.loads(draft_card(tmp_path, ["r0.csv", "r1.csv"]).text)
    assert card["dt"] == pytest.approx(1 / 30, rel=5e-3)
    assert ("time" in card, "inputs" in card) == (False, False)


def test_a_first_row_that_is_there_twice_is_cut_off(tmp_path: Path) -> None:
    t = np.append(0.0, DT * np.arange(N - 1))
    x, _ = moved_by(levels(12))
    for k in range(2):
        table = np.column_stack([t, x + k, levels(12)])
        np.savetxt(tmp_path / f"r{k}.csv", table, "%.6g", ",", header="t,x_m,u", comments="")
    made = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    assert any("1 row" in note for note in made.notes)
    (tmp_path / "dataset.toml").write_text(made.text)
    assert [len(record) for record in tn.load(tmp_path)] == [N - 1, N - 1]


# --- bad input ---


def test_names_alike_but_for_case_are_two_columns(tmp_path: Path) -> None:
    u = levels(13)
    x, _ = moved_by(u)
    made = draft(tmp_path, {"X_m": x, "x_m": moved_by(levels(14))[0], "U": u})
    assert uses(made) == {"X_m": "coordinate", "x_m": "coordinate", "U": "input"}
    assert len({c.name for c in made.choice.coordinates}) == 2


def test_columns_that_move_only_elsewhere_are_no_trouble(tmp_path: Path) -> None:
    t = DT * np.arange(9000)
    late = np.where(t < 1, np.sin(9 * t), 0.0)
    gaps = np.where(np.arange(9000) % 50 == 0, np.nan, 1e99 * np.cos(t))
    for k in range(2):
        table = np.column_stack([t, np.sin(2 * t + k), np.cos(2 * t + k), late, late, gaps])
        header = "t,x_m,y_m,button,valve_A,odd"
        np.savetxt(tmp_path / f"r{k}.csv", table, "%.7g", ",", header=header, comments="")
    made = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    assert {"x_m", "y_m"} <= {c.column for c in made.choice.coordinates}


def test_points_are_documented() -> None:
    documentation = type(WEIGHTS).__doc__ or ""
    assert all(f"{name}:" in documentation for name in vars(WEIGHTS))


# --- what moves one to one with a coordinate is no second one ---


def test_a_copy_of_a_position_in_another_unit_is_no_coordinate(tmp_path: Path) -> None:
    u = levels(21)
    x, _ = moved_by(u)
    pixels = np.round(320 + 240 * x)
    columns = {"x_px": pixels, "x_mm": (pixels - 320) / 2.4, "sensor_V": 3 - 4 * x, "duty": u}
    made = draft(tmp_path, columns)
    assert uses(made) == {"x_px": "", "x_mm": "coordinate", "sensor_V": "", "duty": "input"}
    assert made.choice.unused["x_px"] == "2.4 times 'x_mm'"


def test_an_angle_in_two_units_is_one_coordinate_though_filters_differ(tmp_path: Path) -> None:
    u = levels(24)
    x, _ = moved_by(u)
    roll = np.rad2deg(x) + np.random.default_rng(0).normal(0, 0.05, N)
    made = draft(tmp_path, {"roll": roll, "phi": x, "u": u})
    assert [c.column for c in made.choice.coordinates] in (["roll"], ["phi"])
    set_point = {"phi_ref": np.rad2deg(x), "phi": x, "u": u}
    assert uses(draft(tmp_path, set_point))["phi"] == "coordinate"


def test_of_inputs_and_their_sum_the_sum_is_the_input(tmp_path: Path) -> None:
    feedback, friction = levels(25), 0.3 * levels(26, 20)
    total = feedback + friction
    x, _ = moved_by(total)
    columns = {"theta": x, "u_fb": feedback, "u_fric": friction, "u_total": total}
    made = draft(tmp_path, columns)
    assert [i.column for i in made.choice.inputs] == ["u_total"]
    assert made.choice.unused["u_fb"] == "beside the input 'u_total'"


def test_a_multiple_of_an_input_is_none(tmp_path: Path) -> None:
    u = levels(27)
    x, _ = moved_by(u)
    columns = {"knee_angle": x, "knee_torque": 9 * u, "knee_scaled_torque": u}
    assert len(draft(tmp_path, columns).choice.inputs) == 1


def test_propellers_that_balance_one_another_are_inputs(tmp_path: Path) -> None:
    u = np.round(50 * levels(28))
    x, _ = moved_by(u / 50)
    columns = {f"PWM{k + 1}": 400 + sign * u for k, sign in enumerate((1, 1, -1, -1))}
    made = draft(tmp_path, {"time": DT * np.arange(N), "roll": x, **columns}, clock="")
    assert [i.column for i in made.choice.inputs] == [*columns]


def test_the_rate_of_a_set_point_is_no_input(tmp_path: Path) -> None:
    goal, rate = moved_by(levels(29, 150), damping=8.0)
    u = 30 * (goal - np.roll(goal, 3)) + 0.2 * levels(30)
    x, _ = moved_by(u)
    columns = {"x_position": x, "x_command_position": goal, "x_command_velocity": rate}
    made = draft(tmp_path, {**columns, "x_voltage": u})
    assert [i.column for i in made.choice.inputs] == ["x_voltage"]


def test_a_turn_is_found_though_a_sample_is_lost_at_one_of_its_jumps() -> None:
    angle = np.cumsum(0.5 + 0.2 * np.sin(np.arange(N) / 30))
    wrapped = np.angle(np.exp(1j * angle))
    jumps = np.flatnonzero(np.abs(np.diff(wrapped)) > 3)
    kept = np.delete(wrapped, [jumps[3], jumps[3] + 1])
    assert examine([kept]).wrap == pytest.approx(2 * np.pi)


def test_columns_that_are_copies_are_no_position_and_its_velocity(tmp_path: Path) -> None:
    u = levels(32)
    x, v = moved_by(u)
    other, rate = moved_by(levels(33), stiffness=3.0)
    rows = np.column_stack([x, rate, other, v, rate, rate])
    np.savetxt(tmp_path / "log.csv", rows, "%.7g", ",")
    made = draft_card(tmp_path, ["log.csv"])
    velocities = {c.column: c.velocity.column for c in made.choice.coordinates if c.velocity}
    assert ("column 2", "column 5") not in velocities.items()


def test_a_capital_d_is_a_rate_beside_what_it_is_the_rate_of(tmp_path: Path) -> None:
    u = levels(34)
    x, v = moved_by(u)
    made = draft(tmp_path, {"angle": x, "angleD": v, "u": u})
    assert uses(made) == {"angle": "coordinate", "angleD": "angle", "u": "input"}
    terms = draft(tmp_path, {"gyro": v, "axisP": -2 * v, "axisD": np.gradient(v), "motor": u})
    assert [c.column for c in terms.choice.coordinates] == ["gyro"]


def test_beside_numbered_joints_the_pose_and_the_wrench_are_of_the_tool(tmp_path: Path) -> None:
    u = np.stack([levels(k, 25) for k in range(40, 43)])
    q, v = np.stack([moved_by(x) for x in u], axis=1)
    x, y = np.cos(q[0]) + np.cos(q[0] + q[1]), np.sin(q[0]) + np.sin(q[0] + q[1])
    columns = {f"q{k + 1}": a for k, a in enumerate(q)} | {f"qd{k + 1}": a for k, a in enumerate(v)}
    columns |= {"x": x, "y": y, "F_x": np.gradient(x), "F_y": np.gradient(y)}
    made = draft(tmp_path, columns | {f"tau{k + 1}": a for k, a in enumerate(u)})
    assert [c.column for c in made.choice.coordinates] == ["q1", "q2", "q3"]
    assert [i.column for i in made.choice.inputs] == ["tau1", "tau2", "tau3"]


def test_files_of_set_points_are_no_records(tmp_path: Path) -> None:
    u = levels(35)
    x, _ = moved_by(u)
    for name in ("run_measured", "run_desired", "other"):
        table = np.column_stack([DT * np.arange(N), x, u])
        np.savetxt(tmp_path / f"{name}.csv", table, "%.7g", ",", header="t,x,u", comments="")
    files = ["other.csv", "run_desired.csv", "run_measured.csv"]
    made = draft_card(tmp_path, files)
    assert "left out: run_desired.csv: set points by its name" in made.notes
    assert {r.piece.log.file for r in made.splits.records} == {"other.csv", "run_measured.csv"}
    assert len(draft_card(tmp_path, files[:2]).splits.records) > 1  # nothing says what was measured


def test_a_quaternion_is_no_coordinates(tmp_path: Path) -> None:
    u = levels(37)
    x, _ = moved_by(u)
    tilt = 0.3 * np.sin(np.arange(N) / 70)
    quaternion = {
        "q_w": np.cos(tilt) * np.cos(x),
        "q_x": np.cos(tilt) * np.sin(x),
        "q_y": np.sin(tilt) * np.cos(x),
        "q_z": np.sin(tilt) * np.sin(x),
    }
    made = draft(tmp_path, {"wheel_pos": x, **quaternion, "command": u})
    assert [c.column for c in made.choice.coordinates] == ["wheel_pos"]


def test_derivatives_in_words_are_no_positions(tmp_path: Path) -> None:
    u = levels(38)
    x, v = moved_by(u)
    names = ("sway_angle", "sway_angle_first_derivative", "sway_angle_second_derivative")
    columns = dict(zip(names, (x, v, np.gradient(v, DT)), strict=True))
    made = draft(tmp_path, {**columns, "u": u})
    assert uses(made) == {names[0]: "coordinate", names[1]: names[0], names[2]: "", "u": "input"}


@pytest.mark.parametrize(
    "text",
    [
        "Recorded in May.\nformat: time u angle",
        "| Column | Name | Unit |\n|---:|---|---|\n| 1 | `t` | s |\n| 2 | `u` | V |\n"
        "| 3 | `angle` | deg |",
        "Columns:\n| time (in s) | u (in V) | angle (in deg) |\n|---|:---:|---|",
        "1. By:\n2. About:\n3. Rig:\n\tColumn 1: t\n\tColumn 2: u\n\tColumn 3: angle",
    ],
)
def test_a_readme_names_columns_that_have_no_header(text: str, tmp_path: Path) -> None:
    u = levels(36)
    x, _ = moved_by(u)
    rows = np.column_stack([DT * np.arange(N), u, x])
    np.savetxt(tmp_path / "log.csv", rows, "%.7g", ",")
    (tmp_path / "README.md").write_text(text)
    made = draft_card(tmp_path, ["log.csv"])
    (angle,) = made.choice.coordinates
    assert (angle.column, angle.name, angle.kind) == ("column 3", "angle", "angular")
    assert [i.name for i in made.choice.inputs] == ["u"]
    assert any(note.startswith("names of columns by README.md") for note in made.notes)
    (tmp_path / "dataset.toml").write_text(made.text, encoding="utf-8")
    assert tn.load(tmp_path)[0].coordinates[0].name == "angle"


@pytest.mark.parametrize(
    ("script", "text"),
    [
        ("plot.m", "x = load('log.csv');\nuMotor = x(:, 1);\n% q = x(:,1);\nq = x(:, 2:3);"),
        ("read.py", "data = np.loadtxt(path)\nuMotor = data[:, 0]\nq = data[:, 1:3]  # rad\n"),
        ("table.m", "legend({'a','b','c'})\nT.Names = {'uMotor', 'q1', ...\n 'q2'};"),
    ],
)
def test_a_script_names_columns_that_have_no_header(script: str, text: str, tmp_path: Path) -> None:
    u = levels(36)
    x, _ = moved_by(u)
    np.savetxt(tmp_path / "log.csv", np.column_stack([u, x, x[::-1]]), "%.7g", ",")
    (tmp_path / script).write_text(f"{text}\nTs = 1/200;\nother = 3\n")
    made = draft_card(tmp_path, ["log.csv"])
    assert made.notes[0] == f"names of columns by {script}: uMotor, q1, q2"
    assert [c.name for c in made.choice.coordinates] == ["q1", "q2"]
    assert [i.name for i in made.choice.inputs] == ["uMotor"]
    assert made.dt == 0.005
    assert f"as {script} has it" in made.text
    assert "period" not in [question.key for question in made.questions]


def test_a_script_says_what_channels_are_and_two_periods_say_none(tmp_path: Path) -> None:
    u = levels(39)
    x, _ = moved_by(u)
    (tmp_path / "fit.m").write_text("theta = T('Channel 2');\ndata = iddata(theta', U', 5e-3);\n")
    made = draft(tmp_path, {"Channel 1": u, "Channel 2": x}, clock="")
    assert [c.column for c in made.choice.coordinates] == ["Channel 2"]
    assert "'theta' in its name" in made.text
    assert made.dt == 0.005
    (tmp_path / "simulate.py").write_text("dt = 1e-3\n")
    made = draft_card(tmp_path, ["r0.csv"])
    assert "period" in [question.key for question in made.questions]


@pytest.mark.parametrize(
    "text",
    [
        "The rig.\n- `t`: time (s)\n- `y`: measured force\n- `d`: displacement (mm)\n"
        "- `c`: control input (V)\n",
        "| name | meaning | unit |\n|---|---|---|\n| t | time | s |\n| y | measured force | N |\n"
        "| **d** | displacement | mm |\n| c | control input | V |",
    ],
)
def test_a_readme_says_what_short_names_mean(text: str, tmp_path: Path) -> None:
    u = levels(39)
    x, v = moved_by(u)
    (tmp_path / "README.md").write_text(text)
    made = draft(tmp_path, {"y": u - 0.3 * v, "c": u, "d": x})
    (place,) = made.choice.coordinates
    assert (place.column, place.name, place.kind, place.unit) == ("d", "d", "linear", "mm")
    assert [(i.column, i.unit) for i in made.choice.inputs] == [("c", "V")]
    assert any(note.startswith("described by README.md") for note in made.notes)


def test_lists_in_cells_are_columns_and_current_beside_target_is_no_ampere(tmp_path: Path) -> None:
    valves = np.column_stack([levels(3), levels(4)])
    x, _ = moved_by(valves[:, 0])
    y, _ = moved_by(valves[:, 1])
    rows = zip(valves.tolist(), x, y, strict=True)
    lines = [f'{k * DT},"{u}",{a:.6f},{b:.6f},0.1,0.2' for k, (u, a, b) in enumerate(rows)]
    names = "t,command valve,current_x,current_y,target_x,target_y"
    (tmp_path / "log.csv").write_text("\n".join([names, *lines]))
    made = draft_card(tmp_path, ["log.csv"])
    assert [c.column for c in made.choice.coordinates] == ["current_x", "current_y"]
    assert [i.column for i in made.choice.inputs] == ["command valve[1]", "command valve[2]"]
    (tmp_path / "dataset.toml").write_text(made.text, encoding="utf-8")
    loaded = np.concatenate([record.u for record in tn.load(tmp_path)])
    np.testing.assert_array_equal(loaded, valves)  # the parts of a card's splits


def test_joints_of_several_legs_are_told_by_leg_and_number(tmp_path: Path) -> None:
    joints = [f"{leg}{k}" for leg in ("FL", "FR") for k in (0, 1)]
    torques = {f"{joint}_torque": levels(40 + i) for i, joint in enumerate(joints)}
    places = {f"{joint}_pos": moved_by(torques[f"{joint}_torque"])[0] for joint in joints}
    made = draft(tmp_path, {**torques, **places})
    assert [c.column for c in made.choice.coordinates] == [*places]
    assert [i.column for i in made.choice.inputs] == [*torques]


def test_times_that_would_be_faster_than_any_log_are_in_another_unit(tmp_path: Path) -> None:
    u = levels(45)
    made = draft(tmp_path, {"angle [deg]": moved_by(u)[0], "volts": u}, clock="Time [mS]")
    assert 'unit = "s"' in made.text
    assert any("Time [mS]" in line and "check the unit" in line for line in made.text.splitlines())


def test_a_duration_is_no_unit_of_a_position(tmp_path: Path) -> None:
    u = levels(44)
    made = draft(tmp_path, {"Swing Cmd": u, "Swing Ms": moved_by(u)[0]})
    assert [(c.column, c.unit) for c in made.choice.coordinates] == [("Swing Ms", "rad")]


def test_terms_of_a_controller_are_neither_inputs_nor_positions(tmp_path: Path) -> None:
    u = levels(31)
    x, v = moved_by(u)
    terms = {"P": -3 * x, "I": np.cumsum(-x) / 40, "D": -0.4 * v, "PID": u}
    elbow = {f"elbow_T_{name.lower()}": column for name, column in terms.items() if name != "PID"}
    made = draft(tmp_path, {"elbow_deg": np.rad2deg(x), **elbow, "elbow_torque": u})
    assert {*elbow} <= {*made.choice.unused}
    assert uses(draft(tmp_path, {"Angle": x, **terms})) == {
        **dict.fromkeys("PID", ""),
        "Angle": "coordinate",
        "PID": "input",
    }


def test_joints_that_move_as_one_for_a_while_are_coordinates(tmp_path: Path) -> None:
    course = np.sin(np.arange(N) / 60)
    torques = {f"tau_{k}": np.gradient(np.gradient(k * course)) + levels(k) for k in (1, 2)}
    made = draft(tmp_path, {"q_1": 0.5 * course, "q_2": -1.1 * course, **torques})
    assert [c.column for c in made.choice.coordinates] == ["q_1", "q_2"]


def test_of_two_positions_and_their_difference_two_are_coordinates(tmp_path: Path) -> None:
    force = levels(22)
    x, _ = moved_by(force)
    y, _ = moved_by(x, damping=0.8, stiffness=20)
    made = draft(tmp_path, {"body (m)": x, "wheel (m)": y, "stroke (m)": x - y, "F (N)": force})
    assert [c.column for c in made.choice.coordinates] == ["body (m)", "wheel (m)"]
    assert "the sum or difference" in made.choice.unused["stroke (m)"]


def test_a_position_that_may_move_another_one_is_a_question(tmp_path: Path) -> None:
    road = np.convolve(levels(23, 20), np.ones(8) / 8, "same") / 50
    body, _ = moved_by(road)
    made = draft(tmp_path, {"road (mm)": 100 * road, "body (mm)": 100 * body})
    assert uses(made) == {"road (mm)": "coordinate", "body (mm)": "coordinate"}
    assert [q.text.partition("(")[0] for q in made.questions][:1] == ["what is 'road "]


def test_a_function_of_a_position_is_not_moved_by_it(tmp_path: Path) -> None:
    angle = np.convolve(levels(24, 15), np.ones(30) / 30, "same")
    made = draft(tmp_path, {"angle (rad)": angle, "tip (m)": 0.4 * np.sin(angle) + 0.1 * angle**2})
    assert "angle (rad)" in [c.column for c in made.choice.coordinates]


def test_a_letter_t_that_does_not_rise_is_no_time(tmp_path: Path) -> None:
    tension = levels(25)
    x, _ = moved_by(tension)
    made = draft(tmp_path, {"x": x, "x_ref": np.round(x, 1), "T1": tension}, clock="time")
    assert uses(made) == {"x": "coordinate", "x_ref": "", "T1": "input"}


def test_cosine_and_sine_beside_their_angle_are_not_used(tmp_path: Path) -> None:
    u = levels(26)
    angle, _ = moved_by(u)
    angle = angle + 1e-4 * np.random.default_rng(0).normal(size=N)
    columns = {"theta": angle, "cos_theta": np.cos(angle), "sin_theta": np.sin(angle), "u": u}
    uses_of = uses(draft(tmp_path, columns))
    assert [name for name, use in uses_of.items() if use] == ["theta", "u"]


def test_a_copy_is_known_by_the_cells_that_both_have() -> None:
    x = np.sin(np.arange(300.0))
    holes = np.where(np.arange(300) % 7, 2 * x + 1, np.nan)
    assert find_copy([x], [holes]) == pytest.approx(2)
    assert find_copy([x], [np.full(300, np.nan)]) == 0
    assert find_copy([x], [np.cos(np.arange(300.0))]) == 0


def test_an_answer_on_a_unit_leaves_what_a_name_says(tmp_path: Path) -> None:
    first, second = levels(5), levels(6)
    x, y = moved_by(first)[0], moved_by(second)[0]
    columns = {"x_mm": 100 * x, "y_mm": 100 * y, "u_soll": first, "u_other_mV": 1e3 * second}
    draft(tmp_path, columns)
    made = tn.draft(tmp_path, {"unit u_soll": "%", "role u_soll": "input"})
    assert {i.column: i.unit for i in made.choice.inputs} == {"u_soll": "%", "u_other_mV": "mV"}


def test_a_letter_behind_a_unit_is_none(tmp_path: Path) -> None:
    assert read_name("Ink_M").unit == ""
    assert read_name("rail_m").unit == "m"


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"unit ang": "deg"}, "an answer to 'unit ang'"),
        ({"role one": "inptu"}, "a role 'inptu'"),
        ({"unit phi_rad": "blah"}, "blah"),
    ],
)
def test_answers_that_say_nothing_are_refused(
    answers: dict[str, str], message: str, tmp_path: Path
) -> None:
    twins(tmp_path)
    with pytest.raises(tn.InputError, match=message):
        tn.draft(tmp_path, answers)


def test_letters_say_which_of_several_alike(tmp_path: Path) -> None:
    legs = [moved_by(levels(k)) for k in (1, 2)]
    columns = {f"Leg Angle {x}": legs[k][0] for k, x in enumerate("AB")}
    columns |= {f"Motor Torque {x}": levels(k + 1) for k, x in enumerate("AB")}
    columns |= {f"Motor Current {x}": levels(k + 1) / 8.5 for k, x in enumerate("AB")}
    made = draft(tmp_path, columns)
    assert {c.column for c in made.choice.coordinates} == {"Leg Angle A", "Leg Angle B"}
    assert len({i.column.split()[1] for i in made.choice.inputs}) == 1
    assert read_name("Motor Torque A").unit == ""


def test_two_directions_of_a_free_pendulum_are_positions_and_no_inputs(tmp_path: Path) -> None:
    angle = 1.2 * np.cos(3 * DT * np.arange(N)) * np.exp(-0.05 * DT * np.arange(N))
    made = draft(tmp_path, {"x": 0.6 * np.sin(angle), "y": -0.6 * np.cos(angle)})
    assert [c.column for c in made.choice.coordinates] == ["x", "y"]
    assert not made.choice.inputs


def test_a_tilt_of_more_than_half_a_turn_is_in_degrees(tmp_path: Path) -> None:
    u = levels(3)
    q = moved_by(u)[0]
    made = draft(tmp_path, {"pitch": 6 * q / np.ptp(q), "u": u})
    assert [c.unit for c in made.choice.coordinates] == ["deg"]


def test_numbers_in_brackets_of_a_text_are_no_elements(tmp_path: Path) -> None:
    servos = {f"pos ({k})": moved_by(levels(k))[0] for k in (3, 5)}
    servos |= {f"pwm ({k})": levels(k) for k in (3, 5)}
    made = draft(tmp_path, servos)
    assert [c.column for c in made.choice.coordinates] == ["pos (3)", "pos (5)"]
    assert [i.column for i in made.choice.inputs] == ["pwm (3)", "pwm (5)"]


def test_a_table_beside_the_logs_says_units(tmp_path: Path) -> None:
    (tmp_path / "format.md").write_text(
        "| no | name | unit |\n|-|-|-|\n| 1 | `y` | mm |\n| 2 | `u` | A |"
    )
    u = levels(4)
    made = draft(tmp_path, {"y": moved_by(u)[0], "u": u})
    assert [(c.column, c.unit) for c in made.choice.coordinates] == [("y", "mm")]
    assert [i.unit for i in made.choice.inputs] == ["A"]


def test_times_that_are_there_twice_are_no_input_and_matrices_are_described(
    tmp_path: Path,
) -> None:
    u, t = levels(63), DT * np.arange(N)
    x, _ = moved_by(u)
    matrices = {"theta": np.column_stack([t, 2 * u, x]), "Vm": np.column_stack([t, u])}
    scipy.io.savemat(tmp_path / "a.mat", matrices)
    text = "theta : time (s), desired angle of the arm (deg), angle (deg)\nVm: time (s), in V\n"
    (tmp_path / "notes.txt").write_text(text)
    made = draft_card(tmp_path, ["a.mat"])
    assert [c.column for c in made.choice.coordinates] == ["theta[3]"]
    assert [i.column for i in made.choice.inputs] == ["Vm[2]"]
    assert next(c.role for c in made.columns if c.name == "theta[2]") == "set point"
    (tmp_path / "notes.txt").unlink()
    made = draft_card(tmp_path, ["a.mat"])
    assert "Vm[1]" not in [i.column for i in made.choice.inputs]


def test_samples_that_a_sensor_lost_are_left_out(tmp_path: Path) -> None:
    u = levels(64)
    x, _ = moved_by(u)
    x[[200, 700]] = np.nan
    made = draft(tmp_path, {"angle_rad": x, "u": u})
    assert 'damaged_rows = "skip"' in made.text
    assert any("2 damaged rows" in note for note in made.notes)
    assert sum(map(len, tn.load(tmp_path))) == N  # filled by resampling


def test_files_that_name_positions_are_the_records_and_a_card_has_one_period(
    tmp_path: Path,
) -> None:
    u = levels(65)
    x, _ = moved_by(u)
    for k, ticks in enumerate((1, 1, 2)):
        lines = [f"# SAMPLE_TIME = {ticks * DT}", "# NAME0 = angle", "# NAME1 = u"]
        rows = [f"{a:.6f} {b:.6f}" for a, b in zip(x, u, strict=True)]
        (tmp_path / f"r{k}.dat").write_text("\n".join([*lines, *rows]))
        states = np.column_stack([np.arange(N), u[::-1], u])
        np.savetxt(tmp_path / f"s{k}.csv", states, "%.6g", ",", header="s,d0,d1", comments="")
    files = [f"{kind}{k}.{end}" for kind, end in (("s", "csv"), ("r", "dat")) for k in range(3)]
    made = draft_card(tmp_path, files)
    assert made.dt == DT
    assert [c.column for c in made.choice.coordinates] == ["angle"]
    assert "left out: r2.dat: a period of 0.02 s, and not 0.01 s" in made.notes


def test_the_distance_that_a_position_has_travelled_is_none(tmp_path: Path) -> None:
    u = levels(66)
    x, _ = moved_by(u)
    way = np.concatenate([[0], np.cumsum(np.abs(np.diff(x)))])
    made = draft(tmp_path, {"slide_m": x, "trip_m": way, "u": u})
    assert uses(made) == {"slide_m": "coordinate", "trip_m": "", "u": "input"}
