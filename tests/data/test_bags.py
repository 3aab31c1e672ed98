"""Bags of ROS and MCAP files: topics of messages."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lab_files import ANGLE_TIMES, CARD, angle, held_command, mcap_file, ros1_bag, ros2_bag
from mcap.writer import Writer

import tustinnet as tn
from tustinnet.data.drafting.draft import draft_card, draft_file
from tustinnet.data.readers import read_columns

FILES = [
    ("log.bag", ros1_bag),
    ("log.db3", ros2_bag),
    ("log.mcap", ros2_bag),
    ("json.mcap", mcap_file),
]


@pytest.mark.parametrize(("name", "write"), FILES)
def test_numbers_of_topics_are_columns(
    tmp_path: Path, name: str, write: Callable[[Path], Path]
) -> None:
    columns = read_columns(write(tmp_path / name))
    assert {
        "joint_states/time",
        "joint_states/position/elbow",
        "joint_states/position/shoulder",
        "joint_states/effort/elbow",
        "command/time",
        "command/data[0]",
        "command/data[1]",
    } <= {*columns.names}
    # by the stamps in the headers, not those of reception 3 ms later
    begin = columns["joint_states/time"][0]
    np.testing.assert_allclose(columns["joint_states/time"] - begin, ANGLE_TIMES, atol=1e-9)
    np.testing.assert_allclose(columns["joint_states/position/elbow"], angle(ANGLE_TIMES))
    np.testing.assert_allclose(columns["joint_states/position/shoulder"], 0.25 * np.arange(200))
    assert columns.clocks["command/data[0]"] == "command/time"
    assert "times of joint_states are the stamps in their headers" in columns.notes
    assert "times of command are those of reception" in columns.notes
    others = {"command/note"} if write is mcap_file else {"note/data"}
    assert others <= {name for name, text in columns.others.items() if text == "text"}


@pytest.mark.parametrize(("name", "write"), FILES)
def test_topics_are_brought_onto_the_times_of_the_coordinate(
    tmp_path: Path, name: str, write: Callable[[Path], Path]
) -> None:
    write(tmp_path / name)
    (tmp_path / "dataset.toml").write_text(
        CARD.format(
            time="joint_states/time",
            position="joint_states/position/elbow",
            command="command/data[0]",
        )
    )
    (record,) = tn.load(tmp_path)
    begin = len(ANGLE_TIMES) - len(record)
    assert begin == 6  # the first command comes at 0.055 s
    np.testing.assert_allclose(record.q[:, 0], angle(ANGLE_TIMES[begin:]), atol=1e-12)
    expected = [held_command(t) for t in ANGLE_TIMES[begin:-1]]
    np.testing.assert_allclose(record.u[:-1, 0], expected, atol=2e-3)
    assert (
        "command/data[0] brought from command/time (20 Hz) onto joint_states/time" in record.notes
    )
    assert "6 of 200 samples of joint_states/time left out: others have none" in record.notes


@pytest.mark.parametrize(("name", "write"), FILES)
def test_the_draft_of_a_card_reads_the_file(
    tmp_path: Path, name: str, write: Callable[[Path], Path]
) -> None:
    found = draft_file(write(tmp_path / name))
    roles = {column.name: column.role for column in found.columns}
    assert roles["joint_states/time"] == roles["command/time"] == "time"
    assert roles["joint_states/position/elbow"] == "position"
    assert found.dt == pytest.approx(0.01)
    (tmp_path / "dataset.toml").write_text(found.text)
    (record,) = tn.load(tmp_path)
    assert {"elbow"} <= {c.name for c in record.channels.coordinates}


def test_of_many_columns_those_named_as_motions_are_looked_at(tmp_path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(tmp_path / "log.tdms") as file:
        for k in range(70):
            name = "position" if k == 65 else f"field {k}"
            step = {"wf_increment": 0.01}
            file.write_segment([ChannelObject(f"group {k}", name, angle(ANGLE_TIMES), step)])
    found = draft_file(tmp_path / "log.tdms")
    names = [column.name for column in found.columns]
    assert {"group 65/position", "group 65/time", "group 58/field 58"} <= {*names}
    assert "group 69/field 69" not in names
    assert (
        "120 of 140 columns are looked at, those named as positions and inputs first" in found.notes
    )


# --- messages ---


def test_joints_of_several_publishers_have_times_of_their_own(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("joints", "jsonschema", b"{}")
        channel = writer.register_channel("/arm/joint_states", "json", schema)
        for k in range(80):
            joints = ["a", "b"] if k % 4 else ["grip"]
            stamp = 5 if k == 7 else k  # two messages of one time: the later one counts
            message = {
                "name": joints,
                "position": [k + j for j in range(len(joints))],
                "wide": [0] * 100,
                "goal": {"x": k, "on": True},
            }
            writer.add_message(channel, stamp * 10**7, json.dumps(message).encode(), stamp * 10**7)
        writer.finish()
    columns = read_columns(tmp_path / "log.mcap")
    prefix = "arm/joint_states"
    assert columns.clocks[f"{prefix}/position/a"] == columns.clocks[f"{prefix}/position/b"]
    assert columns.clocks[f"{prefix}/position/grip"] != columns.clocks[f"{prefix}/position/a"]
    grip = columns[columns.clocks[f"{prefix}/position/grip"]]
    np.testing.assert_allclose(grip, np.arange(0, 80, 4) / 100)
    np.testing.assert_array_equal(columns[f"{prefix}/position/grip"], np.arange(0, 80, 4))
    t = columns[columns.clocks[f"{prefix}/position/b"]]
    assert (np.diff(t) > 0).all()
    assert columns[f"{prefix}/position/b"][t == 0.05].tolist() == [8]
    assert columns[f"{prefix}/goal/on"].tolist() == [1.0] * 79
    assert columns.others[f"{prefix}/wide"] == "a list of 100, longer than 64"


def test_rows_of_a_draft_are_those_that_loading_takes(tmp_path: Path) -> None:
    """Topics with clocks of their own: a command that begins later, an encoder that ends sooner."""
    angle_times, command_times = np.arange(0.1, 40, 0.01), np.arange(1.0, 41, 0.02)
    # it moves for 8 s and rests for 2 s
    turn = 2.5 * np.cumsum(0.01 * ((angle_times % 10) < 8))
    angles, commands = np.sin(turn), np.where(command_times % 10 < 8, np.cos(command_times), 0.0)
    samples = [(t, "/encoder", {"angle_rad": q}) for t, q in zip(angle_times, angles, strict=True)]
    samples += [(t, "/motor", {"volts": u}) for t, u in zip(command_times, commands, strict=True)]
    samples += [(t, "/battery", {"temp": 20.0 + t}) for t in np.arange(5.0, 9.0)]
    with (tmp_path / "long.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels: dict[str, int] = {}
        for t, topic, message in sorted(samples, key=lambda sample: sample[:2]):
            if topic not in channels:
                schema = writer.register_schema(topic, "jsonschema", b"{}")
                channels[topic] = writer.register_channel(topic, "json", schema)
            stamp, data = round(t * 1e9), json.dumps(message).encode()
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()
    draft = draft_card(tmp_path, ["long.mcap"])
    assert "long.mcap: 90 of 3990 samples left out: other columns have none there" in draft.notes
    (tmp_path / "dataset.toml").write_text(draft.text)
    data = tn.load(tmp_path)
    assert len(data) == 4  # cut in the rests
    assert sum(len(record) for record in data) == 3900
    later = [record for record in data if record.first_row > 0]
    assert len(later) == 3
    for record in later:  # it rests where the log was cut
        assert np.ptp(record.q[:20]) < 1e-9
