"""Joint commands by topic: JointState, Float64MultiArray and JointTrajectory, and their silence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from peer import wait_for
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from unicon_base.errors import UniconError
from unicon_core.robots import load_robot
from unicon_core.workflow import load_workflow
from unicon_ros import compat
from unicon_ros.bridge import RosSession
from unicon_ros.cli.main import main

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

FOLLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 200
flow: {FLOW: {max_rate: 2.0}}
safety: [finite, joint_limits]
ros: true
map: MAP
"""
GO2 = load_robot("go2")
NAMES = list(GO2.joint_names)
TRAJECTORY = "/joint_trajectory_controller/joint_trajectory"


@pytest.fixture
def follow(tmp_path: Path) -> Callable[..., Path]:
    """A fake Go2 that follows joint commands from its first tick on."""

    def written(name: str, flow: str = "forward_command") -> Path:
        path = tmp_path / "follow.yaml"
        path.write_text(FOLLOW.replace("MAP", name).replace("FLOW", flow))
        return path

    return written


@pytest.fixture
def plain() -> Iterator[Any]:
    """A plain rclpy node of another context."""
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("plain", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield node
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def connected(node: Any, kind: Any, topic: str) -> Any:
    publisher = node.create_publisher(kind, topic, 10)
    wait_for(lambda: publisher.get_subscription_count() == 1, f"a reader of {topic}")
    return publisher


def trajectory(*points: tuple[float, Any], joints: list[str] = NAMES) -> JointTrajectory:
    message = JointTrajectory(joint_names=joints)
    for time, positions in points:
        point = JointTrajectoryPoint(positions=[float(value) for value in positions])
        point.time_from_start.sec, rest = divmod(round(time * 1e9), 1_000_000_000)
        point.time_from_start.nanosec = rest
        message.points.append(point)
    return message


@pytest.mark.parametrize("name", ["joint_command", "forward_command", "joint_trajectory"])
def test_each_map_fits_a_flow_that_follows_and_no_other(
    follow: Callable[..., Path], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(follow(name))]) == 0
    assert main(["check", f"go2_{name}"]) == 0
    capsys.readouterr()
    path = follow(name)
    path.write_text(path.read_text().replace("{forward_command: {max_rate: 2.0}}", "{hold: {}}"))
    assert main(["check", str(path)]) == 1
    told = " ".join(capsys.readouterr().out.split())
    wanted = "has no block forward_command" if "trajectory" in name else "no state 'joint_"
    assert wanted in told


def test_a_joint_state_is_followed_by_name_and_its_silence_holds(
    runs: Callable[..., Any], follow: Callable[..., Path], plain: Any
) -> None:
    run = runs(follow("joint_command"), map="joint_command")
    states = run.program.states
    publisher = connected(plain, JointState, "/joint_command")
    wait_for(lambda: run.runner.statistics.count > 5, "ticks")
    begin = states.joint_pos_target.copy()
    message = JointState(name=[NAMES[4], NAMES[1]], velocity=[0.5, 0.25])
    message.position = [float(begin[4]) - 0.2, float(begin[1]) + 0.1]

    def there() -> bool:
        publisher.publish(message)
        return bool(abs(states.joint_pos_target[4] - (begin[4] - 0.2)) < 1e-5)

    wait_for(there, "the target")
    assert states.joint_vel_target[4] == 0.5
    wait_for(lambda: run.session.incoming[0].stale, "the time-out")
    wait_for(lambda: states.joint_vel_target[4] == 0.0, "no feed-forward")
    wanted = begin.copy()
    wanted[[4, 1]] += np.float32([-0.2, 0.1])
    np.testing.assert_allclose(states.joint_pos_target, wanted, atol=1e-5)
    assert any("unset" in text for text in run.warnings), run.warnings
    for bad in ([float("nan"), 0.0], [1.0, 2.0, 3.0]):
        message.position = bad
        publisher.publish(message)
    publisher.publish(JointState(name=["wheel"], position=[1.0]))
    wait_for(lambda: run.session.incoming[0].decoder.rejected >= 3, "refusals")
    np.testing.assert_allclose(states.joint_pos_target, wanted, atol=1e-5)


def test_plain_numbers_are_followed_in_joint_order(
    runs: Callable[..., Any], follow: Callable[..., Path], plain: Any
) -> None:
    run = runs(follow("forward_command"), map="forward_command")
    states = run.program.states
    publisher = connected(plain, Float64MultiArray, "/forward_position_controller/commands")
    wait_for(lambda: run.runner.statistics.count > 5, "ticks")
    wanted = states.joint_pos_target + np.linspace(-0.05, 0.05, 12, dtype=np.float32)

    def there() -> bool:
        publisher.publish(Float64MultiArray(data=wanted.astype(float).tolist()))
        return bool(np.abs(states.joint_pos_target - wanted).max() < 1e-5)

    wait_for(there, "the targets")
    steps = 0
    before = states.joint_pos_target.copy()
    far = Float64MultiArray(data=(wanted + 0.5).astype(float).tolist())
    while steps < 50:  # however far it is, no step is larger than that of a tick or two
        publisher.publish(far)
        count = run.runner.statistics.count
        wait_for(lambda count=count: run.runner.statistics.count > count, "a tick")
        ticks, after = run.runner.statistics.count - count, states.joint_pos_target.copy()
        assert np.abs(after - before).max() <= (ticks + 2) * 2.0 / 200 * 1.01
        before, steps = after, steps + 1


def test_a_trajectory_is_played_in_time_and_a_wrong_one_is_told(
    runs: Callable[..., Any], follow: Callable[..., Path], plain: Any
) -> None:
    seen: list[Any] = []

    def look(program: Any) -> Any:
        from unicon_core.flow import Block, Stage

        target = program.states.joint_pos_target
        return {Stage.OBSERVE: [Block("look", lambda: seen.append(target.copy()))]}

    run = runs(follow("joint_trajectory"), hooks=[look], map="joint_trajectory")
    played = run.session.trajectories
    publisher = connected(plain, JointTrajectory, TRAJECTORY)
    wait_for(lambda: run.runner.statistics.count > 5, "ticks")
    begin = run.program.states.joint_pos_target.astype(float)
    publisher.publish(trajectory((0.4, begin + 0.2), (0.9, begin - 0.1)))
    wait_for(lambda: played.player.playing, "the trajectory")
    wait_for(lambda: not played.player.playing, "its end")
    path = np.array(seen)[:, 0] - begin[0]
    top = int(path.argmax())
    assert path[top] == pytest.approx(0.2, abs=1e-3)
    first = int(np.argmax(path > 0))
    assert top - first + 1 == 80  # ticks of 5 ms in 0.4 s
    np.testing.assert_allclose(path[first : top + 1], np.linspace(0, 0.2, 81)[1:], atol=1e-5)
    assert path[top + 100] == pytest.approx(-0.1, abs=1e-3)
    bad = [
        trajectory((0.01, begin + 0.5)),
        trajectory((1.0, begin[:3])),
        trajectory((1.0, [0.0]), joints=["wheel"]),
        trajectory(),
    ]
    for message in [*bad, *bad]:
        publisher.publish(message)
    wait_for(lambda: played.rejected == 8, "the refusals")
    told = [text for text in run.warnings if text.startswith(f"a trajectory on {TRAJECTORY}")]
    assert len(told) == 4  # each reason once
    assert run.session.counts()["topics"][TRAJECTORY] == {"received": 9, "rejected": 8}
    assert run.program.states.joint_pos_target[0] == pytest.approx(begin[0] - 0.1, abs=1e-5)


@pytest.mark.skipif(
    compat.message_class("control_msgs/action/FollowJointTrajectory") is not None,
    reason="control_msgs is installed",
)
def test_without_control_msgs_the_action_is_left_out_and_the_message_says_how_to_get_it(
    runs: Callable[..., Any], follow: Callable[..., Path], tmp_path: Path
) -> None:
    run = runs(follow("joint_trajectory"), map="joint_trajectory")
    told = [text for text in run.warnings if "control_msgs" in text]
    assert told == [
        "action joint_trajectory_controller/follow_joint_trajectory is left out: control_msgs is "
        "not installed (apt install ros-$ROS_DISTRO-control-msgs, or build it in the workspace); "
        "trajectories come by topic joint_trajectory_controller/joint_trajectory"
    ]
    only = tmp_path / "only.yaml"
    only.write_text("trajectory: {action: follow}\n")
    session = RosSession(map=str(only), warn=print)
    try:
        with pytest.raises(UniconError, match=r"control_msgs is not installed .* or give a topic"):
            load_workflow(follow("joint_trajectory"), hooks=[session.hook])
    finally:
        session.close()


def test_a_map_with_a_trajectory_needs_a_flow_that_follows(
    sway: Path,
) -> None:
    session = RosSession(map="joint_trajectory_in", warn=print)
    try:
        with pytest.raises(UniconError, match="has no block forward_command that would follow"):
            load_workflow(sway, hooks=[session.hook])
    finally:
        session.close()


def test_trajectories_are_refused_where_some_joints_alone_follow(
    follow: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = follow("joint_trajectory")
    front = "{forward_command: {moves: ['F*'], name: front}}"
    rear = "{forward_command: {moves: ['R*'], name: rear}}"
    whole = "{forward_command: {max_rate: 2.0}}"
    path.write_text(path.read_text().replace(whole, f"{{zip: [{front}, {rear}]}}"))
    assert main(["check", str(path)]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "trajectories are followed by all joints" in told
