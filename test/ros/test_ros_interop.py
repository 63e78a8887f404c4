"""Every ready map against plain rclpy over real DDS: a peer takes, and sends back, each message.

The peer handles messages typed: what it could not read would not come back, and what comes back is
rclpy's serialization, which our decoders must read like the bytes that went there.
"""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from peer import wait_for

from unicon_msgs_map import Decoder, Encoder
from unicon_ros import compat
from unicon_ros.bridge.own_node import OwnNode

sys.path.append(str(Path(__file__).resolve().parent.parent / "map"))
maps = pytest.importorskip("test_map_maps")

pytestmark = [pytest.mark.ros]

KILTED = ["ros-rclpy[fastrtps]==9.1.2", "ros-kilted-common-interfaces"]


@dataclass
class Case:
    """One entry of a ready map: bytes that go to the peer, and how to judge what comes back."""

    name: str
    type: str
    raw: bytes
    same: Callable[[bytes], bool]


def outgoing(stem: str, spec: Any, count: int, mapping: Any) -> Case:
    arrays = maps.states(count)
    encoder = Encoder.build(spec, arrays, {}, maps.variables(count))
    maps.fill(arrays)
    raw, store = encoder.encode(), mapping.messages.store
    sent = store.deserialize_cdr(raw, spec.type)

    def same(back: bytes) -> bool:
        return repr(store.deserialize_cdr(back, spec.type)) == repr(sent)

    return Case(f"{stem} publishes {spec.topic}", spec.type, raw, same)


def incoming(stem: str, spec: Any, count: int, mapping: Any) -> Case:
    raw = maps.serialize(maps.sample(spec, mapping, count), mapping.messages)

    def read(payload: bytes) -> dict[str, np.ndarray]:
        arrays = maps.states(count)
        decoder = Decoder.build(spec, arrays, {}, maps.variables(count))
        assert decoder.decode(payload), decoder.last_error
        return arrays

    def same(back: bytes) -> bool:
        ours, theirs = read(raw), read(back)
        assert any(np.any(ours[name]) for name in spec.states)
        return all(np.array_equal(ours[name], theirs[name]) for name in ours)

    return Case(f"{stem} subscribes {spec.topic}", spec.type, raw, same)


def cases() -> list[Case]:
    found = []
    for stem in maps.FILES:
        mapping, count = maps.loaded(stem)
        for kind, make in (("publish", outgoing), ("subscribe", incoming)):
            found += [
                make(stem, spec, count, mapping)
                for spec in getattr(mapping, kind)
                if compat.message_class(spec.type) is not None
            ]
    return found


@pytest.fixture(params=["same", pytest.param("kilted", marks=pytest.mark.slow)])
def python(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The interpreter of the peer: ours, or one with the wheels of another distribution."""
    if request.param == "same":
        return sys.executable
    given = os.environ.get("UNICON_KILTED_PYTHON")
    if given:
        return given
    home = tmp_path_factory.mktemp("kilted")
    venv.create(home, with_pip=True)
    found = str(home / "bin" / "python")
    install = [found, "-m", "pip", "install", "--quiet", *KILTED]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no wheels of Kilted here ({done.stderr.strip()[-300:]})")
    return found


@pytest.mark.timeout(600)
def test_plain_rclpy_reads_and_writes_what_the_ready_maps_say(
    peers: Callable[..., Any], python: str
) -> None:
    all_cases = cases()
    assert len(all_cases) > 20
    types = list(dict.fromkeys(case.type for case in all_cases))
    peers("echo", *types, python=python)
    own = OwnNode("interop", None, ())
    from rclpy.qos import QoSProfile

    deep = QoSProfile(depth=50)
    publish, take, subscriptions, publishers = {}, {}, [], []
    for number, kind in enumerate(types):
        message = compat.message_class(kind)
        publishers.append(own.node.create_publisher(message, f"there_{number}", deep))
        subscriptions.append(
            own.node.create_subscription(
                message,
                f"back_{number}",
                lambda m: None,
                deep,
                raw=True,
                callback_group=compat.polled_group(),
            )
        )
        publish[kind] = compat.raw_publish(publishers[-1])
        take[kind] = compat.raw_take(subscriptions[-1])

    def matched() -> bool:
        counts = [p.get_subscription_count() for p in publishers]
        return min(counts + [s.get_publisher_count() for s in subscriptions]) == 1

    wait_for(matched, "the peer's topics", 30.0)
    wrong = []
    for case in all_cases:
        came: list[bytes] = []

        def back(case: Case = case, came: list[bytes] = came) -> bool:
            raw = take[case.type][0]()
            came.extend([raw] if raw is not None else [])
            return bool(came)

        publish[case.type][0](case.raw)
        wait_for(back, f"{case.name}: the message to come back", 5.0)
        if not case.same(came[0]):
            wrong.append(case.name)
    for _, release in (*publish.values(), *take.values()):
        release()
    own.close()
    assert wrong == []
