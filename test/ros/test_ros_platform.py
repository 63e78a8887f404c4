"""Platform `ros`: a robot behind plain topics, ticks on arrival, silence, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import PlatformError
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner
from unicon_core.workflow import load_workflow

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

MAKE = "unicon_ros.bridge.ros_platform:make"
WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
start: none
platform: {make}
platforms: {{"{make}": {{connect: {connect}{more}}}}}
rate: 200
commands: [{{velocity_command: {{constant: [0.3, 0.0, 0.0]}}}}]
flow: {{sway: {{gains: {{"*_hip_joint": [1.0, 0, 0]}}, time_constant: 0.0}}}}
safety: {{only: [finite]}}  # the robot of these tests jumps, and lies on its side
pacing: {{trigger: {trigger}, hang: 5.0}}  # a busy machine may hold a process up
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def written(trigger: str = "state", connect: float = 15.0, more: str = "") -> Path:
        path = tmp_path / "behind_ros.yaml"
        path.write_text(WORKFLOW.format(make=MAKE, trigger=trigger, connect=connect, more=more))
        return path

    return written


def test_ticks_come_with_joint_states_in_any_order_and_silence_is_a_fault(
    runs: Callable[..., Any], peers: Callable[..., Any], write: Callable[..., Path]
) -> None:
    robot = load_robot("go2")
    shuffled = list(reversed(robot.joint_names))
    peer = peers("plain_robot", "--imu", *shuffled)
    run = runs(write())
    wanted = dict(zip(robot.joint_names, robot.default_joint_pos.tolist()))
    wanted |= {name: wanted[name] + 0.3 for name in wanted if "hip" in name}

    def there() -> bool:
        heard = peer.of("robot")
        return bool(heard) and all(abs(heard[-1]["at"][n] - wanted[n]) < 0.01 for n in wanted)

    peer.wait_for(there, "the robot to reach the command, joint by joint")
    states = run.program.states
    # A turn of 0.6 + 0.8i about x, 73.7°: gravity comes from y.
    assert states.base_quat.tolist() == pytest.approx([0.8, 0.6, 0.0, 0.0])
    assert states.projected_gravity.tolist() == pytest.approx([0.0, -0.96, -0.28], abs=1e-6)
    platform = run.program.platform
    received = platform.info()["received"]["/joint_states"]
    ticks = run.runner.statistics.count
    assert abs(received - ticks) <= 0.2 * ticks + 10  # a tick for each state, not a free timer
    assert "joint_states" in run.session.skipped  # the robot's own: not published by us too
    peer.kill()
    peer.wait_for(lambda: not run.alive, "the fault")
    (fault,) = run.report.faults
    assert fault.startswith(  # a busy machine is told behind it
        "topic /joint_states: no message for 0.5 s, stamp_ns, joint_pos, joint_vel held; "
        "the robot is silent"
    )


def test_the_last_command_of_a_run_is_damping_and_a_map_without_gains_holds_its_targets(
    peers: Callable[..., Any], write: Callable[..., Path]
) -> None:
    peer = peers("plain_robot", *load_robot("go2").joint_names)
    workflow = load_workflow(write())
    runner = Runner(workflow)
    for _ in range(50):
        assert workflow.platform.wait(2.0)
        runner.tick(0)
    sent = workflow.states.joint_pos_target.copy()
    runner.close()
    assert not workflow.states.joint_stiffness.any()
    assert workflow.states.joint_damping.tolist() == workflow.robot.joint_damping.tolist()
    assert np.array_equal(workflow.states.joint_pos_target, sent)
    peer.wait_for(lambda: peer.of("robot")[-1]["commands"] >= 51, "the damping command")


def test_an_absent_robot_is_one_line(write: Callable[..., Path]) -> None:
    with pytest.raises(PlatformError, match=r"no message on /joint_states within 0\.2 s; start"):
        load_workflow(write(connect=0.2))


def test_a_robot_that_lacks_a_joint_is_refused_by_name(
    peers: Callable[..., Any], write: Callable[..., Path]
) -> None:
    names = load_robot("go2").joint_names
    peers("plain_robot", *names[1:])
    with pytest.raises(PlatformError, match=r"lacks 'FR_hip_joint'"):
        load_workflow(write(connect=3.0))


def test_an_unknown_map_is_named(write: Callable[..., Path]) -> None:
    with pytest.raises(PlatformError, match=r"unknown map 'nope'"):
        load_workflow(write(more=", map: nope"))


UNSAID = """\
subscribe:
  - topic: joint_states
    type: sensor_msgs/msg/JointState
    fields: {header.stamp: stamp_ns, name: $joint_names, position: joint_pos}
publish:
  - topic: joint_commands
    type: sensor_msgs/msg/JointState
    fields: {name: $joint_names, position: joint_pos_target}
"""


@pytest.mark.parametrize("reliability", ["--reliable", "--best-effort"])
def test_a_map_that_says_no_qos_hears_robots_of_either_kind(
    peers: Callable[..., Any], write: Callable[..., Path], tmp_path: Path, reliability: str
) -> None:
    (tmp_path / "unsaid.yaml").write_text(UNSAID)
    peer = peers("plain_robot", reliability, *load_robot("go2").joint_names)
    workflow = load_workflow(write(more=", map: ./unsaid.yaml"))
    runner = Runner(workflow)
    more = []
    try:
        for _ in range(20):
            assert workflow.platform.wait(2.0)  # type: ignore[attr-defined]
            runner.tick(0)
            more.append(workflow.platform.wait(0.0))  # type: ignore[attr-defined]
        assert not all(more)  # on a busy machine the next one may be there already
    finally:
        runner.close()
    peer.wait_for(
        lambda: peer.of("robot")[-1]["commands"] >= 20, "the commands, which are reliable"
    )
