"""Records that are spread over several files."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.check.check import check
from tustinnet.data.catalog import list_input_files, locate
from tustinnet.data.drafting.draft import draft_card

DT = 0.005
T = DT * np.arange(1200)
ANGLE = 40 * np.sin(2 * T) + 15 * np.sin(5 * T)
VOLTS = np.repeat(np.random.default_rng(0).uniform(-3, 3, 24), 50)
CARD = """
name = "arm"
dt = 0.005
[time]
column = "t_ms"
unit = "ms"
[join.motor]
{join}
[[coordinates]]
name = "arm"
kind = "angular"
column = "angle"
unit = "deg"
[[inputs]]
name = "motor"
column = "motor/volts"
unit = "V"
[splits]
train = [{{ file = "enc.csv", join = {{ motor = "{file}" }} }}]
"""


def write(path: Path, header: str, *columns: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=header, comments="")


def folder_with(folder: Path, join: str, file: str = "mot.csv") -> Path:
    write(folder / "enc.csv", "t_ms,angle", 1e3 * T, ANGLE)
    (folder / "dataset.toml").write_text(CARD.format(join=join, file=file))
    return folder


@pytest.mark.parametrize(
    ("join", "shift", "factor"),
    [
        ('column = "s"', 0.0, 1.0),
        ('column = "s"\nunit = "us"', 0.0, 1e6),
        ('column = "s"\nunit = "us"\nstarts_together = true', 1.7e9, 1e6),
    ],
)
def test_an_input_of_another_file_is_held_at_the_times_of_the_positions(
    join: str, shift: float, factor: float, tmp_path: Path
) -> None:
    folder_with(tmp_path, join)
    np.savetxt(
        tmp_path / "mot.csv",
        np.column_stack([(T[::50] + shift) * factor, VOLTS[::50]]),
        "%.17g",
        ",",
        header="s,volts",
        comments="",
    )
    (record,) = tn.load(tmp_path)
    np.testing.assert_allclose(record.u[:, 0], VOLTS, rtol=1e-8)
    np.testing.assert_allclose(record.q[:, 0], np.radians(ANGLE), atol=1e-6)
    np.testing.assert_allclose(record.t, T, atol=1e-6)
    assert (record.name, record.source) == ("enc", "enc.csv")
    assert tmp_path / "mot.csv" in list_input_files(tmp_path)


def test_files_without_times_are_joined_row_by_row(tmp_path: Path) -> None:
    folder_with(tmp_path, "")
    write(tmp_path / "mot.csv", "volts,x", VOLTS, VOLTS)
    (record,) = tn.load(tmp_path)
    np.testing.assert_allclose(record.u[:, 0], VOLTS, rtol=1e-8)
    write(tmp_path / "mot.csv", "volts,x", VOLTS[1:], VOLTS[1:])
    with pytest.raises(tn.InputError, match=r"'motor/volts'.* have lengths"):
        tn.load(tmp_path)


ERRORS = {
    "no such column": ('column = "seconds"', "mot.csv", "motor: no column 'seconds' of times"),
    "no such file": ('column = "s"', "gone.csv", "gone.csv: no such file"),
    "no time in common": ('column = "s"\nunit = "s"', "mot.csv", "no time in common"),
    "outside": ('column = "s"', "../mot.csv", r"join: .*without '\.\.'"),
    "an unknown label": ('column = "s"\n[join.other]', "mot.csv", "no file of .* joins 'other'"),
    "a unit of nothing": ('unit = "ms"', "mot.csv", "without `column`"),
}


@pytest.mark.parametrize("case", ERRORS)
def test_errors_of_joined_files_name_the_place(case: str, tmp_path: Path) -> None:
    join, file, message = ERRORS[case]
    folder_with(tmp_path, join, file)
    write(tmp_path / "mot.csv", "s,volts", T + 100.0, VOLTS)
    with pytest.raises(tn.InputError, match=message):
        tn.load(tmp_path)


# --- drafts ---

PAIRS = {
    "names": ("enc_{}.csv", "volt_{}.csv", 0.0, "volt"),
    "a command": ("log{}_pos.csv", "log{}_cmd.csv", 0.0, "cmd"),
    "folders": ("run{}/encoder.csv", "run{}/drive.csv", 0.0, "drive"),
    "two clocks": ("{}_position.txt", "{}_motor.txt", 1.7e9, "motor"),
    "dates": ("enc_120{}05.csv", "psu_120{}07.csv", 0.0, "psu"),
}


@pytest.mark.parametrize("case", PAIRS)
def test_a_draft_joins_the_files_of_a_record(case: str, tmp_path: Path) -> None:
    first, second, shift, label = PAIRS[case]
    begin = 1.7e9 if case == "dates" else 0.0
    for k in range(1, 4):
        t = begin + 100 * k + T
        (tmp_path / first.format(k)).parent.mkdir(exist_ok=True)
        for path, header, columns in (
            (first, "t_s,angle_deg", [t, ANGLE * k]),
            (second, "time_s,U_V", [t[::50] + shift, np.roll(VOLTS[::50], k)]),
        ):
            np.savetxt(
                tmp_path / path.format(k),
                np.column_stack(columns),
                "%.15g",
                ",",
                header=header,
                comments="",
            )
    files = sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.*"))
    draft = draft_card(tmp_path, files)
    (tmp_path / "dataset.toml").write_text(draft.text)
    card = tomllib.loads(draft.text)
    assert [i["column"] for i in card["inputs"]] == [f"{label}/U_V"]
    join = card["join"][label]
    assert (join["column"], join["unit"]) == ("time_s", "s")
    assert join.get("starts_together", False) is bool(shift)
    assert any("3 records of two files, joined" in note for note in draft.notes)
    data = tn.load(tmp_path)
    assert len(data) == 3
    for k, record in enumerate(sorted(data, key=lambda e: np.ptp(e.q)), 1):
        np.testing.assert_allclose(
            record.u[:, 0], np.repeat(np.roll(VOLTS[::50], k), 50)[: len(record)]
        )
    _, located = locate(tmp_path)
    found = [f.what for f in check(data, located) if f.code.startswith("assumed")]
    assert [f for f in found if "begin together" in f] == found[: int(bool(shift))]


def test_a_draft_says_why_files_are_not_joined(tmp_path: Path) -> None:
    for k in range(1, 4):
        write(tmp_path / f"enc_{k}.csv", "t,angle_deg", 1.7e9 + T, ANGLE)
        write(tmp_path / f"mot_{k}.csv", "t,u_V", T[:300], VOLTS[:300])
    files = [f"{kind}_{k}.csv" for kind in ("enc", "mot") for k in (1, 2, 3)]
    draft = draft_card(tmp_path, files)
    assert any("times have nothing in common" in note for note in draft.notes)
    assert "join" not in draft.text


def test_files_with_all_columns_are_records_whatever_their_names(tmp_path: Path) -> None:
    for kind in ("sine", "step"):
        for k in (1, 2):
            write(tmp_path / f"{kind}_{k}.csv", "t,angle_deg,u_V", T, ANGLE + k, VOLTS)
    write(tmp_path / "calibration.csv", "t,force_N", T, VOLTS)
    files = sorted(p.name for p in tmp_path.iterdir())
    draft = draft_card(tmp_path, files)
    assert "join" not in draft.text
    assert len(draft.splits.records) >= 4
    assert any("calibration.csv" in note for note in draft.notes)


def test_files_of_which_nothing_is_used_are_not_joined(tmp_path: Path) -> None:
    for k in range(3):
        write(tmp_path / f"m{k}_enc.csv", "t,angle_deg", T, ANGLE)
        write(tmp_path / f"m{k}_volt.csv", "t,u_V", T, np.roll(VOLTS, 50 * k))
        noise = np.random.default_rng(k).normal(0, 0.1, len(T))
        current = np.roll(VOLTS, 50 * k) - 0.01 * np.gradient(ANGLE, T) + noise
        write(tmp_path / f"m{k}_amp.csv", "t,i_A", T, current)
    files = sorted(p.name for p in tmp_path.iterdir())
    card = tomllib.loads(draft_card(tmp_path, files).text)
    assert [i["column"] for i in card["inputs"]] == ["volt/u_V"]
    assert {*card["join"]} == {"volt"}
    assert {*card["splits"]["train"][0]["join"]} == {"volt"}
