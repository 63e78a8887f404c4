"""Broken deadlines and lost liveliness: told once for each episode, counted in /diagnostics."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import Twist
from peer import wait_for
from rclpy import event_handler
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import LivelinessPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from ros_helpers import Run

from unicon_ros.bridge import qos
from unicon_ros.bridge.diagnostics import WARN, Diagnostics

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]

TWIST = "{topic: cmd_vel, type: geometry_msgs/msg/Twist, fields: {linear.x: 'velocity_command[0]'},"
JOINTS = "{topic: joints, type: sensor_msgs/msg/JointState, fields: {position: joint_pos},"


@pytest.fixture(autouse=True)
def calm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes end sooner, but later than any pause between two events of one here."""
    monkeypatch.setattr(qos, "CALM", 2.0)


class Twists:
    """A plain publisher of Twist in another context, which beats while it is told to."""

    def __init__(self, **qos: Any) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("plain", context=self._context)
        self._publisher = self._node.create_publisher(Twist, "cmd_vel", QoSProfile(depth=1, **qos))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def until(self, ready: Callable[[], bool], what: str, beat: bool) -> None:
        """Publish at about 50 Hz, or nothing at all, until something holds."""

        def spun() -> bool:
            if beat:
                self._publisher.publish(Twist())
            self._executor.spin_once(0.02)
            return ready()

        wait_for(spun, what)

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)


@pytest.fixture
def twists() -> Iterator[Callable[..., Twists]]:
    made: list[Twists] = []

    def make(**qos: Any) -> Twists:
        made.append(Twists(**qos))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def run_with(runs: Callable[..., Run], react: Path, tmp_path: Path) -> Callable[[str, str], Run]:
    """Run a workflow with one topic."""

    def run(direction: str, entry: str) -> Run:
        path = tmp_path / "one.yaml"
        path.write_text(f"{direction}:\n  - {entry}\n")
        return runs(react, map=path)

    return run


def seconds(value: float) -> Duration:
    return Duration(nanoseconds=round(value * 1e9))


def told(run: Run, what: str) -> list[str]:
    return [warning for warning in run.warnings if what in warning]


def status(run: Run) -> tuple[bytes, str, dict[str, str]]:
    """Return what /diagnostics would say now."""
    assert run.session.estop is not None
    diagnostics = Diagnostics(run.session.node, run.session.estop)
    diagnostics.runner = run.runner
    diagnostics.neighbours = run.session.neighbours
    found = diagnostics.status()
    diagnostics.close()
    return found


@pytest.fixture
def heard(run_with: Callable[..., Run], twists: Callable[..., Twists]) -> tuple[Run, Any, Twists]:
    """A run with a deadline of 0.4 s, its topic, and a publisher that keeps it so far."""
    run = run_with("subscribe", f"{TWIST} qos: {{deadline: 0.4}}}}")
    (topic,) = run.session.incoming
    peer = twists(deadline=seconds(0.4))
    peer.until(lambda: topic.received > 5, "messages", beat=True)
    return run, topic, peer


@pytest.mark.slow
def test_a_late_publisher_is_told_once_for_each_episode(heard: tuple[Run, Any, Twists]) -> None:
    run, topic, peer = heard
    assert not told(run, "deadline")
    for episode in (1, 2):
        before = topic.events.counts()["deadlines missed"]
        peer.until(
            lambda seen=before: topic.events.counts()["deadlines missed"] > seen + 1,
            "missed deadlines",
            beat=False,
        )
        assert len(told(run, "missed")) == episode
        assert topic.events.trouble
        peer.until(lambda: not topic.events.trouble, "the end of the episode", beat=True)
        assert len(told(run, "kept again")) == episode
    assert re.fullmatch(
        r"topic cmd_vel: deadline of 0\.4 s missed \(so far: \d+\); see why its publisher is late, "
        r"or qos\.deadline in the message map",
        told(run, "missed")[0],
    )
    assert told(run, "kept again")[0].startswith("topic cmd_vel: deadline of 0.4 s kept again (so")
    counted = run.session.counts()["topics"]["/cmd_vel"]["deadlines_missed"]
    assert counted == topic.events.counts()["deadlines missed"]


@pytest.mark.slow
def test_the_diagnostics_warn_while_deadlines_are_missed(heard: tuple[Run, Any, Twists]) -> None:
    run, topic, peer = heard
    assert status(run)[2]["/cmd_vel deadlines missed"] == "0"
    peer.until(lambda: bool(topic.events.trouble), "a missed deadline", beat=False)
    level, message, values = status(run)
    assert (level, message) == (WARN, "/cmd_vel: deadline of 0.4 s missed")
    assert int(values["/cmd_vel deadlines missed"]) >= 1
    peer.until(lambda: not topic.events.trouble, "the end of the episode", beat=True)
    assert "deadline" not in status(run)[1]


def test_a_topic_that_we_publish_too_seldom_is_told_once(run_with: Callable[..., Run]) -> None:
    run = run_with("publish", f"{JOINTS} rate: 10, qos: {{deadline: 0.04}}}}")
    (out,) = [out for out in run.session.outgoing if out.topic == "/joints"]
    wait_for(lambda: out.published > 8, "messages")
    most = out.published - 2  # the middleware tells of them once a second
    wait_for(lambda: out.events.counts()["deadlines missed"] >= most, "missed deadlines")
    (once,) = told(run, "deadline")
    assert re.fullmatch(
        r"topic joints: deadline of 0\.04 s missed \(so far: \d+\); raise the topic's rate, "
        r"or qos\.deadline in the message map",
        once,
    )


def test_our_own_liveliness_is_lost_between_two_messages(run_with: Callable[..., Run]) -> None:
    qos = "qos: {liveliness: manual_by_topic, liveliness_lease: 0.04}"
    run = run_with("publish", f"{JOINTS} rate: 10, {qos}}}")
    (out,) = [out for out in run.session.outgoing if out.topic == "/joints"]
    wait_for(lambda: out.events.counts()["liveliness lost"] > 3, "lost liveliness")
    (once,) = told(run, "liveliness")
    assert re.fullmatch(
        r"topic joints: our liveliness lost \(so far: \d+\); raise the topic's rate, "
        r"or qos\.liveliness_lease in the message map",
        once,
    )


@pytest.mark.slow
def test_liveliness_lost_and_regained_is_told(
    run_with: Callable[..., Run], twists: Callable[..., Twists]
) -> None:
    qos = "qos: {liveliness: manual_by_topic, liveliness_lease: 0.3}"
    run = run_with("subscribe", f"{TWIST} {qos}}}")
    (topic,) = run.session.incoming
    manual = LivelinessPolicy.MANUAL_BY_TOPIC
    peer = twists(liveliness=manual, liveliness_lease_duration=seconds(0.3))

    def alive() -> bool:
        return topic.events.counts()["publishers alive"] == 1

    for episode in (1, 2):
        peer.until(alive, "a living publisher", beat=True)
        peer.until(lambda: bool(topic.events.trouble), "the loss", beat=False)
        assert len(told(run, "liveliness lost")) == episode
        peer.until(lambda: not topic.events.trouble, "the end of the episode", beat=True)
        assert told(run, "regained")[-1] == (
            f"topic cmd_vel: liveliness regained (so far: {episode})"
        )
    assert topic.events.counts() == {"liveliness lost": 2, "publishers alive": 1}


@pytest.mark.slow
def test_a_stopped_process_is_not_alive_until_it_goes_on(
    run_with: Callable[..., Run], peers: Callable[..., Any]
) -> None:
    run = run_with("subscribe", f"{TWIST} qos: {{liveliness_lease: 0.5}}}}")
    (topic,) = run.session.incoming
    peer = peers("lively", "0.5")
    wait_for(lambda: topic.events.counts()["publishers alive"] == 1, "a living publisher")
    assert not topic.events.trouble
    os.kill(peer.process.pid, signal.SIGSTOP)
    wait_for(lambda: bool(topic.events.trouble), "the loss")
    level, message, values = status(run)
    assert (level, message) == (WARN, "/cmd_vel: liveliness lost")
    assert values["/cmd_vel liveliness lost"] == "1"
    assert values["/cmd_vel publishers alive"] == "0"
    os.kill(peer.process.pid, signal.SIGCONT)
    wait_for(lambda: not topic.events.trouble, "the end of the episode")
    assert len(told(run, "liveliness")) == 2


@pytest.mark.parametrize(
    ("lacked", "noted", "left"),
    [
        (("DEADLINE",), "deadline", {"liveliness lost", "publishers alive"}),
        (("DEADLINE", "LIVELINESS"), "both", set()),
        (("DEADLINE", "LIVELINESS", "INCOMPATIBLE"), "both", set()),
    ],
    ids=["deadline", "both", "all"],
)
def test_a_middleware_without_an_event_is_noted_and_the_others_stay(
    run_with: Callable[..., Run],
    twists: Callable[..., Twists],
    monkeypatch: pytest.MonkeyPatch,
    lacked: tuple[str, ...],
    noted: str,
    left: set[str],
) -> None:
    real = event_handler.EventHandler

    def limited(*, event_type: Any, **options: Any) -> Any:
        if any(word in event_type.name for word in lacked):
            raise event_handler.UnsupportedEventTypeError("not supported")
        return real(event_type=event_type, **options)

    monkeypatch.setattr(event_handler, "EventHandler", limited)
    run = run_with("subscribe", f"{TWIST} qos: {{deadline: 0.5, liveliness_lease: 0.5}}}}")
    (topic,) = run.session.incoming
    notes = {
        "deadline": "no deadline events, so nobody watches qos.deadline",
        "both": "no deadline and no liveliness events, so nobody watches qos.deadline "
        "and qos.liveliness",
    }
    assert told(run, "nobody watches") == [f"topic cmd_vel: the middleware has {notes[noted]}"]
    assert set(topic.events.counts()) == left
    both = seconds(0.5)
    peer = twists(deadline=both, liveliness_lease_duration=both)
    peer.until(lambda: topic.received > 2, "messages", beat=True)


def test_what_the_map_does_not_declare_is_not_watched(run_with: Callable[..., Run]) -> None:
    run = run_with("subscribe", f"{TWIST} timeout: 1.0}}")
    (topic,) = run.session.incoming
    assert topic.events.counts() == {}
    assert not topic.events.declared
    handlers = {handler.event_type.name for handler in topic.subscription.event_handlers}
    assert not [name for name in handlers if "DEADLINE" in name or "LIVELINESS" in name]
