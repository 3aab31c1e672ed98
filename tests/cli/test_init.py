"""`tustinnet init`, and `fit` of a folder without a card."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from lab_files import lerobot_data_set
from simulated.laboratories import plc, twins, wrapped_counter
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.cli import terminal
from tustinnet.cli.records import load_records_to_fit


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A folder of logs of a counter whose counts in a turn nothing says."""
    folder = tmp_path / "LOGS"
    folder.mkdir()
    wrapped_counter(folder)
    return folder


def test_init_writes_a_card_a_figure_and_what_inspect_says(logs, capsys):
    code, out, err = tustinnet(capsys, "init", logs, "--yes")
    assert code == 0, err
    assert "counts in a turn of the encoder 'cnt', which starts again at 65536: 4096" in err
    for text in ("coordinate [counts]", "it wraps at 65536", "k_bar", "run5"):
        assert text in out
    assert (logs / "init.png").read_bytes().startswith(b"\x89PNG")
    data = tn.load(logs)
    assert (len(data), set(data.splits)) == (5, {"train", "validation"})


def test_init_replaces_nothing_without_overwrite(logs, capsys):
    card = logs / "dataset.toml"
    card.write_text("mine")
    code, out, err = tustinnet(capsys, "init", logs, "--yes")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert "dataset.toml: there already" in err
    assert (card.read_text(), (logs / "init.png").exists()) == ("mine", False)
    assert tustinnet(capsys, "init", logs, "--yes", "--overwrite")[0] == 0
    assert tomllib.loads(card.read_text())["time"] == {"column": "t_ms", "unit": "ms"}


def test_init_takes_some_files_of_a_folder_and_prints_json(logs, capsys):
    code, out, _ = tustinnet(capsys, "init", logs / "run1.csv", logs / "run3.csv", "--json")
    report = json.loads(out)
    assert (code, [e.name for e in tn.load(logs)]) == (0, ["run1", "run3"])
    assert report["text"] == (logs / "dataset.toml").read_text()
    uses = {column["name"]: column["use"] for column in report["columns"]}
    assert uses == {"t_ms": "time", "cnt": "coordinate", "u_V": "input", "status": ""}


@pytest.fixture
def answers(monkeypatch) -> Iterator[list[str]]:
    """Answers that somebody types at a terminal, the first one first."""
    typed: list[str] = []
    monkeypatch.setattr(terminal, "can_ask", lambda: True)
    monkeypatch.setattr(terminal, "ask", lambda question, default: typed.pop(0))
    yield typed
    assert not typed


def test_init_asks_what_the_columns_do_not_say(logs, answers, capsys):
    answers += ["many", "-3", "2048"]
    code, _, err = tustinnet(capsys, "init", logs)
    assert (code, err.count("a number above 0")) == (0, 2)
    assert "assumed" not in err
    (coordinate,) = tomllib.loads((logs / "dataset.toml").read_text())["coordinates"]
    assert coordinate["counts_per_revolution"] == 2048


@pytest.mark.thorough
def test_init_without_a_terminal_assumes_and_says_so(logs, capsys):
    err = tustinnet(capsys, "init", logs)[2]
    assert "no terminal to ask at: as with --yes" in err
    assert "assumed: counts in a turn" in err


@pytest.mark.thorough
def test_a_fit_says_in_a_line_what_the_card_assumes(logs, tmp_path, capsys):
    tustinnet(capsys, "init", logs, "--yes")
    load_records_to_fit(str(logs), None, tmp_path / "RUN")
    lines = [line for line in capsys.readouterr().err.splitlines() if "assumed to be" in line]
    (line,) = lines
    assert "counts in a turn of cnt were assumed to be" in line
    assert line.endswith("4096: check the card, then delete `assumed` there")


REFUSED = {
    "nothing there": (lambda p: ["nowhere"], "no such file or folder"),
    "an empty folder": (lambda p: [p], "no logs"),
    "a folder and a file": (lambda p: [p, p / "a.csv"], "a folder beside other arguments"),
    "another ending": (lambda p: [p / "a.xyz"], "ending '.xyz'"),
    "text": (lambda p: [p / "a.csv"], "no column of numbers"),
    "only times": (lambda p: [p / "t.csv"], "no column besides the times"),
    "nothing moves": (lambda p: [p / "still.csv"], "no column could be a position"),
    "a sensor flickers": (lambda p: [p / "flicker.csv"], "three values at most)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_logs_without_a_position_are_refused(case, tmp_path, capsys):
    arguments, message = REFUSED[case]
    folder = tmp_path / "folder"
    folder.mkdir()
    if case != "an empty folder":
        (folder / "a.csv").write_text("a,b\nx,y\nz,w\n")
        (folder / "a.xyz").write_text("")
        times = 0.01 * np.arange(100)
        pl.DataFrame({"time": times}).write_csv(folder / "t.csv")
        pl.DataFrame({"time": times, "a": np.ones(100)}).write_csv(folder / "still.csv")
        angle = 0.1 * np.random.default_rng(0).integers(0, 3, 100)
        pl.DataFrame({"time": times, "angle": angle}).write_csv(folder / "flicker.csv")
    before = sorted(folder.iterdir())
    code, out, err = tustinnet(capsys, "init", *arguments(folder))
    assert (code, out) == (1, "")
    assert message in err
    assert "error: " in err
    assert sorted(folder.iterdir()) == before


def test_records_that_cannot_be_used_are_left_out(logs, capsys):
    frame = pl.read_csv(logs / "run2.csv")
    frame.with_columns(cnt=pl.lit(7)).write_csv(logs / "run6.csv")
    frame.rename({"cnt": "zaehler"}).write_csv(logs / "other.csv")
    (logs / "diary.txt").write_text("dear diary")
    code, _, err = tustinnet(capsys, "init", logs, "--yes")
    assert code == 0, err
    for message in ("run6.csv: nothing moves", "other.csv: other columns", "diary.txt"):
        assert f"left out: {message}" in err or f"left out: {logs / message}" in err
    assert len(tn.load(logs)) == 5


def test_a_folder_without_a_card_names_init(logs, capsys):
    for verb in (["inspect", logs], ["cross-validate", logs, "--recipe", "linear", "--out", "x"]):
        err = tustinnet(capsys, *verb)[2]
        assert f"`tustinnet init {logs}` writes one" in err


@pytest.mark.thorough
def test_fit_drafts_a_card_into_its_own_folder(tmp_path, capsys):
    folder, out = tmp_path / "LOGS", tmp_path / "RUN"
    folder.mkdir()
    plc(folder)
    before = sorted(folder.iterdir())
    words = ("fit", folder, "--recipe", "linear", "--out", out, "--quiet", "--no-report")
    code, printed, err = tustinnet(capsys, *words)
    assert code == 0, err
    card = out / "dataset.toml"
    assert f"no card in {folder}: drafted {card}" in err
    assert f"{folder} --card {card}" in printed
    assert sorted(folder.iterdir()) == before
    assert (out / "init.png").is_file()
    assert tn.load(folder, card).splits == ("train", "validation")
    # what an earlier run left is replaced only with --overwrite
    card.write_text(card.read_text() + "# mine\n")
    assert "dataset.toml: there already" in tustinnet(capsys, *words)[2]
    assert card.read_text().endswith("# mine\n")
    (out / "log.jsonl").touch()  # as an identification leaves it
    assert "dataset.toml: there already" in tustinnet(capsys, *words)[2]


@pytest.mark.thorough
def test_links_that_leave_the_folder_are_read_only_if_that_is_said(
    logs, tmp_path, capsys, monkeypatch
):
    links, out = tmp_path / "LINKS", tmp_path / "RUN"
    links.mkdir()
    for file in logs.iterdir():
        (links / file.name).symlink_to(file)
    for words in (["init", links, "--yes"], ["fit", links, "--out", out]):
        code, printed, err = tustinnet(capsys, *words)
        assert (code, printed, err.count("\n")) == (1, "", 1)
        assert "a link that leaves the folder" in err
        assert "set TUSTINNET_FOLLOW_LINKS=1" in err
    monkeypatch.setenv("TUSTINNET_FOLLOW_LINKS", "1")
    code, _, err = tustinnet(capsys, "init", links, "--yes")
    assert code == 0, err
    assert len(tn.load(links)) == 5


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_lerobot_data_set_is_given_by_its_folder(version, tmp_path, capsys):
    folder = tmp_path / "so101"
    lerobot_data_set(folder, version)
    pl.DataFrame({"task_index": [0]}).write_parquet(folder / "meta/tasks.parquet")
    code, out, err = tustinnet(capsys, "init", folder, "--yes")
    assert code == 0, err
    assert "note: a LeRobot data set, 50 frames a second" in out
    assert "observation.state.shoulder.pos  coordinate" in out
    assert len(tn.load(folder)) == 3


@pytest.mark.thorough
def test_logs_of_deeper_folders_are_taken(logs, tmp_path, capsys):
    (tmp_path / "2026/march").mkdir(parents=True)
    for file in list(logs.iterdir()):
        file.rename(tmp_path / "2026/march" / file.name)
    assert tustinnet(capsys, "init", tmp_path / "2026", "--yes")[0] == 0
    card = tomllib.loads((tmp_path / "2026/dataset.toml").read_text())
    assert "march/run1.csv" in card["splits"]["train"]


def test_init_marks_what_it_assumed_in_the_card_and_on_the_terminal(tmp_path: Path, capsys) -> None:
    twins(tmp_path)
    code, _, err = tustinnet(capsys, "init", tmp_path, "--yes")
    assert code == 0, err
    assert "assumed: what is '" in err
    assert "points less)?: " in err
    assert "# check" in (tmp_path / "dataset.toml").read_text()


def test_no_input_and_what_is_dropped_are_told_in_a_line(tmp_path: Path, capsys) -> None:
    t = 0.01 * np.arange(900)
    for k, rows in enumerate((900, 900, 12)):
        table = np.column_stack([t, np.sin((2 + k) * t)])[:rows]
        np.savetxt(tmp_path / f"r{k}.csv", table, "%.6g", ",", header="t,angle_rad", comments="")
    code, _, err = tustinnet(capsys, "init", tmp_path, "--yes")
    assert code == 0, err
    assert "note: no input was found" in err
    assert "left out: r2.csv: fewer than 20 samples in a record (12)" in err


def test_a_folder_of_nothing_but_pictures_has_no_logs(tmp_path: Path, capsys) -> None:
    for name in ("a.png", "b.jpg"):
        (tmp_path / name).write_bytes(b"\x89PNG\r\n")
    fit = ("fit", tmp_path, "--out", tmp_path / "run")
    for command in (("init", tmp_path, "--yes"), fit, (*fit, "--system", "qube-servo2")):
        code, out, err = tustinnet(capsys, *command)
        assert (code, out, err.count("\n")) == (1, "", 1)
        assert "no logs" in err


def test_a_remark_on_a_file_is_on_the_terminal_once(tmp_path, capsys):
    t = 0.01 * np.arange(300)
    rows = "\n".join(f"{a:.2f}\t{np.sin(5 * a):.6f}\t" for a in t)
    (tmp_path / "a.txt").write_text(f"{rows}\n")
    code, out, err = tustinnet(capsys, "init", tmp_path, "--yes")
    assert code == 0, err
    assert f"{out}{err}".count("separated by tabs") == 1
    card = (tmp_path / "dataset.toml").read_text()
    assert "empty in every row" in card
    assert "header = true" not in card
