"""Bad input: one line that names the place, exit code 1, nothing half-written."""

from collections.abc import Callable
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


def replace_column(path: Path, column: int, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Writes a file again with another column."""
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    table[:, column] = change(table[:, column])
    np.savetxt(path, table, delimiter=",", header="time,angle,torque", comments="")


# what is done to the folder, and what the one line then names
FOLDERS: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "a missing file": (
        lambda f: (f / "fall2.csv").unlink(),
        ("fall2.csv", "no such file", "[splits]"),
    ),
    "an empty file": (lambda f: (f / "fall2.csv").write_text(""), ("fall2.csv", "empty")),
    "a header alone": (
        lambda f: (f / "fall2.csv").write_text("time,angle,torque\n"),
        ("fall2.csv", "no samples"),
    ),
    "another number of columns": (
        lambda f: edit(f / "dataset.toml", "[time]", "[format]\ncolumns = 4\n[time]"),
        ("fall1.csv", "3 columns", "expected 4"),
    ),
    "a row of another length": (
        lambda f: set_cell(f / "fall1.csv", 7, 1, "1.0,2.0"),
        ("fall1.csv", "row 8 has 4 cells"),
    ),
    "text in a column of numbers": (
        lambda f: set_cell(f / "noise1.csv", 5, 1, "open"),
        ("noise1.csv row 6, angle", "'open'", "a number"),
    ),
    "nan": (
        lambda f: set_cell(f / "noise1.csv", 5, 2, "nan"),
        ("noise1.csv, row 6", "torque", "nan"),
    ),
    "inf": (
        lambda f: set_cell(f / "noise1.csv", 5, 2, "inf"),
        ("noise1.csv, row 6", "torque", "inf"),
    ),
    "a timestamp twice": (
        lambda f: set_cell(f / "fall1.csv", 4, 0, "0.04"),
        ("fall1.csv, row 5", "repeats", "strictly increasing"),
    ),
    "a timestamp that goes back": (
        lambda f: set_cell(f / "fall1.csv", 4, 0, "0.01"),
        ("fall1.csv, row 5", "goes back", "strictly increasing"),
    ),
    "another period": (
        lambda f: replace_column(f / "fall2.csv", 0, lambda t: 2 * t),
        ("fall2.csv", "0.04 s", "expected 0.02 s", "resample"),
    ),
    "constant signals": (
        lambda f: replace_column(f / "fall2.csv", 1, lambda a: 0 * a + 12.5),
        ("fall2.csv", "nothing moves", "angle"),
    ),
    "a card that names a column that is not there": (
        lambda f: edit(f / "dataset.toml", 'column = "angle"', 'column = "angel"'),
        ("fall1.csv", "no column 'angel'", "time, angle, torque"),
    ),
    "a misspelt key in the card": (
        lambda f: edit(f / "dataset.toml", "counts_per_revolution", "count_per_revolution"),
        ("dataset.toml", "did you mean 'counts_per_revolution'?"),
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("case", FOLDERS)
def test_a_folder_that_cannot_be_read_is_refused(case, folder, refused):
    change, names = FOLDERS[case]
    change(folder)
    refused("inspect", folder, names=names)


def test_a_folder_without_a_card(tmp_path, refused):
    refused("inspect", tmp_path, names=(str(tmp_path), "dataset.toml", "--card"))


def test_a_record_shorter_than_a_window(folder, small_recipe, tmp_path, refused):
    lines = (folder / "fall2.csv").read_text().splitlines()
    (folder / "fall2.csv").write_text("\n".join(lines[:9]) + "\n")
    refused(
        "fit",
        folder,
        "--recipe",
        small_recipe,
        "--out",
        tmp_path / "run",
        names=("fall2", "8 samples", "window of 10 steps"),
    )
    assert not list((tmp_path / "run").rglob("*.safetensors"))


@pytest.fixture
def model(run_folder) -> Path:
    return run_folder / "model.safetensors"


def test_models_that_are_none(model, folder, tmp_path, refused):
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(model.read_bytes()[:500])
    refused("show", cut, names=("cut.safetensors", "cut short"))
    refused("evaluate", cut, folder, names=("cut.safetensors", "cut short"))
    refused("show", folder / "fall1.csv", names=("fall1.csv", "not a safetensors file"))
    checkpoint = model.parent / "seed-0" / "checkpoint.safetensors"
    refused("show", checkpoint, names=("kind 'checkpoint'",))


def test_a_model_applied_to_other_coordinates(model, folder, tmp_path, refused):
    edit(folder / "dataset.toml", 'name = "angle"', 'name = "elbow"')
    refused(
        "evaluate",
        model,
        folder,
        names=("fall3", "elbow (angular)", "angle (angular)", "the model"),
    )
    refused("simulate", model, folder, "--out", tmp_path / "sim", names=("elbow",))
    assert not (tmp_path / "sim").exists()


def test_an_output_folder_that_cannot_be_written(folder, model, small_recipe, tmp_path, refused):
    blocked = tmp_path / "blocked"
    blocked.write_text("a file")
    for command in (
        ("fit", folder, "--recipe", small_recipe, "--out", blocked / "run"),
        ("simulate", model, folder, "--out", blocked / "sim"),
        ("inspect", folder, "--figure", blocked / "figure.png"),
        ("evaluate", model, folder, "--figures", blocked / "figures"),
    ):
        refused(*command, names=("blocked", "cannot be written"))


def test_a_figure_of_another_format(folder, tmp_path, refused):
    names = (".xyz", ".png or .svg or .pdf")
    refused("inspect", folder, "--figure", tmp_path / "figure.xyz", names=names)


def test_unknown_names(folder, model, tmp_path, refused):
    refused("inspect", folder, "--split", "trian", names=("no split 'trian'", "train, validation"))
    refused("fit", folder, "--out", tmp_path / "r", "--recipe", "best", names=("no recipe 'best'",))
    refused("evaluate", model, folder, "--start", "zero", names=("unknown start 'zero'",))
    refused("evaluate", model, folder, "--start", "file", names=("derived-6",))
    refused("inspect", "qube-servo", names=("did you mean 'qube-servo2'?",))


def test_a_run_that_is_there_already(model, folder, small_recipe, refused):
    refused(
        "fit",
        folder,
        "--recipe",
        small_recipe,
        "--out",
        model.parent,
        names=("holds an earlier run", "--resume", "--overwrite"),
    )


def test_the_data_variable_points_nowhere(tmp_path, monkeypatch, refused):
    monkeypatch.setenv("TUSTINNET_DATA", str(tmp_path))
    refused("reproduce", "--out", tmp_path / "out", names=("TUSTINNET_DATA", "train", "validation"))
    assert not (tmp_path / "out").exists()


def test_a_network_is_no_physics_to_correct(folder, run_folder, tmp_path, refused):
    out = tmp_path / "corrected"
    refused(
        "fit",
        folder,
        "--physics",
        run_folder / "model.safetensors",
        "--out",
        out,
        names=("--physics", "'tustin-net'", "trained already", "--system first"),
    )
    assert not out.exists()


SEEDS = ("", "0", "-1", "x", "2.5", "1,1", "0,x", ",", "9" * 12, "9" * 12 + ",1", "9" * 5000)


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (["--set", "rates=[1]"], ("small.toml, rates: unknown key", "stages.*.rate")),
        *(([f"--seeds={s}"], ("--seeds", "different seeds", "--seeds 3")) for s in SEEDS),
        (["--set", "epochs"], ("--set", "'epochs'", "KEY=VALUE")),
        (["--set", "search.robust=huber"], ("small.toml, search", "unknown key", "stages")),
        (["--set", "model.hiden=[4]"], ("small.toml, model.hiden", "did you mean 'hidden'?")),
        (["--set", "model.correction.hidden=[4]"], ("small.toml, model.correction", "unknown key")),
        (
            ["--set", "model.kind=lstm"],
            ("small.toml, model.kind", "'lstm'", "tustin-net, euler-lagrange"),
        ),
        (["--set", "stages.*.epoch=3"], ("small.toml, stages.0.epoch", "did you mean 'epochs'?")),
        (["--set", "stages.1.penalty=1"], ("small.toml, stages.1.penalty", "train fewer epochs")),
        (["--set", "stages.7.epochs=3"], ("--set", "no place '7' in a list of 2", "0 to 1")),
        (["--set", "stages.0.epochs=many"], ("small.toml, stages.0.epochs", "integer", "'many'")),
        (["--set", "stages.0.epochs=0"], ("small.toml, stages.0.epochs", "greater than 0")),
        (
            ["--set", "stages.0.frozen_layers=3"],
            ("small.toml", "stage 'first' freezes 3 of 2 hidden"),
        ),
        (
            ["--set", "model.hidden=[4]", "--set", "model.hidden=[5]"],
            ("--set", "'model.hidden' twice"),
        ),
        (["--resume", "--overwrite"], ("--resume, --overwrite", "both", "one of them")),
        (["--device", "gpu"], ("--device gpu", "JAX sees none")),
    ],
    ids=lambda part: " ".join(part)[:40] if isinstance(part, list) else "",
)
def test_options_that_a_fit_does_not_take(options, names, folder, small_recipe, tmp_path, refused):
    out = tmp_path / "run"
    refused("fit", folder, "--recipe", small_recipe, "--out", out, *options, names=names)
    assert not out.exists()


@pytest.mark.thorough
def test_what_a_network_has_no_use_for(folder, run_folder, small_recipe, tmp_path, refused):
    out = tmp_path / "none"
    fit = ("fit", folder, "--recipe", small_recipe, "--out", out)
    refused(*fit, "--system", "qube-servo2", names=("--system", "'tustin-net'", "--recipe grey"))
    model = run_folder / "model.safetensors"
    refused(*fit, "--physics", model, names=("--physics", "'tustin-net'", "best-hybrid"))
    refused(
        "fit",
        folder,
        "--recipe",
        "best-hybrid",
        "--out",
        out,
        names=("recipe 'best-hybrid'", "no physics", "--physics"),
    )
    assert not out.exists()
