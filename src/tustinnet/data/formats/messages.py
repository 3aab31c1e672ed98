"""Messages of topics, as ROS and MCAP record them: their numbers as columns `topic/field`.

A message has fields, which may be messages again. `joint_states/position/elbow` is the position of
the joint `elbow`: where a message has a list of names, lists of that length go by these names,
others by number: `command/data[0]`.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.formats.reader import Array, Contents, Reader
from tustinnet.errors import describe_error

_LONGEST_LIST = 64  # numbers of a list that can be columns: pictures and scans are none
_DEEPEST_MESSAGE = 12  # messages in one another
_LABELS = ("name", "names", "joint_names", "interface_names", "motor_names")
_SECONDS = ("sec", "secs", "seconds")
_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
# units of joint states, of joints that turn and of joints that slide, and words for the latter
_JOINT_UNITS = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "effort": ("N m", "N")}
_LENGTHS = {
    "prismatic",
    "slider",
    "slide",
    "linear",
    "lift",
    "rail",
    "cart",
    "carriage",
    "gripper",
    "finger",
    "x",
    "y",
    "z",
}
_SAME_EPOCH = 86_400 * 10**9  # ns: header stamps further from the reception are of another clock

Message = Any


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic of a recording.

    Attributes:
        name: its name.
        kind: type of its messages.
        count: number of messages.
        messages: function that gives the time at which each was received [ns], and the message.
    """

    name: str
    kind: str
    count: int
    messages: Callable[[], Iterator[tuple[int, Message]]]


class _Layout(NamedTuple):
    """Columns of a topic, the columns of times of each, and whether these are header stamps."""

    prefix: str
    clocks: dict[str, str]
    others: dict[str, str]
    has_stamps: bool


def topic_reader(
    library: str,
    open_topics: Callable[[Path], AbstractContextManager[tuple[list[Topic], int]]],
    extra: str,
) -> Reader:
    """The reader of a kind of recordings.

    Args:
        library: the module that it needs.
        open_topics: function that opens a file and gives its topics and its begin [ns].
        extra: the extra of this package that installs the library.
    """

    def contents(path: Path) -> Contents:
        with open_topics(path) as (topics, begin):
            return topic_contents(topics, begin)

    def arrays(path: Path, names: set[str]) -> dict[str, Array]:
        with open_topics(path) as (topics, begin):
            return topic_arrays(topics, begin, names)

    return Reader(library, contents, arrays, extra, speed=1e6)


def topic_contents(topics: Iterable[Topic], begin: int) -> Contents:
    """The columns of some topics, by their first messages.

    Args:
        topics: the topics.
        begin: time from which the times of columns count [ns].
    """
    arrays, others, clocks, units, stamped, received = [], {}, {}, {}, [], []
    for topic in sorted(topics, key=lambda topic: topic.name):
        try:
            layout = _layout(topic)
        except Exception as error:
            others[topic.name.strip("/")] = f"of messages {topic.kind} ({describe_error(error)})"
            continue
        others |= layout.others
        if not layout.clocks:
            if not layout.others:
                others[layout.prefix] = f"of messages {topic.kind} without numbers"
            continue
        (stamped if layout.has_stamps else received).append(layout.prefix)
        times = dict.fromkeys(layout.clocks.values())
        arrays += [(name, (topic.count,)) for name in (*times, *layout.clocks)]
        clocks |= {**layout.clocks, **{time: time for time in times}}
        if topic.kind.endswith("JointState"):
            units |= {name: _joint_unit(name.removeprefix(layout.prefix)) for name in layout.clocks}
    notes = (
        [f"times count from {begin // 10**9}.{begin % 10**9:09} s of the recorder's clock"]
        if arrays
        else []
    )
    for names, text in ((stamped, "the stamps in their headers"), (received, "those of reception")):
        if names:
            more = ", ..." if len(names) > 8 else ""
            notes.append(f"times of {', '.join(names[:8])}{more} are {text}")
    units |= dict.fromkeys(clocks.values(), "s")
    return Contents(arrays, others, clocks, units, notes=tuple(notes))


def topic_arrays(topics: Iterable[Topic], begin: int, names: set[str]) -> dict[str, Array]:
    """The columns of some names, each as long as there are messages that have it."""
    arrays: dict[str, Array] = {}
    for topic in topics:
        prefix = topic.name.strip("/")
        if not any(name.startswith(f"{prefix}/") for name in names):
            continue
        layout = _layout(topic)
        times = dict.fromkeys(layout.clocks.values())
        # a clock ticks with the messages that have the first of its columns
        ticks = {t: next(c for c, clock in layout.clocks.items() if clock == t) for t in times}
        requested = {*names} & {*layout.clocks, *times}
        if not requested:
            continue
        columns = {ticks.get(name, name) for name in requested}
        # the fields of a message in which they are
        fields = {re.split(r"[/[]", name.removeprefix(f"{prefix}/"))[0] for name in columns}
        stamps: list[int] = []
        values: dict[str, list[float]] = {name: [] for name in columns}
        places: dict[str, list[int]] = {name: [] for name in columns}
        for k, (received, message) in enumerate(topic.messages()):
            stamps.append((_stamp(message) if layout.has_stamps else received) or 0)
            for name, value in _numbers(f"{prefix}/", message, only=fields):
                if name in columns and isinstance(value, float):
                    values[name].append(value)
                    places[name].append(k)
        elapsed = (
            np.array([t - (begin if _is_near(t, begin) else 0) for t in stamps], np.int64) / 1e9
        )
        for name in requested:
            column = ticks.get(name, name)
            t = elapsed[places[column]]
            order = np.argsort(t, kind="stable")
            # of messages of one time the last one counts
            order = order[np.append(np.diff(t[order]) > 0, True)] if len(order) else order
            arrays[name] = (t if name in ticks else np.array(values[column]))[order]
    return arrays


def _joint_unit(field: str) -> str:
    """The unit of a field of a joint state by the convention of ROS (REP 103); empty if unknown."""
    _, quantity, joint = (*re.split(r"[/[]", field, maxsplit=2), "", "")[:3]
    is_length = bool(_LENGTHS & {*re.findall("[a-z]+", joint.lower())})
    return _JOINT_UNITS.get(quantity, ("", ""))[is_length]


def _is_near(stamp: int, begin: int) -> bool:
    return abs(stamp - begin) < _SAME_EPOCH


def _layout(topic: Topic) -> _Layout:
    """The columns in the first messages of a topic; columns of the same messages share a clock."""
    prefix = topic.name.strip("/")
    present: dict[str, list[int]] = {}
    others: dict[str, str] = {}
    stamps: list[int | None] = []
    for k, (_, message) in enumerate(islice(topic.messages(), 50)):
        stamps.append(_stamp(message))
        for name, value in _numbers(f"{prefix}/", message):
            if isinstance(value, str):
                others[name] = value
            else:
                present.setdefault(name, []).append(k)
    clocks: dict[tuple[int, ...], str] = {}
    words = ("time", "stamp", "time of message")
    word = next(word for word in words if f"{prefix}/{word}" not in present)
    for places in sorted(map(tuple, present.values()), key=len, reverse=True):
        number = f"[{len(clocks)}]" if clocks else ""
        clocks.setdefault(places, f"{prefix}/{word}{number}")
    return _Layout(
        prefix,
        {name: clocks[tuple(places)] for name, places in present.items()},
        {name: text for name, text in others.items() if name not in present},
        bool(stamps) and all(stamps) and (len(stamps) == 1 or len({*stamps}) > 1),
    )


def _fields(message: Message) -> dict[str, Any] | None:
    """The fields of a message by name, None of anything else."""
    if isinstance(message, dict):
        return {str(name): value for name, value in message.items()}
    names = _field_names(type(message))
    return {name: getattr(message, name) for name in names} if names else None


@lru_cache(maxsize=1000)  # classes are made for each file
def _field_names(kind: type) -> tuple[str, ...]:
    """The names of the fields of a class of messages, none of another class."""
    if dataclasses.is_dataclass(kind):
        return tuple(f.name for f in dataclasses.fields(kind) if f.name != "__msgtype__")
    return tuple(getattr(kind, "__slots__", ()))


def _nanoseconds(value: Any) -> int | None:
    """The time in a message of seconds and nanoseconds [ns], None of another message."""
    fields = _fields(value)
    if fields is None or len(fields) != 2:
        return None
    seconds = next((fields[name] for name in _SECONDS if name in fields), None)
    rest = next((fields[name] for name in _NANOSECONDS if name in fields), None)
    return None if seconds is None or rest is None else int(seconds) * 10**9 + int(rest)


def _stamp(message: Message) -> int | None:
    """The stamp in the header of a message [ns], None without one."""
    header = (_fields(message) or {}).get("header")
    stamp = (_fields(header) or {}).get("stamp")
    return None if stamp is None else _nanoseconds(stamp)


def _numbers(
    prefix: str,
    message: Message,
    labels: list[str] | None = None,
    depth: int = 0,
    only: set[str] | None = None,
) -> Iterator[tuple[str, float | str]]:
    """Numbers in a message, or in some fields of it, by name, and descriptions of what is none."""
    if depth > _DEEPEST_MESSAGE:
        yield prefix.rstrip("/"), f"messages nested deeper than {_DEEPEST_MESSAGE}"
        return
    fields = _fields(message) or {}
    lists = (fields[name] for name in _LABELS if name in fields)
    own = next((value for value in lists if _is_list_of_text(value)), None)
    labels = [str(text).strip("/") for text in own] if own is not None else labels
    if labels is not None and (len({*labels}) < len(labels) or not all(labels)):
        labels = None  # they name nothing
    for name, value in fields.items():
        if (depth == 0 and name == "header") or (only is not None and name not in only):
            continue
        yield from _value(f"{prefix}{name}", value, labels, depth)


def _value(
    name: str, value: Any, labels: list[str] | None, depth: int
) -> Iterator[tuple[str, float | str]]:
    if isinstance(value, bool | int | float | np.bool_ | np.number):
        yield name, float(value)
    elif isinstance(value, str | bytes | None):
        yield name, "text" if isinstance(value, str) else "no numbers"
    elif (time := _nanoseconds(value)) is not None:
        yield name, time / 1e9
    elif _fields(value) is not None:
        yield from _numbers(f"{name}/", value, labels, depth + 1)
    elif len(value) > _LONGEST_LIST:
        yield name, f"a list of {len(value)}, longer than {_LONGEST_LIST}"
    else:
        items = value.tolist() if isinstance(value, np.ndarray) else value
        by_label = labels is not None and len(labels) == len(items)
        for k, item in enumerate(items):
            label = f"/{labels[k]}" if labels is not None and by_label else f"[{k}]"
            if isinstance(item, str):
                yield name, "text"
            elif isinstance(item, list | tuple | np.ndarray):
                yield name, "a list of lists"
            else:
                yield from _value(f"{name}{label}", item, None, depth)


def _is_list_of_text(value: Any) -> bool:
    return (
        isinstance(value, list | tuple | np.ndarray)
        and len(value) > 0
        and all(isinstance(text, str) for text in value)
    )
