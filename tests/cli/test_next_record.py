"""`next-record`: which of some proposed records would tell the most."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from test_verbs import tustinnet

PROPOSALS = """
[[proposals]]
name = "at rest"
seconds = 2
[[proposals]]
name = "a fall"
seconds = 2
start = { angle = 2.0, angle_dot = -0.5 }
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
        (("start = { angle = 2.0", "start = { angle = 1e300", 1), "less than or equal to 1000000"),
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
    refuse(capsys, "no column 'torque', only voltage; expected the model's inputs: torque", *given,
           "--system", place.system)  # fmt: skip
    table.write_text("torque,brake\n1,2\n1,2\n")
    refuse(capsys, "'brake', which is no input", *given, "--system", place.system)
    table.write_text("torque\n1\n2\n")
    refuse(capsys, "--horizon: not applicable", *given, "--system", place.system, "--horizon", 1)
    network = run_folder / "model.safetensors"
    refuse(capsys, "nothing says how sure it is", network, place.proposals)
    refuse(capsys, "no such file", place.model, tmp_path / "x.toml", "--system", place.system)


def refuse(capsys, told: str, *arguments: object) -> None:
    code, out, err = tustinnet(capsys, "next-record", *arguments)
    assert (code, out, err.count("\n")) == (1, "", 1), err
    assert told in err
