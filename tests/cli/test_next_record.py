"""`next-record`: which of some proposed records would tell the most, and a design of one."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
import pytest
from test_verbs import tustinnet

PROPOSALS = """
[[proposals]]
name = "at rest"
seconds = 2
[[proposals]]
name = "a fall"
seconds = 2
start = { angle = 115, angle_dot = "-0.5 rad/s" }
[[proposals]]
name = "driven"
inputs = "driven.csv"
"""


class Place(NamedTuple):
    model: Path
    system: Path
    proposals: Path


@pytest.fixture
def proposals(tmp_path) -> Path:
    path = tmp_path / "proposals" / "next.toml"
    path.parent.mkdir()
    path.write_text(PROPOSALS)
    u = 3 * np.sin(np.arange(100) / 3)
    np.savetxt(path.parent / "driven.csv", u[:, None], header="torque", comments="", fmt="%.6g")
    return path


@pytest.fixture
def place(identified, system, proposals) -> Place:
    return Place(identified / "model.safetensors", system, proposals)


def test_an_identified_system_wants_what_shrinks_its_errors(place, capsys):
    command = ("next-record", place.model, place.proposals, "--system", place.system)
    code, told, err = tustinnet(capsys, *command, "--json")
    assert code == 0, err
    found = json.loads(told)
    assert (found["criterion"], found["unit"]) == ("covariance of the parameters", "nats")
    values = {of["name"]: of["value"] for of in found["proposals"]}
    assert list(values.values()) == sorted(values.values(), reverse=True)
    assert values["at rest"] == pytest.approx(0, abs=1e-6)
    assert values["a fall"] > 0.01
    said = "proposal 'a fall', start: angle = 115 deg (2.007 rad), angle_dot = -0.5 rad/s"
    assert said in err.replace("\n", " ")
    # only a torque says something of the gain
    words = {of["name"]: of["words"] for of in found["proposals"]}
    assert words["driven"].startswith("error of gain to ")
    assert not words["a fall"].startswith("error of gain")
    code, told, _ = tustinnet(capsys, *command)
    assert code == 0
    assert told.rstrip().endswith(f"record next: {next(iter(values))}")


def test_a_committee_wants_what_its_members_differ_on(run_folder, proposals, tmp_path, capsys):
    both = tmp_path / "both.safetensors"
    members = [run_folder / f"seed-{k}" / "model.safetensors" for k in (0, 1)]
    assert tustinnet(capsys, "committee", *members, "--out", both)[0] == 0
    found = {}
    for over in ((), ("--horizon", 0.5)):
        code, told, err = tustinnet(capsys, "next-record", both, proposals, "--json", *over)
        assert code == 0, err
        found[over] = json.loads(told)
    whole, short = found.values()
    assert (whole["criterion"], whole["unit"]) == ("disagreement of the members", "rad")
    values = [{of["name"]: of["value"] for of in told["proposals"]} for told in (whole, short)]
    assert values[1]["a fall"] < values[0]["a fall"]
    assert whole["proposals"][0]["words"].startswith("angle differs by ")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("seconds = 2\n", "", 1), "either `seconds`, without inputs, or `inputs`"),
        (("angle_dot", "speed", 1), "no coordinate 'speed'; expected some of angle, angle_dot"),
        (("driven.csv", "gone.csv", 1), "gone.csv: no such file"),
        (("driven.csv", "../driven.csv", 1), "a file beside this one or below"),
        (("a fall", "driven", 1), "two proposals 'driven'"),
        (("seconds = 2", "secnods = 2", 1), "did you mean 'seconds'?"),
        (("seconds = 2", "seconds = 99999", 1), "at most 1000000; fewer seconds"),
        (("start = { angle = 115", "start = { angle = 1e300", 1), "at most 1e+06 rad or m"),
        (("start = { angle = 115", 'start = { angle = "115 mm"', 1), "'mm' is not a unit of"),
    ],
)
def test_proposals_that_are_none_are_one_line(change, told, place, capsys):
    text = place.proposals.read_text()
    place.proposals.write_text(text.replace(*change))
    refuse(capsys, told, place.model, place.proposals, "--system", place.system)


def test_what_cannot_be_asked_is_one_line(place, run_folder, tmp_path, capsys):
    given = (place.model, place.proposals)
    table = place.proposals.parent / "driven.csv"
    table.write_text(table.read_text().replace("torque", "voltage"))
    refuse(
        capsys,
        "columns voltage; expected the model's inputs: torque",
        *given,
        "--system",
        place.system,
    )
    table.write_text("torque,brake\n1,2\n1,2\n")
    refuse(capsys, "columns torque, brake; expected", *given, "--system", place.system)
    table.write_text("torque\n1\n2\n")
    refuse(capsys, "--horizon: not applicable", *given, "--system", place.system, "--horizon", 1)
    network = run_folder / "model.safetensors"
    refuse(capsys, "nothing says how sure it is", network, place.proposals)
    refuse(capsys, "no such file", place.model, tmp_path / "x.toml", "--system", place.system)


ARM = Path(__file__).parents[2] / "examples" / "robots" / "scara.urdf"
ROLL = ("--within", "roll=-3:3", "--within", "roll_dot=-6:6", "--limits", "roll_torque=-2:2")
QUICK = ("--harmonics", 3, "--seconds", 4, "--starts", 1, "--budget", "2s")


def test_a_motion_is_designed_for_the_file_of_a_robot(tmp_path, capsys):
    out = tmp_path / "motion"
    code, printed, progress = tustinnet(
        capsys,
        "next-record",
        "--design",
        "--system",
        ARM,
        "--out",
        out,
        "--rate",
        100,
        *ROLL,
        *QUICK,
        "--margin",
        0.2,
        "--noise",
        0.05,
        "--seed",
        3,
        "--within",
        "elbow_ddot=-8:8",
    )
    assert code == 0, progress
    assert {path.name for path in out.iterdir()} == {"motion.csv", "motion.png", "design.json"}
    table = pl.read_csv(out / "motion.csv")
    joints, n = ["shoulder", "elbow", "lift", "roll"], 4 * 100 + 1
    assert table.columns == [
        "time",
        *(name + end for name in joints for end in ("", "_dot", "_ddot")),
        "shoulder_torque",
        "elbow_torque",
        "lift_force",
        "roll_torque",
    ]
    assert len(table) == n
    for name, low, high in (
        ("shoulder", -2.3, 2.3),
        ("lift", -0.2, 0.0),
        ("roll_dot", -6, 6),
        ("elbow_dot", -6, 6),
        ("elbow_ddot", -8, 8),
        ("roll_torque", -2, 2),
        ("elbow_torque", -40, 40),
    ):
        middle, half = (low + high) / 2, 0.8 * (high - low) / 2  # less the margin
        values = table[name].to_numpy()
        assert np.abs(values - middle).max() <= half * (1 + 1e-9), name
        assert np.ptp(values) > 0
    for name in joints:
        for row in (0, -1):
            assert (table[f"{name}_dot"][row], table[f"{name}_ddot"][row]) == (0, 0)
        v = np.gradient(table[name].to_numpy(), 0.01)
        assert np.abs(v - table[f"{name}_dot"].to_numpy())[1:-1].max() < 0.02 * np.abs(v).max()
    assert "22 base parameters; by random motions within the same limits" in printed
    assert "collisions are not looked at" in printed
    assert "it begins and ends at rest at shoulder" in printed
    assert "start 1 of 1" in progress
    plain = json.loads((out / "design.json").read_text())
    shares = [b["expected"] / b["file"] for b in plain["base_parameters"]]
    assert shares == sorted(shares)
    assert (len(shares), plain["seed"], plain["margin"]) == (22, 3, 0.2)


def test_a_design_adds_to_the_records_of_a_fit(place, tmp_path, capsys):
    out = tmp_path / "motion"
    words = [
        "next-record",
        place.model,
        "--system",
        place.system,
        "--design",
        "--out",
        out,
        "--within",
        "angle=-2:2",
        "--within",
        "angle_dot=-4:4",
        "--limits",
        "torque=-9:9",
        "--frequency",
        0.5,
        *QUICK,
        "--json",
        "--quiet",
    ]
    code, printed, err = tustinnet(capsys, *words)
    assert code == 0, err
    assert "start" not in err
    plain = json.loads(printed)
    assert (plain["seconds"], plain["frequency"]) == (4, 0.5)
    errors = {b["name"]: (b["known"], b["expected"]) for b in plain["base_parameters"]}
    summary = json.loads((place.model.parent / "summary.json").read_text())
    for e in summary["identification"]["estimates"]:
        known, expected = errors[e["name"]]
        assert known == pytest.approx(e["error"], rel=1e-6)
        assert expected < known
    assert tustinnet(capsys, *words)[0] == 1, "there already"
    code, printed, _ = tustinnet(capsys, *words[:-2], "--overwrite")
    assert code == 0
    assert "it makes the errors of the records so far" in printed


def test_a_design_is_for_the_group_that_is_named(tmp_path, capsys):
    system, out = tmp_path / "arm.py", tmp_path / "motion"
    system.write_text(
        f"import tustinnet as tn\nSYSTEM = tn.load_robot({str(ARM)!r}, locked={{'roll': 0.0}}, "
        "per={'spindle': 'payload'})\n"
    )
    words = ["next-record", "--design", "--system", system, "--out", out, *QUICK]
    code, _, err = tustinnet(capsys, *words)
    assert (code, err.count("\n")) == (1, 1)
    assert "--group payload=NAME" in err
    code, printed, err = tustinnet(capsys, *words, "--group", "payload=2kg", "--json")
    assert code == 0, err
    found = json.loads(printed)["base_parameters"]
    names = {name for b in found for name in (b["name"], *b["terms"])}
    assert any(name.startswith("spindle.") and name.endswith("[2kg]") for name in names)
    assert not any(name.startswith("spindle.") and "[" not in name for name in names)


def test_what_no_motion_can_be_designed_for_is_one_line(place, run_folder, tmp_path, capsys):
    design = ("--design", "--out", tmp_path / "motion")
    robot = (*design, "--system", place.system)
    limits = ("--within", "angle=-2:2", "--within", "angle_dot=-4:4", "--limits", "torque=-9:9")
    refuse(
        capsys,
        "no limits of the position of 'angle'; expected limits of every position and "
        "velocity; for instance --within angle=-1:1",
        *robot,
    )
    refuse(capsys, "velocity of 'angle'", *robot, *limits[:2])
    refuse(capsys, "no limits of the input 'torque' at 'angle'", *robot, *limits[:4])
    refuse(capsys, "no 'angel'; expected one of angle", *robot, "--within", "angel=-1:1")
    refuse(capsys, "no input 'angle'", *robot, "--limits", "angle=-1:1")
    refuse(capsys, "one direction alone", *robot, "--within", "angle_dot=1:2")
    refuse(capsys, "it needs", *robot, *limits[:4], "--limits", "torque=-0.01:0.01")
    refuse(capsys, "--seconds: -1", *robot, *limits, "--seconds", -1)
    refuse(capsys, "--frequency: nan", *robot, *limits, "--frequency", "nan")
    refuse(capsys, "0.5 periods in 10 s", *robot, *limits, "--frequency", 0.05)
    refuse(capsys, "2.5 periods in 10 s", *robot, *limits, "--frequency", 0.25)
    refuse(capsys, "a tenth of the sampling rate", *robot, *limits, "--rate", 5)
    refuse(capsys, "--rate: 0", *robot, *limits, "--rate", 0)
    refuse(capsys, "--margin: 1", *robot, *limits, "--margin", 1)
    refuse(capsys, "--starts: 0", *robot, *limits, "--starts", 0)
    refuse(capsys, "--seed: -1", *robot, *limits, "--seed", -1)
    refuse(capsys, "--budget: 'soon'", *robot, *limits, "--budget", "soon")
    refuse(capsys, "which nothing in the system is per", *robot, *limits, "--group", "payload=1kg")
    pendulum = ARM.parent / "double_pendulum.urdf"
    refuse(capsys, "1 input of 2 coordinates", *design, "--system", pendulum)
    refuse(capsys, "made for the records", *design, "--system", "mechanism")
    refuse(capsys, "neither a model nor a system", *design)
    refuse(capsys, "no folder for the motion; expected --out DIR", "--design", "--system", ARM)
    network = run_folder / "model.safetensors"
    refuse(capsys, "a model without equations of motion", network, *design)
    refuse(capsys, "--horizon: not applicable to a design", *robot, "--horizon", 1)
    refuse(capsys, "PROPOSALS: not applicable to a design", place.model, place.proposals, *design)
    assert not (tmp_path / "motion").exists()


@pytest.mark.parametrize(
    "option",
    [
        ("--out", "motion"),
        ("--seconds", 5),
        ("--harmonics", 5),
        ("--frequency", 1),
        ("--rate", 100),
        ("--within", "angle=-1:1"),
        ("--limits", "torque=-1:1"),
        ("--margin", 0.1),
        ("--noise", 0.1),
        ("--group", "payload=1kg"),
        ("--starts", 2),
        ("--seed", 1),
        ("--budget", "1s"),
        ("--overwrite",),
        ("--quiet",),
    ],
)
def test_a_ranking_refuses_the_options_of_a_design(option, place, capsys):
    """Given to next-record with proposals."""
    refuse(
        capsys,
        f"{option[0]}: not applicable to a ranking",
        place.model,
        place.proposals,
        "--system",
        place.system,
        *option,
    )


def test_a_ranking_needs_a_model_and_proposals(place, capsys):
    for arguments in ((), (place.model,)):
        code, _, err = tustinnet(capsys, "next-record", *arguments)
        assert code == 2
        assert "missing" in err


def refuse(capsys, told: str, *arguments: object) -> None:
    code, out, err = tustinnet(capsys, "next-record", *arguments)
    *understood, error = err.splitlines()
    assert (code, out, error.startswith("error: ")) == (1, "", True), err
    assert all("start: " in line or line.startswith("--") for line in understood), err
    assert told in err
