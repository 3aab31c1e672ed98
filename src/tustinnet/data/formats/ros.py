"""Bags of ROS 1 (.bag) and ROS 2 (.db3): topics of messages."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from tustinnet.data.formats.messages import Topic, topic_reader


@contextmanager
def _topics(path: Path) -> Iterator[tuple[list[Topic], int]]:
    """The topics of a bag, and the time at which it begins [ns]."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    # bags of ROS 2 before Iron do not define their messages
    store = get_typestore(Stores.LATEST)
    with AnyReader([path], default_typestore=store) as bag:

        def messages(connections: list[Any]) -> Iterator[tuple[int, Any]]:
            for connection, time, data in bag.messages(connections):
                yield time, bag.deserialize(data, connection.msgtype)

        by_topic = groupby(sorted(bag.connections, key=lambda c: c.topic), key=lambda c: c.topic)
        topics = []
        for name, group in by_topic:
            connections = [connection for connection in group if connection.msgcount]
            if connections:
                count = sum(connection.msgcount for connection in connections)
                kind = connections[0].msgtype
                topics.append(Topic(name, kind, count, partial(messages, connections)))
        yield topics, bag.start_time if topics else 0


READER = topic_reader("rosbags.highlevel", _topics, "ros")
