"""`fit --leave-out-spoiled`: what spoils a fit is left out, and named everywhere."""

import json

import pytest
from spoilt_records import records, simulate, write
from test_verbs import tustinnet

import tustinnet as tn

PLAN = """
name = "grey alone"
folds = 3
start = "model-20"
[[candidates]]
name = "grey"
recipe = "grey"
set = ["search.initial=anchored", "search.substeps=1"]
"""


def test_the_command_leaves_out_what_spoils_and_says_so(tmp_path, capsys, system):
    folder = tmp_path / "logs"
    write(folder, records("hand"))
    errors = {}
    for option in ((), ("--leave-out-spoiled",)):
        out = tmp_path / f"out{len(option)}"
        arguments = ["fit", folder, "--recipe", "grey", "--system", system, "--out", out]
        arguments += ["--set", "search.initial=anchored", "--set", "search.substeps=1"]
        arguments += option or ["--no-report"]
        code, printed, err = tustinnet(capsys, *arguments, "--quiet")
        assert code == 0, err
        header = tn.read_header(out / "model.safetensors")["spoiled"]
        summary = json.loads((out / "summary.json").read_text())
        assert summary["spoiled"] == header
        if option:
            assert "* left out: run2, " in printed
            assert header["left_out"][0]["text"].startswith("left out: run2, ")
            assert header["parts"] == []
            assert "left out: run2, " in (out / "report.html").read_text()
        else:
            assert "* spoiled: run2, " in printed
            assert header["parts"][0]["record"] == "run2"
        model = tn.load_model(out / "model.safetensors", system)
        errors[option] = tn.evaluate(model, simulate("other", 11), "model-20")[0].rmse
    assert errors[("--leave-out-spoiled",)] < 0.5 * errors[()]


@pytest.mark.thorough
def test_a_selection_leaves_out_before_its_folds(tmp_path, capsys, system):
    folder, out = tmp_path / "logs", tmp_path / "out"
    write(folder, records("hand"))
    (tmp_path / "plan.toml").write_text(PLAN)
    fit = ["fit", folder, "--plan", tmp_path / "plan.toml", "--system", system, "--out", out]
    fit += ["--quiet", "--no-report"]
    code, printed, err = tustinnet(capsys, *fit, "--leave-out-spoiled")
    assert code == 0, err
    assert "* left out: run2, " in printed
    summary = json.loads((out / "summary.json").read_text())
    assert summary["spoiled"]["left_out"][0]["text"].startswith("left out: run2, ")
    assert summary["spoiled"]["parts"] == []
    scored = next(iter(summary["candidates"][0]["starts"].values()))["rmse"]
    assert {name.split("[")[0] for name in scored} == {f"run{i}" for i in range(6)}
    assert "run2" not in scored
    assert tn.read_header(out / "model.safetensors")["spoiled"] == summary["spoiled"]
    one_fold = PLAN.replace("folds = 3", "folds = 3\nscored = 1")
    (tmp_path / "plan.toml").write_text(one_fold)
    code, printed, err = tustinnet(capsys, *fit, "--overwrite")
    assert code == 0, err
    assert "* spoiled: run2, " in printed
