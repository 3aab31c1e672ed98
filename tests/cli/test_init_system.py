"""`tustinnet init --system`: the card has the coordinates and inputs of the system."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from test_verbs import tustinnet

import tustinnet as tn

ROBOTS = Path(__file__).parents[2] / "examples" / "robots"


def write_logs(folder: Path, header: str, scales: np.ndarray) -> Path:
    """Logs of columns that move as joints and torques do, under any names."""
    rng, t = np.random.default_rng(3), 0.005 * np.arange(600)
    folder.mkdir()
    for run in range(2):
        n = len(scales)
        phase, rate = rng.uniform(0, 6, (3, n)), rng.uniform(0.5, 4, (3, n))
        columns = np.sin(t[:, None, None] * rate + phase).sum(axis=1) * scales
        table = np.column_stack([t, columns])
        np.savetxt(folder / f"run{run}.csv", table, "%.6f", ",", header=header, comments="")
    return folder


def write_arm(folder: Path, count: int) -> Path:
    """An arm of some joints, each with an actuator."""
    links = "".join(
        f'<link name="l{k}"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/>'
        "</inertial></link>"
        f'<joint name="joint{k}" type="continuous"><parent link="{f"l{k - 1}" if k > 1 else "b"}"/>'
        f'<child link="l{k}"/><origin xyz="0.3 0 0"/></joint>'
        for k in range(1, count + 1)
    )
    (file := folder / "arm.urdf").write_text(f'<robot name="a"><link name="b"/>{links}</robot>')
    return file


def card_of(folder: Path) -> dict[str, dict[str, dict[str, object]]]:
    """Coordinates and inputs of the card in a folder, by name."""
    card = tomllib.loads((folder / "dataset.toml").read_text())
    return {
        sort: {entry["name"]: entry for entry in card.get(sort, [])}
        for sort in ("coordinates", "inputs")
    }


SCARA = (
    "time_s,Roll [deg],elbow_pos,lift_mm,Shoulder Angle,spare,i_shoulder_mA,elbow tau [mNm],"
    "roll_effort,lift_N"
)


def test_columns_are_matched_with_the_joints_of_a_robot(tmp_path: Path, capsys) -> None:
    folder = write_logs(
        tmp_path / "logs", SCARA, np.array([40, 0.8, 60, 0.7, 1, 900, 800, 0.5, 20.0])
    )
    system = ROBOTS / "scara.urdf"
    code, out, err = tustinnet(capsys, "init", folder, "--system", system, "--yes", "--json")
    assert code == 0, err
    card = card_of(folder)
    loaded = tn.load_system(system)
    assert [*card["coordinates"]] == [c.name for c in loaded.coordinates]
    assert {name: c["column"] for name, c in card["coordinates"].items()} == {
        "shoulder": "Shoulder Angle",
        "elbow": "elbow_pos",
        "lift": "lift_mm",
        "roll": "Roll [deg]",
    }
    assert card["coordinates"]["lift"]["kind"] == "linear"
    inputs = card["inputs"]
    assert [*inputs] == [i.name for i in loaded.inputs]
    assert {i["column"] for i in inputs.values()} == {
        "i_shoulder_mA",
        "elbow tau [mNm]",
        "lift_N",
        "roll_effort",
    }
    elbow = next(i for i in inputs.values() if i["column"] == "elbow tau [mNm]")
    assert (elbow["unit"], elbow["scale"]) == ("N m", 0.001)
    # a current is no torque: the line says what a fit needs
    assert "motor_constants={'shoulder': ...}" in err
    assert "next, when that is mended: tustinnet fit" in err
    assert "--system FILE.py --out RUN" in err
    assert "'spare'" not in err
    used = {c["name"]: c["use"] for c in json.loads(out)["columns"]}
    assert used["spare"] == ""


@pytest.mark.thorough
def test_a_card_of_a_robot_works_at_once(tmp_path: Path, capsys) -> None:
    header = SCARA.replace("i_shoulder_mA", "shoulder_torque")
    folder = write_logs(
        tmp_path / "logs", header, np.array([40, 0.8, 60, 0.7, 1, 9, 800, 0.5, 20.0])
    )
    system = ROBOTS / "scara.urdf"
    code, _, err = tustinnet(capsys, "init", folder, "--system", system, "--yes")
    assert code == 0, err
    assert f"--recipe inverse-dynamics --system {system} --out RUN" in err
    assert "not matched" not in err
    assert "needs" not in err
    record = tn.load(folder)[0]
    adapted = tn.load_system(system).for_channels(record.coordinates, record.inputs, "the card")
    assert adapted.channels.n_u == 4


def test_what_has_no_column_is_one_line_each(tmp_path: Path, capsys) -> None:
    header = "time_s,elbow_deg,foo,shoulder_deg,elbow_tau,lift_N"
    folder = write_logs(tmp_path / "logs", header, np.array([40, 30, 50, 3, 20.0]))
    text = (ROBOTS / "scara.urdf").read_text()
    text = text.replace("</robot>", "<transmission name='t'/></robot>")
    (file := tmp_path / "scara.urdf").write_text(text)
    code, _, err = tustinnet(capsys, "init", folder, "--system", file, "--yes")
    assert code == 0, err
    assert "scara.urdf, t: left out, as none of its joints is there\n" in err
    lines = [line for line in err.splitlines() if line.startswith("not matched:")]
    assert [line.split("for the ")[1] for line in lines] == [
        "coordinate 'lift'",
        "coordinate 'roll'",
        "input 'shoulder_torque'",
        "input 'roll_torque'",
    ]
    assert "locked={'lift': 0.0, 'roll': 0.0}" in err


def test_fewer_positions_than_joints_that_nothing_joins_are_counted(tmp_path: Path, capsys) -> None:
    folder = write_logs(tmp_path / "logs", "time_s,q1,q2,i1,i2", np.array([1, 1, 5, 5.0]))
    code, _, err = tustinnet(capsys, "init", folder, "--system", ROBOTS / "scara.urdf", "--yes")
    assert code == 1
    assert "2 positions that neither names nor numbers join to the system's coordinates" in err
    assert "('q1', 'q2'): no column was found for the coordinate 'shoulder'" in err


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        # numbers of columns that are those of the joints
        (("q2", "q1", "q3"), {"joint1": "q1", "joint2": "q2", "joint3": "q3"}),
        # counted from 0 on: the order
        (("q0", "q1", "q2"), {"joint1": "q0", "joint2": "q1", "joint3": "q2"}),
    ],
)
def test_numbers_are_those_of_joints_or_an_order(
    columns: tuple[str, ...], expected: dict[str, str], tmp_path: Path, capsys
) -> None:
    file = write_arm(tmp_path, 3)
    header = ",".join(["time_s", *(f"{c}_rad" for c in columns), *(f"tau{c[1]}" for c in columns)])
    folder = write_logs(tmp_path / "logs", header, np.array([1, 1, 1, 5, 5, 5.0]))
    code, _, err = tustinnet(capsys, "init", folder, "--system", file, "--yes")
    assert code == 0, err
    card = card_of(folder)
    assert {n: c["column"] for n, c in card["coordinates"].items()} == {
        name: f"{column}_rad" for name, column in expected.items()
    }
    assert {n: i["column"] for n, i in card["inputs"].items()} == {
        f"{name}_torque": f"tau{column[1]}" for name, column in expected.items()
    }
    is_by_order = "q0" in columns
    assert ("no name says it" in (folder / "dataset.toml").read_text()) == is_by_order


LEG = """<mujoco><worldbody><body name="a"><joint name="hip" axis="0 1 0"/>
  <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
  <body name="b"><joint name="knee" axis="0 1 0"/>
  <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body></body></worldbody>
  <actuator><position joint="hip" kp="20"/><position name="lower" joint="knee" kp="20"/></actuator>
</mujoco>"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("positions", "goals"),
    [
        (("present_position_1", "present_position_2"), ("goal_position_1", "goal_position_2")),
        (("state.knee.pos", "state.hip.pos"), ("action.knee.pos", "action.hip.pos")),
        (("hip_ist", "knee_ist"), ("hip_soll", "knee_soll")),
        (("q_hip_deg", "q_knee_deg"), ("q_des_hip_deg", "q_des_knee_deg")),
    ],
)
def test_goals_are_inputs_of_servos(positions, goals, tmp_path: Path, capsys) -> None:
    (file := tmp_path / "leg.xml").write_text(LEG)
    header = ",".join(["time_s", *positions, *goals])
    folder = write_logs(tmp_path / "logs", header, np.array([1, 1, 1.1, 1.1]))
    code, _, err = tustinnet(capsys, "init", folder, "--system", file, "--yes")
    assert code == 0, err
    assert "not matched" not in err
    card, order = card_of(folder), slice(None, None, -1 if "knee" in goals[0] else 1)
    assert [i["column"] for i in card["inputs"].values()] == [*goals][order]
    assert [*card["inputs"]] == ["hip_goal", "lower"]
    assert {i["unit"] for i in card["inputs"].values()} == {"rad"}


def test_a_file_that_is_no_robot_is_said_before_logs_are_read(tmp_path: Path, capsys) -> None:
    (file := tmp_path / "arm.urdf").write_text("<robot>")
    code, _, err = tustinnet(capsys, "init", tmp_path / "nowhere", "--system", file)
    assert (code, err.count("\n")) == (1, 1)
    assert "no well-formed XML" in err


def test_links_without_an_inertia_need_a_density_here_too(tmp_path: Path, capsys) -> None:
    (file := tmp_path / "arm.urdf").write_text(
        '<robot name="a"><link name="b"/><link name="l"><visual><geometry><sphere radius="0.1"/>'
        '</geometry></visual></link><joint name="hip" type="continuous"><parent link="b"/>'
        '<child link="l"/></joint></robot>'
    )
    folder = write_logs(tmp_path / "logs", "time_s,hip_rad,hip_torque", np.array([1.0, 5.0]))
    code, _, err = tustinnet(capsys, "init", folder, "--system", file, "--yes")
    assert (code, err.count("\n")) == (1, 1)
    code_file = tmp_path / "arm.py"
    told = "SYSTEM = tn.load_robot(FILE, default_density=2700.0)"
    assert told in err
    code_file.write_text(f"import tustinnet as tn\n{told.replace('FILE', repr('arm.urdf'))}")
    code, _, err = tustinnet(capsys, "init", folder, "--system", code_file, "--yes")
    assert code == 0, err
    assert f"--system {code_file} --out RUN" in err


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("position", "set_point", "torque"),
    [
        ("q_{}", "q_d_{}", "tau_J_{}"),
        ("actual_q_{}", "target_q_{}", "actual_current_{}"),
        ("q_{}", "q_ref_{}", "tau_{}"),
        ("ist_{}", "soll_{}", "moment_{}"),
        ("pos{}", "pos_des{}", "torque{}"),
    ],
)
def test_set_points_of_positions_are_no_torques(
    position, set_point, torque, tmp_path: Path, capsys
) -> None:
    """Arms in closed loop: what a position follows one to one is its set point."""
    rng, t = np.random.default_rng(1), 0.004 * np.arange(1500)
    (folder := tmp_path / "logs").mkdir()
    for run in range(2):
        rate, phase = rng.uniform(0.5, 4, (2, 3, 2))
        asked, q = (
            np.sin((t[:, None, None] - lag) * rate + phase).sum(axis=1) for lag in (0, 0.02)
        )
        tau = np.gradient(np.gradient(q, axis=0), axis=0) / 0.004**2 + 3 * np.sin(q)
        table = np.column_stack([t, q, asked, tau + 0.1 * rng.normal(size=tau.shape)])
        names = [name.format(k) for name in (position, set_point, torque) for k in (0, 1)]
        header = ",".join(["timestamp", *names])
        np.savetxt(folder / f"run{run}.csv", table, "%.6f", ",", header=header, comments="")
    arm = write_arm(tmp_path, 2)
    code, _, err = tustinnet(capsys, "init", folder, "--system", arm, "--yes")
    assert code == 0, err
    card = card_of(folder)
    for sort, name in (("coordinates", position), ("inputs", torque)):
        assert [c["column"] for c in card[sort].values()] == [name.format(k) for k in (0, 1)]
