"""A peer that sends what is refused is silent, however much it sends: commands and sensors."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from ros_attack import REACT, Run, behind_topics, peer, robot, running, wait_for

from unicon_base.errors import PlatformError
from unicon_core.workflow import load_workflow
from unicon_ros.bridge import RosSession
from unicon_ros.bridge.topics import TopicIn

pytestmark = [
    pytest.mark.ros,
    pytest.mark.alone,  # a peer that another test starves for 0.5 s is silent
    pytest.mark.usefixtures("domain", "short_damping"),
    pytest.mark.timeout(90),
]

WALK = """\
schema: unicon.workflow/1
robot: go2
platform: mujoco
policies: {walk: go2_velocity}
flow: {policy: walk}
safety: [finite, joint_limits, tilt_stop]
"""


def test_a_walking_go2_stops_half_a_second_after_its_driver_sends_only_garbage(
    tmp_path: Path,
) -> None:
    path = tmp_path / "walk.yaml"
    path.write_text(WALK)
    with running(path) as run, peer("lying_driver", "0.8") as driver:
        states, (topic,) = run.program.states, run.session.incoming
        wait_for(lambda: bool(driver.of("garbage")), "the garbage")
        begun = run.runner.statistics.count
        wait_for(lambda: topic.stale, "the time-out", 8.0)
        # Half a second and its rounding; the rest is for a busy machine.
        assert (run.runner.statistics.count - begun) * run.program.period < 2.0
        x, refused = float(states.base_pos_w[0]), topic.decoder.rejected
        wait_for(lambda: topic.decoder.rejected > refused + 300, "more garbage")
        assert topic.stale
        assert states.velocity_command.tolist() == [0.0, 0.0, 0.0]
        assert abs(float(states.base_pos_w[0]) - x) < 0.5
        report = run.end()
    assert report.faults == []
    assert any("no accepted message for 0.5 s" in warning for warning in run.warnings)
    assert len([warning for warning in run.warnings if "was refused" in warning]) == 1


@pytest.mark.parametrize(
    "lie",
    [
        "nan joints",
        *(pytest.param(lie, marks=pytest.mark.slow) for lie in ("few joints", "nan imu")),
    ],
)
def test_a_robot_that_sends_only_garbage_is_a_fault(lie: str, tmp_path: Path) -> None:
    with robot(lie, 0.2) as peer:
        run = Run(behind_topics(tmp_path, "finite, tilt_stop")).start()
        try:
            wait_for(lambda: bool(peer.lines) and peer.lines[-1]["lies"], "the lies")
            sent = run.runner.statistics.count
            wait_for(lambda: not run.alive, "the fault", 8.0)
        finally:
            report = run.end()
    (fault,) = report.faults
    topic = "/imu/data" if "imu" in lie else "/joint_states"
    assert fault.startswith(f"topic {topic}: no accepted message for 0.5 s")
    assert "; the robot is silent" in fault
    assert report.ticks - sent < 200  # of 100 Hz


def test_a_robot_that_sent_garbage_from_the_first_message_on_is_not_there(tmp_path: Path) -> None:
    with robot("nan joints", -1.0) as peer:
        wait_for(lambda: bool(peer.lines), "the robot")
        with pytest.raises(PlatformError) as error:
            load_workflow(behind_topics(tmp_path, "finite", connect=2.5))
    assert "no message on /joint_states within 2.5 s" in str(error.value)
    assert "is nan, and nonfinite: reject is declared" in str(error.value)


@pytest.fixture
def topic(tmp_path: Path) -> Iterator[TopicIn]:
    """`cmd_vel` of a workflow whose script commands 0.1, without anybody at the other end."""
    path = tmp_path / "react.yaml"
    path.write_text(REACT)
    session = RosSession(warn=[].append)
    workflow = load_workflow(path, hooks=[session.hook])
    (found,) = session.incoming
    found.command = workflow.states.velocity_command  # type: ignore[attr-defined]
    yield found
    workflow.close()
    session.close()


def arrive(topic: TopicIn, *values: float) -> None:
    """Let messages with these vx lie in the queue, and poll."""
    from geometry_msgs.msg import Twist
    from rclpy.serialization import serialize_message

    waiting = []
    for value in values:
        twist = Twist()
        twist.linear.x = value
        waiting.append(serialize_message(twist))
    topic._take = lambda: waiting.pop(0) if waiting else None
    topic.command[...] = (0.1, 0.0, 0.0)  # type: ignore[attr-defined]
    topic.poll()
    assert not waiting


NAN = float("nan")


def test_of_one_tick_the_newest_message_that_is_accepted_counts(topic: TopicIn) -> None:
    arrive(topic, 0.8)
    arrive(topic, 0.5, 0.0, NAN, NAN)
    assert topic.command.tolist() == [0.0, 0.0, 0.0]  # type: ignore[attr-defined]
    assert (topic.received, topic.decoder.rejected, topic.dropped) == (5, 2, 1)


def test_a_tick_of_refused_messages_keeps_what_was_accepted_until_the_time_out(
    topic: TopicIn,
) -> None:
    arrive(topic, 0.5)
    arrive(topic, NAN, NAN)
    assert topic.command.tolist() == [0.5, 0.0, 0.0]  # type: ignore[attr-defined]
    begin = time.monotonic()
    while not topic.stale:
        assert time.monotonic() - begin < 5.0
        arrive(topic, NAN)
    assert topic.command.tolist() == [0.0, 0.0, 0.0]  # type: ignore[attr-defined]
    arrive(topic, 0.25)
    assert not topic.stale
    assert topic.command.tolist() == [0.25, 0.0, 0.0]  # type: ignore[attr-defined]


def test_a_refused_message_that_was_taken_ahead_is_silence_too(topic: TopicIn) -> None:
    arrive(topic, 0.5)
    begin = time.monotonic()
    while not topic.stale:
        assert time.monotonic() - begin < 5.0
        prefetched(topic, NAN)
    assert topic.command.tolist() == [0.0, 0.0, 0.0]  # type: ignore[attr-defined]


def prefetched(topic: TopicIn, value: float) -> None:
    from geometry_msgs.msg import Twist
    from rclpy.serialization import serialize_message

    twist = Twist()
    twist.linear.x = value
    waiting = [serialize_message(twist)]
    topic._take = lambda: waiting.pop() if waiting else None
    topic.command[...] = (0.1, 0.0, 0.0)  # type: ignore[attr-defined]
    assert topic.prefetch()
    topic.accept()


def test_until_a_first_message_is_accepted_the_script_rules(topic: TopicIn) -> None:
    arrive(topic, NAN)
    assert not topic.heard
    assert topic.command.tolist() == pytest.approx([0.1, 0.0, 0.0])  # type: ignore[attr-defined]


def test_reasons_without_end_are_told_ten_times(topic: TopicIn) -> None:
    told: list[str] = []
    topic._warn = told.append
    for i in range(50):
        arrive(topic, 1e39 * (i + 1))
    assert topic.decoder.rejected == 50
    assert len(told) == 10
