"""Two robots in one domain for a minute, recorded and driven: nothing of one is the other's.

Names, frames, clocks, bags, diagnostics and the emergency stop are looked at, from the outside and
in the two recordings. The operator is a plain rclpy process; it equals what teleop_twist_keyboard,
`ros2 service call` and a monitor of /diagnostics do.
"""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")
pytest.importorskip("rosbags")

from rosbags.highlevel import AnyReader

from unicon_lab.recording import Record, open_record

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SECONDS, ESTOP_AFTER = 60.0, 40.0
NODES = ("/robot1/walker1", "/robot2/walker2")
SHARED = {"/tf", "/tf_static", "/clock", "/unicon/ticks"}


@pytest.fixture
def told(
    start: Callable[..., subprocess.Popen[bytes]], domains: list[int], tmp_path: Path
) -> dict[str, Any]:
    """What the operator noted, after both recordings were closed."""
    nodes = []
    for name in NODES:
        _, space, node = name.split("/")
        clock = [] if space == "robot1" else ["-r", "/clock:=clock"]
        nodes.append(
            start(
                "steady_node", "--ros-args",
                "-r", f"__ns:=/{space}", "-r", f"__node:={node}", *clock,
                "-p", "workflow:=go2_teleop", "-p", f"frame_prefix:={space}/",
                "-p", f"record:={tmp_path / space}.mcap",
                domain=domains[0],
            )
        )  # fmt: skip
        time.sleep(2.0)  # clocks that are not in step
    out = tmp_path / "told.json"
    operator = start("drives_two", out, SECONDS, ESTOP_AFTER, *NODES, domain=domains[0])
    assert operator.wait(SECONDS + 100.0) == 0
    for node in nodes:
        assert node.poll() is None
        node.send_signal(signal.SIGINT)
    for node in nodes:
        assert node.wait(30.0) == 0
    found: dict[str, Any] = json.loads(out.read_text())
    return found


def messages(file: Path) -> dict[str, list[Any]]:
    """Return topic to its messages but the ticks."""
    found: dict[str, list[Any]] = {}
    with AnyReader([file]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic != "/unicon/ticks":
                read = reader.deserialize(raw, connection.msgtype)
                found.setdefault(connection.topic, []).append(read)
    return found


def nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def numbers_in(bag: dict[str, list[Any]], space: str) -> list[int]:
    """Return the numbers of the commands that a robot received."""
    return [round(message.linear.z) for message in bag[f"/{space}/cmd_vel"]]


@pytest.mark.timeout(240)
def test_two_robots_in_one_domain_do_not_mix(told: dict[str, Any], tmp_path: Path) -> None:
    spaces = ("robot1", "robot2")
    files = [tmp_path / f"{space}.mcap" for space in spaces]
    bags = [messages(file) for file in files]
    records = [open_record(file) for file in files]

    the_names_are_apart(told)
    for number, space in enumerate(spaces):
        bag, robot = bags[number], told["robots"][number]
        # Names: of topics all others stand below the robot's namespace.
        own = {topic for topic in bag if topic not in SHARED}
        names = {"joint_states", "imu/data", "odom", "robot_description", "cmd_vel"}
        names |= {"clock"} if space == "robot2" else set()
        assert own == {f"/{space}/{name}" for name in names}
        # Frames: with the robot's prefix, on the wire and in the bag.
        assert robot["frames"] == [[f"{space}/odom", f"{space}/base_link"]]
        frames = {
            frame
            for topic in ("/tf", "/tf_static")
            for message in bag[topic]
            for each in message.transforms
            for frame in (each.header.frame_id, each.child_frame_id)
        }
        assert {f"{space}/odom", f"{space}/base_link", f"{space}/FL_calf"} <= frames
        assert all(frame.startswith(f"{space}/") for frame in frames)
        the_clocks_are_apart(robot, bag, space, records[number])
        # Commands: those that were sent to this robot, in their order, and none of the other's.
        received = numbers_in(bag, space)
        assert received == sorted(set(received))
        assert set(received) <= set(robot["sent"])
        assert all(number_of % 2 == number for number_of in received)
    # The second one heard them to the end, the first one until it was stopped; a tick that others
    # held up for half a second may have cost some.
    for number, share in ((0, ESTOP_AFTER / SECONDS), (1, 1.0)):
        received, sent = numbers_in(bags[number], spaces[number]), told["robots"][number]["sent"]
        assert len(received) == pytest.approx(share * len(sent), rel=0.05)
    the_estop_is_one_robots(told, records)
    the_diagnostics_are_apart(told)
    facts = [record.facts for record in records]
    assert facts[0]["run"] != facts[1]["run"]


def the_names_are_apart(told: dict[str, Any]) -> None:
    nodes = [f"{space}/{name}" for name, space in told["nodes"]]
    assert all(nodes.count(name) == 1 for name in NODES), nodes
    publishers = told["publishers"]
    assert publishers["/clock"] == publishers["/robot2/clock"] == 1
    assert publishers["/robot1/joint_states"] == publishers["/robot2/joint_states"] == 1
    for name in ("joint_states", "imu/data", "odom", "cmd_vel", "robot_description"):
        assert f"/{name}" not in publishers
    for name in NODES:
        assert publishers[f"{name}/layout"] == 1


def the_clocks_are_apart(
    robot: dict[str, Any], bag: dict[str, list[Any]], space: str, record: Record
) -> None:
    clock = "/clock"
    if space == "robot2":
        clock = "/robot2/clock"
        assert "/clock" not in bag
    stamps = [nanoseconds(message.clock) for message in bag[clock]]
    assert stamps == sorted(stamps)
    assert len(stamps) - len(set(stamps)) <= 1  # damping after a fault tells its tick again
    assert set(robot["clock"]) <= set(stamps)
    assert set(robot["joint_stamps"]) <= set(stamps)
    assert len(robot["clock"]) > 1000
    joints = [nanoseconds(message.header.stamp) for message in bag[f"/{space}/joint_states"]]
    assert joints == stamps
    ticks = record.stamps.tolist()
    assert ticks == sorted(ticks)
    assert set(stamps) == set(ticks)


def the_estop_is_one_robots(told: dict[str, Any], records: list[Record]) -> None:
    first, second = (np.array(robot["path"]) for robot in told["robots"])
    pressed, ended = told["pressed"], told["ended"]
    assert 0.0 < told["answered"] - pressed < 2.0
    # The first one walked until then, and nothing comes of it afterwards.
    assert np.hypot(*(first[-1, 1:] - first[0, 1:])) > 5.0
    assert first[-1, 0] < pressed + 2.0
    # The second one went on to the end.
    assert second[-1, 0] > ended - 1.0
    commands = [record.states("velocity_command") for record in records]
    at_the_end = commands[1][-100:]
    assert np.allclose(commands[0][-50], (0.4, 0.0, 0.0), atol=1e-6)
    assert (at_the_end[:, 0] == 0.0).all()
    turned = (np.abs(commands[1][:, 2] - 0.6) < 1e-6).sum()
    assert turned > 0.9 * SECONDS / records[1].period
    assert not records[0].ended[-1]  # the tick of the fault
    assert records[1].ended[-1]
    assert len(records[1].ticks) - len(records[0].ticks) > 0.8 * (ended - pressed) * 50


def the_diagnostics_are_apart(told: dict[str, Any]) -> None:
    of_robot: list[list[Any]] = [[], []]
    for at, name, message, values in told["statuses"]:
        (number,) = (i for i, node in enumerate(NODES) if node.rsplit("/", 1)[1] in name)
        of_robot[number].append((at, name, message, values))
    for number, other in ((0, "/robot2/"), (1, "/robot1/")):
        assert len(of_robot[number]) > 0.8 * SECONDS
        assert len({name for _, name, _, _ in of_robot[number]}) == 1
        for _, _, _, values in of_robot[number]:
            assert not any(key.startswith(other) for key in values)
    pressed = told["pressed"]
    latched = [values["estop"] for at, _, _, values in of_robot[0] if at > pressed + 2.0]
    assert set(latched) == {"latched"}
    assert {values["estop"] for _, _, _, values in of_robot[1]} == {"clear"}
    rates = [float(v["rate_hz"]) for _, _, _, v in of_robot[1] if "rate_hz" in v]
    assert np.median(rates) == pytest.approx(50.0, abs=1.0)
