"""What names of columns say, and how labels and conventions are read."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from lab_files import mcap_file

from tustinnet.data.drafting.draft import draft_card
from tustinnet.data.drafting.names import read_name
from tustinnet.data.readers import read_columns

# a name, its quantity, its unit and whether it is a command
NAMES = [
    ("posición [°]", "position", "deg", False),
    ("i1_cmd_mA", "current", "mA", True),
    ("F_kN", "force", "kN", False),
    ("axis0.controller.input_pos", "position", "", True),
    ("input torque", "control", "", False),
    ("rpm", "velocity", "rpm", False),
    ("Sollposition X [mm]", "position", "mm", True),
    ("Istposition", "position", "", False),
    ("seilwinkel", "position", "", False),
    ("Geschwindigkeitssollwert [mm/s]", "velocity", "mm/s", True),
    ("BatteryVoltage_V", "other", "V", False),
    ("Schleppabstand [mm]", "error", "mm", False),
    ("wheelspeed", "velocity", "", False),
    ("uq", "voltage", "", False),
    ("deg", "position", "deg", False),
    ("yaw_torque", "torque", "", False),
    ("tau_theta", "torque", "", False),
    ("ctrl.roll", "control", "", False),
    ("yaw_current", "current", "", False),
    ("current_yaw", "position", "", False),
    ("pitch_voltage", "voltage", "", False),
    ("pot_voltage", "position", "", False),
    ("angle_current", "position", "", False),
    ("i2_A", "current", "A", False),
    ("XTACHO", "velocity", "", False),
    ("cylinder_p", "pressure", "", False),
    ("angleD_raw", "velocity", "", False),
    ("positionDD", "acceleration", "", False),
    ("ID", "counter", "", False),
    ("Tcoil_C", "other", "degC", False),
    ("tau_c", "torque", "", False),
    ("angle_squared", "other", "", False),
    ("en1angle", "position", "", False),
    ("Motor Torque A", "torque", "", False),
]


@pytest.mark.parametrize(("name", "quantity", "unit", "is_command"), NAMES)
def test_words_and_units_of_a_name(name: str, quantity: str, unit: str, is_command: bool) -> None:
    reading = read_name(name)
    assert (reading.quantity, reading.unit) == (quantity, unit)
    assert (reading.qualifier == "command") == is_command


def test_units_are_read_from_comments_and_from_attributes_of_a_scope(tmp_path: Path) -> None:
    rows = "".join(f"{k},{k * k},{k % 7}\n" for k in range(30))
    (tmp_path / "a.csv").write_text(f"# x: mm\n# L: 0.4\n# u: motor power\nt,x,u\n{rows}")
    assert read_columns(tmp_path / "a.csv").units == {"x": "mm"}
    above = {"Name": ("x", "u"), "SampleTime[ms]": (1, 1), "Unit": ("mm (Length)", "(None)")}
    lines = [f"{key};{x};{key};{u}" for key, (x, u) in above.items()]
    lines += [f"{k};{k * k};{k};{k % 7}" for k in range(30)]
    (tmp_path / "b.csv").write_text("\n".join(lines) + "\n")
    assert read_columns(tmp_path / "b.csv").units["x"] == "mm"


def test_labels_beside_the_numbers_of_a_mat_file_are_their_names(tmp_path: Path) -> None:
    t = 0.01 * np.arange(400)
    u = np.sign(np.sin(t * 3))
    signals = np.empty((1, 2), dtype=[(key, object) for key in ("Name", "Unit", "Data")])
    signals[0, 0] = ("Motor angle", "rad", np.cumsum(np.cumsum(u))[None] * 1e-4)
    signals[0, 1] = ("u_cmd", "V", u[None])
    capture = {"X": {"Name": "", "Unit": "s", "Data": t[None]}, "Y": signals}
    scipy.io.savemat(tmp_path / "log.mat", {"exp": capture})
    columns = read_columns(tmp_path / "log.mat")
    assert columns.labels == {"exp.Y(1).Data": "Motor angle", "exp.Y(2).Data": "u_cmd"}
    assert columns.units["exp.Y(1).Data"] == "rad"
    choice = draft_card(tmp_path, ["log.mat"]).choice
    assert [(c.name, c.column, c.unit) for c in choice.coordinates] == [
        ("Motor_angle", "exp.Y(1).Data", "rad")
    ]
    assert [(c.name, c.unit) for c in choice.inputs] == [("u_cmd", "V")]


def test_joint_states_have_the_units_of_ros(tmp_path: Path) -> None:
    units = read_columns(mcap_file(tmp_path / "log.mcap")).units
    assert units["joint_states/position/shoulder"] == "rad"
    assert units["joint_states/effort/elbow"] == "N m"
    assert "command/data[0]" not in units


def test_signals_in_the_rows_of_a_matrix_are_columns(tmp_path: Path) -> None:
    t = 0.01 * np.arange(300)
    scipy.io.savemat(tmp_path / "log.mat", {"servo": np.stack([t, np.sin(t)]), "K": np.eye(3)})
    columns = read_columns(tmp_path / "log.mat")
    assert columns.names[:2] == ("servo[1]", "servo[2]")
    np.testing.assert_array_equal(columns["servo[2]"], np.sin(t))
    assert len(columns["K[1]"]) == 3


def _write_two_joints(folder: Path, names: Sequence[str]) -> None:
    """Logs of two joints that are driven apart, the second one by a current."""
    rng, t = np.random.default_rng(1), 0.01 * np.arange(900)
    for run in range(2):
        u = [np.sin(f * t + rng.uniform(0, 6, (4, 1))).sum(axis=0) for f in (1.1, 1.7)]
        q = []
        for force in u:
            v = x = 0.0
            positions = []
            for f in force:
                v += 0.01 * (f - 0.5 * v - 2 * x)
                x += 0.01 * v
                positions.append(x)
            q.append(np.round(np.array(positions), 4))
        table = np.column_stack([t, *q, *u])
        np.savetxt(
            folder / f"r{run}.csv", table, delimiter=",", comments="", header=",".join(names)
        )


@pytest.mark.parametrize(
    "names",
    [
        ("t", "rail_m", "yaw_rad", "rail_force", "yaw_amps"),
        ("t", "x_m", "yaw", "x_force", "yaw_current"),
        ("t", "q1_rad", "q2_rad", "tau1_Nm", "i2_A"),
    ],
)
def test_a_current_at_one_joint_is_no_effect_of_the_force_at_another(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    _write_two_joints(tmp_path, names)
    draft = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    assert [c.column for c in draft.choice.coordinates] == [*names[1:3]]
    assert [i.column for i in draft.choice.inputs] == [*names[3:]]
    assert not draft.choice.unused


def test_what_a_drive_controls_is_a_command_and_a_controllers_effort_no_torque() -> None:
    assert read_name("control_position").qualifier == "command"
    assert read_name("control_torque").quantities.keys() == {"control", "torque"}
    assert read_name("Control Effort").quantity == "control"
    assert read_name("effort_0").quantity == "torque"
    assert (read_name("erpm").quantity, read_name("amp_hours_used").quantity) == (
        "velocity",
        "other",
    )


def test_psi_behind_an_input_is_an_angle_and_behind_a_pressure_its_unit() -> None:
    assert (read_name("u_psi").unit, read_name("u_psi").object) == ("", read_name("psi").object)
    assert read_name("p_psi").unit == read_name("tank (psi)").unit == "psi"
