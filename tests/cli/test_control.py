"""The verb that designs a controller, on the small pendulum."""

import contextlib
import io
import json
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.cli.main import run
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.store.header import read_header
from tustinnet.store.model_file import copy_with_header

LIMITS = ("--limits", "torque=-6:6")  # of 10 / 2 that hold it level


@pytest.fixture
def model(identified) -> Path:
    return identified / "model.safetensors"


class Held(NamedTuple):
    """A controller that holds the pendulum upright: its folder, and what was said."""

    out: Path
    text: str
    messages: str


@pytest.fixture(scope="module")
def held_once(identified_once, tmp_path_factory) -> Held:
    out = tmp_path_factory.mktemp("control") / "held"
    asked = ("control", identified_once / "model.safetensors", "--at", "angle=180")
    asked += ("--limits", "torque=-6000:6000mN*m", "--safe", "torque=0.5", "--starts", 5)
    text, messages = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(text),
        contextlib.redirect_stderr(messages),
        pytest.raises(SystemExit) as ended,
    ):
        run([str(word) for word in (*asked, "--out", out)])
    assert not ended.value.code, messages.getvalue()
    return Held(out, text.getvalue(), messages.getvalue())


@pytest.fixture
def held(held_once, tmp_path) -> Path:
    """A copy of that folder, which a test may change."""
    return Path(shutil.copytree(held_once.out, tmp_path / "held"))


@pytest.mark.thorough
def test_a_controller_holds_the_pendulum_upright(held_once):
    out, text, _ = held_once
    assert "unstable" in text
    assert "controllable; observable" in text
    assert "no records were given (--data)" in text
    rows = [line for line in text.splitlines() if line.strip().startswith("nominal")]
    assert "5 of 5" in " ".join(rows)  # a table wider than the terminal is printed in parts
    assert "without feedback, its inputs held, the model alone does in 0 of 5" in text
    names = {path.name for path in out.iterdir()}
    assert {
        "controller.c",
        "estimator.c",
        "model.c",
        "main.c",
        "controller.json",
        "design.json",
        "closed_loop.png",
        "robustness.png",
        "bode.png",
    } <= names
    design = json.loads((out / "design.json").read_text())
    assert design["motion"] is None
    # the small pendulum by its torque is one coordinate by one input
    assert "as a PID in parallel form: kp = " in text
    gains = json.loads((out / "controller.json").read_text())["feedback"]["gain"][0]
    pid = {"proportional": gains[0], "integral": 0.0, "derivative": gains[1]}
    assert design["pid"] == pytest.approx(pid)
    # the model's own balance of torques there
    assert abs(design["equilibrium"]["states"]["angle"] - np.pi) < 0.1


def test_a_motion_from_a_file_is_followed(model, tmp_path, capsys):
    (file := tmp_path / "ref.csv").write_text("time,angle\n0,0\n1,20\n2,25\n")
    told = ("control", model, "--follow", file, *LIMITS, "--starts", 1, "--out", tmp_path / "held")
    code, text, messages = tustinnet(capsys, *told)
    assert code == 0, messages
    plan = next(line for line in text.splitlines() if line.strip().startswith("plan: angle "))
    assert float(plan.split()[2]) < 0.01
    code, _, messages = tustinnet(capsys, *told, "--at", "angle=0")
    assert code == 1
    assert "--at: not applicable beside --follow" in messages
    code, _, messages = tustinnet(capsys, "control", model, "--out", tmp_path / "other")
    assert code == 1
    assert "neither --at nor --follow" in messages


@pytest.mark.thorough
def test_what_fails_on_another_plant_is_not_written(model, system, tmp_path, capsys):
    weak = tmp_path / "weak.py"
    weak.write_text(system.read_text().replace('p: p["gain"]', 'p: -p["gain"]'))
    out = tmp_path / "held"
    told = ("control", model, "--at", "angle=180deg", *LIMITS, "--starts", 2, "--plant", weak)
    code, text, messages = tustinnet(capsys, *told, "--out", out)
    assert code == 1
    assert "plant weak.py" in text
    assert "the controller: meets the goal in 0 of 2 runs on another plant" in messages
    assert "--force writes it all the same" in messages
    assert not out.exists() or not any(out.iterdir())
    code, text, messages = tustinnet(capsys, *told, "--force", "--json", "--out", out)
    assert code == 0, messages
    assert json.loads(text)["problem"]
    readme = (out / "README.md").read_text()
    assert "- its test on other plants failed (meets the goal in 0 of 2 runs" in readme
    assert (out / "controller.c").is_file()


@pytest.mark.thorough
def test_a_swing_up_by_records_with_options_of_all_kinds(model, folder, system, tmp_path, capsys):
    out = tmp_path / "swung"
    code, text, messages = tustinnet(
        capsys,
        "control",
        model,
        "--at",
        "angle=180deg",
        "--swing-up",
        "--seconds",
        4,
        *LIMITS,
        "--data",
        folder,
        "--card",
        folder / "dataset.toml",
        "--weight",
        "angle=20deg",
        "--weight",
        "torque=3",
        "--within",
        "der_angle=-20:20rad/s",
        "--delay",
        1,
        "--trust-beyond",
        "--system",
        system,
        "--plant",
        system,
        "--json",
        "--quiet",
        "--starts",
        3,
        "--out",
        out,
    )
    assert code == 0, messages
    assert "designing" not in messages
    design = json.loads(text)
    assert design == json.loads((out / "design.json").read_text())
    assert design["motion"]["seconds"] == pytest.approx(4.0)
    assert design["motion"]["begins_again_after_a_fall"]
    assert design["estimator"]["tests"]
    plant = design["robustness"][-1]
    assert plant["kind"].startswith("plant ")
    assert plant["runs"] == 3
    assert design["robustness"][0]["successes"] == 3
    tracking = tn.control.read_controller(out)
    assert isinstance(tracking, tn.control.Tracking)
    recovery = tracking.recovery
    assert recovery is not None
    # a quarter of the way from where it hangs, at 0, to the top
    np.testing.assert_allclose(recovery.fallen_beyond, [np.pi / 4, 0], atol=0.05)
    np.testing.assert_array_equal(recovery.feedback.x0, tracking.plan.x[0])
    page = (out / "control.html").read_text()
    assert "after a fall: where angle is more than 0.7" in page
    assert "After a fall the controller damps the motion" in page


@pytest.mark.thorough
def test_integral_action_and_a_second_controller_in_the_same_folder(model, tmp_path, capsys):
    out = tmp_path / "held"
    arguments = (
        "control",
        model,
        "--at",
        "angle=0",
        *LIMITS,
        "--integral",
        "angle",
        "--starts",
        1,
        "--out",
        out,
    )
    assert tustinnet(capsys, *arguments)[0] == 0
    first = (out / "controller.json").read_bytes()
    code, _, messages = tustinnet(capsys, *arguments)
    assert code == 1
    assert "--overwrite" in messages
    code, text, _ = tustinnet(capsys, *arguments, "--overwrite")
    assert code == 0
    assert "integral of angle" in text
    assert (out / "controller.json").read_bytes() == first


@pytest.mark.thorough
def test_a_motion_from_one_place_to_another(model, tmp_path, capsys):
    out, pieces = tmp_path / "moved", model.with_name("pieces.safetensors")
    scores = read_header(model)["scores"] | {"horizon": 0.5}
    copy_with_header(model, pieces, scores=scores)
    code, text, messages = tustinnet(
        capsys,
        "control",
        pieces,
        "--at",
        "angle=0",
        "--to",
        "angle=0.4rad",
        *LIMITS,
        "--out",
        out,
        "--trust-beyond",
        "--starts",
        1,
    )
    assert code == 0, messages
    assert "motion:" in text
    assert "the model was compared with records over 0.5 s at a time" in messages
    assert "after a fall" not in text  # from a stable goal nothing falls
    tracking = tn.control.read_controller(out)
    assert isinstance(tracking, tn.control.Tracking)
    plan = tracking.plan
    assert plan.x[0, 0] == pytest.approx(0.0, abs=0.1)
    assert plan.x[-1, 0] == pytest.approx(0.4, abs=0.05)


@pytest.mark.thorough
def test_predictive_control_is_designed_played_and_written(model, tmp_path, capsys, monkeypatch):
    out = tmp_path / "ahead"
    command = ("control", model, "--at", "angle=180deg", "--swing-up", *LIMITS, "--trust-beyond")
    told = (*command, "--within", "angle=90:420", "--starts", 1, "--out", out)
    code, text, messages = tustinnet(capsys, *told, "--mpc", 10)
    assert code == 0, messages
    assert "predictive control: at every sample 10 steps ahead" in text
    assert "PID" not in text
    design = json.loads((out / "design.json").read_text())
    assert design["predictive"] == {"steps": 10, "iterations": 1}
    assert design["check"]["difference"] < 1e-9
    assert "predictive control, 10 periods ahead" in (out / "README.md").read_text()
    assert "without looking ahead" in (out / "control.html").read_text()
    logs = write_log(out, tmp_path / "logs")
    code, text, messages = tustinnet(capsys, "control", out, "--replay", logs)
    assert code == 0, messages
    assert "torque differs" in text
    with monkeypatch.context() as patch:
        patch.setenv("CC", "no-such-compiler")
        code, _, messages = tustinnet(capsys, "control", out, "--replay", logs)
        assert code == 1
        assert "a compiler, by which it is played" in messages
    for steps in (0, 101):
        code, _, messages = tustinnet(capsys, *told, "--mpc", steps)
        assert code == 2
        assert "'--mpc'" in messages


def test_the_exported_loop_compiles_and_ends_at_the_goal(held):
    feedback = tn.control.read_controller(held)
    assert isinstance(feedback, tn.control.Feedback)
    np.testing.assert_array_equal(feedback.safe, [0.5])
    subprocess.run(["make", "-s"], cwd=held, check=True)
    rows = subprocess.run(["./main"], cwd=held, check=True, capture_output=True, text=True).stdout
    angle = float(rows.splitlines()[-1].split(",")[1])
    assert abs(angle - np.pi) < 0.1


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (("--at", "elbow=0"), "--at: no 'elbow' among the coordinates"),
        (
            ("--at", "angle=0", "--at", "angle=1", *LIMITS),
            "'angle=0, angle=1'; expected NAME=VALUE",
        ),
        (("--at", "angle=0", "--to", "angle=1", "--to", "elbow=2", *LIMITS), "--to: no 'elbow'"),
        (("--at", "angle=0", "--limits", "torque=-6:6,force=-6:6"), "force"),
        (("--at", "angle"), "--at"),
        (("--at", "angle=30mm", *LIMITS), "'mm' is not a unit of a quantity in rad"),
        (("--at", "angle=180rad", *LIMITS), "far outside of the recorded motion; expected about -"),
        (("--at", "angle=0", "--to", "angle=-40", *LIMITS, "--within", "angle=9:3"), "--within"),
        (("--at", "angle=1.5rad", "--limits", "torque=-1:1"), "nearest"),
        (("--at", "angle=0", "--limits", "torque=6:-6"), "--limits"),
        (("--at", "angle=0", "--limits", "force=-6:6"), "force"),
        (("--at", "angle=0", *LIMITS, "--seconds", 1), "--seconds"),
        (("--at", "angle=0", *LIMITS, "--within", "angle=-1:1"), "--within"),
        (("--at", "angle=0", *LIMITS, "--mpc", 9, "--integral", "angle"), "--integral: not appl"),
        (("--at", "angle=0", *LIMITS, "--mpc", 9, "--observer"), "--observer: not appl"),
        (("--at", "angle=0", *LIMITS, "--mpc", 9, "--within", "elbow=0:1"), "elbow"),
        (("--at", "angle=0", *LIMITS, "--card", "x.toml"), "--card"),
        (("--at", "angle=0", *LIMITS, "--weight", "angle=fast"), "--weight"),
        (("--at", "angle=0", *LIMITS, "--weight", "elbow=1"), "elbow"),
        (("--at", "angle=0", *LIMITS, "--integral", "elbow"), "elbow"),
        (("--at", "angle=0", *LIMITS, "--group", "payload=1kg"), "group"),
        (("--at", "angle=0", *LIMITS, "--safe", "torque=7"), "-6 to 6"),
        (("--at", "angle=0", *LIMITS, "--plant", "nothing.fmu"), "nothing.fmu"),
        (("--at", "angle=0", *LIMITS, "--swing-up", "--to", "angle=1"), "--swing-up"),
        (
            ("--at", "angle=3.14159rad", *LIMITS, "--swing-up", "--seconds", 0.1, "--trust-beyond"),
            "reached",
        ),
    ],
)
def test_what_cannot_be_is_said_in_a_line_and_nothing_is_written(
    model, tmp_path, capsys, arguments, names
):
    out = tmp_path / "none"
    code, text, messages = tustinnet(capsys, "control", model, *arguments, "--out", out)
    assert code == 1
    errors = [line for line in messages.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert names in errors[0]
    assert not text
    assert not out.exists()


def test_an_input_without_limits_stays_within_what_was_recorded(model, tmp_path, capsys):
    code, printed, messages = tustinnet(
        capsys, "control", model, "--at", "angle=0", "--out", tmp_path / "controller"
    )
    assert code == 0
    assert "limits of torque as recorded, as none are declared" in messages
    assert "without feedback, its inputs held, the model alone does in 20 of 20, so that" in printed
    low, high = tn.read_header(model)["range"]["inputs"][0]
    assert f"limits of inputs: torque {low:.4g} to {high:.4g} N m" in printed


def test_a_network_holds_no_point_that_its_records_do_not_have(run_folder, tmp_path, capsys):
    code, _, messages = tustinnet(
        capsys,
        "control",
        run_folder / "model.safetensors",
        "--at",
        "angle=180deg",
        *LIMITS,
        "--out",
        tmp_path / "none",
    )
    assert code == 1
    assert "equilibrium" in messages


def test_a_number_alone_is_in_the_unit_of_the_column_and_said_back(held_once):
    assert "--at: angle = 180 deg (3.142 rad)" in held_once.messages
    assert "--limits: torque = -6000:6000 mN*m (-6:6 N m)" in held_once.messages
    at = json.loads((held_once.out / "design.json").read_text())["at"]
    assert at == {"angle": pytest.approx(np.pi)}


def test_a_swing_up_without_a_place_to_hang_names_options_of_the_verb(model, tmp_path, capsys):
    code, _, messages = tustinnet(
        capsys, "control", model, "--at", "angle=0", "--swing-up", *LIMITS, "--out", tmp_path / "x"
    )
    assert code == 1
    assert "name the start and the goal: --at and --to" in messages


def write_log(controller: Path, to: Path) -> Path:
    """A log of the machine of a controller, moved by hand."""
    loaded = tn.load_model(controller / "model.safetensors")
    t = np.arange(300) * loaded.dt
    q = np.pi + 0.05 * np.sin(3 * t)[:, None]
    record = tn.from_arrays(
        q, 0 * q, dt=loaded.dt, coordinates=loaded.coordinates, inputs=loaded.inputs, name="hand"
    )
    write_data_set(tn.DataSet("hand", (record,)), to, "moved by hand")
    return to


def test_the_verb_replays_a_log(held, tmp_path, capsys):
    out, logs = held, tmp_path / "logs"
    write_log(out, logs)
    code, text, messages = tustinnet(capsys, "control", out, "--replay", logs)
    assert code == 0, messages
    assert "torque differs" in text
    assert "1 of 1 record differ from this controller's by more than half" in text
    assert "stand up to" not in text
    assert "estimator: angle: the filter is" in text
    assert "next: tustinnet evaluate" in text
    log, card = next(logs.glob("*.csv")), logs / "dataset.toml"
    code, text, _ = tustinnet(capsys, "control", out, "--replay", log, "--card", card, "--json")
    (row,) = json.loads(text)["records"]
    assert row["inputs"]["torque"]["difference"] > 0
    code, _, messages = tustinnet(capsys, "control", out, "--replay", logs, "--delay", "0")
    assert code == 1
    assert "--delay" in messages
    assert "beside --replay" in messages
    for name in ("model.safetensors", "controller.json"):
        (out / name).unlink()
        code, _, messages = tustinnet(capsys, "control", out, "--replay", logs)
        assert code == 1
        assert f"no {name} there" in messages
        assert "before 0.3" in messages
