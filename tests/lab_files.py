"""Log files of laboratories, each written by the library of its format."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

SECONDS = 2.0
BEGIN = 1_700_000_000 * 10**9  # ns
ANGLE_TIMES = np.arange(0, SECONDS, 0.01)  # s
COMMAND_TIMES = np.arange(0.055, SECONDS, 0.05)  # s, an input that begins later


def angle(t: np.ndarray) -> np.ndarray:
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
column = "{topic}/time"
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
                header=header, name=[JOINTS[j] for j in order],
                position=np.array([0.25 * k, position])[order], velocity=np.array([]),
                effort=np.array([1.0, 2.0])[order],
            )  # fmt: skip
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
                "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9},
                           "frame_id": "arm"},
                "name": JOINTS, "position": [0.25 * k, float(angle(t))], "velocity": [],
                "effort": [1.0, 2.0],
            }  # fmt: skip
            writer.write_message("/joint_states", schema, message, stamp + 3_000_000, stamp)
        for t, command in zip(COMMAND_TIMES, commands(), strict=True):
            time, data = BEGIN + round(t * 1e9), json.dumps({"data": [command, 7], "note": "on"})
            json_writer.add_message(channel, time, data.encode(), time)
        writer.finish()
    return path
