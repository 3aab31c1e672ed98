"""MCAP files: topics of messages of ROS 2, or in JSON."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from tustinnet.data.formats.messages import Topic, topic_reader
from tustinnet.errors import InputError


@contextmanager
def _topics(path: Path) -> Iterator[tuple[list[Topic], int]]:
    """The topics of a file, and the time at which it begins [ns]."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise InputError(
                path,
                "the file has no summary: its recording was cut short",
                "a whole file",
                "repair it: mcap recover",
            )
        factory, topics = DecoderFactory(), []
        by_name: dict[str, list[int]] = {}
        for channel in summary.channels.values():
            by_name.setdefault(channel.topic, []).append(channel.id)

        def messages(name: str) -> Iterator[tuple[int, Any]]:
            decoders: dict[int, Callable[[bytes], Any]] = {}
            for schema, channel, message in reader.iter_messages(topics=[name]):
                if channel.id not in decoders:
                    decoder = factory.decoder_for(channel.message_encoding, schema)
                    if decoder is None and channel.message_encoding == "json":
                        decoder = json.loads
                    if decoder is None:
                        raise InputError(
                            name, f"encoding '{channel.message_encoding}'", "cdr or json"
                        )
                    decoders[channel.id] = decoder
                yield message.log_time, decoders[channel.id](message.data)

        for name, ids in by_name.items():
            count = sum(summary.statistics.channel_message_counts.get(k, 0) for k in ids)
            schema = summary.schemas.get(summary.channels[ids[0]].schema_id)
            if count:
                topics.append(
                    Topic(name, schema.name if schema else "", count, partial(messages, name))
                )
        yield topics, summary.statistics.message_start_time


READER = topic_reader("mcap.reader", _topics, "mcap")
