"""ULog, MDF and TDMS files, HDF5 groups, LeRobot data sets."""

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest
from lab_files import (
    ANGLE_TIMES,
    CARD,
    COMMAND_TIMES,
    angle,
    commands,
    hdf5_file,
    held_command,
    lerobot_data_set,
    mdf_file,
    tdms_file,
    ulog_file,
)

import tustinnet as tn
from tustinnet.data import readers
from tustinnet.data.drafting.draft import draft_file
from tustinnet.data.readers import read_columns

# file, its writer, and the names of time, position and command
FILES = [
    ("log.ulg", ulog_file, "arm_state/time", "arm_state/q[0]", "actuator/volts"),
    ("log.mf4", mdf_file, "motion/time", "motion/elbow", "drive/volts"),
    ("log.mdf", mdf_file, "group 1/time", "group 1/elbow", "group 2/volts"),
    ("log.tdms", tdms_file, "motion/time", "motion/elbow", "drive/volts"),
]
Write = Callable[[Path], Path]


@pytest.mark.parametrize(("name", "write", "time", "position", "command"), FILES)
def test_each_group_has_its_own_times(
    tmp_path: Path, name: str, write: Write, time: str, position: str, command: str
) -> None:
    columns = read_columns(write(tmp_path / name))
    np.testing.assert_allclose(columns[time], ANGLE_TIMES, atol=1e-9)
    np.testing.assert_allclose(columns[position], angle(ANGLE_TIMES), atol=1e-7)
    np.testing.assert_allclose(columns[command], commands())
    clock = columns.clocks[command]
    np.testing.assert_allclose(columns[clock], COMMAND_TIMES, atol=1e-9)
    assert columns.clocks[position] == columns.clocks[time] == time
    if name != "log.ulg":
        assert (columns.units[position], columns.units[command]) == ("rad", "V")


@pytest.mark.parametrize(("name", "write", "time", "position", "command"), FILES)
def test_a_card_brings_groups_onto_one_time_base(
    tmp_path: Path, name: str, write: Write, time: str, position: str, command: str
) -> None:
    write(tmp_path / name)
    (tmp_path / "dataset.toml").write_text(
        CARD.format(time=time, position=position, command=command)
    )
    (record,) = tn.load(tmp_path)
    assert len(record) == 194
    np.testing.assert_allclose(record.q[:, 0], angle(ANGLE_TIMES[6:]), atol=1e-7)
    expected = [held_command(t) for t in ANGLE_TIMES[6:-1]]
    np.testing.assert_allclose(record.u[:-1, 0], expected, atol=2e-3)


@pytest.mark.parametrize(("name", "write", "time", "position", "command"), FILES)
def test_the_draft_reads_the_file(
    tmp_path: Path, name: str, write: Write, time: str, position: str, command: str
) -> None:
    found = draft_file(write(tmp_path / name))
    roles = {column.name: column.role for column in found.columns}
    assert (roles[time], roles[position], roles[command]) == ("time", "position", "input")
    (tmp_path / "dataset.toml").write_text(found.text)
    (record,) = tn.load(tmp_path)
    assert record.dt == pytest.approx(0.01)
    if name != "log.ulg":
        (unit,) = [c.unit for c in found.columns if c.name == position]
        assert unit == "rad"


def test_instances_of_a_topic_are_numbered(tmp_path: Path) -> None:
    columns = read_columns(ulog_file(tmp_path / "log.ulg"))
    np.testing.assert_allclose(columns["actuator[1]/volts"], -commands())
    assert "timestamp" not in " ".join(columns.names)


@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [
        ("log.ulg", "pyulog", "ulog"),
        ("log.mf4", "asammdf", "mdf"),
        ("log.tdms", "nptdms", "tdms"),
        ("log.bag", "rosbags", "ros"),
        ("log.db3", "rosbags", "ros"),
        ("log.mcap", "mcap", "mcap"),
        ("log.xlsx", "fastexcel", "excel"),
    ],
)
def test_a_library_that_is_absent_is_named_with_its_pip_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str, extra: str
) -> None:
    (tmp_path / name).write_text("x")
    asked = []

    def find_spec(package: str) -> None:
        asked.append(package)

    monkeypatch.setattr("tustinnet.errors.find_spec", find_spec)
    pattern = rf"{name}: the package {module} is not installed; .*pip install 'tustinnet\[{extra}\]"
    with pytest.raises(tn.InputError, match=pattern):
        read_columns(tmp_path / name)
    assert asked == [module]


# --- times that do not fit ---


def topics(path: Path, base: np.ndarray, other: np.ndarray) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as file:
        for group, t in (("a", base), ("b", other)):
            step = {"wf_increment": float(t[1] - t[0]), "wf_start_offset": float(t[0])}
            file.write_segment([ChannelObject(group, "x", np.sin(t), step)])
        file.write_segment([ChannelObject("c", "x", np.sin(base), {})])
    return path


@pytest.mark.parametrize(
    ("time", "position", "command", "message"),
    [
        ("a/time", "a/x", "b/x", r"no time in common \(a/time 0\.\.1\.99 s, b/time 5\.\.6\.99 s\)"),
        ("a/time", "a/x", "c/x", r"'c/x' has no times of its own, 'a/time' has"),
        (None, "a/x", "b/x", r"sampled at different times.*column = \"a/time\"` under \[time\]"),
    ],
)
def test_times_that_do_not_belong_together_are_refused(
    tmp_path: Path, time: str | None, position: str, command: str, message: str
) -> None:
    topics(tmp_path / "log.tdms", ANGLE_TIMES, 5 + ANGLE_TIMES)
    card = CARD.format(time=time, position=position, command=command)
    if time is None:
        card = card.replace("[time]", "dt = 0.01").replace('column = "None"\n', "")
    (tmp_path / "dataset.toml").write_text(card)
    with pytest.raises(tn.InputError, match=message):
        tn.load(tmp_path)


def test_an_encoder_that_wraps_still_wraps_at_other_times(tmp_path: Path) -> None:
    t = np.arange(0.005, 2, 0.01)
    turning = np.remainder(4 * t, 2 * np.pi)

    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(tmp_path / "log.tdms") as file:
        for group, times, x in (("a", ANGLE_TIMES, np.sin(ANGLE_TIMES)), ("b", t, turning)):
            step = {"wf_increment": 0.01, "wf_start_offset": float(times[0])}
            file.write_segment([ChannelObject(group, "x", x, step)])
    (tmp_path / "dataset.toml").write_text(
        'name = "arm"\n[time]\ncolumn = "a/time"\n'
        '[[coordinates]]\nname = "one"\nkind = "angular"\ncolumn = "a/x"\n'
        '[[coordinates]]\nname = "two"\nkind = "angular"\ncolumn = "b/x"\n'
    )
    (record,) = tn.load(tmp_path)
    np.testing.assert_allclose(record.q[:, 1], 4 * ANGLE_TIMES[1:], atol=1e-6)
    assert any("wrap" in note for note in record.notes)


# --- LeRobot ---

LEROBOT = """
name = "arm"
[time]
column = "timestamp"
[[coordinates]]
name = "elbow"
kind = "angular"
column = "observation.state.elbow.pos"
[[inputs]]
name = "command"
column = "action.elbow.pos"
unit = "rad"
[splits]
train = ["data/chunk-*/*.parquet"]
"""


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_of_a_lerobot_data_set_are_records(tmp_path: Path, version: str) -> None:
    files = lerobot_data_set(tmp_path, version)
    columns = read_columns(files[0])
    assert {
        "observation.state.shoulder.pos",
        "observation.state.elbow.pos",
        "action.shoulder.pos",
        "observation.effort[0]",
        "observation.effort[1]",
        "timestamp",
    } <= {*columns.names}
    assert columns.notes == ("a LeRobot data set, 50 frames a second",)
    (tmp_path / "dataset.toml").write_text(LEROBOT)
    data = tn.load(tmp_path)
    names = [f"episode_{k:06}" for k in range(3)]
    assert [e.name for e in data] == (
        names if version == "v2.1" else [f"file-000[{k}]" for k in range(3)]
    )
    assert [len(e) for e in data] == [60, 70, 80]
    np.testing.assert_allclose(data[2].q[:, 0], np.cos(2 * np.arange(80) / 50), atol=1e-6)
    draft = draft_file(files[0]).text
    assert 'column = "action.elbow.pos"' in draft.split("[[inputs]]", 1)[1]


def test_one_episode_is_chosen_by_its_number(tmp_path: Path) -> None:
    lerobot_data_set(tmp_path, "v3.0")
    file = '{ file = "data/chunk-000/file-000.parquet", record = "1" }'
    card = LEROBOT.replace('"data/chunk-*/*.parquet"', file)
    (tmp_path / "dataset.toml").write_text(card)
    (record,) = tn.load(tmp_path)
    assert (record.name, len(record)) == ("file-000[1]", 70)
    (tmp_path / "dataset.toml").write_text(card.replace('"1"', '"7"'))
    with pytest.raises(tn.InputError, match=r"records 0, 1, 2; expected a record '7'"):
        tn.load(tmp_path)
    (tmp_path / "dataset.toml").write_text(card.replace('"1"', '"1", cell = 2'))
    with pytest.raises(tn.InputError, match="`cell` and `record`"):
        tn.load(tmp_path)


def test_names_that_do_not_fit_a_list_and_a_bad_description(tmp_path: Path) -> None:
    (file, *_) = lerobot_data_set(tmp_path, "v2.0")
    place = tmp_path / "meta/info.json"
    info = json.loads(place.read_text())
    info["features"]["action"]["names"] = ["only one"]
    place.write_text(json.dumps(info))
    assert "action[1]" in read_columns(file).names
    place.write_text("{")
    with pytest.raises(tn.InputError, match=r"info\.json: cannot be read as JSON"):
        read_columns(file)


def test_lists_of_several_lengths_are_refused(tmp_path: Path) -> None:
    pl.DataFrame({"x": [[1.0, 2.0], [3.0]], "t": [0.0, 1.0]}).write_parquet(tmp_path / "a.parquet")
    columns = read_columns(tmp_path / "a.parquet")
    assert columns.names == ("x[0]", "x[1]", "t")
    np.testing.assert_array_equal(columns["t"], [0, 1])
    with pytest.raises(tn.InputError, match="x: lists of 1 to 2 numbers; expected lists of one"):
        columns["x[0]"]


# --- HDF5 ---


def test_groups_of_one_kind_are_records(tmp_path: Path) -> None:
    path = hdf5_file(tmp_path / "log.h5")
    columns = read_columns(path)
    np.testing.assert_array_equal(columns["data/demo_1/elbow"], angle(ANGLE_TIMES + 1))
    np.testing.assert_array_equal(columns["data/demo_1/obs/joints[2]"], angle(ANGLE_TIMES))
    np.testing.assert_array_equal(columns["table.force"], [2, 2, 2])
    assert columns.others["mask"] == "no real numbers"
    assert [*columns.parts] == ["demo_0", "demo_1", "demo_2"]
    found = draft_file(path)
    assert "log.h5: 3 records" in found.notes
    (unit,) = [c.unit for c in found.columns if c.name == "elbow"]
    assert unit == "rad"
    card = 'name = "arm"\n[time]\ncolumn = "t"\n[[coordinates]]\nname = "elbow"\n'
    card += 'kind = "angular"\ncolumn = "elbow"\n'
    (tmp_path / "dataset.toml").write_text(card)
    data = tn.load(tmp_path)
    assert [e.name for e in data] == ["log[demo_0]", "log[demo_1]", "log[demo_2]"]
    np.testing.assert_array_equal(data[1].q[:, 0], angle(ANGLE_TIMES + 1))
    # a card may name the whole file's columns instead
    whole = card.replace('"t"', '"data/demo_2/t"').replace('n = "elbow"', 'n = "data/demo_2/elbow"')
    (tmp_path / "dataset.toml").write_text(whole)
    (record,) = tn.load(tmp_path)
    np.testing.assert_array_equal(record.q[:, 0], angle(ANGLE_TIMES + 2))


def test_links_and_deep_groups_of_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = ANGLE_TIMES
        file["round"] = h5py.SoftLink("/")
        file["away"] = h5py.ExternalLink("b.h5", "/")
    assert read_columns(tmp_path / "a.h5").names == ("x",)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["/".join(["g"] * 30) + "/x"] = ANGLE_TIMES
    with pytest.raises(tn.InputError, match="nested deeper than 20"):
        read_columns(tmp_path / "b.h5")
    assert readers.is_readable(tmp_path / "b.hdf5")
