"""Publishers that misbehave, over real DDS: right values or the declared policy, and a diagnostic.

Names come reordered, incomplete, unknown or not at all, arrays too short, bytes malformed or cut.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rosbags.typesys import Stores, get_typestore
from talkers import Talker

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

N = 6
NAMES = [f"joint_{k}" for k in range(N)]
JOINT_STATE = "sensor_msgs/msg/JointState"
MAP = """\
subscribe:
  - topic: {policy}
    type: sensor_msgs/msg/JointState
    missing: {missing}
    extra: {extra}
    unnamed: {unnamed}
    fields: {{name: $joint_names, position: joint_pos, velocity: joint_vel}}
"""
POLICIES = {
    "keeps": ("hold", "ignore", "error"),
    "zeroes": ("zero", "ignore", "error"),
    "refuses": ("error", "error", "error"),
    "in_order": ("hold", "ignore", "order"),
}


class Line:
    """A publisher, and our topics with one policy each, in namespaces of the policies' names."""

    def __init__(self, folder: Path) -> None:
        words = []
        for name, (missing, extra, unnamed) in POLICIES.items():
            path = folder / f"{name}.yaml"
            path.write_text(
                MAP.format(policy="states", missing=missing, extra=extra, unnamed=unnamed)
            )
            words.append(f"{path}={N}")
        self.ours = Talker("map_host", *words).ready()
        self.peer = Talker("plain_peer").ready()
        for name in POLICIES:  # until both sides have found each other
            self.ours.wait(
                lambda name=name: self.took(name),  # type: ignore[misc]
                f"the first message of {name}",
                again=lambda name=name: self.publish(name, position=[0.0] * N, name=NAMES),  # type: ignore[misc]
            )
        time.sleep(0.5)  # what was published again may still come

    def publish(self, policy: str, **message: Any) -> None:
        """Publish a JointState."""
        self.peer.tell(publish=f"/{policy}/states", type=JOINT_STATE, message=message)

    def raw(self, policy: str, data: bytes) -> None:
        """Publish bytes."""
        self.peer.tell(raw=f"/{policy}/states", type=JOINT_STATE, hex=data.hex())

    def took(self, policy: str) -> dict[str, Any]:
        """Return what our side told last."""
        told = self.ours.of("took", topic=f"/{policy}/states")
        return told[-1] if told else {}

    def after(self, policy: str, act: Callable[[], object]) -> dict[str, Any]:
        """Do something and return what our side tells of the message that then came."""
        before = self.took(policy)["received"]
        act()
        self.ours.wait(lambda: self.took(policy)["received"] > before, f"a message on {policy}")
        return self.took(policy)

    def says(self, policy: str, **message: Any) -> dict[str, Any]:
        """Publish a JointState and return what our side tells of it."""
        return self.after(policy, lambda: self.publish(policy, **message))

    def reaches(self, policy: str, position: list[float]) -> dict[str, Any]:
        """Publish whole names and positions behind other messages; return what is told of it."""
        self.publish(policy, name=NAMES, position=position)
        self.ours.wait(
            lambda: self.took(policy)["states"]["joint_pos"] == position,
            f"{position} on {policy}",
        )
        return self.took(policy)


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Line]:
    made = Line(tmp_path_factory.mktemp("maps"))
    yield made
    assert made.ours.end() == 0, made.ours.errors
    made.peer.kill()


def values(start: float) -> list[float]:
    return [start + k for k in range(N)]


@pytest.mark.parametrize("policy", POLICIES)
def test_every_change_of_joint_order_is_followed(line: Line, policy: str) -> None:
    dice = random.Random(5)
    for turn in range(10):
        order = list(range(N))
        dice.shuffle(order)
        told = line.says(
            policy,
            name=[NAMES[k] for k in order],
            position=[10.0 * turn + k for k in order],
            velocity=[-float(k) for k in order],
        )
        assert told["states"]["joint_pos"] == values(10.0 * turn)
        assert told["states"]["joint_vel"] == [-float(k) for k in range(N)]


def test_dropped_names_are_refused_with_the_reason(line: Line) -> None:
    line.says("keeps", name=NAMES, position=values(1.0))
    told = line.says("keeps", position=values(50.0))
    assert told["states"]["joint_pos"] == values(1.0)
    assert told["rejected"] == 1
    assert "name is empty, and unnamed: error is declared" in told["error"]
    assert any("a message was refused" in warning for warning in told["warnings"])


def test_dropped_names_mean_our_order_where_that_is_declared(line: Line) -> None:
    told = line.says("in_order", position=values(20.0))
    assert told["states"]["joint_pos"] == values(20.0)
    told = line.says("in_order", position=values(50.0)[:3])  # whose three?
    assert told["states"]["joint_pos"] == values(20.0)
    assert "3" in told["error"]


def test_half_the_joints_leave_the_others_as_declared(line: Line) -> None:
    half = {"name": NAMES[3:], "position": [70.0, 71.0, 72.0]}
    for policy in ("keeps", "zeroes", "refuses"):
        line.says(policy, name=NAMES, position=values(30.0), velocity=values(0.0))
    told = line.says("keeps", **half)
    assert told["states"]["joint_pos"] == [30.0, 31.0, 32.0, 70.0, 71.0, 72.0]
    assert told["states"]["joint_vel"] == values(0.0)  # none came
    told = line.says("zeroes", **half)
    assert told["states"]["joint_pos"] == [0.0, 0.0, 0.0, 70.0, 71.0, 72.0]
    told = line.says("refuses", **half)
    assert told["states"]["joint_pos"] == values(30.0)
    assert "lacks 'joint_0', 'joint_1', 'joint_2', and missing: error" in told["error"]


def test_unknown_joints_are_ignored_or_refused_as_declared(line: Line) -> None:
    more = {"name": ["gripper", *NAMES], "position": [9.0, *values(40.0)]}
    assert line.says("keeps", **more)["states"]["joint_pos"] == values(40.0)
    told = line.says("refuses", **more, velocity=[0.0] * (N + 1))
    assert "unknown 'gripper'" in told["error"]
    assert told["states"]["joint_pos"] != values(40.0)


def test_a_name_that_stands_twice_and_counts_that_differ_are_refused(line: Line) -> None:
    line.says("keeps", name=NAMES, position=values(1.0))
    twice = [NAMES[0], *NAMES[:-1]]
    assert "twice" in line.says("keeps", name=twice, position=values(5.0))["error"]
    told = line.says("keeps", name=NAMES, position=values(5.0)[:4])
    assert told["states"]["joint_pos"] == values(1.0)
    assert "position" in told["error"]


def test_numbers_that_are_not_finite_are_refused(line: Line) -> None:
    line.says("keeps", name=NAMES, position=values(1.0))
    for wrong in (float("nan"), float("inf"), 1e300):
        told = line.says("keeps", name=NAMES, position=[wrong, *values(1.0)[1:]])
        assert told["states"]["joint_pos"] == values(1.0)
        assert "joint_0" in told["error"]


def joint_state(position: list[float], *, little: bool = True) -> bytes:
    """Return a JointState by rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="x")
    empty = np.zeros(0)
    message = types[JOINT_STATE](header, NAMES, np.array(position), empty, empty)
    return bytes(store.serialize_cdr(message, JOINT_STATE, little_endian=little))


def test_big_endian_bytes_are_read(line: Line) -> None:
    told = line.after("keeps", lambda: line.raw("keeps", joint_state(values(3.0), little=False)))
    assert told["states"]["joint_pos"] == values(3.0)


def test_every_cut_of_a_message_is_refused_and_the_next_whole_one_read(line: Line) -> None:
    line.says("keeps", name=NAMES, position=values(1.0), velocity=values(2.0))
    whole = joint_state(values(80.0))
    before = line.took("keeps")
    # 2 bytes are not an encapsulation header; the middleware itself may drop those.
    for length in range(5, len(whole) - 20, 7):
        line.raw("keeps", whole[:length])
        time.sleep(0.012)  # a tick of the host: each is looked at
    told = line.reaches("keeps", values(6.0))
    assert told["rejected"] > before["rejected"] + 10
    for line_ in line.ours.of("took", topic="/keeps/states"):
        if before["received"] < line_["received"] < told["received"]:
            assert line_["states"]["joint_pos"] == values(1.0), line_["error"]


def test_mutated_and_random_bytes_never_end_the_process(line: Line) -> None:
    dice, whole = random.Random(11), joint_state(values(8.0))
    for turn in range(200):
        data = bytearray(whole)
        for _ in range(1 + turn % 4):
            data[4 + dice.randrange(len(data) - 4)] = dice.randrange(256)
        if turn % 5 == 0:
            data[4:] = dice.randbytes(dice.randrange(200))
        line.raw("zeroes", bytes(data))
        if turn % 4 == 0:
            time.sleep(0.01)
    told = line.reaches("zeroes", values(6.0))
    assert told["rejected"] > 20
    assert line.ours.process.poll() is None
