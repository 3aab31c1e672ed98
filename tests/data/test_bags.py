"""Bags of ROS and MCAP files: topics of messages."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lab_files import ANGLE_TIMES, CARD, angle, held_command, mcap_file, ros1_bag, ros2_bag

import tustinnet as tn
from tustinnet.data.file_inspection import inspect_file
from tustinnet.data.readers import read_columns

FILES = [
    ("log.bag", ros1_bag), ("log.db3", ros2_bag), ("log.mcap", ros2_bag), ("json.mcap", mcap_file),
]  # fmt: skip


@pytest.mark.parametrize(("name", "write"), FILES)
def test_numbers_of_topics_are_columns(
    tmp_path: Path, name: str, write: Callable[[Path], Path]
) -> None:
    columns = read_columns(write(tmp_path / name))
    assert {
        "joint_states/time", "joint_states/position/elbow", "joint_states/position/shoulder",
        "joint_states/effort/elbow", "command/time", "command/data[0]", "command/data[1]",
    } <= {*columns.names}  # fmt: skip
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
        CARD.format(time="joint_states/time", position="joint_states/position/elbow",
                    command="command/data[0]")
    )  # fmt: skip
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
    found = inspect_file(write(tmp_path / name))
    roles = {column.name: column.role for column in found.columns}
    assert roles["joint_states/time"] == roles["command/time"] == "time"
    assert roles["joint_states/position/elbow"] == "position"
    assert found.dt == pytest.approx(0.01)
    (tmp_path / "dataset.toml").write_text(found.draft)
    (record,) = tn.load(tmp_path)
    assert {"joint_states_position_elbow"} <= {c.name for c in record.channels.coordinates}
