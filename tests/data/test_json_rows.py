"""JSON files and JSON lines: the layouts of loggers, rows of several topics, damaged files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import tustinnet as tn
from tustinnet.data.columns import Columns
from tustinnet.data.formats import json_rows
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError

T = [0.0, 0.01, 0.02, 0.03]
ANGLE = [0.1, 0.3, 0.2, -0.4]
ROWS: list[dict[str, Any]] = [{"t": t, "angle": a} for t, a in zip(T, ANGLE, strict=True)]
FRAME = {"t": dict(enumerate(T)), "angle": dict(enumerate(ANGLE))}


def read(path: Path, content: Any) -> Columns:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read_columns(path)


@pytest.mark.parametrize(
    "content",
    [
        ROWS,
        {"t": T, "angle": ANGLE},
        {"mass": 0.9, "motor": "XL430", "entries": ROWS},
        {"log": {"samples": {"rows": ROWS}}},
        {"columns": ["t", "angle"], "index": [0, 1, 2, 3], "data": [[*r.values()] for r in ROWS]},
        FRAME,
        dict(enumerate(ROWS)),
        [["t", "angle"], *([*r.values()] for r in ROWS)],
        "\n".join(map(json.dumps, ROWS)),
        "﻿" + json.dumps(ROWS),
    ],
    ids=[
        "rows",
        "columns",
        "under a key",
        "deep",
        "pandas split",
        "pandas columns",
        "pandas index",
        "names above",
        "lines",
        "byte order mark",
    ],
)
def test_the_columns_of_each_layout(tmp_path: Path, content: Any) -> None:
    columns = read(tmp_path / "log.json", content)
    assert columns.names == ("t", "angle")
    np.testing.assert_array_equal(columns["t"], T)
    np.testing.assert_array_equal(columns["angle"], ANGLE)


@pytest.mark.parametrize("ending", [".jsonl", ".ndjson"])
def test_a_line_that_is_cut_off_at_the_end_is_left_out(tmp_path: Path, ending: str) -> None:
    lines = "\n".join(map(json.dumps, ROWS))
    columns = read(tmp_path / f"log{ending}", lines[:-4])
    np.testing.assert_array_equal(columns["angle"], ANGLE[:-1])
    assert columns.notes == ("the last line is cut off, and left out",)


def test_what_is_beside_the_rows_is_named(tmp_path: Path) -> None:
    columns = read(tmp_path / "log.json", {"mass": 0.9, "motor": "XL430", "entries": ROWS})
    assert columns.others == {"mass": "0.9", "motor": "'XL430'"}


def test_lists_and_objects_in_rows_are_columns(tmp_path: Path) -> None:
    rows = [
        {"motor": {"q": [a, -a], "on": True}, "state": "run", "at": f"12:00:0{k}.5"}
        for k, a in enumerate(ANGLE)
    ]
    columns = read(tmp_path / "log.json", rows)
    assert columns.names == ("motor/q[1]", "motor/q[2]", "motor/on", "at")
    np.testing.assert_array_equal(columns["motor/q[2]"], np.negative(ANGLE))
    np.testing.assert_array_equal(columns["motor/on"], 1.0)
    np.testing.assert_allclose(np.diff(columns["at"]), 1.0)
    assert columns.others == {"state": "text"}
    assert columns.notes == ("'at': dates or times of day, read as seconds since midnight",)


@pytest.mark.parametrize(
    "content",
    [{"slow": ROWS, "fast": ROWS}, {k: {"t": T, "angle": ANGLE} for k in ("slow", "fast")}],
    ids=["rows", "columns"],
)
def test_tables_of_the_same_columns_are_records(tmp_path: Path, content: Any) -> None:
    columns = read(tmp_path / "log.json", content)
    assert list(columns.parts) == ["slow", "fast"]
    np.testing.assert_array_equal(columns.part("fast")["angle"], ANGLE)


def test_motors_that_share_their_times_are_of_one_record(tmp_path: Path) -> None:
    motors = {number: {"id": int(number), "angle": ANGLE} for number in ("31", "44")}
    columns = read(tmp_path / "log.json", {"t": T, "motors": motors})
    assert not columns.parts
    assert columns.names == ("t", "motors/31/angle", "motors/44/angle")


def as_lines(frame: pl.DataFrame) -> str:
    rows = ({k: v for k, v in row.items() if v is not None} for row in frame.iter_rows(named=True))
    return "\n".join(map(json.dumps, rows))


@pytest.mark.parametrize(
    ("ending", "write"),
    [
        (".jsonl", as_lines),
        (".csv", lambda frame: frame.write_csv()),
        (".csv", lambda frame: frame.write_csv(null_value="nan")),
    ],
    ids=["json lines", "empty cells", "nan"],
)
@pytest.mark.parametrize("unit", ["s", "ms"])
def test_topics_of_different_rates_have_times_of_their_own(
    tmp_path: Path, ending: str, write: Callable[[pl.DataFrame], str], unit: str
) -> None:
    factor = {"s": 1.0, "ms": 1e3}[unit]
    t, late = np.arange(200) * 0.01, np.arange(99) * 0.02 + 0.003
    angles = {"stamp": np.round(t * factor, 6), "angle": np.sin(3 * t), "speed": 3 * np.cos(3 * t)}
    volts = {"stamp": np.round(late * factor, 6), "volts": np.sign(np.sin(5 * late))}
    frame = pl.concat([pl.DataFrame(angles), pl.DataFrame(volts)], how="diagonal").sort("stamp")
    log = tmp_path / f"log{ending}"
    log.write_text(write(frame))
    columns = read_columns(log)
    assert columns.clocks == {
        "stamp": "stamp",
        "angle/stamp": "angle/stamp",
        "angle": "angle/stamp",
        "speed": "angle/stamp",
        "volts/stamp": "volts/stamp",
        "volts": "volts/stamp",
    }
    np.testing.assert_allclose(columns["volts/stamp"], late * factor)
    (tmp_path / "dataset.toml").write_text(tn.draft(tmp_path).text)
    (record,) = tn.load(tmp_path)
    assert record.dt == pytest.approx(0.01)
    np.testing.assert_allclose(record.q[:, 0], np.sin(3 * t[1 : 1 + len(record)]), atol=1e-6)
    assert any("(50 Hz) onto angle/stamp" in note for note in record.notes)


def test_a_table_with_a_few_empty_cells_is_none_of_topics(tmp_path: Path) -> None:
    rows = "".join(f"{0.01 * k:.2f},{'' if k == 7 else k * k}\n" for k in range(50))
    (tmp_path / "log.csv").write_text("t,x\n" + rows)
    columns = read_columns(tmp_path / "log.csv")
    assert not columns.clocks
    with pytest.raises(InputError, match="row 9, x: an empty cell"):
        columns["x"]


def test_a_counter_of_rows_is_no_time_of_topics(tmp_path: Path) -> None:
    rows = "".join(
        f"{k},{0.01 * k:.2f},{k * k if k % 2 else ''},{'' if k % 2 else k}\n" for k in range(50)
    )
    (tmp_path / "log.csv").write_text("index,t,x,u\n" + rows)
    assert read_columns(tmp_path / "log.csv").clocks["x"] == "x/t"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1, 2", "cannot be read as .json"),
        ("{}", "holds no samples"),
        ('{"a": 1}', "holds no samples, only 'a': 1"),
        ("[" * 100_000 + "]" * 100_000, "cannot be read as .json"),
        ('["a", "b"]', "holds no samples"),
        ('[{"t": 1}, {"t": "x"}]', "holds no samples, only 't': no numbers"),
        ('{"a": 1}\n{"a": 2}\n{"a" 3}\n{"a": 4}', "cannot be read as .json"),
    ],
)
def test_what_holds_no_samples_is_one_message(tmp_path: Path, content: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path / "log.json", content)


def test_a_file_that_is_too_large_says_what_to_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(json_rows, "_LARGEST", 100)
    (tmp_path / "log.json").write_text(json.dumps(ROWS * 10))
    with pytest.raises(InputError, match=r"0 MiB of JSON.*CSV or Parquet"):
        json_rows.READER.contents(tmp_path / "log.json")


def test_the_json_of_other_programs_beside_logs_is_left_out_with_a_line(tmp_path: Path) -> None:
    t = np.arange(300) * 0.01
    for k in range(2):
        frame = pl.DataFrame({"t": t, "angle": np.sin(3 * t + k), "volts": np.cos(2 * t)})
        frame.write_csv(tmp_path / f"run{k}.csv")
    (tmp_path / "settings.json").write_text('{"rig": "arm", "gains": [1.0, 2.0, 3.0]}')
    draft = tn.draft(tmp_path)
    assert "settings.json" not in draft.text
    assert any("settings.json" in note for note in draft.notes)
    # nor is it a record of a card that names no files
    card, _, _ = draft.text.partition("[splits]")
    (tmp_path / "dataset.toml").write_text(card)
    assert [e.name for e in tn.load(tmp_path)] == ["run0", "run1"]


def test_objects_of_a_list_whose_fields_are_long_lists_are_records(tmp_path: Path) -> None:
    runs = [
        {"angle": [k + 0.1 * i for i in range(50)], "u": [float(i % 7) for i in range(50)]}
        for k in range(3)
    ]
    (tmp_path / "log.json").write_text(json.dumps({"rate": 50, "data": runs}))
    columns = read_columns(tmp_path / "log.json")
    assert len(columns.parts) == 3
    label = [*columns.parts][1]
    np.testing.assert_allclose(columns.part(label)["angle"], 1 + 0.1 * np.arange(50))
    alone = read(tmp_path / "one.json", {"rate": 50, "data": runs[:1]})
    np.testing.assert_allclose(alone["angle"], 0.1 * np.arange(50))


def test_matrices_of_several_lengths_are_records(tmp_path: Path) -> None:
    rows = [[t, a, -a] for t, a in zip(T, ANGLE, strict=True)]
    columns = read(tmp_path / "tests.json", {"units": "rev", "slow": rows, "fast": rows[:3]})
    assert [*columns.parts] == ["slow", "fast"]
    assert columns.part("fast").names == ("[1]", "[2]", "[3]")
    np.testing.assert_array_equal(columns.part("fast")["[2]"], ANGLE[:3])
    same = read(tmp_path / "joints.json", {"q": rows, "v": rows})  # of one record
    assert not same.parts
