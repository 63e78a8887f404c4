"""Readers of others, to hold recordings against, and small recordings to break."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from unicon_lab.recording.recorder import Recorder

__all__ = ["flat", "message", "read_by_both", "small"]

KIND = "std_msgs/msg/String"
TOPICS = ("/even", "/odd")


def read_by_both(file: Path) -> dict[str, list[int]]:
    """Return topic to the times of its messages in [ns], as rosbags and as mcap read them."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with AnyReader([file]) as reader:
        found: dict[str, list[int]] = {c.topic: [] for c in reader.connections}
        counts = {c.topic: c.msgcount for c in reader.connections}
        for connection, stamp, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            found[connection.topic].append(stamp)
    assert counts == {topic: len(stamps) for topic, stamps in found.items()}
    other: dict[str, list[int]] = {topic: [] for topic in found}
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(counts.values())
        for _, channel, message, _ in reader.iter_decoded_messages():
            other[channel.topic].append(message.log_time)
    assert other == found
    return found


def message(number: int, size: int = 8) -> bytes:
    """Return a message of `KIND`, in CDR: a number with `size` digits."""
    text = b"%0*d\0" % (size, number)
    return b"\x00\x01\x00\x00" + len(text).to_bytes(4, "little") + text


def small(recorder: Recorder, count: int) -> None:
    """Give a recorder `count` messages on two topics, at 1, 2, 3, … ns, and close it."""
    write = [recorder.channel(topic, KIND) for topic in TOPICS]
    recorder.start()
    for number in range(count):
        write[number % 2](number + 1, message(number))
    recorder.close()


def flat(value: Any, dtype: Any) -> Any:
    """Return the numbers of a field in their order, shape (n,); those of named ones as well."""
    if isinstance(value, (list, tuple)) and value and not isinstance(value[0], (int, float, bool)):
        return np.concatenate([flat(each, dtype) for each in value])
    names = getattr(value, "__slots__", None) or getattr(value, "__dataclass_fields__", ())
    named = [getattr(value, name) for name in names if not name.startswith("_")]
    return np.asarray(named or value, dtype).reshape(-1)
