"""Our own code under Kilted's rclpy: a run with ROS on, heard by a plain process of Jazzy's."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from talkers import Talker, clean_environment

EVIDENCE = "vendor"
"""What these tests run against, the most that config/evidence.yaml may say by them."""

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(1200)]

WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 100
commands: [{velocity_command: {constant: [0.1, 0.0, 0.0]}}]
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}, time_constant: 0.0}}
safety: [finite]
"""
TWIST = "geometry_msgs/msg/Twist"
PRIVATE_NAMES = """\
import functools
import json
import time
import rclpy
from sensor_msgs.msg import JointState
from unicon_ros import compat

rclpy.init()
node = rclpy.create_node("names")
names = ("deadline", "incompatible_qos", "liveliness")
create = functools.partial(node.create_publisher, JointState, "x", 1)
publisher, lacking = compat.with_events("publisher", dict.fromkeys(names, print), create)
subscription = node.create_subscription(JointState, "x", print, 1, raw=True)
publish, _ = compat.raw_publish(publisher)
take, _ = compat.raw_take(subscription)
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(node)
asked = []
node.create_timer(0.001, lambda: asked.append("timer"))
serving = compat.Serving(executor, lambda node: None)
time.sleep(0.01)
for piece in serving.round():
    piece.run()
waits = compat.ReusedWaitSet([subscription], node.context)
print(json.dumps({
    "publish": publish != publisher.publish,
    "take": take is not None and take() is None,
    "serve": sorted({*asked}),  # it may be due again
    "wait": waits.wait(0.01),
    "events": not lacking and len(publisher.event_handlers) >= len(names),
}))
waits.close()
"""


def test_a_run_under_kilted_is_heard_by_jazzy_and_takes_its_commands(
    kilted: Callable[[], str], tmp_path: Path
) -> None:
    python = kilted()
    path, report = tmp_path / "run.yaml", tmp_path / "report.json"
    path.write_text(WORKFLOW)
    peer = Talker("plain_peer").ready()
    peer.tell(subscribe="/joint_states", type="sensor_msgs/msg/JointState")
    command = ["-m", "unicon_ros", "run", str(path), "--ros", "--duration", "8", "--quiet"]
    run = subprocess.Popen(
        [python, *command, "--report", str(report)],
        env=clean_environment(),
        cwd=tmp_path,  # the installed package, not the source tree
        stderr=subprocess.PIPE,
        text=True,
    )
    twist = {"linear": {"x": 0.5}}
    try:
        moved = peer.wait(
            lambda: [
                line
                for line in peer.of("heard")
                if any(abs(p - 0.5) < 0.2 for p in line["message"]["position"][::3])
            ],
            "joint states that follow the command",
            timeout=30.0,
            again=lambda: peer.tell(
                publish="/cmd_vel", type="geometry_msgs/msg/Twist", message=twist
            ),
        )
        assert len(moved[0]["message"]["name"]) == 12
        _, errors = run.communicate(timeout=60)
    finally:
        run.kill()
        peer.kill()
    assert run.returncode == 0, errors
    result = json.loads(report.read_text())
    assert result["faults"] == []
    assert result["bridge"]["published"] > 1000
    assert result["bridge"]["received"] > 0


def test_kilteds_private_names_are_those_that_the_fast_paths_use(
    kilted: Callable[[], str], tmp_path: Path
) -> None:
    done = subprocess.run(
        [kilted(), "-c", PRIVATE_NAMES],
        env=clean_environment(),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {
        "publish": True,
        "take": True,
        "serve": ["timer"],
        "wait": False,
        "events": True,
    }
