"""Cross-validation by the command: files, JSON, refusals."""

import json

import pytest
from conftest import SYSTEM
from test_verbs import tustinnet

RECORDS = {"fall1", "fall2", "fall3", "noise1", "noise2"}
QUICK = ("--set", "stages.*.epochs=1", "--folds", 3, "--quiet")


@pytest.fixture
def out(tmp_path):
    return tmp_path / "folds"


def test_every_record_is_scored_by_models_that_never_saw_it(folder, tiny_recipe, out, capsys):
    verb = ("cross-validate", folder, "--recipe", tiny_recipe, "--out", out, *QUICK, "--seeds", 2)
    code, printed, err = tustinnet(capsys, *verb, "--start", "derived-6", "--json")
    assert code == 0, err
    told = json.loads((out / "folds.json").read_text())
    assert json.loads(printed) == told
    assert (told["recipe"], told["unit"]) == ("tiny", "rad")
    assert {r["record"] for r in told["records"]} == RECORDS
    assert len(told["records"]) == 2 * len(RECORDS)  # by each seed
    assert {r["fold"] for r in told["records"]} == {0, 1, 2}
    assert len(told["outcomes"]) == 6
    (summary,) = told["summary"].values()
    assert set(summary["by_seed"]) == {"0", "1"}
    assert summary["mean"] == pytest.approx(sum(summary["by_seed"].values()) / 2)
    assert summary["standard_error"] > 0
    table = (out / "folds.md").read_text()
    assert "from derived-6" in table
    assert "mean ± standard error" in table
    assert all(f"| {record} |" in table for record in RECORDS)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    code, printed, err = tustinnet(capsys, *verb)
    assert (code, printed) == (1, "")
    assert "folds.json: there already" in err
    assert "--overwrite" in err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    code, printed, _ = tustinnet(capsys, *verb, "--overwrite")
    assert code == 0
    assert "models not fitted to the record" in printed
    assert "from model-20" in (out / "folds.md").read_text()


@pytest.mark.thorough
def test_a_system_is_identified_anew_in_every_fold(folder, tmp_path, out, capsys):
    system = tmp_path / "small_pendulum.py"
    system.write_text(SYSTEM)
    code, printed, err = tustinnet(
        capsys,
        "cross-validate",
        folder,
        "--recipe",
        "grey",
        "--system",
        system,
        "--folds",
        3,
        "--set",
        "search.initial=anchored",
        "--start",
        "derived-6",
        "--quiet",
        "--json",
        "--out",
        out,
    )
    assert code == 0, err
    told = json.loads(printed)
    assert {r["record"] for r in told["records"]} == RECORDS
    assert told["summary"]["derived-6"]["mean"] < 0.02
    assert all("converged" in outcome for outcome in told["outcomes"].values())


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--recipe", "grey", "--system", "{}", "--seeds", "2"], ["--seeds", "no seeds"]),
        (["--recipe", "grey"], ["--system", "no system"]),
        (["--recipe", "standard", "--system", "{}"], ["--system", "not applicable"]),
        (["--recipe", "standard", "--physics", "best-grey"], ["--physics", "'tustin-net'"]),
        (["--recipe", "nope"], ["no recipe 'nope'"]),
        (["--recipe", "standard", "--set", "search.robust=huber"], ["search", "unknown key"]),
        (["--recipe", "standard", "--folds", "9"], ["--folds", "9 folds of 5 records", "3 to 5"]),
        (["--recipe", "standard", "--start", "zero"], ["unknown start 'zero'"]),
        (["--cluster", "127.0.0.1"], ["cluster 127.0.0.1", "no address", "HOST:PORT"]),
        (["--cluster", "127.0.0.1:1"], ["127.0.0.1:1: does not answer", "ray start --head"]),
        (["--cluster", "auto", "--device", "gpu"], ["--device gpu", "jobs on a cluster"]),
    ],
    ids=lambda part: " ".join(part),
)
def test_what_cannot_be_asked_is_one_line(arguments, told, folder, tmp_path, out, capsys):
    system = tmp_path / "small_pendulum.py"
    system.write_text(SYSTEM)
    arguments = [a.format(system) for a in arguments]
    code, printed, err = tustinnet(
        capsys, "cross-validate", folder, "--out", out, "--quiet", *arguments
    )
    assert (code, printed) == (1, "")
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    for word in told:
        assert word in line
    assert "Traceback" not in err
    assert not (out / "folds.json").exists()
