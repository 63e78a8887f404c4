"""Introspection: lets any ROS tool learn what states there are, by standard messages alone.

    ros2 topic echo --once --full-length --field data /unicon/layout      what stands latched
    ros2 service call /unicon/list_states std_srvs/srv/Trigger            the same, asked for

Both are one JSON text with a line for each state, which `unicon_core.states.Layout.from_json`
reads too. Chosen states with their values come on `~/debug`, see `DebugTopic`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

from unicon_core.flow import blocks_of
from unicon_core.workflow import Program
from unicon_msgs_map.codec.binding import Arrays
from unicon_ros.bridge.debug_topic import DebugTopic
from unicon_ros.bridge.declare import declare
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.bridge.topics_in import TopicIn
from unicon_ros.bridge.topics_out import TopicOut
from unicon_ros.controls import Answer
from unicon_ros.parameter_table import INTROSPECTION

SCHEMA = "unicon.layout/1"
TOPIC = "~/layout"


class Introspection:
    """Of one workflow on a node.

    Args:
        node: rclpy node; parameters that it lacks are declared.
        group: callback group of the timer of the debug topic.
        running: tells whether ticks go on.
    """

    def __init__(self, node: Any, group: Any, running: Callable[[], bool]) -> None:
        self._node, self._group, self._running = node, group, running
        self._program: Program | None = None
        self._text = ""
        self._latched: Any = None
        self._debug: DebugTopic | None = None
        declare(node, INTROSPECTION)

    def attach(
        self, program: Program, topics: Sequence[TopicOut | TopicIn], arrays: Arrays
    ) -> None:
        """Tell of a program, once it is built.

        Args:
            program: it.
            topics: of the session.
            arrays: the states as they are published.

        Raises:
            UniconError: parameter `debug_states` names what there is not.
        """
        from std_msgs.msg import String

        if self._program is program:
            return
        self.close()
        self._program = program
        self._text = layout_text(program, topics)
        self._latched = self._node.create_publisher(String, TOPIC, qos_profile(LATCHED))
        self._latched.publish(String(data=self._text))
        chosen = [text for text in self._node.get_parameter("debug_states").value if text]
        if chosen:
            rate = self._node.get_parameter("debug_rate").value
            self._debug = DebugTopic(
                self._node, program, arrays, chosen, rate, self._group, self._running
            )

    def list_states(self) -> Answer:
        """Answer `~/list_states`."""
        return (True, self._text) if self._text else (False, "no workflow is built yet")

    def close(self) -> None:
        """Destroy publishers and timer; safe to call twice."""
        if self._debug is not None:
            self._debug.close()
        if self._latched is not None:
            self._node.destroy_publisher(self._latched)
        self._debug = self._latched = self._program = None


def layout_text(program: Program, topics: Sequence[TopicOut | TopicIn] = ()) -> str:
    """Return what states a program has, as JSON with a line for each state, block and topic.

    `states` are those of `Layout.to_json`; `writers` tells the blocks that write or amend each,
    `topics` which states a topic carries, and in which direction seen from us.

    Args:
        program: it, with all its blocks.
        topics: that mirror its states.
    """
    layout = program.states.layout
    writers: dict[str, list[str]] = {}
    for block in blocks_of(program.root):
        for state in (*block.writes, *block.amends):
            named = writers.setdefault(state, [])
            named += [block.name] if block.name not in named else []
    heads = {
        "schema": SCHEMA,
        "workflow": program.name,
        "robot": program.robot.name,
        "platform": program.platform.facts.name,
        "period_s": program.period,
        "num_robots": layout.num_robots,
        "layout_hash": layout.hash,
        "nbytes": layout.nbytes,
    }
    states = [_json({"name": name, **spec.to_dict()}) for name, spec in layout.specs.items()]
    told: dict[str, dict[str, Any]] = {}
    for topic in topics:
        received = isinstance(topic, TopicIn)
        spec = topic.decoder.spec if isinstance(topic, TopicIn) else topic.spec
        direction = "in" if received else "out"
        entry: dict[str, Any] = {"type": spec.type, "direction": direction, "states": []}
        carried = told.setdefault(topic.topic, entry)["states"]
        carried += [name for name in spec.states if name in layout.specs and name not in carried]
    lines = [f"{_json(name)}: {_json(value)}," for name, value in heads.items()]
    lines += ['"states": [', ",\n".join(states), "],"]
    lines += ['"writers": {', _entries(writers), "},", '"topics": {', _entries(told), "}"]
    return "\n".join(["{", *lines, "}"])


def _entries(values: dict[str, Any]) -> str:
    return ",\n".join(f"{_json(name)}: {_json(value)}" for name, value in values.items())


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
