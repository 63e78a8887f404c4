"""ros2_control both ways: we are its hardware, and we command its robot; peers that behave so."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from peer import Peer, wait_for
from std_msgs.msg import Float64MultiArray

from unicon_core.flow import Block, Stage
from unicon_core.robots import load_robot
from unicon_core.workflow import HookBlocks, Program

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

GO2 = load_robot("go2")
NAMES = list(GO2.joint_names)
STAND = GO2.default_joint_pos.astype(float)

HARDWARE = """\
schema: unicon.workflow/1
robot: go2
platform: mujoco
rate: 100
flow: {chain: [{pose: {to: stand, duration: 0.5}}, {forward_command: {start_tolerance: 0.5}}]}
safety: [finite, joint_limits]
ros: true
map: ros2_control_hardware
"""
CONTROLLER = """\
schema: unicon.workflow/1
robot: go2
platform: ros
platforms: {ros: {map: MAP, connect: 15.0}}
start: {operator: false}
rate: 100
flow:
  chain:
    - pose: {to: stand, duration: 1.0}
    - sway: {gains: {"*_thigh_joint": [0.2, 0, 0]}, amplitude: [1.0, 0, 0], frequency: 0.25}
safety: {only: [finite, joint_limits]}
pacing: {hang: 5.0}                      # a busy machine may hold a process up
"""


def as_hardware(
    runs: Callable[..., Any], peers: Callable[..., Peer], tmp_path: Path, seconds: float
) -> dict[str, Any]:
    """Let a controller manager run a simulated robot of ours; return what was counted."""
    path = tmp_path / "hardware.yaml"
    path.write_text(HARDWARE)
    run = runs(path, duration=seconds + 60.0, map="ros2_control_hardware")
    manager = peers("controller_manager", "100", f"{seconds}", *NAMES)
    manager.wait_for(lambda: bool(manager.of("manager")), "the manager")
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("user", context=context)
    reference = node.create_publisher(Float64MultiArray, "forward_position_controller/commands", 10)
    states = run.program.states
    wait_for(lambda: reference.get_subscription_count() == 1, "the forward controller")
    wait_for(lambda: run.program.states.tick > 60, "the flow to follow")
    down = STAND.copy()
    down[1::3] += 0.2
    down[2::3] -= 0.4
    wanted = np.array(down)

    def refer() -> None:
        reference.publish(Float64MultiArray(data=wanted.tolist()))

    refer()
    far = list(wanted)
    wait_for(lambda: np.abs(states.joint_pos_target - far).max() < 1e-4, "the first reference")
    turns = 0
    while not manager.of("sent"):
        wanted[1::3] = STAND[1::3] + (0.3 if turns % 2 else 0.1)
        refer()
        turns += 1
        before = len(manager.of("manager"))
        manager.wait_for(
            lambda before=before: len(manager.of("manager")) > before or bool(manager.of("sent")),
            "the manager",
        )
    status, errors = manager.end()
    assert status == 0, errors
    (done,) = manager.of("done")
    topic = next(each for each in run.session.incoming if "commands" in each.topic)
    wait_for(lambda: topic.received >= done["sent"], "what was sent last")
    counted = {
        **done,
        "taken": topic.received,
        "rejected": topic.decoder.rejected,
        "turns": turns,
        "off": float(np.abs(states.joint_pos_target - wanted).max()),
    }
    node.destroy_node()
    rclpy.shutdown(context=context)
    report = run.end()
    assert report.faults == []
    assert not report.fell
    return counted


def as_controller(
    runs: Callable[..., Any],
    peers: Callable[..., Peer],
    tmp_path: Path,
    interface: str,
    seconds: float,
) -> dict[str, Any]:
    """Let a workflow of ours command a robot that ros2_control runs; return what was counted."""
    path = tmp_path / f"{interface}.yaml"
    path.write_text(CONTROLLER.replace("MAP", f"ros2_control_{interface}"))
    rest = [f"{n}={p}" for n, p in zip(NAMES, STAND + 0.1)]
    robot = peers("ros2_control_robot", interface, "200", f"{seconds + 40.0}", *rest)
    heard: list[tuple[int, int]] = []

    def look(program: Program) -> HookBlocks:
        stamp, count = program.states.stamp_ns, program.platform.arrivals  # type: ignore[attr-defined]
        tick = partial(_note, heard, count, stamp)
        return {Stage.ESTIMATE: [Block("look", tick)]}

    run = runs(path, hooks=[look], duration=seconds)
    platform = run.program.platform
    wait_for(lambda: not run.alive, "the end of the run", seconds + 40.0)
    assert run.report is not None
    assert run.report.faults == []
    info = platform.info()
    (published,) = info["published"].values()
    robot.wait_for(lambda: robot.of("robot")[-1]["commands"] >= published, "the last command")
    count = len(robot.of("robot"))
    robot.wait_for(lambda: len(robot.of("robot")) > count + 1, "what comes behind it")
    told = robot.of("robot")
    moving = [line["at"]["FR_thigh_joint"] for line in told]
    return {
        **told[-1],
        "sent": published,
        "taken": heard[-1][0] - heard[1][0],
        "told": (heard[-1][1] - heard[1][1]) / 5e6,
        "range": max(moving) - min(moving),
        "ticks": run.report.ticks,
    }


def _note(heard: list[tuple[int, int]], count: Callable[[], int], stamp: Any) -> None:
    heard.append((count(), int(stamp)))


@pytest.mark.slow
def test_a_controller_manager_runs_our_robot_as_topic_based_hardware(
    runs: Callable[..., Any], peers: Callable[..., Peer], tmp_path: Path
) -> None:
    counted = as_hardware(runs, peers, tmp_path, 4.0)
    assert counted["gaps"] == 0
    assert counted["taken"] == counted["sent"] > 50
    assert counted["rejected"] == 0


@pytest.mark.slow
def test_our_workflow_commands_a_robot_of_ros2_control_by_torques(
    runs: Callable[..., Any], peers: Callable[..., Peer], tmp_path: Path
) -> None:
    counted = as_controller(runs, peers, tmp_path, "effort", 2.0)
    assert counted["dropped"] == 0
    assert counted["commands"] == counted["sent"] > 150
    assert counted["taken"] == counted["told"] > 300
    assert counted["range"] > 0.1  # it sways, through its controllers
    # A controller that keeps the last for ever has zeros.
    assert counted["effort"] == [0.0] * len(NAMES)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_nothing_is_lost_in_a_minute_as_hardware(
    runs: Callable[..., Any], peers: Callable[..., Peer], tmp_path: Path
) -> None:
    counted = as_hardware(runs, peers, tmp_path, 60.0)
    print(counted)
    assert counted["heard"] > 5500
    assert counted["gaps"] == 0
    assert counted["taken"] == counted["sent"] > 4000
    assert counted["rejected"] == 0
    assert counted["off"] < 1e-3


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("interface", ["position", "effort", "trajectory"])
def test_nothing_is_lost_in_a_minute_as_controller(
    runs: Callable[..., Any], peers: Callable[..., Peer], tmp_path: Path, interface: str
) -> None:
    counted = as_controller(runs, peers, tmp_path, interface, 60.0)
    print(counted)
    assert counted["dropped"] == 0
    assert counted["commands"] == counted["sent"] > (2500 if interface == "trajectory" else 5500)
    assert counted["taken"] == counted["told"] > 11_000
    assert counted["range"] > 0.1
