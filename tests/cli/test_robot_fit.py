"""A robot's file as the system of a command: fit, the copy that is kept, and what is refused."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from robot_twins import record_in_loop, true_values
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.errors import InputError

ROBOT = Path(__file__).parents[2] / "examples" / "robots" / "cart_pole.xml"
CARD = """
name = "robot"
dt = 0.005
[[coordinates]]
name = "pole"
kind = "angular"
column = "pole"
[[coordinates]]
name = "slide"
kind = "linear"
column = "slide"
[[inputs]]
name = "force"
column = "force"
unit = "N"
hold = "zero-order"
delay = 0.0
[splits]
train = ["run0.csv", "run1.csv"]
validation = ["run2.csv"]
"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> Path:
    """Logs of a cart that a force moves to and fro, with a pole that hangs; and its file."""
    folder = tmp_path_factory.mktemp("robot")
    (folder / "robot.xml").write_text(ROBOT.read_text())
    system = tn.load_system(ROBOT)
    for e in record_in_loop(system, true_values(system, 2), count=3, seconds=3.0):
        table = np.column_stack([e.q, e.u])
        np.savetxt(
            folder / f"{e.name}.csv", table, delimiter=",", header="slide,pole,force", comments=""
        )
    (folder / "dataset.toml").write_text(CARD)
    return folder


def test_fit_takes_the_file_and_keeps_a_copy(logs, tmp_path, capsys):
    run = tmp_path / "run"
    robot = logs / "robot.xml"
    code, out, err = tustinnet(
        capsys,
        "fit",
        logs,
        "--recipe",
        "inverse-dynamics",
        "--set",
        "search.candidates=[]",
        "--system",
        robot,
        "--out",
        run,
    )
    assert code == 0, err
    assert "forces that are missing on the validation records" in out
    assert (run / "system.xml").read_text() == robot.read_text()
    summary = json.loads((run / "summary.json").read_text())
    errors = summary["identification"]["force_errors"]
    held_out = [e for e in errors if e["split"] == "validation"]
    assert [e["coordinate"] for e in held_out] == ["pole", "slide"], "in the order of the card"
    assert held_out[1]["missing"] < 0.05 * held_out[1]["size"]
    assert set(summary["scores"]["mean_by_unit"]) == {"rad", "m"}
    for text in (" [rad]", " [m]", "base_parameters.csv", "\ntime: "):
        assert text in out
    with (run / "base_parameters.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    base_parameters = summary["identification"]["base_parameters"]
    assert [float(row["value"]) for row in rows] == [b["value"] for b in base_parameters]
    assert float(rows[0]["low (95 %)"]) < float(rows[0]["value"]) < float(rows[0]["high (95 %)"])
    # later verbs read the copy without a question; the report draws the links
    code, out, err = tustinnet(
        capsys, "evaluate", run / "model.safetensors", logs, "--forces", "--figures", tmp_path / "f"
    )
    assert code == 0, err
    assert "run2" in out
    assert "Forces that a motion needs and its actuators do not give" in out
    assert {path.name for path in (tmp_path / "f").iterdir()} == {"run2.png", "run2-forces.png"}
    code, out, err = tustinnet(
        capsys, "evaluate", run / "model.safetensors", logs, "--forces", "--json"
    )
    for own, fitted in zip(json.loads(out)["forces"], held_out, strict=True):
        assert own.keys() == fitted.keys()
        assert own["missing"] == pytest.approx(fitted["missing"], rel=1e-3)
    # records without any of training are compared up to the frequency of the fit, too
    aside = tmp_path / "aside.toml"
    aside.write_text(CARD.partition("train =")[0] + 'test = ["run2.csv"]\n')
    code, out, err = tustinnet(
        capsys, "evaluate", run / "model.safetensors", logs, "--card", aside, "--forces", "--json"
    )
    assert [e["cutoff"] for e in json.loads(out)["forces"]] == [e["cutoff"] for e in held_out]
    assert tn.load_model(run / "model.safetensors").coordinates[0].name == "pole"
    page = (run / "report.html").read_text()
    assert "Missing forces" in page
    assert f"{len(rows)} base parameters" in page
    assert 'id="search"' not in page, "an empty chart"
    # a search by simulation begins with it
    more = tmp_path / "more"
    code, out, err = tustinnet(
        capsys,
        "fit",
        logs,
        "--recipe",
        "grey",
        "--system",
        robot,
        "--out",
        more,
        "--from",
        run / "model.safetensors",
        "--set",
        "search.horizon=0.5",
        "--set",
        "search.iterations=1",
        "--no-report",
    )
    assert code == 0, err
    assert (more / "model.safetensors").exists()


@pytest.mark.thorough
def test_a_python_file_with_options_is_kept_with_its_robot(logs, tmp_path, capsys, monkeypatch):
    """The robot is found beside the code, wherever the command runs."""
    code_file = tmp_path / "system" / "arm.py"
    code_file.parent.mkdir()
    (code_file.parent / "cart.xml").write_text((logs / "robot.xml").read_text())
    code_file.write_text(
        "import tustinnet as tn\nSYSTEM = tn.load_robot('cart.xml', friction=['load'])\n"
    )
    run = tmp_path / "run"
    arguments = ["fit", logs, "--recipe", "inverse-dynamics", "--no-report", "--out", run]
    arguments += ["--set", "search.candidates=[]"]
    code, _, err = tustinnet(capsys, *arguments, "--system", code_file)
    assert code == 0, err
    assert (run / "cart.xml").read_text() == (logs / "robot.xml").read_text()
    monkeypatch.chdir(tmp_path)
    (code_file.parent / "cart.xml").unlink()
    code, out, err = tustinnet(
        capsys,
        "evaluate",
        run / "model.safetensors",
        logs,
        "--split",
        "validation",
        "--horizon",
        "0.25",
        "--system",
        run / "system.py",
    )
    assert code == 0, err
    assert "run2" in out
    # code is run where it was run before, or is named
    assert tn.load_model(run / "model.safetensors").coordinates[0].name == "pole"
    with monkeypatch.context() as elsewhere:
        elsewhere.setenv("TUSTINNET_CONFIG", str(tmp_path / "another machine"))
        told = r"Python code that its run keeps.*system='.*system\.py'"
        with pytest.raises(InputError, match=told):
            tn.load_model(run / "model.safetensors")
        named = tn.load_model(run / "model.safetensors", system=run / "system.py")
    assert named.coordinates[0].name == "pole"
    # a run is replaced with all that it kept, another file is not
    (other := run / "cart.xml").write_text("<mujoco/>")
    code, _, err = tustinnet(capsys, *arguments, "--system", run / "system.py", "--overwrite")
    assert code == 1
    (code_file.parent / "cart.xml").write_text((logs / "robot.xml").read_text())
    code, _, err = tustinnet(capsys, *arguments, "--system", code_file, "--overwrite")
    assert code == 1
    assert f"{other}: another file than {code_file.parent / 'cart.xml'}" in err


def test_links_without_inertias_get_those_of_their_shapes(logs, tmp_path, capsys):
    bare = tmp_path / "cart.urdf"
    bare.write_text("""<robot name="cart"><link name="rail"/>
      <link name="cart"><collision><geometry><box size="0.1 0.1 0.05"/></geometry></collision>
      </link>
      <link name="rod"><visual><origin xyz="0 0 -0.2"/><geometry><cylinder radius="0.01"
        length="0.4"/></geometry></visual></link>
      <joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/></joint>
      <joint name="pole" type="continuous"><parent link="cart"/><child link="rod"/>
        <axis xyz="0 1 0"/></joint></robot>""")
    fit = ("fit", logs, "--recipe", "inverse-dynamics", "--no-report", "--out", tmp_path / "run")
    code, _, err = tustinnet(capsys, *fit, "--system", bare)
    assert (code, err.count("\n")) == (1, 1)
    told = "SYSTEM = tn.load_robot(FILE, default_density=2700.0)"
    assert told in err
    code, _, err = tustinnet(capsys, *fit, "--system", bare, "--default-density", "2700")
    assert (code, err.count("\n")) == (1, 1)
    assert f"a system file: {told}" in err


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("robot.urdf", "<robot>", ["no well-formed XML"]),
        ("robot.urdf", None, ["no such file"]),
        ("scara.urdf", "scara", ["no coordinate of the joints 'shoulder', 'elbow'", "or lock"]),
        ("robot.obj", "", ["no such system", "FILE.urdf"]),
    ],
)
def test_what_is_no_robot_of_the_logs_is_one_line(file, text, words, logs, tmp_path, capsys):
    path = tmp_path / file
    if text == "scara":
        path.write_text((ROBOT.parent / "scara.urdf").read_text())
    elif text is not None:
        path.write_text(text)
    out = tmp_path / "run"
    code, _, err = tustinnet(
        capsys, "fit", logs, "--recipe", "grey", "--system", path, "--out", out
    )
    assert code == 1
    lines = err.strip().splitlines()
    assert len(lines) == 1
    for word in words:
        assert word in lines[0]
