"""The bridge's session: names, latched topics, time-outs, fall-backs, diagnostics, services."""

from __future__ import annotations

import json
import os
import platform
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Twist
from peer import wait_for
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from worn_meshes import go2_with_meshes

from unicon_base.errors import MissingDependencyError, UniconError
from unicon_core.runtime import Runner
from unicon_core.workflow import load_workflow
from unicon_ros import compat
from unicon_ros.bridge import RosSession

EVIDENCE = "vendor"
"""What these tests run against, the most that config/evidence.yaml may say by them."""

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]


@pytest.fixture
def plain() -> Any:
    """A plain rclpy node of another context, in namespace /peer."""
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("plain", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    node.spin_until = lambda ready, what="": _spin_until(executor, ready, what)  # type: ignore[attr-defined]
    yield node
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def _spin_until(executor: Any, ready: Callable[[], bool], what: str) -> None:
    def spun() -> bool:
        executor.spin_once(0.02)
        return ready()

    wait_for(spun, what)


def test_namespace_and_remaps_apply_to_relative_names_only(
    runs: Callable[..., Any], react: Path, plain: Any
) -> None:
    run = runs(react, namespace="robot1", ros_args=["-r", "joint_states:=js", "-r", "__node:=two"])
    topics = set(run.session.counts()["topics"])
    relative = {f"/robot1/{name}" for name in ("js", "imu/data", "odom", "cmd_vel", "contacts")}
    assert topics == relative | {"/clock", "/tf"}
    assert run.session.node.get_fully_qualified_name() == "/robot1/two"
    heard: list[Any] = []
    plain.create_subscription(JointState, "/robot1/js", heard.append, 10)
    plain.spin_until(lambda: heard, "/robot1/js")


def test_a_topic_rules_from_its_first_message_and_is_zero_after_its_time_out(
    runs: Callable[..., Any], react: Path, plain: Any
) -> None:
    run = runs(react)
    seen: list[tuple[float, ...]] = []
    command = run.program.states.velocity_command
    publisher = plain.create_publisher(Twist, "cmd_vel", 10)
    plain.spin_until(lambda: publisher.get_subscription_count() == 1, "the bridge's subscription")
    plain.spin_until(lambda: run.runner.statistics.count > 3, "ticks")
    script = (float(np.float32(0.1)), 0.0, 0.0)
    assert tuple(command.tolist()) == script  # nothing was heard yet
    message = Twist()
    message.linear.y = -0.25
    publisher.publish(message)
    hips = run.program.states.joint_pos_target

    def note() -> bool:
        seen.append(tuple(command.tolist()))
        return run.session.incoming[0].stale

    plain.spin_until(note, "the time-out")
    assert (0.0, -0.25, 0.0) in seen
    first = seen.index((0.0, -0.25, 0.0))
    # The script writes 0.1 in every tick; a reader between two blocks may see it, the flow may not.
    default = run.program.robot.default_joint_pos
    assert run.session.incoming[0].received == 1
    plain.spin_until(lambda: np.allclose(hips, default, atol=1e-6), "the flow to see zeros")
    allowed = {(0.0, -0.25, 0.0), (0.0, 0.0, 0.0), script}
    assert set(seen[first:]) <= allowed


def test_the_queue_is_drained_to_the_latest_message(react: Path, plain: Any) -> None:
    session = RosSession()
    workflow = load_workflow(react, hooks=[session.hook])
    (block,) = [b for b in workflow.blocks if b.name == "ros inputs"]
    publisher = plain.create_publisher(Twist, "cmd_vel", 10)
    plain.spin_until(lambda: publisher.get_subscription_count() == 1, "the bridge's subscription")
    topic = session.incoming[0]
    plain.spin_until(lambda: topic.subscription.get_publisher_count() == 1, "the other way")
    for i in range(5):
        message = Twist()
        message.linear.x = 0.1 * i
        publisher.publish(message)

    def latest() -> bool:
        block.tick()
        return bool(workflow.states.velocity_command[0] == np.float32(0.4))

    plain.spin_until(latest, "the latest message")
    assert topic.received == 5
    assert topic.dropped > 0
    workflow.close()
    session.close()


def test_a_late_joiner_gets_the_robot_description(
    runs: Callable[..., Any], sway: Path, plain: Any
) -> None:
    run = runs(sway)
    heard: list[String] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    plain.create_subscription(String, "robot_description", heard.append, latched)
    plain.spin_until(lambda: heard, "robot_description")
    assert heard[0].data.startswith("<?xml")
    for name in run.program.robot.joint_names:
        assert f'<joint name="{name}" type="revolute">' in heard[0].data


@pytest.mark.parametrize("there", [True, False])
def test_a_peer_gets_the_meshes_of_the_robot_or_what_is_lacking(
    runs: Callable[..., Any], sway: Path, plain: Any, tmp_path: Path, there: bool
) -> None:
    model = go2_with_meshes(tmp_path / "my robot")
    if not there:
        (tmp_path / "my robot" / "meshes" / "thigh.STL").unlink()
    sway.write_text(f"{sway.read_text()}scene: {{model: '{model}'}}\n")
    run = runs(sway)
    heard: list[String] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    plain.create_subscription(String, "robot_description", heard.append, latched)
    plain.spin_until(lambda: heard, "robot_description")
    meshes = re.findall(r'<mesh filename="([^"]+)" scale="1 1 1" />', heard[0].data)
    files = ["coque é.stl", "thigh.STL"][: 1 + there]
    assert meshes == [(model.parent / "meshes" / name).as_uri() for name in files]
    said = "robot_description shows primitives or less: 1 mesh files are absent (first: thigh.STL)"
    assert sum(said in line for line in run.warnings) == (not there)


@pytest.mark.parametrize("missing", ["take", "publish", "executor"])
def test_without_rclpys_private_names_the_public_ones_do(
    runs: Callable[..., Any],
    react: Path,
    plain: Any,
    missing: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if missing == "take":
        monkeypatch.setattr(compat, "raw_take", lambda s: (None, lambda: None))
    elif missing == "publish":
        monkeypatch.setattr(compat, "raw_publish", lambda p: (p.publish, lambda: None))
    else:
        real = compat.Serving

        class Hidden:
            def __init__(self, executor: Any) -> None:
                self.spin_once, self.context = executor.spin_once, executor.context
                self.get_nodes = executor.get_nodes

        monkeypatch.setattr(
            compat, "Serving", lambda executor, watch: real(Hidden(executor), watch)
        )
    run = runs(react)
    heard: list[JointState] = []
    plain.create_subscription(JointState, "joint_states", heard.append, 10)
    publisher = plain.create_publisher(Twist, "cmd_vel", 10)
    message = Twist()
    message.linear.x = 0.5

    def answered() -> bool:
        publisher.publish(message)
        hip = run.program.robot.joint_names.index("FL_hip_joint")
        return any(abs(m.position[hip] - 0.6) < 1e-6 for m in heard)

    plain.spin_until(answered, "the command to come back as a joint position")
    assert run.session.incoming[0].polled is (missing != "take")


def test_the_guards_find_no_private_names_on_other_objects() -> None:
    class Other:
        def publish(self, data: bytes) -> None:
            self.data = data

    publisher = Other()
    publish, release = compat.raw_publish(publisher)
    publish(b"x")
    release()
    assert publisher.data == b"x"
    assert compat.raw_take(Other())[0] is None


def test_an_incompatible_peer_is_named_once(
    runs: Callable[..., Any], react: Path, tmp_path: Path, plain: Any
) -> None:
    path = tmp_path / "best.yaml"
    path.write_text(
        "publish:\n"
        "  - {topic: joint_states, type: sensor_msgs/msg/JointState,\n"
        "     qos: {reliability: best_effort}, fields: {position: joint_pos}}\n"
    )
    run = runs(react, map=path)
    wants = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
    plain.create_subscription(JointState, "joint_states", lambda m: None, wants)
    plain.spin_until(lambda: any("incompatible" in w for w in run.warnings), "the diagnostic")
    told = [w for w in run.warnings if "incompatible" in w]
    assert told == [
        "topic joint_states: a subscription has an incompatible reliability (ours: best_effort), "
        "so nothing passes between us; set qos.reliability of the topic in the message map, "
        "or the peer's"
    ]


def test_malformed_bytes_are_refused_and_told_once(
    runs: Callable[..., Any], react: Path, plain: Any
) -> None:
    run = runs(react)
    publisher = plain.create_publisher(Twist, "cmd_vel", 10)
    plain.spin_until(lambda: publisher.get_subscription_count() == 1, "the bridge's subscription")
    topic = run.session.incoming[0]

    def refused() -> bool:
        publisher.publish(b"\x00\x01\x00\x00garbage")
        return topic.decoder.rejected > 2

    plain.spin_until(refused, "refused messages")
    assert len([w for w in run.warnings if "refused" in w]) == 1
    assert not topic.heard
    assert run.alive


def test_services_pause_step_reset_go_on_and_stop_a_simulator(
    runs: Callable[..., Any], peers: Callable[..., Any], sway: Path
) -> None:
    run = runs(sway)
    words = ["pause", "step", "step", "start", "start", "reset", "stop"]
    peer = peers("caller", "unicon", *words)
    status, errors = peer.end()
    assert status == 0, errors
    answers = {(i, line["word"]): line["success"] for i, line in enumerate(peer.lines)}
    expected = [True, True, True, True, False, True, True]
    assert list(answers.values()) == expected, peer.lines
    peer.wait_for(lambda: not run.alive, "the end of the run")
    assert run.report.faults == []


def test_an_emergency_stop_is_a_fault_before_anything_else_is_sent(
    runs: Callable[..., Any], peers: Callable[..., Any], react: Path
) -> None:
    run = runs(react)
    assert peers("caller", "unicon", "estop").end()[0] == 0
    peers("caller").wait_for(lambda: not run.alive, "the end of the run")
    assert run.report.faults == ["emergency stop by the service ~/estop"]


def test_an_emergency_stop_gets_through_a_flood_of_other_services(
    runs: Callable[..., Any], peers: Callable[..., Any], react: Path
) -> None:
    run = runs(react)
    flood = peers("caller", "unicon", "flood=reset,4")
    flood.wait_for(lambda: run.session.slack.served > 20, "the flood")
    assert peers("caller", "unicon", "estop").end()[0] == 0
    flood.wait_for(lambda: not run.alive, "the end of the run")
    assert run.report.faults == ["emergency stop by the service ~/estop"]


BAD_MAPS = {
    "publish: [{topic: x, type: no_msgs/msg/None, fields: {a: joint_pos}}]": "no_msgs/msg/None",
    "publish: [{topic: x, type: std_msgs/msg/Float32, fields: {data: nonsense}}]": "'nonsense'",
    "publish: [{topic: 'a//b', type: std_msgs/msg/Int64, fields: {data: tick}}]": "a ROS name",
    "publish: [{topic: x, type: std_msgs/msg/Int64, qos: {history: keep_all}, "
    "fields: {data: tick}}]": "a reader that hangs would stop the tick; say history: keep_last",
    "subscribe: [{topic: x, type: sensor_msgs/msg/JointState, "
    "fields: {name: $joint_names, position: joint_pos}}]": "which platform 'fake' writes",
}


@pytest.mark.parametrize("text", BAD_MAPS)
def test_a_wrong_map_is_one_line_that_names_the_culprit(
    react: Path, tmp_path: Path, text: str
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)

    def load() -> None:
        session = RosSession(map=path)
        try:
            load_workflow(react, hooks=[session.hook])
        finally:
            session.close()

    with pytest.raises(UniconError) as caught:
        load()
    assert BAD_MAPS[text] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_map_lists_the_known_ones() -> None:
    with pytest.raises(UniconError, match=r"unknown map 'nope'.*default"):
        RosSession(map="nope")


@pytest.mark.parametrize(
    "wrong",
    [{"namespace": "1 2"}, {"node_name": "a b"}, {"ros_args": ["-r", "x"]}],
    ids=["namespace", "node", "argument"],
)
def test_wrong_names_and_arguments_are_one_line(wrong: dict[str, Any]) -> None:
    with pytest.raises(
        UniconError, match="correct the name, the namespace or --ros-args"
    ) as caught:
        RosSession(**wrong)
    assert "\n" not in str(caught.value)


def test_a_missing_rclpy_names_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def absent(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr("unicon_ros.compat.loading.importlib.import_module", absent)
    extra = ", or pip install 'unicon_ros[ros]'" if sys.version_info < (3, 15) else ""
    for machine, words in (("x86_64", extra), ("aarch64", "")):  # it has no wheels for others
        monkeypatch.setattr(platform, "machine", lambda machine=machine: machine)
        with pytest.raises(MissingDependencyError) as caught:
            RosSession()
        told = str(caught.value)
        assert told.endswith(f"needs rclpy: source /opt/ros/<distro>/setup.bash{words}")


def test_the_middlewares_threads_do_not_preempt_the_tick_and_pythons_are_left_alone(
    react: Path,
) -> None:
    session = RosSession()
    workflow = load_workflow(react, hooks=[session.hook])
    waiting = threading.Event()
    mine = threading.Thread(target=waiting.wait)
    mine.start()
    session.attach(Runner(workflow))
    policies = {int(tid): os.sched_getscheduler(int(tid)) for tid in os.listdir("/proc/self/task")}
    python = {thread.native_id for thread in threading.enumerate()}
    assert {policy for tid, policy in policies.items() if tid in python} == {os.SCHED_OTHER}
    others = [policy for tid, policy in policies.items() if tid not in python]
    assert others
    assert set(others) == {os.SCHED_BATCH}
    waiting.set()
    mine.join()
    workflow.close()
    session.close()


def test_counts_can_be_written_as_json(react: Path) -> None:
    session = RosSession()
    workflow = load_workflow(react, hooks=[session.hook])
    assert json.loads(json.dumps(session.counts()))["published"] == 0
    workflow.close()
    session.close()
    session.close()


def test_skills_are_asked_for_by_services(
    runs: Callable[..., Any], peers: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "skills.yaml"
    path.write_text(
        "robot: go2\nplatform: fake\nrate: 50\nstates: {ready: {initial: 0.25}}\n"
        "skills: {stand: {do: hold}, limp: {do: damp, enter: ready > 0.5}, low: {do: damp}}\n"
        "flow: skills\n",
        encoding="utf-8",
    )
    run = runs(path)
    peer = peers("caller", "unicon", "skills/limp", "skills/stand", "skills/low")
    status, errors = peer.end()
    assert status == 0, errors
    answers = [(line["success"], line["message"]) for line in peer.lines]
    refused = "refused: ready > 0.5 does not hold: ready is 0.25"
    told = [(False, refused), (True, "it runs already"), (True, "low from the next tick on")]
    assert answers == told, peer.lines
    peer.wait_for(lambda: run.program.states["skill"] == 2, "the skill")
