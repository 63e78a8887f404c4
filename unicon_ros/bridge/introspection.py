"""Introspection: lets any ROS tool learn what states there are, by standard messages alone.

    ros2 topic echo --once --full-length --field data /unicon/layout      what stands latched
    ros2 service call /unicon/list_states std_srvs/srv/Trigger            the same, asked for

Both are one JSON text with a line for each state, which `unicon_core.states.Layout.from_json`
reads too. Chosen states with their values come on `~/debug`, as `ros2 topic echo` shows them
readably: a diagnostic_msgs/DiagnosticArray with a status for each state, its name, unit and
elements by name. A timer publishes it, in the slack of the ticks, and only while somebody listens.

    ros2 topic echo /unicon/debug            with parameter debug_states: [joint_pos, "action[0:3]"]
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

from unicon_base import AnyDict, UniconError, alternatives
from unicon_core.flow import blocks_of
from unicon_core.workflow import Program
from unicon_msgs_map import Encoder, FieldSpec, PublishSpec, Qos
from unicon_msgs_map.codec.binding import Arrays, Bound, Names, bind_state
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.layout.paths import PathError, Reference, parse_path, parse_reference
from unicon_ros import compat
from unicon_ros.bridge.bindings import names_of
from unicon_ros.bridge.own_node import Answer
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.bridge.topics import TopicIn, TopicOut
from unicon_ros.parameter_table import INTROSPECTION, declare

SCHEMA = "unicon.layout/1"
TOPIC = "~/layout"

DEBUG = "~/debug"
DEBUG_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
PARAMETER = "parameter debug_states"
MOST = 256
"""Numbers in a message: as texts they take 0.2 ms of the slack."""
FLOAT, WHOLE = "12.5g", "20d"
"""Of fixed width, so that the message has one layout; the longest are -1.2346e-308 and -2⁶³."""


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
    told: dict[str, AnyDict] = {}
    for topic in topics:
        spec, direction = topic.spec, "in" if isinstance(topic, TopicIn) else "out"
        entry = {"type": spec.type, "direction": direction, "states": []}
        carried = told.setdefault(topic.topic, entry)["states"]
        carried += [name for name in spec.states if name in layout.specs and name not in carried]
    lines = [f"{_json(name)}: {_json(value)}," for name, value in heads.items()]
    lines += ['"states": [', ",\n".join(states), "],"]
    lines += ['"writers": {', _entries(writers), "},", '"topics": {', _entries(told), "}"]
    return "\n".join(["{", *lines, "}"])


def _entries(values: AnyDict) -> str:
    return ",\n".join(f"{_json(name)}: {_json(value)}" for name, value in values.items())


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


class DebugTopic:
    """Publishes until it is closed.

    Args:
        node: rclpy node; its executor is served in the slack.
        program: whose states they are; of the first robot, where there are many.
        arrays: the states as they are published.
        chosen: states, parts of them as in a map, or patterns such as `joint_*`.
        rate: in [Hz].
        group: callback group of the timer.
        running: tells whether ticks go on.

    Raises:
        UniconError: no such state or element, too many numbers, or the rate is not one.
    """

    def __init__(
        self,
        node: Any,
        program: Program,
        arrays: Arrays,
        chosen: Sequence[str],
        rate: float,
        group: Any,
        running: Callable[[], bool],
    ) -> None:
        if not 0.0 < rate <= 100.0:
            raise UniconError(f"parameter debug_rate is {rate!r} Hz; give 0.1 to 100")
        encoder = debug_encoder(chosen, program, arrays)
        message = compat.message_class(DEBUG_TYPE)
        if message is None:
            raise UniconError(
                f"{PARAMETER} needs the type {DEBUG_TYPE}; install the ROS package diagnostic_msgs"
            )

        self._encode, self._running, self._node = encoder.encode, running, node
        self._publisher = node.create_publisher(message, DEBUG, qos_profile(encoder.spec.qos))
        self._publish, self._release = compat.raw_publish(self._publisher)
        self._encode()  # the first is cold
        self._timer = compat.steady_timer(node, 1.0 / rate, self._look, group)

    def _look(self) -> None:
        if self._running() and self._publisher.get_subscription_count():
            self._publish(self._encode())

    def close(self) -> None:
        """Destroy timer and publisher."""
        self._node.destroy_timer(self._timer)
        self._release()
        self._node.destroy_publisher(self._publisher)


def debug_encoder(chosen: Sequence[str], program: Program, arrays: Arrays) -> Encoder:
    """Return what makes the message; arguments and errors as of `DebugTopic`."""
    names, specs = names_of(program), program.states.layout.specs
    fields = [_field("header.stamp", Reference("state", "stamp_ns"))]
    count = 0
    for number, bound in enumerate(_chosen(chosen, arrays, names)):
        state = bound.field.source.name
        spec, at = specs[state], f"status[{number}]"
        said = ", ".join(filter(None, (spec.unit, spec.frame and f"frame {spec.frame}")))
        for key, text in (
            ("name", str(bound.field.source)),
            ("message", said),
            ("hardware_id", program.robot.name),
        ):
            fields.append(_field(f"{at}.{key}", Reference("const", value=text)))
        for row, element in enumerate(bound.elements):
            name = bound.names[row] if bound.names else str(element)
            value, source = f"{at}.values[{row}]", Reference("state", state, element)
            fields.append(_field(f"{value}.key", Reference("const", value=name)))
            form = FLOAT if bound.is_float else WHOLE
            fields.append(replace(_field(f"{value}.value", source), text=form))
        count += len(bound.elements)
    if count > MOST:
        raise UniconError(
            f"{PARAMETER}: {count} numbers are asked for, {MOST} at most; name fewer states, or "
            "parts of them such as joint_pos[0:3]"
        )
    types, qos = shared_messages(), Qos(depth=1)
    entry = PublishSpec(DEBUG, DEBUG_TYPE, tuple(fields), types, qos=qos, where=PARAMETER)
    return Encoder.build(entry, arrays)


def _field(path: str, source: Reference) -> FieldSpec:
    return FieldSpec(path, parse_path(path), source, where=PARAMETER)


def _chosen(chosen: Sequence[str], arrays: Arrays, names: Names) -> list[Bound]:
    """Return the states that are meant, each once, in the order in which they are named."""
    found: dict[str, Bound] = {}
    for text in chosen:
        if any(sign in text for sign in "*?"):
            meant = [name for name in arrays if fnmatchcase(name, text)]
            if not meant:
                raise UniconError(
                    f"{PARAMETER}: no state is like {text!r}; {alternatives(text, arrays)}"
                )
        else:
            meant = [text]
        for each in meant:
            try:
                source = parse_reference(each)
            except PathError as error:
                raise UniconError(f"{PARAMETER}: {error}") from error
            if source.kind != "state":
                raise UniconError(
                    f"{PARAMETER}: {each!r} is not a state; {alternatives(each, arrays)}"
                )
            if source.name not in arrays:
                raise UniconError(
                    f"{PARAMETER}: no state {source.name!r}; {alternatives(source.name, arrays)}"
                )
            field = FieldSpec("values", (), source, where=PARAMETER)
            found.setdefault(str(source), bind_state(field, arrays, names))
    return list(found.values())
