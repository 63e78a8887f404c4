"""`unicon replay --play`: a plain node hears the recorded states with /clock, and pauses it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from peer import wait_for
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

pytest.importorskip("rosbags")

from unicon_lab.recording import open_record
from unicon_lab.replay.player import play
from unicon_ros.bridge import RosSession
from unicon_ros.cli.main import main

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

WORKFLOW = {
    "robot": "go2",
    "platform": "fake",
    "rate": 50,
    "duration": 3.0,
    "flow": {"chain": [{"pose": {"to": "rest", "duration": 2.0}}, "hold"]},
}


def test_a_plain_node_hears_what_was_recorded(tmp_path: Path) -> None:
    workflow, bag = tmp_path / "workflow.yaml", tmp_path / "run.mcap"
    workflow.write_text(yaml.safe_dump(WORKFLOW), "utf-8")
    arguments = ["--speed", "max", "--quiet", "--record", str(bag)]
    assert main(["run", str(workflow), *arguments]) == 0
    record = open_record(bag)

    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("peer", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    heard: list[JointState] = []
    clock: list[int] = []
    quality = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(JointState, "/joint_states", heard.append, quality)
    node.create_subscription(Clock, "/clock", lambda m: clock.append(_ns(m.clock)), quality)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()

    session = RosSession(warn=str)
    reports: list[Any] = []
    player = threading.Thread(
        target=lambda: reports.append(play(bag, loop=True, session=session, warn=str))
    )
    player.start()
    try:
        wait_for(lambda: len(heard) > 20 and len(clock) > 20, "messages")
        assert call(node, "pause").success
        wait_for(lambda: session.controls.paused, "the pause")
        seen = _quiet(clock)
        assert call(node, "start").success
        wait_for(lambda: len(clock) > seen + 10, "going on")
        assert call(node, "stop").success
        player.join(20)
    finally:
        session.controls.stop()
        player.join(20)
        session.close()
        executor.shutdown()
        spinning.join(10)
        node.destroy_node()
        rclpy.try_shutdown(context=context)

    stamps = record.states("stamp_ns").tolist()
    rows = {stamp: row for row, stamp in enumerate(stamps)}
    names = list(record.layout.specs["joint_pos"].names)
    assert set(clock) <= set(rows)
    for message in heard:
        row = rows[_ns(message.header.stamp)]
        order = [names.index(name) for name in message.name]
        told = np.asarray(message.position, np.float32)
        assert told.tobytes() == record.states("joint_pos")[row][order].tobytes()
    assert reports[0].faults == []


def call(node: Node, name: str) -> Any:
    """Call a service of the player; the executor spins elsewhere."""
    client = node.create_client(Trigger, f"/unicon/{name}")
    assert client.wait_for_service(20.0)
    future = client.call_async(Trigger.Request())
    wait_for(future.done, name)
    return future.result()


def _quiet(messages: list[int]) -> int:
    """Wait until nothing comes any more; return how many have come."""
    before = -1
    while before != len(messages):
        before = len(messages)
        threading.Event().wait(0.3)
    return before


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
