"""What a bag has of a run with ROS on: what came in as it came, under the names on the wire."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")

from peer import wait_for
from rosbags.highlevel import AnyReader

from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_lab.recording.run_recording import Recording

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

SPEED = 0.123456789
BEHIND = """\
schema: unicon.workflow/1
robot: go2
start: none
platform: ros
platforms: {ros: {connect: 15.0}}
rate: 100
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}, time_constant: 0.0}}
commands: [{velocity_command: {constant: [0.3, 0.0, 0.0]}}]
safety: {only: [finite]}
pacing: {trigger: state, hang: 5.0}
"""
ROBOT = """\
schema: unicon.workflow/1
robot: go2
platform: fake_robot
rate: 100
start: {fade_in: 0.2}
flow: hold
pacing: {hang: 20}
"""


def messages(file: Path) -> dict[str, list[Any]]:
    """Return topic to its messages."""
    found: dict[str, list[Any]] = {}
    with AnyReader([file]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic != "/unicon/ticks":
                message = reader.deserialize(raw, connection.msgtype)
                found.setdefault(connection.topic, []).append(message)
    return found


def test_inputs_are_recorded_as_received_and_names_are_those_on_the_wire(
    tmp_path: Path, sway: Path
) -> None:
    import rclpy
    from geometry_msgs.msg import Twist

    from unicon_ros.bridge import RosSession

    file = tmp_path / "run.mcap"
    remaps = ["-r", "joint_states:=legs/states", "-r", "/tf:=tf"]
    session = RosSession(namespace="/robot1", ros_args=remaps)
    recording = Recording(file, session=session)
    program = load_workflow(sway, hooks=[session.hook, recording.hook])
    runner = Runner(program, RunOptions(duration=40.0, warn=print))
    session.attach(runner)
    ticks = threading.Thread(target=runner.run)
    context = rclpy.context.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("teleop", context=context)
    publisher = node.create_publisher(Twist, "/robot1/cmd_vel", 10)
    sent = [float("nan") if number == 7 else SPEED + number for number in range(20)]
    (heard,) = session.incoming
    try:
        ticks.start()
        wait_for(publisher.get_subscription_count, "a subscription")
        first = Twist()
        while not heard.received and ticks.is_alive():  # until both sides know each other
            publisher.publish(first)
            time.sleep(0.05)
        for speed in sent:
            message = Twist()
            message.linear.x = speed
            publisher.publish(message)
            time.sleep(0.02)  # its queue is that of ten messages
        wait_for(lambda: heard.received > len(sent), "all messages")
        time.sleep(0.2)
    finally:
        runner.stop()
        ticks.join(20)
        session.close()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
    found = messages(file)
    speeds = [message.linear.x for message in found["/robot1/cmd_vel"]]
    assert len(speeds) == heard.received
    assert heard.decoder.rejected == 1
    assert repr(speeds[-len(sent) :]) == repr(sent)  # the refused one too
    published: Counter[str] = Counter()
    for out in session.outgoing:  # several share /tf
        published[out.topic] += out.published
    assert published.total()
    for topic, count in published.items():
        assert len(found.get(topic, ())) == count  # nobody listens to `contacts`
    assert {"/robot1/legs/states", "/robot1/tf", "/robot1/robot_description"} <= found.keys()
    assert {"/joint_states", "/robot1/joint_states", "/tf", "/cmd_vel"}.isdisjoint(found)


def test_a_robot_behind_topics_is_recorded_with_its_sensors_and_its_commands(
    tmp_path: Path, runs: Callable[..., Any], peers: Callable[..., Any]
) -> None:
    joints = load_robot("go2").joint_names
    peer = peers("plain_robot", "--imu", *joints)
    path, file = tmp_path / "behind.yaml", tmp_path / "behind.mcap"
    path.write_text(BEHIND)
    recording = Recording(file)
    run = runs(path, hooks=[recording.hook])
    peer.wait_for(
        lambda: [line["commands"] for line in peer.of("robot")[-1:]] > [50], "fifty commands"
    )
    platform = run.program.platform
    run.end()
    found = messages(file)
    (states,) = (topic for topic in platform.incoming if topic.topic == "/joint_states")
    (commands,) = platform.outgoing
    # What came while it connected is before the run.
    assert 50 < len(found["/joint_states"]) <= states.received
    assert set(found["/joint_states"][0].name) == set(joints)
    assert len(found["/imu/data"]) > 50
    # The damping at the end comes in it too, as long as the recorder lives.
    assert 50 < len(found["/joint_commands"]) <= commands.published


def test_a_robots_messages_carry_the_wall_clock_published_or_not(tmp_path: Path) -> None:
    from unicon_ros.bridge import RosSession

    path, file = tmp_path / "robot.yaml", tmp_path / "robot.mcap"
    path.write_text(ROBOT)
    session = RosSession(warn=lambda line: None)
    recording = Recording(file, session=session)
    program = load_workflow(path, hooks=[session.hook, recording.hook])
    runner = Runner(program, RunOptions(duration=0.5, operator=False, warn=print))
    session.attach(runner)
    runner.run()
    session.close()
    ages: dict[str, list[float]] = {}
    with AnyReader([file]) as reader:
        for connection, logged, raw in reader.messages():
            if connection.topic in ("/unicon/ticks", "/tf_static"):  # which holds at any time
                continue
            message = reader.deserialize(raw, connection.msgtype)
            for each in getattr(message, "transforms", [message]):
                if hasattr(each, "header"):
                    stamp = each.header.stamp
                    age = abs(logged - stamp.sec * 10**9 - stamp.nanosec) * 1e-9
                    ages.setdefault(connection.topic, []).append(age)
    assert {"/joint_states", "/tf"} <= ages.keys()
    assert max(max(each) for each in ages.values()) < 5.0
    assert "/clock" not in messages(file)
