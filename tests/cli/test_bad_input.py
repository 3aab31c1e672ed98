"""Bad input: one line that names the place, exit code 1, nothing half-written."""

from pathlib import Path

import numpy as np
import pytest


def edit(path: Path, *change: str) -> None:
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(change[0], change[1], 1))


def set_cell(path: Path, row: int, column: int, value: str) -> None:
    """Changes a cell; row 0 is the header."""
    lines = [line.split(",") for line in path.read_text().splitlines()]
    lines[row][column] = value
    path.write_text("\n".join(",".join(line) for line in lines) + "\n")


def test_a_missing_file(folder, refused):
    (folder / "fall2.csv").unlink()
    refused("inspect", folder, told=("fall2.csv", "no such file", "[splits]"))


def test_an_empty_file(folder, refused):
    (folder / "fall2.csv").write_text("")
    refused("inspect", folder, told=("fall2.csv", "empty"))


def test_a_file_with_only_a_header(folder, refused):
    (folder / "fall2.csv").write_text("time,angle,torque\n")
    refused("inspect", folder, told=("fall2.csv", "no samples"))


def test_a_wrong_column_count(folder, refused):
    edit(folder / "dataset.toml", "[time]", "[format]\ncolumns = 4\n[time]")
    refused("inspect", folder, told=("fall1.csv", "3 columns", "expected 4"))


def test_a_row_of_another_length(folder, refused):
    set_cell(folder / "fall1.csv", 7, 1, "1.0,2.0")
    refused("inspect", folder, told=("fall1.csv", "row 8 has 4 cells"))


def test_text_in_a_number_column(folder, refused):
    set_cell(folder / "noise1.csv", 5, 1, "open")
    refused("inspect", folder, told=("noise1.csv row 6, angle", "'open'", "a number"))


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_numbers_that_are_not_finite(folder, refused, value):
    set_cell(folder / "noise1.csv", 5, 2, value)
    refused("inspect", folder, told=("noise1.csv, row 6", "torque", value))


@pytest.mark.parametrize(("time", "word"), [("0.04", "repeats"), ("0.01", "goes back")])
def test_timestamps_that_do_not_go_forward(folder, refused, time, word):
    set_cell(folder / "fall1.csv", 4, 0, time)
    refused("inspect", folder, told=("fall1.csv, row 5", word, "strictly increasing"))


def test_a_record_shorter_than_a_window(folder, small_recipe, tmp_path, refused):
    lines = (folder / "fall2.csv").read_text().splitlines()
    (folder / "fall2.csv").write_text("\n".join(lines[:9]) + "\n")
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", tmp_path / "run",
        told=("fall2", "8 samples", "window of 10 steps"),
    )  # fmt: skip
    assert not list((tmp_path / "run").rglob("*.safetensors"))


def test_two_experiments_with_different_periods(folder, refused):
    table = np.loadtxt(folder / "fall2.csv", delimiter=",", skiprows=1)
    table[:, 0] *= 2
    np.savetxt(folder / "fall2.csv", table, delimiter=",", header="time,angle,torque", comments="")
    refused("inspect", folder, told=("fall2.csv", "0.04 s", "expected 0.02 s", "resample"))


def test_signals_that_are_all_constant(folder, refused):
    table = np.loadtxt(folder / "fall2.csv", delimiter=",", skiprows=1)
    table[:, 1] = 12.5
    np.savetxt(folder / "fall2.csv", table, delimiter=",", header="time,angle,torque", comments="")
    refused("inspect", folder, told=("fall2.csv", "nothing moves", "angle"))


def test_a_card_that_names_a_column_that_is_not_there(folder, refused):
    edit(folder / "dataset.toml", 'column = "angle"', 'column = "angel"')
    refused("inspect", folder, told=("fall1.csv", "no column 'angel'", "time, angle, torque"))


def test_a_misspelt_key_in_the_card(folder, refused):
    edit(folder / "dataset.toml", "counts_per_revolution", "count_per_revolution")
    refused("inspect", folder, told=("dataset.toml", "did you mean 'counts_per_revolution'?"))


def test_a_folder_without_a_card(tmp_path, refused):
    refused("inspect", tmp_path, told=(str(tmp_path), "dataset.toml", "--card"))


@pytest.fixture
def model(run_folder) -> Path:
    return run_folder / "model.safetensors"


def test_models_that_are_none(model, folder, tmp_path, refused):
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(model.read_bytes()[:500])
    refused("show", cut, told=("cut.safetensors", "cut short"))
    refused("evaluate", cut, folder, told=("cut.safetensors", "cut short"))
    refused("show", folder / "fall1.csv", told=("fall1.csv", "not a safetensors file"))
    checkpoint = model.parent / "seed-0" / "checkpoint.safetensors"
    refused("show", checkpoint, told=("kind 'checkpoint'",))


def test_a_model_applied_to_other_coordinates(model, folder, tmp_path, refused):
    edit(folder / "dataset.toml", 'name = "angle"', 'name = "elbow"')
    told = ("fall3", "elbow (angular)", "angle (angular)", "the model")
    refused("evaluate", model, folder, told=told)
    refused("simulate", model, folder, "--out", tmp_path / "sim", told=("elbow",))
    assert not (tmp_path / "sim").exists()


def test_an_output_folder_that_cannot_be_written(folder, model, small_recipe, tmp_path, refused):
    blocked = tmp_path / "blocked"
    blocked.write_text("a file")
    for command in (
        ("fit", folder, "--recipe", small_recipe, "--out", blocked / "run"),
        ("simulate", model, folder, "--out", blocked / "sim"),
        ("inspect", folder, "--figure", blocked / "figure.png"),
        ("evaluate", model, folder, "--figures", blocked / "figures"),
        ("compare", model, folder, "--figures", blocked / "figures"),
        ("residuals", model, folder, "--figure", blocked / "figure.png"),
    ):
        refused(*command, told=("blocked", "cannot be written"))


@pytest.mark.parametrize("verb", ["inspect", "residuals"])
def test_a_figure_of_another_format(verb, folder, model, tmp_path, refused):
    given = (folder,) if verb == "inspect" else (model, folder)
    names = (".xyz", ".png or .svg or .pdf")
    refused(verb, *given, "--figure", tmp_path / "figure.xyz", told=names)


def test_unknown_names(folder, model, tmp_path, refused):
    refused("inspect", folder, "--split", "trian", told=("no split 'trian'", "train, validation"))
    refused("fit", folder, "--out", tmp_path / "r", "--recipe", "best", told=("no recipe 'best'",))
    refused("evaluate", model, folder, "--start", "zero", told=("unknown start 'zero'",))
    refused("evaluate", model, folder, "--start", "file", told=("derived-6",))
    refused("inspect", "qube-servo", told=("did you mean 'qube-servo2'?",))


def test_a_run_that_is_there_already(model, folder, small_recipe, refused):
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", model.parent,
        told=("holds an earlier run", "--resume", "--overwrite"),
    )  # fmt: skip


def test_the_data_variable_points_nowhere(tmp_path, monkeypatch, refused):
    monkeypatch.setenv("TUSTINNET_DATA", str(tmp_path))
    refused("reproduce", "--out", tmp_path / "out", told=("TUSTINNET_DATA", "train", "validation"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "rates", ["[]", "[0,1]", "[1,1]", "fast", "[inf]", "[-1]", "[1e9]", "[1e-300]", "1"]
)
def test_factors_of_rates_are_refused(rates, folder, small_recipe, tmp_path, refused):
    out = tmp_path / "run"
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", out, "--set", f"rates={rates}",
        told=("`rates` was removed", "--set stages.*.rate=RATE"),
    )  # fmt: skip
    assert not out.exists()


def test_a_device_that_is_not_there(folder, small_recipe, tmp_path, refused):
    out = tmp_path / "run"
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", out, "--device", "gpu",
        told=("--device gpu", "JAX sees none"),
    )  # fmt: skip
    assert not out.exists()


def test_a_network_is_no_physics_to_correct(folder, run_folder, tmp_path, refused):
    out = tmp_path / "corrected"
    refused(
        "fit", folder, "--physics", run_folder / "model.safetensors", "--out", out,
        told=("--physics", "'tustin-net'", "trained already", "--system first"),
    )  # fmt: skip
    assert not out.exists()


@pytest.mark.parametrize(
    "seeds", ["", "0", "-1", "x", "2.5", "1,1", "0,x", ",", "9" * 12, "9" * 12 + ",1", "9" * 5000]
)
def test_seeds_that_are_none(seeds, folder, small_recipe, tmp_path, refused):
    out = tmp_path / "run"
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", out, f"--seeds={seeds}",
        told=("--seeds", "different seeds", "--seeds 3"),
    )  # fmt: skip
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ("epochs", ("--set", "'epochs'", "KEY=VALUE")),
        ("search.loss=state", ("small.toml, search", "unknown key", "stages")),
        ("model.hiden=[4]", ("small.toml, model.hiden", "did you mean 'hidden'?")),
        ("model.correction.hidden=[4]", ("small.toml, model.correction", "unknown key")),
        ("model.kind=lstm", ("small.toml, model.kind", "'lstm'", "tustin-net, euler-lagrange")),
        ("stages.*.epoch=3", ("small.toml, stages.0.epoch", "did you mean 'epochs'?")),
        ("stages.1.penalty=1", ("small.toml, stages.1", "`penalty` was removed")),
        ("stages.7.epochs=3", ("--set", "no place '7' in a list of 2", "0 to 1")),
        ("stages.0.epochs=many", ("small.toml, stages.0.epochs", "integer", "'many'")),
        ("stages.0.epochs=0", ("small.toml, stages.0.epochs", "greater than 0")),
        ("stages.0.frozen_layers=3", ("small.toml", "stage 'first' freezes 3 of 2 hidden")),
    ],
)
def test_changes_that_a_recipe_does_not_take(
    change, names, folder, small_recipe, tmp_path, refused
):
    out = tmp_path / "run"
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", out, "--set", change, told=names
    )  # fmt: skip
    assert not out.exists()


def test_a_key_that_is_set_twice(folder, small_recipe, tmp_path, refused):
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", tmp_path / "run",
        "--set", "model.hidden=[4]", "--set", "model.hidden=[5]",
        told=("--set", "'model.hidden' twice"),
    )  # fmt: skip


def test_a_run_is_resumed_or_overwritten(folder, small_recipe, tmp_path, refused):
    refused(
        "fit", folder, "--recipe", small_recipe, "--out", tmp_path / "run",
        "--resume", "--overwrite", told=("--resume, --overwrite", "both", "one of them"),
    )  # fmt: skip


def test_what_a_network_has_no_use_for(folder, run_folder, small_recipe, tmp_path, refused):
    out = tmp_path / "none"
    fit = ("fit", folder, "--recipe", small_recipe, "--out", out)
    refused(*fit, "--system", "qube-servo2", told=("--system", "'tustin-net'", "--recipe grey"))
    model = run_folder / "model.safetensors"
    refused(*fit, "--physics", model, told=("--physics", "'tustin-net'", "best-hybrid"))
    refused(
        "fit", folder, "--recipe", "best-hybrid", "--out", out,
        told=("recipe 'best-hybrid'", "no physics", "--physics"),
    )  # fmt: skip
    assert not out.exists()
