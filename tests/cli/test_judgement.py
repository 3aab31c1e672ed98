"""The free runs by which a model was judged are the default of what is computed with it later."""

import json
from pathlib import Path

import numpy as np
import pytest
from every_family import example
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.store.header import (
    Judgement,
    doubt_in_header,
    judgement_in_header,
    read_header,
)
from tustinnet.store.model_file import copy_with_header


@pytest.fixture
def model(run_folder) -> Path:
    """A model that was judged on validation records from `derived-6`."""
    return run_folder / "model.safetensors"


def judged(model: Path, name: str, **changes: object) -> Path:
    """A copy of a model whose file says that it was judged in another way."""
    scores = {**read_header(model)["scores"], **changes}
    copy = model.parent / f"{name}.safetensors"
    copy_with_header(model, copy, scores={k: v for k, v in scores.items() if v is not None})
    return copy


def printed(capsys, *arguments: object) -> tuple[dict, str]:
    """JSON and messages of a verb."""
    code, out, err = tustinnet(capsys, *arguments, "--json")
    assert code == 0, err
    return json.loads(out), err


def test_a_fit_says_in_the_file_how_it_was_judged(model, capsys):
    header = read_header(model)
    assert judgement_in_header(header) == Judgement(start="derived-6", split="validation")
    other = judged(model, "other", horizon=1.0)
    for path, length in ((model, "whole records"), (other, "segments of 1 s")):
        _, out, _ = tustinnet(capsys, "show", path)
        (line,) = [line for line in out.splitlines() if line.startswith("score ")]
        assert "validation, mean RMSE" in line
        assert f"start 'derived-6', {length}, in the median " in line


@pytest.mark.thorough
def test_records_are_those_that_the_model_was_not_fitted_to(model, folder, capsys):
    told, err = printed(capsys, "evaluate", model, folder)
    assert (told["split"], told["start"], told["horizon"]) == ("validation", "derived-6", None)
    assert {e["split"] for e in told["experiments"]} == {"validation"}
    assert told["fitted_to"] == []
    line = "note: default: validation records (--split), start 'derived-6' as in the model's file"
    assert [err.count("note: "), err.count(line)] == [1, 1]
    told, err = printed(capsys, "evaluate", model, folder, "--split", "all")
    fitted = [e["experiment"] for e in told["experiments"] if e["split"] == "train"]
    assert told["fitted_to"] == fitted
    named = f"note: fitted to {len(fitted)} of the records, whose scores are optimistic: "
    assert f"{named}{', '.join(fitted)}" in err


def test_a_copy_of_a_fitted_record_in_another_file_is_named(model, folder, capsys):
    rows = np.loadtxt(folder / "fall1.csv", delimiter=",", skiprows=1)
    rows[:, 0] += 100.0
    np.savetxt(
        folder / "fresh.csv",
        rows,
        delimiter=",",
        header="time,angle,torque",
        comments="",
        fmt="%.7g",
        newline="\r\n",
    )
    card = folder / "dataset.toml"
    card.write_text(
        card.read_text().replace("validation = [", 'test = ["fresh.csv"]\nvalidation = [')
    )
    content, err = printed(capsys, "evaluate", model, folder)
    assert content["split"] == "test"
    assert content["fitted_to"] == ["fresh"]
    assert "fitted to all records, whose scores are optimistic: fresh" in err


def test_a_test_split_comes_first(model, folder, capsys):
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace("validation = [", "test = ["))
    told, err = printed(capsys, "evaluate", model, folder)
    assert told["split"] == "test"
    assert "default: test records" in err


@pytest.mark.thorough
def test_start_and_horizon_are_those_of_the_file_unless_told_otherwise(
    model, folder, tmp_path, capsys
):
    file = judged(model, "other", start="derived-8", horizon=1.0)
    sim = ("--out", tmp_path / "sim", "--overwrite")
    for verb, *more in (
        ("evaluate",),
        ("simulate", *sim),
    ):
        asked = (verb, file, folder, *more)
        told, err = printed(capsys, *asked)
        assert (told["start"], told["horizon"]) == ("derived-8", 1.0)
        assert "start 'derived-8' as in the model's file (--start)" in err
        assert "segments of 1 s as in the model's file (--horizon)" in err
        given = ("--start", "derived-6", "--horizon", "inf", "--split", "validation")
        told, err = printed(capsys, *asked, *given)
        assert (told["start"], told["horizon"]) == ("derived-6", None)
        assert "note: default" not in err
    page = tmp_path / "report.html"
    code, _, err = tustinnet(capsys, "report", file, folder, "--out", page)
    assert code == 0
    assert "segments of 1 s as in the model's file" in err
    assert "restarted every 1 s" in page.read_text(encoding="utf-8")


@pytest.mark.thorough
def test_files_that_disagree_or_cannot_apply_leave_the_usual_start(model, folder, capsys):
    other = judged(model, "other", start="derived-8", horizon=1.0)
    told, err = printed(capsys, "evaluate", model, other, folder)
    assert (told["start"], told["horizon"]) == ("model-20", None)
    assert "as in the model's file" not in err
    for name, changes in {
        "no-velocities": {"start": "file"},
        "too-long": {"start": "derived-9999"},
        "silent": {"start": None},
    }.items():
        told, _ = printed(capsys, "evaluate", judged(model, name, **changes), folder)
        assert (told["start"], told["horizon"]) == ("model-20", None), name
    longer = judged(model, "longer-than-records", horizon=1e3)
    told, _ = printed(capsys, "evaluate", longer, folder)
    assert (told["start"], told["horizon"]) == ("derived-6", None)  # the start applies


def test_a_damaged_judgement_is_one_line(model, folder, capsys):
    for changes in ({"start": 6}, {"horizon": -1.0}, {"split": ["test"]}):
        file = judged(model, "damaged", **changes)
        code, out, err = tustinnet(capsys, "evaluate", file, folder)
        assert (code, out, err.count("\n")) == (1, "", 1)
        assert f"{file}, scores.{next(iter(changes))}: " in err


def test_a_file_says_what_share_of_a_trivial_predictors_error_its_models_is(tmp_path, capsys):
    for share, doubt, shown in (
        (0.2, "", "in the median 20 % of standing still"),
        (3.0, "its model is 3 times as far off as standing still, on half", "300 % of standing"),
        (None, "its model diverges, on half", "mean RMSE"),
    ):
        reference = {"predictor": "standing still", "share": share}
        scores = {"split": "left out", "unit": "rad", "mean": 0.1, "reference": reference}
        file = tmp_path / "model.safetensors"
        tn.save(example("qube"), file, scores=scores)
        assert doubt_in_header(read_header(file)).startswith(doubt)
        assert doubt or not doubt_in_header(read_header(file))
        _, text, _ = tustinnet(capsys, "show", file)
        assert shown in text
    assert not doubt_in_header({})
