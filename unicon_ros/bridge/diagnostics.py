"""Diagnostics: what /diagnostics says about a run, once a second; `Neighbours`: what would harm it.

Every status bears the fully qualified name of the node, which tells robots in one ROS domain
apart. A second node of our name answers our services too, a second publisher of /clock lets the
time jump, and a publisher of another type than the map's is received by no node, without a word of
the middleware. A look takes some 10 µs for each topic; the answers are rcl's own copy of the graph.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from unicon_base import TextSink
from unicon_core.runtime import Runner, TickStatistics, percentiles
from unicon_core.runtime.phases import Phase
from unicon_ros import compat
from unicon_ros.bridge.estop import FAULT, EmergencyStop
from unicon_ros.bridge.topics import TopicIn, TopicOut

CLOCK = "/clock"
"""Name of the topic in maps, before remaps."""
AT_ONCE = 8
"""Topics looked at in one go."""


@dataclass(eq=False)
class Neighbours:
    """Looks around for one node.

    Args:
        node: rclpy node.
        outgoing, incoming: its topics, read anew in every look.
        warn: takes what is told, one line each.

    Attributes:
        present: what is told of and still so, by what it is of.
    """

    node: Any
    outgoing: Sequence[TopicOut]
    incoming: Sequence[TopicIn]
    warn: TextSink

    def __post_init__(self) -> None:
        self._told: set[str] = set()
        self._counts: dict[str, int] = {}
        self._next = 0
        self.present: dict[str, str] = {}

    def look(self) -> None:
        """Look at names, clock and some of the topics; about once a second, outside of ticks."""
        self._names()
        for out in self.outgoing:
            if out.spec.topic == CLOCK:
                self._clock(out.topic)
        incoming = self.incoming
        for _ in range(min(AT_ONCE, len(incoming))):
            self._next = (self._next + 1) % len(incoming)
            topic = incoming[self._next]
            if self._changed(topic.topic):
                told = other_types(self.node, topic.topic, topic.spec.type)
                self._tell(topic.topic, told)

    def _names(self) -> None:
        name, space = self.node.get_name(), self.node.get_namespace()
        there = self.node.get_node_names_and_namespaces().count((name, space))
        full = self.node.get_fully_qualified_name()
        self._tell(
            "name",
            f"there are {there} nodes {full} in this ROS domain: a service call or a "
            "parameter reaches them all or any one; give each a name or a namespace of its own "
            "(-r __node:=NAME, -r __ns:=/NAME)"
            if there > 1
            else "",
        )

    def _clock(self, topic: str) -> None:
        if not self._changed(topic):
            return
        others = _publishers(self.node, topic)
        ours = (self.node.get_fully_qualified_name(), "rosgraph_msgs/msg/Clock")
        if ours in others:
            others.remove(ours)
        self._tell(
            topic,
            f"topic {topic}: {_listed(others)} publishes it too, so that the time jumps for all "
            f"who follow it; let one simulator publish it, or remap it (-r {CLOCK}:=clock)"
            if others
            else "",
        )

    def _changed(self, topic: str) -> bool:
        """Return whether the number of publishers is another one than at the last look."""
        count = self.node.count_publishers(topic)
        before = self._counts.get(topic, 0)
        self._counts[topic] = count
        return bool(count != before)

    def _tell(self, what: str, text: str) -> None:
        if not text:
            self.present.pop(what, None)
            return
        self.present[what] = text
        key = "name" if what == "name" else text
        if key not in self._told:
            self._told.add(key)
            self.warn(text)


def other_types(node: Any, topic: str, kind: str) -> str:
    """Return who publishes a topic with another type than ours, as a sentence, or "".

    Args:
        node: rclpy node.
        topic: full name.
        kind: our type, such as `geometry_msgs/msg/Twist`.
    """
    others = [each for each in _publishers(node, topic) if each[1] != kind]
    if not others:
        return ""
    types = " and ".join(dict.fromkeys(each[1] for each in others))
    return (
        f"topic {topic}: {_listed(others)} publishes {types}, which nobody hears here, since the "
        f"map says {kind}; correct the type there or in the map, or remap the topic"
    )


def _publishers(node: Any, topic: str) -> list[tuple[str, str]]:
    """Return full name of the node, and type, of each publisher of a topic."""
    return [
        (f"{each.node_namespace.rstrip('/')}/{each.node_name}", each.topic_type)
        for each in node.get_publishers_info_by_topic(topic)
    ]


def _listed(publishers: Sequence[tuple[str, str]]) -> str:
    return "node " + ", ".join(dict.fromkeys(name for name, _ in publishers))


OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"
TEMPERATURES = ("joint_temperature", "motor_temperature", "temperature")
TOPIC = "/diagnostics"
LAST = 0.1
"""How long readers may take to get the last status in [s]."""


class Diagnostics:
    """Publishes diagnostic_msgs/DiagnosticArray with a status of ours.

    Args:
        node: rclpy node.
        estop: its emergency stop, whose latch is told.

    Attributes:
        runner: what is told about; None while nothing runs.
        neighbours: says whose topics are told, and what is told of others; None while nobody looks.
        fault: why the last run ended, "" if it ended well.
        causes: `cause NAME` to its size, of those that explain how the robot moves.
    """

    def __init__(self, node: Any, estop: EmergencyStop) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self._node, self._estop = node, estop
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, 10)
        self.runner: Runner | None = None
        self.neighbours: Neighbours | None = None
        self.fault = ""
        self.causes: dict[str, str] = {}
        self._at = time.monotonic()
        self._ticks = self._overruns = 0
        self._paused = 0.0
        self._counts: dict[str, int] = {}

    def publish(self) -> None:
        """Send the present status; a timer's callback."""
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        level, message, values = self.status()
        if self._estop.latched:
            level, message = ERROR, f"{self.fault or FAULT}; latched until ~/clear_estop"
        values["estop"] = "latched" if self._estop.latched else "clear"
        status = DiagnosticStatus(
            level=level, name=f"{self._node.get_fully_qualified_name()}: tick"
        )
        status.message = message
        if self.runner is not None:
            space = self._node.get_namespace().strip("/")
            status.hardware_id = "/".join(filter(None, (space, self.runner.program.robot.name)))
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Return level, message and values since the last call."""
        now = time.monotonic()
        seconds, self._at = max(now - self._at, 1e-6), now
        runner = self.runner
        if runner is None:
            if self.fault:
                return ERROR, self.fault, {"fault": self.fault}
            return OK, "inactive", {}
        statistics = runner.statistics
        ticks, overruns = statistics.count - self._ticks, statistics.overruns - self._overruns
        if ticks < 0:  # another run
            ticks, overruns = statistics.count, statistics.overruns
        self._ticks, self._overruns = statistics.count, statistics.overruns
        paused, self._paused = max(runner.paused_s - self._paused, 0.0), runner.paused_s
        values = {
            "workflow": runner.program.name,
            "platform": runner.program.platform.facts.name,
            "rate_hz": f"{ticks / max(seconds - paused, 1e-6):.2f}" if ticks else "0.00",
            "ticks": str(statistics.count),
            "overruns": str(statistics.overruns),
        }
        for name, value in _recent_us(statistics, ticks).items():
            values[f"tick_{name}_us"] = f"{value:.1f}"
        message = "running" if runner.phase is Phase.RUN else runner.phase.value
        if runner.waits_for:
            message = f"waiting for {runner.waits_for}"
        values["phase"] = runner.phase.value
        many = overruns > 0.01 * max(ticks, 1)
        wrong = [f"{overruns} overruns in {seconds:.1f} s"] * many + self._topics(values, seconds)
        values |= self.causes
        wrong = [": ".join(each) for each in self.causes.items()] + wrong
        if "twin_gap" in runner.program.states:
            wrong = [*_twin(runner, values), *wrong]
        for name in TEMPERATURES:
            if name in runner.program.states:
                values[f"{name}_max"] = f"{float(runner.program.states[name].max()):.1f}"
        return (WARN, wrong[-1], values) if wrong else (OK, message, values)

    def _topics(self, values: dict[str, str], seconds: float) -> list[str]:
        """Add what topics tell to the values; return what is wrong with them."""
        neighbours, wrong = self.neighbours, list[str]()
        if neighbours is None:
            return wrong
        for label, each in _labelled(neighbours):
            for name, count in each.events.counts().items():
                values[f"{label} {name}"] = str(count)
            if each.events.trouble:
                wrong.append(f"{each.topic}: {each.events.trouble}")
            passed = each.published if isinstance(each, TopicOut) else each.received
            before, self._counts[label] = self._counts.get(label, 0), passed
            values[f"{label} hz"] = f"{max(passed - before, 0) / seconds:.2f}"
            if isinstance(each, TopicOut):
                if each.failed:
                    values[f"{label} failed"] = str(each.failed)
                continue
            rejected, last_error = each.decoder.rejected, each.decoder.last_error
            if rejected:
                values[f"{label} rejected"] = f"{rejected}; {last_error}"
                wrong.append(f"{each.topic}: messages were refused")
            if each.stale:
                wrong.append(f"{each.topic}: no messages any more")
        return [*wrong, *neighbours.present.values()]

    def close(self) -> None:
        """Tell how the run ended, where there was one, and destroy the publisher."""
        runner, self.runner = self.runner, None
        if runner is not None:
            self.fault = "; ".join(runner.faults)
            self.publish()
            compat.wait_for_readers(self._publisher, LAST)
        self._node.destroy_publisher(self._publisher)


def _labelled(node: Neighbours) -> list[tuple[str, TopicOut | TopicIn]]:
    """Return topics with what tells them apart: their names, and more where several share one."""
    both: list[TopicOut | TopicIn] = [*node.outgoing, *node.incoming]
    names = [each.topic for each in both]
    labels: list[str] = []
    for each in both:
        label = each.topic
        if names.count(label) > 1:
            label += f" ({each.part})" if isinstance(each, TopicOut) else " (in)"
        alike = sum(other == label or other.startswith(f"{label} ") for other in labels)
        labels.append(f"{label} {alike + 1}" if alike else label)
    return list(zip(labels, both))


def _twin(runner: Runner, values: dict[str, str]) -> list[str]:
    """Tell how far the robot is from its live twin, joint by joint; return what is wrong."""
    states, names = runner.program.states, runner.program.robot.joint_names
    gaps, lags = states["twin_gap"], states["twin_lag"]
    for name, gap, lag in zip(names, gaps, lags):
        values[f"twin {name}"] = f"gap {gap:.3f} rad, lag {lag * 1e3:+.0f} ms"
    flagged = [names[i] for i in np.flatnonzero(states["twin_flag"])]
    if not flagged:
        return []
    worst = names[int(np.argmax(gaps))]
    return [f"not as the twin: {', '.join(flagged)}; worst {worst}, {gaps.max():.2f} rad"]


def _recent_us(statistics: TickStatistics, ticks: int) -> dict[str, float]:
    """Return p50, p99, max in [µs] from `recv` to the end of `send` of the last ticks."""
    rows = statistics.rows
    count = min(ticks, len(rows), statistics.count)
    ends = [4 + i for i in range(len(statistics.names)) if i not in statistics.deferred]
    if count < 1 or not ends:
        return percentiles(np.empty(0))
    recent = rows[np.arange(statistics.count - count, statistics.count) % len(rows)]
    return percentiles((recent[:, ends].max(axis=1) - recent[:, 2]) * 1e-3)
