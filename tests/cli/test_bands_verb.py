"""Bands of models that were calibrated: drawn, judged, refused."""

import json
from pathlib import Path
from typing import NamedTuple

import polars as pl
import pytest
from test_verbs import tustinnet

import tustinnet as tn


class Place(NamedTuple):
    """What the verbs are given."""

    plain: Path
    banded: Path
    logs: Path
    system: Path


@pytest.fixture
def place(identified, folder, system, tmp_path) -> Place:
    """An identified model, and its copy with bands."""
    plain, file = identified / "model.safetensors", tmp_path / "banded" / "model.safetensors"
    calibration = tn.calibrate(plain, validation(folder), file, system=system)
    assert (calibration.start, calibration.horizon) == ("model-20", None)
    assert calibration.highest_level == pytest.approx(2 / 3)
    return Place(plain, file, folder, system)


def validation(folder: Path) -> tn.DataSet:
    return tn.load(folder).split("validation")


@pytest.mark.thorough
def test_a_calibrated_model_simulates_and_is_judged_with_bands(place, tmp_path, capsys):
    banded, folder = place.banded, place.logs
    given = ("--system", place.system, "--start", "model-20", "--split", "validation")
    sim = tmp_path / "sim"
    asked = ("simulate", banded, folder, *given, "--out", sim, "--band", 0.6)
    assert tustinnet(capsys, *asked)[0] == 0
    by_time = pl.read_csv(sim / "fall3.csv")
    assert (by_time["angle_low"] <= by_time["angle"]).all()
    assert (by_time["angle"] <= by_time["angle_high"]).all()
    assert tustinnet(capsys, *asked, "--whole-records", "--overwrite")[0] == 0
    whole = pl.read_csv(sim / "fall3.csv")
    widths = [(of["angle_high"] - of["angle_low"]).to_numpy().mean() for of in (by_time, whole)]
    assert widths[0] < widths[1]

    figures = tmp_path / "figures"
    asked = ("evaluate", banded, folder, *given, "--band", 0.6)
    code, out, _ = tustinnet(capsys, *asked, "--json", "--whole-records", "--figures", figures)
    assert code == 0
    told = json.loads(out)["band"]
    assert (told["level"], told["of"]) == (0.6, "record")
    assert {of["part"] for of in told["covered"]} <= {"moving", "rest"}
    # what was calibrated on these records holds the share of them that it can promise
    assert all(of["whole"] == of["records"] or of["inside"] > 0.5 for of in told["covered"])
    assert (figures / "fall3.png").exists()
    code, out, _ = tustinnet(capsys, *asked)
    assert code == 0
    assert "Bands of 60 % of the time" in out
    drawn = ("evaluate", banded, banded, folder, *given, "--band", 0.6)
    assert tustinnet(capsys, *drawn, "--figures", tmp_path / "compared")[0] == 0


def test_a_copy_with_bands_is_the_same_model(place):
    one, other = (tn.read_header(path) for path in (place.plain, place.banded))
    assert other.pop("bands")["records"] == ["fall3", "noise2"]
    assert one == other
    assert (place.banded.parent / "system.py").exists()


def test_bands_that_cannot_be_are_one_line(place, run_folder, tmp_path, refused, capsys):
    plain, banded, folder, file = place
    out = tmp_path / "x.safetensors"
    net = run_folder / "model.safetensors"
    given = ("--system", file)
    records = validation(folder)
    for model, data, to, start, problem in (
        (plain, tn.load(folder).split("train"), out, None, "fall1, fall2, noise1, which .* fitted"),
        (plain, records, plain, None, "what the command reads"),
        (plain, records, banded, None, "there already"),
        (plain, records, out, "nowhere", "nowhere"),
        (plain, [], out, None, "no records; expected at least 2"),
        (plain, list(records)[:1], out, None, "1 record; expected at least 2"),
        (net, records, out, None, "nothing says how sure it is"),
    ):
        own = None if model is net else file
        with pytest.raises(tn.InputError, match=problem):
            tn.calibrate(model, data, to, start=start, system=own)
    assert not out.exists()
    sim = ("--out", tmp_path / "sim")
    start = ("--start", "model-20")
    refused(
        "simulate",
        banded,
        folder,
        *given,
        *start,
        *sim,
        "--band",
        0.9,
        names="which cannot promise more than 66.7 %; expected 9 records",
    )
    refused("simulate", banded, folder, *given, *start, *sim, "--band", 90, names="between 0 and 1")
    refused(
        "simulate",
        banded,
        folder,
        *given,
        *sim,
        "--band",
        0.6,
        "--start",
        "derived-6",
        names="'model-20', whole records, as the model was calibrated",
    )
    refused("simulate", plain, folder, *given, *sim, "--band", 0.6, names="without bands")
    refused("simulate", net, folder, *sim, "--band", 0.6, names="nothing says how sure it is")
    refused("simulate", banded, folder, *given, *sim, "--whole-records", names="add --band")
    refused("evaluate", banded, folder, *given, "--whole-records", names="add --band")
    refused("evaluate", banded, banded, folder, *given, "--band", 0.6, names="--figures DIR")
    assert not (tmp_path / "sim").exists()
    tn.calibrate(plain, records, banded, horizon=1.0, system=file, overwrite=True)
    asked = ("simulate", banded, folder, *given, *start, *sim, "--band", 0.6)
    refused(*asked, "--horizon", "inf", names="horizon 1 s, as the model was calibrated")
    code, told, err = tustinnet(capsys, *asked)
    assert code == 0
    assert "restarted every 1 s" in told
    assert "segments of 1 s as in the model's file (--horizon)" in err
