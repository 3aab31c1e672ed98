"""From files and data frames to records, as a card says."""

import hashlib
import os
from pathlib import Path
from typing import Any

import jaxtyping
import numpy as np
import pandas as pd
import polars as pl
import pytest
import scipy.io

import tustinnet as tn
from tustinnet.data.card import Card
from tustinnet.data.declaration import declare
from tustinnet.data.loading import load_folder

DT = 0.01
ANGLE = {"name": "angle", "kind": "angular", "column": "angle"}
TORQUE = {"name": "torque", "column": "torque", "unit": "N m"}


def card(**changes: Any) -> Card:
    content = {"name": "toy", "dt": DT, "coordinates": [ANGLE], "inputs": [TORQUE]}
    return declare({**content, **changes}, Card, "card")


def write(path: Path, samples: int = 40, **columns: np.ndarray) -> Path:
    """Writes a log of a swing; given columns replace or join the usual ones."""
    t = columns.get("time", np.arange(samples) * DT)
    usual = {"time": t, "angle": np.sin(3 * t), "torque": np.cos(t)}
    path.parent.mkdir(exist_ok=True)
    pl.DataFrame({**usual, **columns}).write_csv(path)
    return path


def one(path: Path, **changes: Any) -> tn.Experiment:
    """The only record of a file, read with a card."""
    (experiment,) = load_folder(path.parent, card(splits={"train": [path.name]}, **changes))
    return experiment


def timed(**keys: Any) -> dict[str, Any]:
    return {"time": {"column": "time", **keys}}


# --- sampling periods ---


@pytest.mark.parametrize("irregular", ["keep", "resample"])
def test_records_of_a_clock_with_much_jitter_have_one_period(tmp_path, irregular) -> None:
    generator = np.random.default_rng(0)
    for k in range(4):
        write(tmp_path / f"log{k}.csv", time=DT * (np.arange(90) + generator.uniform(0, 0.3, 90)))
    data = load_folder(tmp_path, card(dt=None, **timed(irregular=irregular)))
    medians = [np.median(np.diff(e.t)) for e in data] if irregular == "keep" else [DT]
    assert data.channels.dt == pytest.approx(np.median(medians), rel=0.02)
    assert {e.dt for e in data} == {data.channels.dt}
    if irregular == "resample":
        assert all(np.allclose(np.diff(e.t), e.dt) for e in data)


def test_records_of_two_periods_are_refused_with_what_to_write(tmp_path) -> None:
    for k, factor in enumerate((1, 1, 2)):
        write(tmp_path / f"log{k}.csv", time=factor * DT * np.arange(40))
    with pytest.raises(tn.InputError, match=r"'log2': samples 0\.02 s apart.*add `dt = 0\.01`"):
        load_folder(tmp_path, card(dt=None, **timed()))


@pytest.mark.parametrize(
    ("clock", "scale", "remedy"),
    [
        (
            "time",
            1,
            r"samples 0\.01 s apart: add `dt = 0\.01`, or \[time\] with "
            r'`column = "time"`$',
        ),
        ("t_ms", 1e3, r'`dt = 0\.01`, or \[time\] with `column = "t_ms"` and `unit = "ms"`$'),
    ],
)
def test_a_card_without_a_period_is_refused_with_the_line_to_add(
    tmp_path, clock, scale, remedy
) -> None:
    t = scale * DT * np.arange(40)
    path = write(tmp_path / "log.csv")
    pl.DataFrame({clock: t, "angle": np.sin(t / scale), "torque": np.cos(t / scale)}).write_csv(
        path
    )
    with pytest.raises(tn.InputError, match=f"no sampling period in the card.*{remedy}"):
        load_folder(tmp_path, card(dt=None))


def test_a_card_without_a_period_of_files_without_times_says_what_is_missing(tmp_path) -> None:
    q = np.random.default_rng(0).normal(size=40)
    write(tmp_path / "log.csv")
    pl.DataFrame({"angle": q, "torque": -q}).write_csv(tmp_path / "log.csv")
    with pytest.raises(tn.InputError, match=r"add `dt = \.\.\.` \(in seconds\)"):
        load_folder(tmp_path, card(dt=None))


@pytest.mark.parametrize(
    "name", ["README.txt", "readme_first.txt", "LICENSE.txt", "Notes.txt", "read.md", "build.log"]
)
def test_texts_for_people_beside_a_card_are_no_logs(tmp_path, name) -> None:
    write(tmp_path / "notes2.csv")
    write(tmp_path / "log.csv")
    (tmp_path / name).write_text("Measured on Monday.\n")
    assert [e.name for e in load_folder(tmp_path, card())] == ["log", "notes2"]


def test_logs_that_end_in_log_are_read_where_nothing_else_is(tmp_path: Path) -> None:
    write(tmp_path / "putty.log")
    assert [e.name for e in load_folder(tmp_path, card())] == ["putty"]


# --- folders ---


def test_a_folder_with_a_card_is_read(folder: Path, pendulum: tn.DataSet) -> None:
    data = tn.load(folder)
    assert [e.name for e in data] == [e.name for e in pendulum]
    assert [e.split for e in data] == [e.split for e in pendulum]
    for read, written in zip(data, pendulum, strict=True):
        np.testing.assert_allclose(read.q, written.q, atol=1e-9)
        np.testing.assert_allclose(read.u, written.u, atol=1e-7)
        np.testing.assert_allclose(read.t, written.t, atol=1e-9)
    assert data.coordinates[0].resolution == pytest.approx(2 * np.pi / 4096)


def test_a_record_says_where_it_came_from(folder: Path) -> None:
    e = tn.load(folder)["fall1"]
    assert e.source == "fall1.csv"
    assert e.sha256 == hashlib.sha256((folder / "fall1.csv").read_bytes()).hexdigest()
    assert e.first_row == 0


def test_records_that_cannot_be_used_are_left_out_where_others_remain(tmp_path: Path) -> None:
    nan = np.full(40, np.nan)
    write(tmp_path / "run1.csv")
    write(tmp_path / "run2.csv", angle=nan)
    (tmp_path / "run3.csv").write_text("")
    write(tmp_path / "run4.csv", angle=np.zeros(40))
    logs = np.empty(2, object)
    logs[:] = [{"angle": np.sin(np.arange(40)), "torque": x} for x in (nan, np.ones(40))]
    scipy.io.savemat(tmp_path / "logs.mat", {"logs": logs})
    columns = {
        "coordinates": [{"name": "a", "kind": "angular", "column": "logs.angle"}],
        "inputs": [{"name": "u", "unit": "V", "column": "logs.torque"}],
    }
    for splits, keys, omitted in (
        (
            {"train": ["run*.csv"]},
            {},
            [
                "run2.csv, row 2, angle: nan (40 such)",
                "run3.csv: the file is empty",
                "run4.csv: nothing moves",
            ],
        ),
        ({"train": ["logs.mat"]}, columns, ["logs.mat, cell 1, sample 0"]),
    ):
        messages: list[str] = []
        data = load_folder(tmp_path, card(splits=splits, **keys), on_message=messages.append)
        assert len(data) == 1
        for message, text in zip(messages, omitted, strict=True):
            assert message.startswith(f"left out: {tmp_path}")
            assert text in message
        with pytest.raises(tn.InputError, match="finite number"):
            load_folder(tmp_path, card(splits=splits, **keys))
    # one that is named, and all of a split, are not left out
    for splits in (
        {"train": ["run1.csv", "run2.csv"]},
        {"train": ["run1.csv"], "validation": ["run[23].csv"]},
    ):
        with pytest.raises(tn.InputError, match=r"run2\.csv, row 2, angle: nan"):
            load_folder(tmp_path, card(splits=splits), on_message=lambda text: None)


def test_patterns_find_files_in_natural_order(tmp_path: Path) -> None:
    for number in (1, 2, 10, "21²", 3):
        write(tmp_path / "train" / f"run{number}.csv")
    data = load_folder(tmp_path, card(splits={"train": ["train/run*.csv"]}))
    assert [e.name for e in data] == ["run1", "run2", "run3", "run10", "run21²"]
    assert data[3].source == "train/run10.csv"


def test_a_range_of_rows_is_a_record_of_its_own(tmp_path: Path) -> None:
    write(tmp_path / "log.csv")
    files = [
        {"file": "log.csv", "name": "first", "rows": [0, 15]},
        {"file": "log.csv", "name": "second", "rows": [20, 40], "k_bar": 7},
    ]
    first, second = load_folder(tmp_path, card(splits={"train": files}, **timed()))
    assert (len(first), first.first_row, first.k_bar) == (15, 0, None)
    assert (len(second), second.first_row, second.k_bar) == (20, 20, 7)
    assert second.t[0] == pytest.approx(0.2)


@pytest.mark.parametrize("time", [timed(), {}, timed(irregular="resample")])
def test_a_range_of_seconds_is_a_record_of_its_own(tmp_path: Path, time: dict[str, Any]) -> None:
    t = 7.3 + np.arange(40) * DT  # seconds count from the first timestamp
    if "irregular" in time.get("time", {}):
        t[30:] += 0.5 * DT
    write(tmp_path / "log.csv", time=t, angle=np.arange(40.0) ** 2 / 100)
    files = [{"file": "log.csv", "seconds": [a, b]} for a, b in [(0, 0.29), (0.29, 0.395)]]
    first, second = load_folder(tmp_path, card(splits={"train": files}, **time))
    assert [e.name for e in (first, second)] == ["log_0-0.29s", "log_0.29-0.395s"]
    assert (first.first_row, len(first), first.q[-1, 0]) == (0, 29, 7.84)  # the end is excluded
    assert (second.first_row, second.q[0, 0]) == (29, pytest.approx(8.41))
    assert (second.recording is not None) == ("irregular" in time.get("time", {}))


def test_records_are_told_apart_where_files_have_one_name(tmp_path: Path) -> None:
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        write(tmp_path / place / "log.csv")
    write(tmp_path / "long.csv")
    splits = {
        "train": ["a/log.csv", {"file": "long.csv", "rows": [0, 20]}],
        "validation": ["b/log.csv", {"file": "long.csv", "rows": [20, 40]}],
    }
    data = load_folder(tmp_path, card(splits=splits))
    assert [e.name for e in data] == ["a_log", "long_0-20", "b_log", "long_20-40"]


def test_an_optional_split_may_be_absent_but_not_torn(tmp_path: Path) -> None:
    write(tmp_path / "a.csv")
    declared = card(
        splits={"train": ["a.csv"], "test": ["b.csv", "c.csv"]}, optional_splits=["test"]
    )
    assert load_folder(tmp_path, declared).splits == ("train",)
    write(tmp_path / "b.csv")
    with pytest.raises(tn.InputError, match=r"c\.csv: no such file"):
        load_folder(tmp_path, declared)


def test_files_whose_clocks_jitter_are_one_data_set(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    for name in ("a", "b"):
        jitter = generator.uniform(-1e-5, 1e-5, 40)
        write(tmp_path / f"{name}.csv", time=np.arange(40) * DT + jitter)
    data = load_folder(tmp_path, card(dt=None, splits={"train": ["*.csv"]}, **timed()))
    assert data.dt == pytest.approx(DT, rel=1e-2)


# --- what a card may name ---


@pytest.mark.parametrize("file", ["link.csv", "*.csv", "away/log.csv", "a*/log.csv"])
def test_a_link_that_leaves_the_folder_is_refused(tmp_path: Path, file: str) -> None:
    folder, other = tmp_path / "logs", tmp_path / "other"
    folder.mkdir()
    (folder / "link.csv").symlink_to(write(other / "log.csv"))
    (folder / "away").symlink_to(other)
    with pytest.raises(tn.InputError, match=r"\.csv: a link that leaves the folder"):
        load_folder(folder, card(splits={"train": [file]}))


def test_links_inside_of_the_folder_and_to_it_are_followed(tmp_path: Path) -> None:
    path = write(tmp_path / "logs" / "log.csv")
    (path.parent / "link.csv").symlink_to(path)
    (tmp_path / "here").symlink_to(path.parent)
    assert len(one(tmp_path / "here" / "link.csv")) == 40


def test_a_device_is_never_read(tmp_path: Path) -> None:
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(tn.InputError, match=r"zero\.csv: a link that leaves the folder"):
        one(tmp_path / "zero.csv")
    with pytest.raises(tn.InputError, match=r"pipe\.csv: a folder, pipe or device"):
        one(tmp_path / "pipe.csv")


def test_links_in_a_circle_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.csv").symlink_to(tmp_path / "b.csv")
    (tmp_path / "b.csv").symlink_to(tmp_path / "a.csv")
    for file in ("a.csv", "*.csv"):
        with pytest.raises(tn.InputError, match=r"a\.csv: (no such file|cannot be followed)"):
            load_folder(tmp_path, card(splits={"train": [file]}))


def test_folders_that_a_pattern_finds_are_no_records(tmp_path: Path) -> None:
    (tmp_path / "run.old.csv").mkdir()
    write(tmp_path / "run1.csv")
    with pytest.warns(UserWarning, match=r"run\.old\.csv: a folder, no record; it is left out"):
        records = load_folder(tmp_path, card(splits={"train": ["run*"]}))
    assert [e.name for e in records] == ["run1"]


def test_a_file_whose_name_is_no_records_name_is_told(tmp_path: Path) -> None:
    path = write(tmp_path / "._run.csv")
    with pytest.raises(tn.InputError, match=r"^\._run\.csv: the name '\._run'.*name = \"\.\.\.\""):
        one(path)
    files = [{"file": path.name, "name": "run"}]
    assert load_folder(tmp_path, card(splits={"train": files}))[0].name == "run"


# --- columns ---


def test_a_file_without_header_is_told(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("0.5,1\n0.6,2\n0.8,3\n")
    for form in ({}, {"header": False}):
        with pytest.raises(tn.InputError, match=r"no column 'angle'.*has no header: columns go by"):
            one(path, format=form)
    e = one(path, coordinates=[{**ANGLE, "column": 1}], inputs=[])
    np.testing.assert_array_equal(e.q[:, 0], [0.5, 0.6, 0.8])
    assert e.notes == ("no header: the first row is a sample",)


def test_numbers_name_columns_of_a_file_with_header(tmp_path: Path) -> None:
    changes = {"coordinates": [{**ANGLE, "column": 2}], "format": {"columns": 3}}
    e = one(write(tmp_path / "log.csv"), **changes)
    assert len(e) == 40


def test_columns_go_by_number_from_1(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("0.5,1\n0.6,2\n0.8,3\n")
    e = one(
        path,
        format={"header": False},
        coordinates=[{**ANGLE, "column": 1}],
        inputs=[{**TORQUE, "column": 2}],
    )
    np.testing.assert_array_equal(e.q[:, 0], [0.5, 0.6, 0.8])
    np.testing.assert_array_equal(e.u[:, 0], [1, 2, 3])


@pytest.mark.thorough
def test_one_of_many_columns_is_read(tmp_path: Path) -> None:
    path, names = tmp_path / "log.csv", [f"c{k}" for k in range(10_000)]
    rows = [",".join(names), ",".join(["1"] * 10_000), ",".join(["2"] * 10_000)]
    path.write_text("\n".join(rows))
    e = one(path, coordinates=[{**ANGLE, "column": "c9999"}], inputs=[])
    assert e.q[:, 0].tolist() == [1.0, 2.0]


def test_columns_that_are_not_used_may_hold_anything_finite_or_not(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", spare=np.full(40, np.nan))
    assert len(one(path)) == 40


def test_velocities_are_read_in_their_unit(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", speed=np.arange(40.0))
    with_velocity = {**ANGLE, "velocity": {"column": "speed", "unit": "deg/s", "measured": True}}
    e = one(path, coordinates=[with_velocity])
    assert e.v is not None
    assert e.v_measured
    np.testing.assert_allclose(e.v[:, 0], np.deg2rad(np.arange(40.0)))


def test_velocities_count_as_measured_only_where_the_card_says_so(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", speed=np.arange(40.0))
    assert not one(path, coordinates=[{**ANGLE, "velocity": {"column": "speed"}}]).v_measured


@pytest.mark.parametrize("inputs", [[TORQUE], []])
def test_other_variables_of_an_archive_do_not_matter(
    tmp_path: Path, inputs: list[dict[str, Any]]
) -> None:
    path = tmp_path / "log.npz"
    t = np.arange(40) * DT
    np.savez(path, gains=np.array([1.0, 2.0, 3.0]), angle=np.sin(t), torque=t)
    e = one(path, inputs=inputs)
    assert e.u.shape == (40, len(inputs))
    files = [{"file": "log.npz", "rows": [10, 30]}]
    (part,) = load_folder(tmp_path, card(inputs=inputs, splits={"train": files}))
    np.testing.assert_array_equal(part.q, e.q[10:30])


def test_columns_of_unequal_lengths_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # as people run it: without the type checks of the test set-up
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    path = tmp_path / "log.npz"
    np.savez(path, angle=np.arange(40.0), torque=np.arange(30.0))
    with pytest.raises(tn.InputError, match=r"\(30, 1\)|lengths"):
        one(path)


# --- refused, with the place and the remedy ---


def at(sample: int, value: float, usual: np.ndarray | None = None) -> np.ndarray:
    """Values of a column, by default 0.5, with another one at a sample."""
    column = np.full(40, 0.5) if usual is None else usual.copy()
    column[sample] = value
    return column


TIMES = np.arange(40) * DT
GAP = np.delete(np.arange(45) * DT, slice(20, 25))
WITH_SPEED = {**ANGLE, "velocity": {"column": "speed"}}
CART = {"name": "cart", "kind": "linear", "column": "x"}


@pytest.mark.parametrize(
    ("columns", "entry", "changes", "message"),
    [
        # columns
        (
            {},
            {},
            {"coordinates": [{**ANGLE, "column": "phi"}]},
            r"log\.csv: no column 'phi'; expected one of: time, angle, torque",
        ),
        (
            {},
            {},
            {"coordinates": [{**ANGLE, "column": 4}]},
            "3 columns; expected a column 4 .*from 1",
        ),
        (
            {},
            {},
            {"format": {"columns": 6}},
            r"log\.csv: 3 columns; expected 6 as in the card",
        ),
        ({}, {"cell": 3}, {}, r"log\.csv: no cell or struct arrays; .*a cell 3"),
        (
            {"speed": TIMES, "x": TIMES},
            {},
            {"coordinates": [WITH_SPEED, CART]},
            "no velocity column for 'cart'",
        ),
        # numbers
        *(
            (
                {"angle": at(13, value, at(20, value))},
                {},
                {},
                rf"log\.csv, row 15, angle: {value} \(2 such\)",
            )
            for value in (np.nan, np.inf)
        ),
        (
            {"angle": at(13, 1e200)},
            {"rows": [10, 30]},
            {},
            r"row 15, angle: 1e\+200 .*at most 1e\+100",
        ),
        ({"angle": np.full(40, 0.3)}, {}, {}, r"nothing moves \(angle\)"),
        # parts
        ({}, {"rows": [10, 41]}, {}, "rows 10..41; expected a range within 0..40"),
        (
            {},
            {"seconds": [0.1, 0.5]},
            timed(),
            r"log\.csv: seconds 0\.1\.\.0\.5; .* the 0\.39 s that the file",
        ),
        ({}, {"seconds": [3, 4]}, timed(), r"log\.csv: seconds 3\.\.4; .*0\.39 s"),
        ({}, {"seconds": [0.2, 0.1]}, timed(), r"splits\.train\.0\.seconds: .*then a later one"),
        ({}, {"seconds": [-1, 0.1]}, timed(), r"splits\.train\.0\.seconds"),
        (
            {},
            {"seconds": [0, 1], "rows": [0, 9]},
            timed(),
            r"`rows` and `seconds` of 'log\.csv'; give one",
        ),
        ({}, {"seconds": [0.101, 0.102]}, timed(), r"log\.csv: 0 samples; expected at least 2"),
        # times
        (
            {"time": GAP},
            {},
            timed(),
            r'log\.csv, row 22: interval of 0\.06 s before sample 20 .*within 5%.*"resample"',
        ),
        (
            {"time": 2 * TIMES},
            {},
            timed(irregular="keep"),
            r"samples 0\.02 s apart; expected 0\.01",
        ),
        (
            {},
            {},
            {**timed(irregular="resample"), "dt": 2},
            r"samples 0\.01 s apart; expected 2 s as in the card; correct `dt`$",
        ),
        (
            {"time": at(20, TIMES[19], TIMES)},
            {},
            timed(irregular="keep"),
            r"log\.csv, row 22, column time: time 0\.19 s repeats 0\.19",
        ),
        (
            {"time": at(20, TIMES[10], TIMES)},
            {},
            timed(irregular="keep"),
            r"log\.csv, row 22, column time: time 0\.1 s goes back from 0\.19",
        ),
        *(
            (
                {"time": TIMES + wild * np.maximum(np.arange(40) - 29, 0)},
                {"rows": [5, 31]},
                timed(irregular="resample"),
                r"log\.csv, row 32: a grid of 0\.01 s makes .* of 26",
            )
            for wild in (1e9, 1e18, 1e99)
        ),
        *(
            (
                {"time": np.arange(40) * interval},
                {},
                {**timed(), **period},
                rf"samples .* s apart.*{message}",
            )
            for interval in (1e-320, 1e-12, 1e12)
            for period, message in (
                ({"dt": None}, "1e-09 to 10000 s"),
                ({}, r"0\.01 s as in the card"),
            )
        ),
    ],
)
def test_a_log_that_does_not_fit_the_card_is_refused(
    tmp_path: Path,
    columns: dict[str, Any],
    entry: dict[str, Any],
    changes: dict[str, Any],
    message: str,
) -> None:
    write(tmp_path / "log.csv", **columns)
    with pytest.raises(tn.InputError, match=message):
        load_folder(tmp_path, card(splits={"train": [{"file": "log.csv", **entry}]}, **changes))


@pytest.mark.parametrize(
    ("files", "changes", "message"),
    [
        (
            {"a.csv": DT},
            {"splits": {"train": ["a.csv", "b.csv"]}},
            r"b\.csv: no such file \(1 of the card's train",
        ),
        ({}, {"splits": {"train": ["run*.csv"]}}, r"run\*\.csv: no such file"),
        (
            {},
            {"splits": {"train": ["a.csv"]}, "optional_splits": ["train"]},
            r"none of the files of the card 'toy'.*a\.csv",
        ),
        (
            {"a.csv": DT, "b.csv": 0.02},
            {"splits": {"train": ["*.csv"]}, "dt": None, **timed()},
            r"'b': samples 0\.02 s apart; .* 0\.01 s as in other .*add `dt = 0\.01`",
        ),
    ],
)
def test_a_folder_that_does_not_fit_the_card_is_refused(
    tmp_path: Path, files: dict[str, float], changes: dict[str, Any], message: str
) -> None:
    for file, dt in files.items():
        write(tmp_path / file, time=np.arange(40) * dt)
    with pytest.raises(tn.InputError, match=message):
        load_folder(tmp_path, card(**changes))


@pytest.mark.parametrize(
    ("angle", "changes", "message"),
    [
        ([0.0, None, 2], {}, r"bench, sample 1 .*, angle: nan"),
        (["0.0", "off", "2"], {}, r"bench, sample 1 .*, angle: 'off'; expected a number"),
        ([0.0, 1, 2], {"inptus": []}, "bench, inptus: unknown key; did you mean 'inputs'"),
    ],
)
def test_a_data_frame_that_does_not_fit_the_card_is_refused(
    angle: list[Any], changes: dict[str, Any], message: str
) -> None:
    content = {"dt": DT, "coordinates": [ANGLE], **changes}
    with pytest.raises(tn.InputError, match=message):
        tn.from_frame(pl.DataFrame({"angle": angle}), content, name="bench")


# --- times ---


def test_without_a_time_column_samples_are_a_period_apart(tmp_path: Path) -> None:
    np.testing.assert_allclose(one(write(tmp_path / "log.csv")).t, np.arange(40) * DT)


def test_without_a_period_the_median_interval_is_taken(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", time=1e3 * np.arange(40) * DT)
    e = one(path, dt=None, **timed(unit="ms"))
    assert e.dt == pytest.approx(DT)


def test_jitter_within_the_tolerance_is_accepted_and_noted(tmp_path: Path) -> None:
    t = np.arange(40) * DT
    t[20] += 3e-4
    e = one(write(tmp_path / "log.csv", time=t), **timed())
    np.testing.assert_array_equal(e.t, t)
    assert "worst 0.0003 s) accepted" in e.notes[0]


@pytest.fixture
def gap(tmp_path: Path) -> Path:
    """A log of a swing in which five samples are missing."""
    return write(tmp_path / "log.csv", time=np.delete(np.arange(45) * DT, slice(20, 25)))


def test_irregular_times_are_kept_where_the_card_says_so(gap: Path) -> None:
    e = one(gap, **timed(irregular="keep"))
    assert len(e) == 40
    assert e.dt == DT
    assert "irregular times kept" in e.notes[0]


def test_irregular_times_are_resampled_where_the_card_says_so(gap: Path) -> None:
    e = one(gap, **timed(irregular="resample"))
    np.testing.assert_allclose(e.t, np.arange(45) * DT, atol=1e-12)
    np.testing.assert_allclose(e.q[:, 0], np.sin(3 * e.t), atol=1e-4)
    assert "resampled onto a grid of 0.01 s" in e.notes[0]
    assert "1 gap interpolated" in e.notes[0]


# --- cards without splits ---


def test_a_card_without_splits_means_all_logs_beside_it(tmp_path: Path) -> None:
    for name in ("run10", "run2", "run1"):
        write(tmp_path / f"{name}.csv")
    pl.read_csv(tmp_path / "run1.csv").write_parquet(tmp_path / "last.parquet")
    (tmp_path / ".run3.csv").write_text("hidden")
    (tmp_path / "notes.md").write_text("no log")
    write(tmp_path / "older" / "run4.csv")
    data = load_folder(tmp_path, card())
    assert [e.name for e in data] == ["last", "run1", "run2", "run10"]
    assert data.splits == ()
    write(tmp_path / "run5.csv", angle=np.full(40, np.nan))
    messages: list[str] = []
    assert len(load_folder(tmp_path, card(), on_message=messages.append)) == 4
    assert len(messages) == 1
    with pytest.raises(tn.InputError, match=r"run5\.csv, row 2, angle: nan"):
        load_folder(tmp_path, card(), on_message=messages.append, required=["run5"])


def test_a_card_without_splits_needs_logs_beside_it(tmp_path: Path) -> None:
    write(tmp_path / "older" / "run4.csv")
    with pytest.raises(tn.InputError, match=r"no logs beside the card 'toy'.*under"):
        load_folder(tmp_path, card())


# --- wrapped angles ---


def test_a_wrapped_angle_is_unwrapped_before_it_is_resampled(tmp_path: Path) -> None:
    t = np.delete(np.arange(200) * DT, [50, 51, 120])
    wrapped = (8 * t + 180 / 57.3) % (2 * np.pi)
    path = write(tmp_path / "log.csv", time=t, angle=np.rad2deg(wrapped), torque=t)
    e = one(path, coordinates=[{**ANGLE, "unit": "deg"}], **timed(irregular="resample"))
    np.testing.assert_allclose(np.diff(e.q[:, 0]), 8 * DT, atol=1e-9)
    assert e.notes[0] == "angle: unwrapped (3 jumps)"


@pytest.mark.parametrize("changes", [{"unwrap": False}, {"kind": "linear"}])
def test_jumps_are_left_where_they_are_no_wraps(tmp_path: Path, changes: dict[str, Any]) -> None:
    angle = np.where(np.arange(40) < 20, 0.0, 6.0)
    e = one(write(tmp_path / "log.csv", angle=angle), coordinates=[{**ANGLE, **changes}])
    np.testing.assert_array_equal(e.q[:, 0], angle)


COUNT = 2 * np.pi / 4096


def wrapping_folder(tmp_path: Path, **first_by_name: float) -> Path:
    """A folder of records of an encoder of 0 to 4095 counts, which begin at so many radians."""
    t = np.arange(200) * DT
    for name, first in first_by_name.items():
        counts = np.round((first + 0.2 * np.sin(8 * t)) / COUNT) % 4096
        write(tmp_path / f"{name}.csv", 200, angle=counts)
    return tmp_path


def wrapping_card(files: str = "*.csv", **changes: Any) -> Card:
    angle = {**ANGLE, "unit": "counts", "counts_per_revolution": 4096, **changes}
    return card(coordinates=[angle], splits={"train": [files]})


def test_records_of_a_wrapped_encoder_begin_in_one_turn(tmp_path: Path) -> None:
    folder = wrapping_folder(tmp_path, a=0.1, b=6.2, c=6.0, d=-0.05)
    data = load_folder(folder, wrapping_card())
    begins = {e.name: e.q[0, 0] for e in data}
    # c stays on one side of 0, but its encoder wraps in the others
    expected = {"a": 0.1, "b": 6.2 - 2 * np.pi, "c": 6.0 - 2 * np.pi, "d": -0.05}
    assert begins == pytest.approx(expected, abs=COUNT)
    assert data["b"].notes[-1] == "angle: moved by -1 turn"
    assert "moved" not in " ".join(data["a"].notes)
    for e in data:  # also where it is logged by itself
        if e.name != "c":
            other = load_folder(folder, wrapping_card(f"{e.name}.csv"))
            np.testing.assert_array_equal(other[0].q, e.q)


def test_a_card_says_whether_an_encoder_wraps(tmp_path: Path) -> None:
    alone = wrapping_folder(tmp_path / "alone", c=6.0)
    assert load_folder(alone, wrapping_card())[0].q[0, 0] > 5.9
    wraps = load_folder(alone, wrapping_card(wraps=True))
    assert wraps[0].q[0, 0] == pytest.approx(6.0 - 2 * np.pi, abs=COUNT)
    jumps = wrapping_folder(tmp_path / "jumps", b=6.2)
    never = load_folder(jumps, wrapping_card(wraps=False))
    assert never[0].q[0, 0] == pytest.approx(6.2, abs=COUNT)
    assert np.ptp(never[0].q) < 1


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"unwrap": False, "unit": "rad"}, "`wraps` of `unwrap = false`"),
        ({"kind": "linear", "unit": "m"}, "`wraps` of a linear coordinate"),
    ],
)
def test_wraps_of_an_angle_that_is_not_unwrapped_is_refused(
    changes: dict[str, Any], problem: str
) -> None:
    with pytest.raises(tn.InputError, match=problem):
        card(coordinates=[{**ANGLE, "wraps": True, **changes}])


def test_an_encoder_of_several_turns_is_left_where_it_begins(tmp_path: Path) -> None:
    t = np.arange(200) * DT
    write(tmp_path / "a.csv", 200, angle=40 + 8 * t)
    write(tmp_path / "b.csv", 200, angle=5.9 + 0.1 * t)
    data = load_folder(tmp_path, card(splits={"train": ["*.csv"]}))
    assert [e.q[0, 0] for e in data] == [40.0, 5.9]


# --- data frames ---


@pytest.mark.parametrize("library", [pd, pl])
def test_a_data_frame_with_a_mapping_as_card(library: Any) -> None:
    t = np.arange(30) * DT
    frame = library.DataFrame({"time": t, "angle": np.rad2deg(t), "torque": np.arange(30)})
    e = tn.from_frame(
        frame,
        {"dt": DT, "coordinates": [{**ANGLE, "unit": "deg"}], "inputs": [TORQUE], **timed()},
        name="bench",
        split="validation",
    )
    assert (e.name, e.split) == ("bench", "validation")
    np.testing.assert_allclose(e.q[:, 0], t, atol=1e-12)
    np.testing.assert_array_equal(e.u[:, 0], np.arange(30))


def test_a_data_frame_with_a_card() -> None:
    frame = pl.DataFrame({"angle": [0.0, 1, 2], "torque": [0.0, 0, 0]})
    assert tn.from_frame(frame, card()).dt == DT


# --- records in the cells of a MAT file ---


def cells(path: Path, count: int = 3) -> Path:
    """A MAT file with a cell array of logs, of growing length."""
    logs = np.empty(count, object)
    for k in range(count):
        t = np.arange(20 + k) * DT
        logs[k] = {"time": t, "angle": np.sin(3 * t), "torque": np.cos(t), "label": "swing"}
    scipy.io.savemat(path, {"logs": logs, "note": "on the bench"})
    return path


def cell_card(*entries: Any, column: str = "logs.angle") -> Card:
    return card(
        coordinates=[{**ANGLE, "column": column}],
        inputs=[{**TORQUE, "column": "logs.torque"}],
        splits={"train": list(entries)},
        time={"column": "logs.time"},
    )


def test_each_cell_of_a_mat_file_is_a_record(tmp_path: Path) -> None:
    cells(tmp_path / "logs.mat")
    data = load_folder(tmp_path, cell_card("logs.mat"))
    assert [(e.name, len(e)) for e in data] == [("logs[1]", 20), ("logs[2]", 21), ("logs[3]", 22)]
    third, part = load_folder(
        tmp_path,
        cell_card({"file": "logs.mat", "cell": 3}, {"file": "logs.mat", "cell": 1, "rows": [0, 9]}),
    )
    assert (third.name, len(third), part.name, len(part)) == ("logs[3]", 22, "logs[1]_0-9", 9)
    assert third.sha256 == part.sha256 == data[0].sha256


@pytest.mark.parametrize(
    ("entry", "column", "message"),
    [
        ({"cell": 4}, "logs.angle", r"logs\.mat: 3 elements; expected a cell 4"),
        ({"cell": 0}, "logs.angle", r"splits\.train\.0\.cell"),
        ({"cell": 2}, "logs.label", r"logs\.mat, cell 2: 'logs\.label' is text"),
        ({"cell": 2}, "logs.angel", r"logs\.mat, cell 2: no column 'logs\.angel'; .*logs\.angle"),
        ({}, "note", r"logs\.mat, cell 1: 'note' is text"),
        ({"cell": 2, "rows": [0, 30]}, "logs.angle", r"cell 2: rows 0\.\.30; .*0\.\.21"),
    ],
)
def test_cells_that_are_not_there_are_refused(
    tmp_path: Path, entry: dict[str, Any], column: str, message: str
) -> None:
    cells(tmp_path / "logs.mat")
    with pytest.raises(tn.InputError, match=message):
        load_folder(tmp_path, cell_card({"file": "logs.mat", **entry}, column=column))
