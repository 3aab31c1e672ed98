"""Log files of laboratories, each written by the library of its format."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

SECONDS = 2.0
BEGIN = 1_700_000_000 * 10**9  # ns
ANGLE_TIMES = np.arange(0, SECONDS, 0.01)  # s
COMMAND_TIMES = np.arange(0.055, SECONDS, 0.05)  # s, an input that begins later


def angle(t: Any) -> Any:
    return np.sin(3 * t)


def commands() -> np.ndarray:
    return np.random.default_rng(0).choice([-2.0, 0.5, 1.0], len(COMMAND_TIMES))


def held_command(t: float, dt: float = 0.01) -> float:
    """Mean of the command over a period: held from sample to sample."""
    fine = t + dt * (np.arange(1000) + 0.5) / 1000
    return float(np.mean(commands()[np.searchsorted(COMMAND_TIMES, fine, "right") - 1]))


CARD = """
name = "arm"
[time]
column = "{time}"
[[coordinates]]
name = "elbow"
kind = "angular"
column = "{position}"
[[inputs]]
name = "motor"
column = "{command}"
unit = "V"
"""


# --- messages ---

JOINTS = ["shoulder", "elbow"]


def ros_messages(types: dict[str, Any], *, version: int) -> Iterator[tuple[str, int, Any]]:
    """Topic, time of reception [ns] and message, as they were received."""
    events = [(t + 0.003, "/joint_states", k) for k, t in enumerate(ANGLE_TIMES)]
    events += [(t, "/command", k) for k, t in enumerate(COMMAND_TIMES)]
    events += [(0.5, "/note", 0)]
    for received, topic, k in sorted(events):
        if topic == "/joint_states":
            stamp = BEGIN + round(ANGLE_TIMES[k] * 1e9)
            time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            sequence = {"seq": k} if version == 1 else {}
            header = types["std_msgs/msg/Header"](stamp=time, frame_id="arm", **sequence)
            position = angle(ANGLE_TIMES[k])
            order = [0, 1] if k % 2 else [1, 0]  # names may come in any order
            message = types["sensor_msgs/msg/JointState"](
                header=header,
                name=[JOINTS[j] for j in order],
                position=np.array([0.25 * k, position])[order],
                velocity=np.array([]),
                effort=np.array([1.0, 2.0])[order],
            )
        elif topic == "/command":
            dimension = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            data = np.array([commands()[k], 7.0])
            message = types["std_msgs/msg/Float64MultiArray"](layout=dimension, data=data)
        else:
            message = types["std_msgs/msg/String"](data="a pause")
        yield topic, BEGIN + round(received * 1e9), message


def ros1_bag(path: Path) -> Path:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as bag:
        connections: dict[str, Any] = {}
        for topic, time, message in ros_messages(store.types, version=1):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], time, store.serialize_ros1(message, kind))
    return path


def ros2_bag(path: Path) -> Path:
    """A bag of ROS 2: its file, in a folder of its own."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    folder = path.with_suffix("")
    with Writer(folder, version=9, storage_plugin=plugin) as bag:
        connections: dict[str, Any] = {}
        for topic, time, message in ros_messages(store.types, version=2):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], time, store.serialize_cdr(message, kind))
    (written,) = folder.glob(f"*{path.suffix}")
    written.rename(path)
    return path


JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def mcap_file(path: Path) -> Path:
    """A file of joint states of ROS 2 and commands in JSON."""
    import json

    from mcap.writer import Writer as JsonWriter
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        json_writer: JsonWriter = writer._writer
        json_schema = json_writer.register_schema("command", "jsonschema", b"{}")
        channel = json_writer.register_channel("/command", "json", json_schema)
        for k, t in enumerate(ANGLE_TIMES):
            stamp = BEGIN + round(t * 1e9)
            message = {
                "header": {
                    "stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9},
                    "frame_id": "arm",
                },
                "name": JOINTS,
                "position": [0.25 * k, float(angle(t))],
                "velocity": [],
                "effort": [1.0, 2.0],
            }
            writer.write_message("/joint_states", schema, message, stamp + 3_000_000, stamp)
        for t, command in zip(COMMAND_TIMES, commands(), strict=True):
            time, data = BEGIN + round(t * 1e9), json.dumps({"data": [command, 7], "note": "on"})
            json_writer.add_message(channel, time, data.encode(), time)
        writer.finish()
    return path


# --- groups and topics ---


def ulog_file(path: Path) -> Path:
    """A log of PX4 of two topics, the second of which has two instances."""
    import struct

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), kind[0]) + content

    begin = 5_000_000  # us
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", begin), message(b"B", bytes(40))]
    parts += [
        message(
            b"F", b"arm_state:uint64_t timestamp;float[2] q;uint8_t mode;uint8_t[7] _padding0;"
        ),
        message(b"F", b"actuator:uint64_t timestamp;double volts;"),
        message(b"A", struct.pack("<BH", 0, 0) + b"arm_state"),
        message(b"A", struct.pack("<BH", 0, 1) + b"actuator"),
        message(b"A", struct.pack("<BH", 1, 2) + b"actuator"),
    ]
    events = [
        (t, struct.pack("<HQ2fB", 0, begin + round(t * 1e6), angle(t), t, 3)) for t in ANGLE_TIMES
    ]
    for t, command in zip(COMMAND_TIMES, commands(), strict=True):
        stamp = begin + round(t * 1e6)
        events += [(t, struct.pack("<HQd", 1, stamp, command))]
        events += [(t, struct.pack("<HQd", 2, stamp, -command))]
    parts += [message(b"D", data) for _, data in sorted(events)]
    raw = path.with_suffix(".raw")
    raw.write_bytes(b"".join(parts))
    from pyulog import ULog

    ULog(str(raw)).write_ulog(str(path))
    raw.unlink()
    return path


def mdf_file(path: Path) -> Path:
    from asammdf import MDF, Signal

    with MDF(version="3.30" if path.suffix == ".mdf" else "4.10") as file:
        motion = [
            Signal(angle(ANGLE_TIMES), ANGLE_TIMES, name="elbow", unit="rad"),
            Signal(np.arange(200, dtype=np.uint8), ANGLE_TIMES, name="counter"),
        ]
        file.append(motion, acq_name="motion", common_timebase=True)
        file.append([Signal(commands(), COMMAND_TIMES, name="volts", unit="V")], acq_name="drive")
        file.save(path, overwrite=True)
    return path


def tdms_file(path: Path) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    begin = np.datetime64("2026-01-01T12:00:00.000000", "us")

    def waveform(t: np.ndarray, unit: str) -> dict[str, Any]:
        return {
            "wf_start_time": begin,
            "wf_start_offset": float(t[0]),
            "unit_string": unit,
            "wf_increment": float(t[1] - t[0]),
        }

    with TdmsWriter(path) as file:
        file.write_segment(
            [
                ChannelObject("motion", "elbow", angle(ANGLE_TIMES), waveform(ANGLE_TIMES, "rad")),
                ChannelObject("motion", "note", ["a"] * 200),
                ChannelObject("drive", "volts", commands(), waveform(COMMAND_TIMES, "V")),
            ]
        )
    return path


# --- LeRobot ---


def lerobot_data_set(folder: Path, version: str) -> list[Path]:
    """A data set of three episodes of two motors: a file for each (v2), or one for all (v3)."""
    import json

    import polars as pl

    motors = ["shoulder.pos", "elbow.pos"]
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": motors},
        "action": {"dtype": "float32", "shape": [2], "names": {"motors": motors}},
        "observation.effort": {"dtype": "float32", "shape": [2], "names": None},
    }
    (folder / "meta").mkdir(parents=True)
    info = {"codebase_version": version, "fps": 50, "features": features}
    (folder / "meta/info.json").write_text(json.dumps(info))
    episodes = []
    for episode in range(3):
        t = np.arange(60 + 10 * episode) / 50
        state = np.column_stack([np.sin(3 * t + episode), np.cos(2 * t)]).astype(np.float32)
        table = {
            "observation.state": state,
            "action": np.roll(state, -1, axis=0).tolist(),
            "observation.effort": (2 * state).tolist(),
            "timestamp": t.astype(np.float32),
            "episode_index": np.full(len(t), episode),
            "frame_index": np.arange(len(t)),
        }
        episodes.append(pl.DataFrame(table))
    (folder / "data/chunk-000").mkdir(parents=True)
    if version.startswith("v2"):
        files = [folder / f"data/chunk-000/episode_{k:06}.parquet" for k in range(3)]
        for file, table in zip(files, episodes, strict=True):
            table.write_parquet(file)
        return files
    file = folder / "data/chunk-000/file-000.parquet"
    pl.concat(episodes).write_parquet(file)
    return [file]


# --- groups of arrays ---


def hdf5_file(path: Path) -> Path:
    """A file of three demonstrations in groups, as robot learning has them."""
    import h5py

    with h5py.File(path, "w") as file:
        for k in range(3):
            group = file.create_group(f"data/demo_{k}")
            group["elbow"] = angle(ANGLE_TIMES + k)
            group["elbow"].attrs["units"] = "rad"
            group["obs/joints"] = np.column_stack([ANGLE_TIMES, angle(ANGLE_TIMES)])
            group["t"] = ANGLE_TIMES
        file["mask"] = ["demo_0", "demo_1"]
        file.create_dataset(
            "table", data=np.array([(1, 2.0)] * 3, dtype=[("count", "i4"), ("force", "f8")])
        )
    return path


def workbook(path: Path, sheets: dict[str, list[list[Any]]]) -> Path:
    import xlsxwriter

    with xlsxwriter.Workbook(path) as book:
        for name, table in sheets.items():
            sheet = book.add_worksheet(name)
            for row, cells in enumerate(table):
                sheet.write_row(row, 0, cells)
    return path
