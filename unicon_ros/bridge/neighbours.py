"""Neighbours: others in the ROS graph who would harm a run, each told once.

A second node of our name answers our services too, a second publisher of /clock lets the time jump,
and a publisher of another type than the map's is heard by nobody, without a word of the middleware.
A look takes some 10 µs for each topic; the answers are rcl's own copy of the graph.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from unicon_ros.bridge.topics_in import TopicIn
from unicon_ros.bridge.topics_out import TopicOut

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
    warn: Callable[[str], None]

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
            f"there are {there} nodes {full} in this ROS domain: whoever calls a service or sets a "
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
