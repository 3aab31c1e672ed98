"""`fit` without a recipe: a plan of candidates, a budget, one model and an account in words."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import SYSTEM
from linear_machines import double_integrator
from small_selection import NETWORK_ONLY, plan_in
from test_verbs import tustinnet

from tustinnet.cli.select import print_choice, print_next_steps, read_options
from tustinnet.finding import make_finding
from tustinnet.report.tables import Table

PLAN = """
name = "two"
folds = 3
start = "derived-6"
candidates = [{ name = "grey", recipe = "grey.toml" }, { name = "network", recipe = "linear" }]
"""


@pytest.fixture
def out(tmp_path):
    return tmp_path / "run"


def test_a_folder_of_logs_and_a_system_become_one_model(folder, tmp_path, out, capsys):
    plan, system = plan_in(tmp_path, PLAN), tmp_path / "small_pendulum.py"
    system.write_text(SYSTEM)
    verb = ("fit", folder, "--plan", plan, "--system", system, "--out", out)
    code, printed, err = tustinnet(capsys, *verb, "--budget", "5min")
    assert code == 0, err
    assert "best so far: " in err
    assert "grey, all training records: " in err
    assert "free runs of records that a model was not fitted to" in printed
    assert "* chosen: grey, identified from all 5 records" in printed
    assert " better than the next, network: by " in printed
    summary = json.loads((out / "summary.json").read_text())
    assert summary["best"] == "grey"
    assert "| network |" in (out / "candidates.md").read_text()
    figures = sorted(path.stem for path in (out / "figures").iterdir())
    assert figures == ["candidates", "fall1", "fall2", "fall3", "noise1", "noise2"]
    # the system that was kept serves the model, and those of the folds
    for model in (
        "model.safetensors",
        "candidates/grey/model.safetensors",
        "candidates/grey/fold-1-seeds-0/fold-1-seed-0/model.safetensors",
    ):
        code, printed, err = tustinnet(
            capsys, "evaluate", out / model, folder, "--start", "derived-6", "--json"
        )
        assert code == 0, err
        fitted = json.loads(printed)["fitted_to"]  # of a selection, validation records too
        assert "fold-" in model or fitted == ["fall3", "noise2"]
    code, _, err = tustinnet(capsys, *verb)
    assert code == 1
    assert "holds an earlier selection" in err
    code, printed, err = tustinnet(capsys, *verb, "--resume", "--json", "--quiet")
    assert (code, err) == (0, "")
    again = json.loads(printed)
    assert [c["starts"] for c in again["candidates"]] == [
        c["starts"] for c in summary["candidates"]
    ]


@pytest.mark.parametrize("quiet", [False, True])
def test_notes_are_printed_once(monkeypatch, capsys, quiet):
    left_out = make_finding("candidates left out", why="too late", candidates=["b"])
    choice: Any = SimpleNamespace(
        findings=(make_finding("records diverge"), left_out), notes=(left_out,)
    )
    monkeypatch.setattr(
        "tustinnet.report.selection.candidates_table", lambda choice: Table(["a"], [["1"]])
    )
    print_choice(choice, quiet=quiet)  # without `quiet` they were printed while it was made
    assert ("* left out, too late: b" in capsys.readouterr().out) == quiet


@pytest.mark.parametrize("error", [0.5, 133.0])
def test_only_a_model_that_is_of_use_is_exported(capsys, error):
    result = SimpleNamespace(rmse=lambda: {"a": error})
    candidate = SimpleNamespace(content=SimpleNamespace(is_by_forces=False))
    plan = SimpleNamespace(candidate=lambda name: candidate)
    choice: Any = SimpleNamespace(
        best="m",
        model=double_integrator(),
        candidates=SimpleNamespace(plan=plan),
        follows=True,  # as it is but for one record
        result=lambda name: result,
        reference=SimpleNamespace(mean=1.0),
        context=SimpleNamespace(folder=Path("run")),
    )
    print_next_steps(choice, "logs")
    printed = capsys.readouterr().out
    assert ("export" in printed, "control" in printed) == (error < 1, error < 1)
    assert "evaluate" in printed


@pytest.mark.parametrize(
    ("plan", "on_cluster", "budget", "seconds"),
    [
        (None, False, None, 240.0),
        (None, False, "none", None),
        (None, False, "90s", 90.0),
        ("quick", False, None, None),
        ("quick", False, "1.5h", 5400.0),
        (None, True, None, None),
    ],
)
def test_only_the_usual_plan_on_this_machine_has_a_usual_budget(plan, on_cluster, budget, seconds):
    options = read_options(plan, budget, None, on_cluster=on_cluster, leave_out_spoiled=False)
    assert options.budget == seconds


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--seeds", "2"], ["--seeds", "without a recipe", "--plan"]),
        (["--set", "model.hidden=[3]"], ["--set", "without a recipe"]),
        (["--recipe", "standard", "--budget", "1min"], ["--budget", "single recipe"]),
        (["--recipe", "standard", "--plan", "usual"], ["--plan", "single recipe"]),
        (["--recipe", "standard", "--cluster", "auto"], ["--cluster", "single recipe"]),
        (["--cluster", "127.0.0.1"], ["cluster 127.0.0.1", "no address", "HOST:PORT"]),
        (["--cluster", "127.0.0.1:1"], ["127.0.0.1:1: does not answer", "ray start --head"]),
        (["--cluster", "auto", "--device", "gpu"], ["--device gpu", "jobs on a cluster"]),
        (["--budget", "soon"], ["--budget", "'soon'", "10min"]),
        (["--budget", "0s"], ["--budget", "above 0"]),
        (["--plan", "best"], ["no plan 'best'", "usual"]),
        (["--plan", "{}", "--system", "qube-servo2"], ["--system", "not applicable to the plan"]),
        (["--resume", "--overwrite"], ["both"]),
    ],
    ids=lambda part: " ".join(part),
)
def test_what_cannot_be_asked_is_one_line(arguments, told, folder, tmp_path, out, capsys):
    plan = plan_in(tmp_path, NETWORK_ONLY)
    given = [a.format(plan) for a in arguments]
    code, printed, err = tustinnet(capsys, "fit", folder, "--out", out, "--quiet", *given)
    assert (code, printed) == (1, "")
    assert len(err.strip().splitlines()) == 1
    for word in told:
        assert word in err
    assert not out.exists()


@pytest.mark.thorough
def test_a_system_of_other_records_leaves_the_others_to_go_on(folder, tmp_path, out, capsys):
    plan = plan_in(tmp_path, PLAN.replace("[{ folds = 3 }]", "[{ folds = 1 }]"))
    code, printed, err = tustinnet(
        capsys,
        *("fit", folder, "--plan", plan, "--system", "qube-servo2", "--out", out, "--no-report"),
    )
    assert code == 0, err
    assert "grey, fold 0: " in err
    assert "* chosen: network" in printed
    table = (out / "candidates.md").read_text()
    assert re.search(r"without a score: grey \(.*the system 'qube-servo2'.*\)\n", table)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("SYSTEM = (", "never closed"),
        ("import nowhere_to_be_found", "nowhere_to_be_found"),
        ("ARM = 1", "no SYSTEM"),
    ],
)
def test_a_system_file_that_does_not_run_is_one_line_before_anything(
    text, told, folder, tmp_path, out, capsys
):
    plan, system = plan_in(tmp_path, PLAN), tmp_path / "broken.py"
    system.write_text(text)
    verb = ("fit", folder, "--plan", plan, "--system", system, "--out", out, "--budget", "5min")
    code, printed, err = tustinnet(capsys, *verb, "--quiet")
    assert (code, printed) == (1, "")
    assert len(err.strip().splitlines()) == 1
    assert "broken.py" in err
    assert told in err
    assert not out.exists()


@pytest.mark.thorough
def test_an_earlier_selection_that_is_overwritten_leaves_nothing(folder, tmp_path, out, capsys):
    text = NETWORK_ONLY.replace("small.toml", "linear")
    plan = plan_in(tmp_path, text)
    verb = ("fit", folder, "--plan", plan, "--out", out, "--quiet", "--no-report")
    assert tustinnet(capsys, *verb)[0] == 0
    (out / "figures" / "mine.png").write_text("not of a selection")
    assert (out / "candidates" / "network").is_dir()
    card = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(card.replace(', "noise2.csv"', ""))
    plan.write_text(text.replace('name = "network"', 'name = "renamed"'))
    code, _, err = tustinnet(capsys, *verb, "--overwrite")
    assert code == 0, err
    assert [path.name for path in (out / "candidates").iterdir()] == ["renamed"]
    drawn = sorted(path.stem for path in (out / "figures").iterdir())
    assert drawn == ["candidates", "fall1", "fall2", "fall3", "mine", "noise1"]
