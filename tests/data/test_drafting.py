"""Drafts of data cards for the folders of made-up laboratories."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from simulated.laboratories import EVERY, Truth, differences

import tustinnet as tn
from tustinnet.data.drafting.draft import draft_card
from tustinnet.data.drafting.evidence import find_families
from tustinnet.data.drafting.names import read_name
from tustinnet.data.drafting.numbers import examine

Laboratory = Callable[[Path], Truth]


def draft(folder: Path) -> dict[str, Any]:
    """The card that is drafted for all files of a folder; it is written there and loads."""
    files = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
    text = draft_card(folder, files).text
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    return tomllib.loads(text)


@pytest.mark.parametrize("laboratory", EVERY, ids=lambda f: f.__name__)
def test_the_draft_says_what_a_person_would_say(laboratory: Laboratory, tmp_path: Path) -> None:
    truth = laboratory(tmp_path)
    card = draft(tmp_path)
    assert differences(card, truth, tn.load(tmp_path)) == []


def test_inputs_that_differ_by_the_angle_they_are_about_are_one_family() -> None:
    names = ("phi_deg", "theta_deg", "mot_phi_V", "mot_theta_V")
    none = np.zeros((4, 4), bool)
    assert find_families([read_name(n) for n in names], none, none) == [0, 1, 2, 2]


def test_the_card_says_which_kinds_are_divided_and_a_usual_record_is_drawn(tmp_path: Path) -> None:
    t = 0.01 * np.arange(400)
    rng = np.random.default_rng(0)
    for name, size in {"chirp": 1.0, "run1": 1.0, "run2": 1.1, "run3": 0.9, "slow": 9.0}.items():
        u = np.repeat(rng.uniform(-1, 1, 40), 10)
        q = size * np.cumsum(np.cumsum(u - u.mean())) * 1e-3
        table = np.column_stack([t, q, u])
        np.savetxt(tmp_path / f"{name}.csv", table, "%.6g", ",", header="t_s,x_m,u_V", comments="")
    drafted = draft_card(tmp_path, sorted(p.name for p in tmp_path.iterdir()))
    assert "divided among the splits: run, the others are in train" in drafted.text
    assert drafted.typical.log.file != "slow.csv"


# --- what nothing in the logs says ---


def turning(turn: float) -> list[np.ndarray]:
    """Angles of a wheel that turns to and fro, which start again after each turn."""
    t = 0.01 * np.arange(800)
    return [turn * ((k * np.sin(0.6 * t) + 2 * np.sin(1.9 * t)) % 1) for k in (2, 3, 4)]


UNSAID = {
    "counts": (
        4096.0,
        {"unit": "counts", "counts_per_revolution": 4096},
        ["counts_per_revolution"],
    ),
    "turns": (1.0, {"unit": "rev"}, None),
    "radians": (2 * np.pi, {"unit": "rad"}, None),
}


@pytest.mark.parametrize("case", UNSAID)
def test_the_scale_of_an_angle_that_starts_again_is_proposed_and_asked(
    case: str, tmp_path: Path
) -> None:
    turn, keys, assumed = UNSAID[case]
    for k, angle in enumerate(turning(turn)):
        values = np.floor(angle) if case == "counts" else angle
        pl.DataFrame({"t": 0.01 * np.arange(800), "x": values}).write_csv(tmp_path / f"r{k}.csv")
    files = [f"r{k}.csv" for k in range(3)]
    found = draft_card(tmp_path, files)
    (coordinate,) = tomllib.loads(found.text)["coordinates"]
    assert {key: coordinate.get(key) for key in keys} == keys
    assert coordinate["kind"] == "angular"
    assert coordinate.get("assumed") == assumed
    assert bool(found.questions) == bool(assumed)


def test_a_switched_voltage_does_not_wrap() -> None:
    rng = np.random.default_rng(1)
    voltage = 12.0 * np.sign(np.sin(0.1 * np.arange(2000))) + rng.normal(0, 0.05, 2000)
    assert examine([voltage]).wrap is None


@pytest.mark.parametrize("names", ["obs[1],obs[2],obs[3]", "sin_th,cos_th,thdot", "a,b,c"])
def test_cosine_and_sine_are_one_angle(names: str, tmp_path: Path) -> None:
    t = 0.01 * np.arange(800)
    order = [1, 0] if names != "obs[1],obs[2],obs[3]" else [0, 1]
    for k in range(3):
        angle = (3 + k) * np.sin(1.1 * t) + np.sin(2.3 * t)
        circle = [np.cos(angle), np.sin(angle)]
        speed = np.gradient(angle, t)
        table = np.column_stack([t, *(circle[j] for j in order), speed, np.cos(7 * t)])
        header = f"t,{names},torque_Nm"
        np.savetxt(tmp_path / f"r{k}.csv", table, "%.8g", ",", header=header, comments="")
    card = draft(tmp_path)
    first, second, rate = names.split(",")
    (coordinate,) = card["coordinates"]
    cosine, sine = (second, first) if order == [1, 0] else (first, second)
    assert (coordinate["column"], coordinate["sine"]) == (cosine, sine)
    assert coordinate["name"] == cosine.removeprefix("cos_")
    assert coordinate["velocity"]["column"] == rate
    for k, record in enumerate(sorted(tn.load(tmp_path), key=lambda e: e.name)):
        expected = (3 + k) * np.sin(1.1 * t) + np.sin(2.3 * t)
        np.testing.assert_allclose(record.q[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("names", ["acc_x,acc_z", "x,y", "tip_x_m,tip_y_m"])
def test_other_quantities_on_a_circle_are_no_angle(names: str, tmp_path: Path) -> None:
    t = 0.01 * np.arange(800)
    for k in range(2):
        angle = (3 + k) * np.sin(1.1 * t)
        table = np.column_stack([t, np.cos(angle), np.sin(angle), angle, np.cos(7 * t)])
        np.savetxt(
            tmp_path / f"r{k}.csv",
            table,
            "%.8g",
            ",",
            header=f"t,{names},phi_rad,torque",
            comments="",
        )
    assert "sine" not in draft_card(tmp_path, ["r0.csv", "r1.csv"]).text


def test_of_proportional_inputs_the_one_that_moves_first_stays(tmp_path: Path) -> None:
    t = 0.01 * np.arange(800)
    for k in range(2):
        volts = np.repeat(np.random.default_rng(k).uniform(-3, 3, 16), 50)
        table = np.column_stack([t, np.sin(2 * t + k), 0.4 * volts, volts])
        np.savetxt(
            tmp_path / f"r{k}.csv", table, "%.8g", ",", header="t,phi_rad,i_A,u_V", comments=""
        )
    found = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    assert [i.column for i in found.choice.inputs] == ["u_V"]
    assert "proportional to the input 'u_V'" in found.choice.unused["i_A"]


@pytest.mark.parametrize(
    ("names", "units", "questions"),
    [
        (["tau_0", "tau_1"], ["N m", "N m"], 1),
        (["tau_0 [%]", "tau_1 [%]"], ["%", "%"], 0),
        (["Control Effort"], ["1"], 1),
        (["cart_x"], ["m"], 1),
    ],
)
def test_a_unit_that_follows_from_a_word_is_assumed_and_asked_once(
    names: list[str], units: list[str], questions: int, tmp_path: Path
) -> None:
    t = 0.01 * np.arange(800)
    for k in range(2):
        inputs = np.repeat(np.random.default_rng(k).uniform(-3, 3, (16, len(names))), 50, axis=0)
        angle = np.cumsum(np.cumsum(inputs.sum(axis=1))) * 1e-4
        table = np.column_stack([t, angle - angle.mean(), inputs])
        header = ",".join(["t", "phi_rad", *names])
        np.savetxt(tmp_path / f"r{k}.csv", table, "%.8g", ",", header=header, comments="")
    found = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    assert [i.column for i in found.choice.inputs] == names
    assert [i.unit for i in found.choice.inputs] == units
    assert all(i.assumed == ("unit",) * questions for i in found.choice.inputs)
    assert len(found.questions) == questions


@pytest.mark.parametrize("stem", ["x[{}]", "y{}", "x_{}"])
def test_an_element_of_a_vector_is_no_length(stem: str, tmp_path: Path) -> None:
    t = 0.01 * np.arange(800)
    for k in range(2):
        columns = [t, np.sin(2 * t + k), np.cos(3 * t) * np.sin(t), np.cos(7 * t)]
        header = ",".join(["t", stem.format(1), stem.format(2), "torque"])
        np.savetxt(
            tmp_path / f"r{k}.csv",
            np.column_stack(columns),
            "%.8g",
            ",",
            header=header,
            comments="",
        )
    card = draft(tmp_path)
    assert [c["kind"] for c in card["coordinates"]] == ["angular", "angular"]


def test_axes_in_which_nothing_moves_are_left_out(tmp_path: Path) -> None:
    rng, t = np.random.default_rng(0), 0.01 * np.arange(900)
    for k in range(2):
        noise = rng.normal(0, 0.1, (2, 900))
        table = np.column_stack([t, 30 * np.sin(2 * t + k), *noise, np.cos(7 * t)])
        np.savetxt(
            tmp_path / f"r{k}.csv",
            table,
            "%.6g",
            ",",
            header="t,yaw_deg,pitch_deg,roll_deg,motor_V",
            comments="",
        )
    found = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    assert [c.column for c in found.choice.coordinates] == ["yaw_deg"]
    assert "only noise" in found.choice.unused["roll_deg"]


def test_a_draft_takes_the_period_from_the_lines_above_the_table(tmp_path: Path) -> None:
    t = 0.004 * np.arange(900)
    for k in range(2):
        np.savetxt(
            tmp_path / f"r{k}.csv",
            np.column_stack([np.sin(2 * t + k), np.cos(7 * t)]),
            "%.6g",
            ",",
            header="Sample rate: 250 Hz\nangle_rad,motor_V",
            comments="",
        )
    found = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    card = tomllib.loads(found.text)
    assert (card["dt"], card.get("assumed"), found.questions) == (0.004, None, ())


def test_files_without_a_header_have_the_names_of_the_others(tmp_path: Path) -> None:
    t = 0.01 * np.arange(400)
    for k, header in enumerate(("", "t angle volts\n", "", "t angle volts\n")):
        u = np.repeat(np.random.default_rng(k).choice([-2.0, 2.0], 20), 20)
        angle = np.cumsum(np.cumsum(u)) * 1e-4 + np.sin(t)
        rows = "\n".join(" ".join(f"{x:.6f}" for x in row) for row in zip(t, angle, u, strict=True))
        (tmp_path / f"run{k}.txt").write_text(header + rows)
    card = draft(tmp_path)
    assert [(c["name"], c["column"]) for c in card["coordinates"]] == [("angle", 2)]
    assert [(i["name"], i["column"]) for i in card["inputs"]] == [("volts", 3)]
    data = tn.load(tmp_path)
    assert [len(e) for e in data] == [400] * 4
    notes = draft_card(tmp_path, [f"run{k}.txt" for k in range(4)]).notes
    assert "no header in run0.txt, run2.txt: columns are called as in the other files" in notes


@pytest.mark.parametrize(
    ("names", "dt", "note"),
    [
        (("a_4000us", "b_4000us"), 0.004, ""),
        (("a_1300us", "b_4ms"), 0.01, "1300us, 4ms: sampling periods? each needs a card"),
        (("a_500ms", "b_500ms"), 0.01, ""),
        (("a_2kg", "b_4kg"), 0.01, "2kg, 4kg: loads are `groups`"),
    ],
)
def test_a_period_in_the_names_of_files_is_assumed_or_asked(
    names: tuple[str, str], dt: float, note: str, tmp_path: Path
) -> None:
    for k, name in enumerate(names):
        u = np.repeat(np.random.default_rng(k).choice([-2.0, 2.0], 40), 20)
        angle = np.cumsum(np.cumsum(u)) * 1e-4
        rows = "\n".join(f"{a:.6f},{b}" for a, b in zip(angle, u, strict=True))
        (tmp_path / f"{name}.csv").write_text(f"angle,volts\n{rows}")
    made = draft_card(tmp_path, [f"{name}.csv" for name in names])
    assert made.dt == dt
    assert [q.assumption for q in made.questions if q.key == "period"] == [str(dt)]
    assert [n for n in made.notes if "names of files" in n] == (
        [f"names of files differ by {note}"] if note else []
    )


def test_a_velocity_in_raw_units_is_left_out(tmp_path: Path) -> None:
    t = 0.01 * np.arange(900)
    for k in range(2):
        q = np.round(900 * np.sin(2 * t + k))
        raw = np.round(0.0639 * np.gradient(q, t))
        np.savetxt(
            tmp_path / f"r{k}.csv",
            np.column_stack([t, q, raw, np.cos(7 * t)]),
            "%.6g",
            ",",
            header="t,present_position,present_velocity,goal_pwm",
            comments="",
        )
    found = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    assert [c.velocity for c in found.choice.coordinates] == [None]
    assert "in a unit that nothing says" in found.choice.unused["present_velocity"]


@pytest.mark.parametrize("names", ["cos_q,sin_q,qdot", "q,dq", "q_deg,dq_rad_s"])
def test_velocities_say_the_period_of_files_without_times(names: str, tmp_path: Path) -> None:
    t = 0.025 * np.arange(900)
    for k in range(2):
        q = 2 * np.sin(2 * t + k) + np.sin(t)
        columns = {
            "cos_q,sin_q,qdot": [np.cos(q), np.sin(q)],
            "q,dq": [q],
            "q_deg,dq_rad_s": [np.degrees(q)],
        }[names]
        table = np.column_stack([*columns, np.gradient(q, t), np.cos(7 * t)])
        np.savetxt(
            tmp_path / f"r{k}.csv", table, "%.7g", ",", header=f"{names},torque_Nm", comments=""
        )
    found = draft_card(tmp_path, ["r0.csv", "r1.csv"])
    card = tomllib.loads(found.text)
    is_sure = names != "q,dq"  # without any unit both are taken for one, which is asked
    assert (card["dt"], card.get("assumed")) == (0.025, None if is_sure else ["dt"])
    assert ("period" in {q.key for q in found.questions}) != is_sure
    assert ("which are slopes of the positions" in found.text) == is_sure
    answered = draft_card(tmp_path, ["r0.csv", "r1.csv"], {"period": "0.05"})
    assert tomllib.loads(answered.text)["dt"] == 0.05


NAMES = [
    "t",
    "time",
    "a",
    "x",
    "q1",
    "dq1",
    "u",
    "I",
    "pos [mm]",
    "n_ist [1/min]",
    "soll",
    "Flag",
    "index",
    "episode_index",
    "theta",
    "thetadot",
    "K [°C]",
    "1",
    "",
    "p/bar",
    "tau_cmd",
    '"q"',
    "ä",
    "a.b.c",
    "[x]",
    "/",
    "_deg",
    "v_m",
]


def any_columns(rng: np.random.Generator, samples: int) -> dict[str, np.ndarray]:
    """Columns of any names and numbers, most of which make no sense."""
    k = np.arange(samples)
    courses = [
        0.01 * k,
        0.0 * k,
        rng.normal(size=samples),
        rng.normal(size=samples).cumsum(),
        np.round(10 * rng.normal(size=samples).cumsum()),
        1e9 * k + 1.7e18,
        rng.integers(0, 2, samples).astype(float),
        1e99 * rng.normal(size=samples),
        np.where(rng.random(samples) < 0.1, np.nan, 0.1 * k),
        np.repeat(rng.normal(size=samples), 9),
    ]
    names = rng.choice(NAMES, rng.integers(1, 9), replace=False)
    return {str(name): courses[rng.integers(len(courses))][:samples] for name in names}


@pytest.mark.parametrize("seed", range(20))
def test_any_columns_make_a_card_that_loads_or_are_refused(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    samples = int(rng.choice([2, 7, 40, 300]))
    pl.DataFrame(any_columns(rng, samples)).write_csv(tmp_path / "log.csv")
    try:
        made = draft_card(tmp_path, ["log.csv"])
        made.require_readable(tmp_path)
    except tn.InputError:
        return
    (tmp_path / "dataset.toml").write_text(made.text, encoding="utf-8")
    tn.load(tmp_path)


@pytest.mark.parametrize(
    ("name", "quantity", "unit"),
    [
        ("x_dot_cm", "velocity", "cm/s"),
        ("angle_rate_deg", "velocity", "deg/s"),
        ("theta_ddot_rad", "acceleration", "rad/s^2"),
        ("dx_mm", "position", "mm"),  # may be a displacement
    ],
)
def test_a_rate_in_the_unit_of_its_position_is_per_second(
    name: str, quantity: str, unit: str
) -> None:
    reading = read_name(name)
    assert (reading.quantity, reading.unit) == (quantity, unit)


def test_a_set_point_has_the_unit_of_what_follows_it(tmp_path: Path) -> None:
    count, t = 2 * np.pi / 4096, 0.02 * np.arange(400)
    for k in range(2):
        goal = 0.7 * np.sin((2 + k) * t) * np.sin(0.9 * t)
        position = np.interp(t - 0.05, t, goal)
        speed = np.gradient(position, t)
        pl.DataFrame(
            {
                "time": t,
                "position": np.round(position / count) * count,
                "speed": speed,
                "goal_position": goal,
            }
        ).write_csv(tmp_path / f"log{k}.csv")
    card = draft(tmp_path)
    assert [c["unit"] for c in card["coordinates"]] == ["rad"]
    assert [(i["column"], i["unit"], i.get("assumed")) for i in card["inputs"]] == [
        ("goal_position", "rad", None)
    ]
