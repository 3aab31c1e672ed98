"""Each verb on a small data set."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import tustinnet as tn
from tustinnet.check.check import check
from tustinnet.cli.findings import warning_lines
from tustinnet.cli.main import run


def tustinnet(capsys: pytest.CaptureFixture, *arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of the command."""
    with pytest.raises(SystemExit) as ended:
        run([str(a) for a in arguments])
    captured = capsys.readouterr()
    return int(ended.value.code or 0), captured.out, captured.err


@pytest.fixture
def model(run_folder) -> Path:
    """A model of the small system."""
    return run_folder / "model.safetensors"


def test_help_names_every_verb_and_loads_no_jax():
    program = (
        "import sys\nfrom tustinnet.cli.main import run\n"
        "try: run(['--help'])\nexcept SystemExit as e: assert not e.code\n"
        "assert not {'jax', 'polars', 'matplotlib', 'scipy'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for verb in (
        "demo",
        "inspect",
        "fit",
        "cross-validate",
        "simulate",
        "evaluate",
        "export",
        "show",
        "report",
        "reproduce",
    ):
        assert f"\n  {verb} " in done.stdout


def test_wrong_usage_exits_with_2(capsys):
    assert tustinnet(capsys, "fit")[0] == 2
    assert tustinnet(capsys, "inspect", "--nonsense")[0] == 2
    assert tustinnet(capsys, "simulate", "m", "x")[0] == 2
    assert tustinnet(capsys, "cross-validate", "x", "--out", "y", "--folds", "2")[0] == 2


@pytest.mark.parametrize(
    ("verb", "current"),
    [
        *((verb, "tustinnet ") for verb in ("compare", "residuals", "learning-curve")),
        *((verb, "in Python: tn.") for verb in ("calibrate", "committee", "next-record")),
    ],
)
def test_a_verb_of_before_says_what_to_write_instead(verb, current, capsys):
    code, out, err = tustinnet(capsys, verb, "x", "y")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert f"error: '{verb}': a verb of an earlier version; expected {current}" in err


def test_version(capsys):
    assert tustinnet(capsys, "--version")[1].startswith("tustinnet ")


def test_inspect_looks_at_a_single_file(folder, capsys):
    file = folder / "fall1.csv"
    code, out, _ = tustinnet(capsys, "inspect", file)
    assert code == 0
    for told in ("300 rows", "every 20 ms", "steps of", 'column = "angle"', "[splits]"):
        assert told in out
    code, out, _ = tustinnet(capsys, "inspect", file, "--json")
    roles = {c["name"]: c["role"] for c in json.loads(out)["columns"]}
    assert roles == {"time": "time", "angle": "position", "torque": "constant"}
    for option in (["--split", "train"], ["--strict"], ["--card", folder / "dataset.toml"]):
        code, out, err = tustinnet(capsys, "inspect", file, *option)
        assert (code, out, err.count("\n")) == (1, "", 1)
        assert f"{option[0]}: not applicable to the single file" in err
    assert "no such file" in tustinnet(capsys, "inspect", folder / "nothing.csv")[2]


def test_inspect_prints_tables(folder, capsys):
    code, out, _ = tustinnet(capsys, "inspect", folder)
    assert code == 0
    assert "fall1" in out
    assert "0.00153398" in out  # 2 pi / 4096
    assert "log [ms]" in out


def test_inspect_as_json_with_a_figure(folder, tmp_path, capsys):
    figure = tmp_path / "look" / "records.png"
    code, out, _ = tustinnet(capsys, "inspect", folder, "--json", "--figure", figure)
    assert code == 0
    reports = json.loads(out)["experiments"]
    assert [r["name"] for r in reports] == ["fall1", "fall2", "noise1", "fall3", "noise2"]
    assert reports[0]["samples"] == 300
    assert reports[2]["k_bar"] == 240
    assert reports[0]["coordinates"][0]["count"] == pytest.approx(0.00153398, rel=1e-3)
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_fit_reports_the_spread_of_several_seeds_and_keeps_model_and_figures(
    folder, small_recipe, tmp_path, capsys
):
    out_folder = tmp_path / "fitted"
    code, out, err = tustinnet(
        capsys, "fit", folder, "--recipe", small_recipe, "--out", out_folder, "--seeds", 2, "--json"
    )
    assert code == 0, err
    told = json.loads(out)
    assert [s["seed"] for s in told["seeds"]] == [0, 1]
    assert told["spread"]["min"] < told["spread"]["max"]
    assert "100 %" in err  # progress goes to standard error, as lines where there is no terminal
    assert "\x1b" not in err
    assert (out_folder / "model.safetensors").is_file()
    figures = {p.name for p in (out_folder / "figures").iterdir()}
    assert figures == {"training.png", "fall3.png", "noise2.png"}


@pytest.mark.thorough
def test_fit_takes_seeds_by_name_and_changes_of_the_recipe(folder, small_recipe, tmp_path, capsys):
    code, out, _ = tustinnet(
        capsys,
        "fit",
        folder,
        "--recipe",
        small_recipe,
        "--out",
        tmp_path / "run",
        "--seeds",
        "4,7",
        "--set",
        "stages.*.epochs=1",
        "--set",
        "description=quick",
        "--json",
        "--quiet",
    )
    assert code == 0
    told = json.loads(out)
    assert [(s["seed"], s["epochs"]) for s in told["seeds"]] == [(4, [1, 1]), (7, [1, 1])]
    shown = json.loads(tustinnet(capsys, "show", tmp_path / "run/model.safetensors", "--json")[1])
    assert shown["recipe"]["description"] == "quick"


def test_fit_resumes_a_finished_run(model, folder, small_recipe, capsys):
    before = model.read_bytes()
    code, out, _ = tustinnet(
        capsys,
        "fit",
        folder,
        "--recipe",
        small_recipe,
        "--out",
        model.parent,
        "--resume",
        "--seeds",
        2,
    )
    assert code == 0
    assert "finished" in out
    assert model.read_bytes() == before


def test_a_training_that_diverges_ends_with_an_account_and_exit_code_1(
    folder, small_recipe, tmp_path, capsys
):
    small_recipe.write_text(small_recipe.read_text().replace("rate = 3e-3", "rate = 1e3"))
    code, out, err = tustinnet(
        capsys, "fit", folder, "--recipe", small_recipe, "--out", tmp_path / "run"
    )
    assert code == 1
    assert "diverged" in out
    assert "after 5 returns to the last good state" in err
    assert (tmp_path / "run" / "seed-0" / "model.safetensors").is_file()


def test_simulate_writes_the_free_runs(model, folder, tmp_path, capsys):
    out_folder = tmp_path / "simulated"
    code, out, _ = tustinnet(
        capsys, "simulate", model, folder, "--out", out_folder, "--split", "validation", "--json"
    )
    assert code == 0
    told = json.loads(out)
    assert told["start"] == "derived-6"
    table = pl.read_csv(out_folder / "fall3.csv")
    assert table.columns == ["time", "torque", "angle", "angle_dot", "angle_measured"]
    assert len(table) == 200
    assert {s["experiment"] for s in told["simulations"]} == {"fall3", "noise2"}


def test_simulate_never_replaces_records_and_asks_before_replacing_other_files(
    model, folder, tmp_path, capsys
):
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    code, _, err = tustinnet(capsys, "simulate", model, folder, "--out", folder, "--overwrite")
    assert code == 1
    assert "what the command reads" in err
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    command = ("simulate", model, folder, "--out", tmp_path / "sim", "--experiment", "fall3")
    assert tustinnet(capsys, *command)[0] == 0
    code, _, err = tustinnet(capsys, *command)
    assert code == 1
    assert "add --overwrite" in err
    assert tustinnet(capsys, *command, "--overwrite")[0] == 0


def test_fit_does_not_write_among_the_records(folder, small_recipe, capsys):
    code, _, err = tustinnet(capsys, "fit", folder, "--recipe", small_recipe, "--out", folder)
    assert code == 1
    assert "the folder of the data" in err
    assert not list(folder.glob("seed-*"))


@pytest.mark.thorough
def test_fit_says_what_looks_wrong_in_the_records(folder, tiny_recipe, tmp_path, capsys):
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace("4096", "3000"))
    code, _, err = tustinnet(
        capsys, "fit", folder, "--recipe", tiny_recipe, "--out", tmp_path / "r", "--quiet"
    )
    assert code == 0
    assert "warning: angle: encoder count 0.001534 rad found (0.0020944 rad declared" in err


def spoil(folder: Path, *, still: bool = False) -> None:
    """Makes a sample of a record jump, or lets the torque of every record be a still angle, too."""
    if not still:
        lines = (folder / "fall2.csv").read_text().splitlines()
        cells = lines[101].split(",")
        lines[101] = ",".join([cells[0], str(float(cells[1]) + 100), *cells[2:]])
        (folder / "fall2.csv").write_text("\n".join(lines) + "\n")
        return
    for path in folder.glob("*.csv"):
        head, *rows = path.read_text().splitlines()
        path.write_text("\n".join([f"{head},other", *(f"{row},0.3" for row in rows)]) + "\n")
    card = folder / "dataset.toml"
    other = '[[coordinates]]\nname = "other"\nkind = "linear"\ncolumn = "other"\n[[inputs]]'
    card.write_text(card.read_text().replace("[[inputs]]", other))


def test_strict_refuses_records_in_which_something_looks_wrong(folder, capsys):
    assert tustinnet(capsys, "inspect", folder, "--strict")[0] == 0
    spoil(folder)
    told = (
        "record 'fall2': angle jumps at sample 100, 101: bad rows, lost counts, runs in a row? "
        "(2 jumps of up to 1.7515 rad, "
    )
    told += "1142 counts)"
    code, out, err = tustinnet(capsys, "inspect", folder, "--strict")
    assert code == 1
    assert "warning: angle jumps" in out  # the page of findings says how to mend them
    assert f"error: {told}; expected records without severe findings and warnings" in err
    assert tustinnet(capsys, "inspect", folder)[0] == 0


@pytest.mark.thorough
def test_fit_leaves_out_records_that_cannot_be_used(folder, tiny_recipe, tmp_path, capsys):
    text = (folder / "fall1.csv").read_text().splitlines()
    rows = [",".join([row.split(",")[0], "nan", "nan"]) for row in text[1:]]
    (folder / "fall9.csv").write_text("\n".join([text[0], *rows]) + "\n")
    noise = (folder / "noise2.csv").read_text().splitlines()
    (folder / "noise2.csv").write_text("\n".join(noise[:5]) + "\n")
    card = folder / "dataset.toml"
    assert '"fall1.csv"' in card.read_text()
    card.write_text(card.read_text().replace('"fall1.csv"', '"fall[19].csv"'))
    fit = ("fit", folder, "--recipe", tiny_recipe, "--set", "stages.*.epochs=1", "--quiet")
    code, _, err = tustinnet(capsys, *fit, "--no-report", "--out", tmp_path / "run")
    assert code == 0
    assert err.count("fall9.csv") == 1
    assert f"left out: {folder / 'fall9.csv'}, row 2, angle: nan" in err
    assert "left out: noise2: 4 samples; expected at least 6" in err
    code, _, err = tustinnet(capsys, "inspect", folder)
    assert code == 1
    assert f"error: {folder / 'fall9.csv'}, row 2, angle: nan" in err


def test_verbs_leave_out_what_a_fit_leaves_out(folder, model, tmp_path, capsys):
    (folder / "fall9.csv").write_text("time,angle,torque\n0,nan,0\n0.02,nan,1\n")
    noise = (folder / "noise2.csv").read_text().splitlines()
    (folder / "noise9.csv").write_text("\n".join(noise[:5]) + "\n")
    card = folder / "dataset.toml"
    card.write_text(
        card.read_text()
        .replace('"fall3.csv"', '"fall[39].csv"')
        .replace('"noise2.csv"', '"noise[29].csv"')
    )
    for verb in (
        ("evaluate", model, folder, "--start", "derived-6"),
        ("evaluate", model, model, folder, "--start", "derived-6"),
        ("simulate", model, folder, "--out", tmp_path / "runs"),
        ("report", model, folder, "--out", tmp_path / "report.html"),
    ):
        code, _, err = tustinnet(capsys, *verb)
        assert code == 0, err
        assert err.count("left out: ") == 2
        assert f"left out: {folder / 'fall9.csv'}, row 2, angle: nan" in err
        assert "left out: noise9: 4 samples; expected at least 6" in err
    runs = ("simulate", model, folder, "--out", tmp_path / "named", "--experiment")
    assert "fall9.csv, row 2, angle: nan" in tustinnet(capsys, *runs, "fall9")[2]
    code, _, err = tustinnet(capsys, *runs, "noise9", "--start", "derived-6")
    assert code == 1
    assert "error: noise9: 4 samples" in err


@pytest.mark.parametrize(
    ("hold", "advice"),
    [
        (None, "no hold declared: `fit` and `cross-validate` determine it"),
        ("unknown", 'hold = "unknown": `fit` and `cross-validate` determine it'),
        ("first-order", 'hold = "first-order" as declared; without this key `fit`'),
    ],
)
def test_inspect_says_how_the_hold_of_an_input_is_found(folder, hold, advice, capsys):
    text = "".join(
        line
        for line in (folder / "dataset.toml").read_text().splitlines(keepends=True)
        if not line.startswith("hold")
    )
    key = "" if hold is None else f'hold = "{hold}"\n'
    (folder / "dataset.toml").write_text(text.replace("[[inputs]]\n", f"[[inputs]]\n{key}"))
    rows = np.loadtxt(folder / "noise1.csv", delimiter=",", skiprows=1)
    rows[:, 2] *= (-1) ** np.arange(len(rows))
    np.savetxt(folder / "noise1.csv", rows, delimiter=",", header="time,angle,torque", comments="")
    code, out, err = tustinnet(capsys, "inspect", folder)
    assert code == 0, err
    assert f"its course between samples decides the simulation ({advice}" in out


def test_a_remark_names_all_records_of_a_few_and_the_first_ones_of_many(pendulum):
    e = pendulum["fall1"]
    channels = replace(e.channels, coordinates=(tn.Coordinate("angle", "angular", 0.002),))
    spoilt = [replace(e, name=f"run{k}", channels=channels) for k in range(9)]
    for count, total, names in (
        (6, 9, "[run0, run1, run2, run3, run4, run5]"),
        (9, 9, "[all 9 records]"),
        (9, 10, "[run0, run1, run2 and 6 others]"),
    ):
        found = [f for f in check(spoilt[:count]) if f.code == "encoder count"]
        line, advice = warning_lines(found, total, "my logs", Path("a.toml"))
        assert line.startswith("warning: angle: encoder count 0.001534 rad found (0.002 rad ")
        assert line.endswith(f" times)  {names}")
        assert advice == "note: how to mend them: tustinnet inspect 'my logs' --card a.toml"


@pytest.mark.thorough
def test_fit_and_cross_validate_say_first_what_looks_wrong_and_what_never_moves(
    folder, tiny_recipe, tmp_path, capsys
):
    spoil(folder)
    spoil(folder, still=True)
    with_recipe = (folder, "--recipe", tiny_recipe, "--set", "stages.*.epochs=1", "--quiet")
    for verb in (
        ("fit", *with_recipe, "--no-report"),
        ("cross-validate", *with_recipe, "--folds", 3),
    ):
        code, _, err = tustinnet(capsys, *verb, "--out", tmp_path / verb[0])
        assert code == 0
        assert "warning: angle jumps at sample 100, 101" in err
        assert "warning: other never changes" in err
        assert "other never moves in the training records: nothing can be learnt of it" in err


def test_evaluate_prints_the_scores_with_their_start(model, folder, capsys):
    code, out, _ = tustinnet(capsys, "evaluate", model, folder, "--split", "validation")
    assert code == 0
    assert "start 'derived-6'" in out
    assert "fit [%]" in out
    assert "mean" in out


def test_evaluate_as_json_with_steps_ahead_and_figures(model, folder, tmp_path, capsys):
    code, out, _ = tustinnet(
        capsys,
        "evaluate",
        model,
        folder,
        "--split",
        "all",
        "--json",
        "--ahead",
        20,
        "--figures",
        tmp_path / "f",
    )
    assert code == 0
    told = json.loads(out)
    assert len(told["experiments"]) == 5
    assert len(told["ahead"]["rmse"]) == 20
    assert set(told["means"]) == {"train", "validation"}
    assert told["ahead"]["rmse"][0] < told["ahead"]["rmse"][-1]
    assert (tmp_path / "f" / "ahead.png").is_file()


def test_show_prints_the_header(model, capsys):
    code, out, _ = tustinnet(capsys, "show", model)
    assert code == 0
    for word in ("angle (angular)", "torque [N m, zero-order]", "small, seed", "derived-6", "kept"):
        assert word in out
    assert json.loads(tustinnet(capsys, "show", model, "--json")[1])["kind"] == "tustin-net"


def test_an_option_of_one_value_that_is_given_twice_is_refused(tmp_path, capsys):
    out = tmp_path / "x"
    code, _, err = tustinnet(
        capsys, "fit", "qube", "--budget", "9s", "--out", out, "--budget", "60s"
    )
    assert code != 0
    assert err == "error: --budget: given twice; expected one value\n"
    assert not out.exists()
