"""A single file that no card describes."""

import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import scipy.io

import tustinnet as tn
from tustinnet.data.drafting.draft import draft_file

N = 400
T = np.arange(N) * 0.01
ANGLE = np.sin(3 * T) + 0.3 * np.sin(11 * T)
COUNTS = np.round(ANGLE * 4096 / (2 * np.pi))
RATE = np.gradient(ANGLE, 0.01)
LEVELS = np.repeat(np.random.default_rng(0).choice([-2.0, 0.0, 2.0], N // 40), 40)
NOISE = np.random.default_rng(1).normal(size=N)


def log(path: Path) -> Path:
    pl.DataFrame(
        {
            "time [ms]": 1000 * T,
            "arm": COUNTS,
            "rate": RATE,
            "a": LEVELS,
            "b": NOISE,
            "gain": np.ones(N),
            "state": ["on"] * N,
        }
    ).write_csv(path)
    return path


def test_columns_are_told_apart(tmp_path: Path) -> None:
    found = draft_file(log(tmp_path / "run 1.csv"))
    roles = {c.name: c.role for c in found.columns}
    assert roles == {
        "time [ms]": "time",
        "arm": "position",
        "rate": "velocity",
        "a": "input",
        "b": "other",
        "gain": "constant",
    }
    assert {*found.texts} == {"state"}
    assert (found.rows, found.clock.unit) == (N, "ms")
    assert found.dt == pytest.approx(0.01)
    assert found.clock.worst == pytest.approx(0, abs=1e-9)
    by_name = {c.name: c for c in found.columns}
    assert by_name["arm"].numbers.count == pytest.approx(1)
    assert by_name["rate"].because.startswith("slope of 'arm'")
    assert by_name["a"].because.startswith("held levels")
    assert by_name["b"].because == "no quantity of the motion: only noise"


PUSH = ANGLE + 0.2 * np.cos(9 * T)  # nearly as the angle, as an input of a slow machine is
BELT = {"time": T, "motor_cnt": COUNTS, "carriage_mm": 90 * PUSH, "voltage": PUSH**3}
# columns; of each coordinate name, column, unit and velocity column; of each input name and unit
DRAFTS = [
    (
        BELT,
        [("motor", "motor_cnt", "counts", None), ("carriage", "carriage_mm", "mm", None)],
        [("voltage", "V")],
    ),
    # a unit says more than words or values
    (
        {"arm_deg": np.cos(5 * T), "pos_um": np.sin(7 * T), "encoder_ticks1": ANGLE},
        [
            ("arm", "arm_deg", "deg", None),
            ("pos", "pos_um", "um", None),
            ("encoder", "encoder_ticks1", "counts", None),
        ],
        [],
    ),
    # of a voltage, forces and a current the voltage moves first
    (
        {"x": ANGLE, "lift_n": NOISE, "shaft_nm": COUNTS, "coil_a": RATE, "b_volt": LEVELS},
        [("x", "x", "m", None)],
        [("b", "V")],
    ),
    (
        {"x": ANGLE, "lift_n": NOISE, "shaft_nm": LEVELS},
        [("x", "x", "m", None)],
        [("lift", "N"), ("shaft", "N m")],
    ),
    (
        {"slide [cm]": PUSH, "motorCnt 1": COUNTS, "drive (mV)": PUSH**3},
        [("slide", "slide [cm]", "cm", None), ("motorCnt_1", "motorCnt 1", "counts", None)],
        [("drive", "mV")],
    ),
    # channels of one name keep their units
    (
        {"motor_rad": ANGLE, "motor_v": PUSH},
        [("motor_rad", "motor_rad", "rad", None)],
        [("motor_v", "V")],
    ),
    # a command has the unit of what it commands
    (
        {"setpoint_mm": ANGLE, "slide_mm": ANGLE},
        [("slide", "slide_mm", "mm", None)],
        [("setpoint", "mm")],
    ),
    # motors have encoders; what counts in equal steps is measured, unless it is named as a drive
    ({"motor": COUNTS, "torque": PUSH}, [("motor", "motor", "counts", None)], [("torque", "N m")]),
    ({"motor": PUSH, "x": ANGLE}, [("x", "x", "m", None)], [("motor", "1")]),
    (
        {"pwm": np.round(100 * PUSH), "encoder_a": COUNTS},
        [("encoder_a", "encoder_a", "counts", None)],
        [("pwm", "1")],
    ),
    # a slope, unless the unit says that it is something else; velocities of all coordinates or none
    ({"arm_rad": ANGLE, "gyro_deg_per_s": RATE}, [("arm", "arm_rad", "rad", "gyro_deg_per_s")], []),
    (
        {"arm_rad": ANGLE, "gyro_deg_per_s": RATE, "tip_deg": RATE},
        [("arm", "arm_rad", "rad", None), ("tip", "tip_deg", "deg", None)],
        [],
    ),
    ({"cart_m": ANGLE, "speed_rad_s": RATE, "w": RATE}, [("cart", "cart_m", "m", "w")], []),
]


@pytest.mark.parametrize(("columns", "coordinates", "inputs"), DRAFTS)
def test_units_in_names_then_values_then_words_decide(
    tmp_path: Path, columns: dict, coordinates: list, inputs: list
) -> None:
    log = tmp_path / "log.csv"
    pl.DataFrame({"time": T, **columns}).write_csv(log)
    draft = draft_file(log).text
    (tmp_path / "dataset.toml").write_text(draft)
    tn.load(tmp_path)
    card = tomllib.loads(draft)
    assert coordinates == [
        (c["name"], c["column"], c["unit"], c.get("velocity", {}).get("column"))
        for c in card["coordinates"]
    ]
    lengths = [c["unit"] in ("mm", "um", "cm", "m") for c in card["coordinates"]]
    assert [c["kind"] == "linear" for c in card["coordinates"]] == lengths
    assert inputs == [(i["name"], i["unit"]) for i in card.get("inputs", [])]


def test_the_draft_says_why_and_what_to_check(tmp_path: Path) -> None:
    pl.DataFrame({**BELT, "gain": np.ones(N), "spin_rad_s": NOISE}).write_csv(tmp_path / "log.csv")
    draft = draft_file(tmp_path / "log.csv").text
    for line in (
        '# "motor_cnt" as a coordinate: in counts by its name; '
        "steps of 1, as of a sensor's counts; smooth",
        "# check counts in a turn: 4096 is assumed",
        "counts_per_revolution = 4096",
        """# "voltage" as an input: 'voltage' in its name""",
        '# not used: "gain": constant',
        '# not used: "spin_rad_s": a velocity, and the slope of no position',
    ):
        assert line in draft.splitlines()


def test_a_speed_without_any_position_is_the_coordinate(tmp_path: Path) -> None:
    pl.DataFrame({"time": T, "spin_rad_s": NOISE, "voltage": NOISE}).write_csv(tmp_path / "log.csv")
    draft = draft_file(tmp_path / "log.csv").text
    assert "the speed is the coordinate (docs/how-to/speed-only.md)\n" in draft
    (coordinate,) = tomllib.loads(draft)["coordinates"]
    assert (coordinate["kind"], coordinate["unit"]) == ("linear", "rad/s")


def test_the_draft_is_a_card_that_reads_the_file(tmp_path: Path) -> None:
    found = draft_file(log(tmp_path / "run 1.csv"))
    (tmp_path / "dataset.toml").write_text(found.text)
    (e,) = tn.load(tmp_path)
    assert (e.name, e.dt, [c.name for c in e.inputs]) == ("run 1", 0.01, ["a"])
    np.testing.assert_allclose(e.q[:, 0], COUNTS * 2 * np.pi / 4096)
    assert e.v is not None


def test_files_without_header_clock_or_text_form_are_looked_at_too(tmp_path: Path) -> None:
    bare = tmp_path / "bare.dat"
    np.savetxt(bare, np.column_stack([ANGLE, LEVELS]), delimiter=",")
    found = draft_file(bare)
    assert found.clock.column is None
    assert [c.role for c in found.columns] == ["position", "input"]
    (tmp_path / "dataset.toml").write_text(found.text)
    assert tn.load(tmp_path)[0].dt == 0.01
    logs = np.empty(2, object)
    logs[:] = [{"t": T, "q": ANGLE}] * 2
    scipy.io.savemat(tmp_path / "logs.mat", {"logs": logs, "label": "x"})
    found = draft_file(tmp_path / "logs.mat")
    roles = {c.name: c.role for c in found.columns}
    assert roles == {"logs.t": "time", "logs.q": "position"}
    assert {*found.texts} == {"label"}
    assert "2 cells" in found.notes[0]
    (tmp_path / "dataset.toml").write_text(found.text)
    bare.unlink()  # all logs beside the card are records
    assert [e.name for e in tn.load(tmp_path)] == ["logs[1]", "logs[2]"]


def test_a_file_of_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("a,b\nx,y\nz,w\n")
    with pytest.raises(tn.InputError, match=r"log\.csv: no column of numbers"):
        draft_file(tmp_path / "log.csv")
