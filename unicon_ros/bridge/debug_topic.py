"""DebugTopic: chosen states on `~/debug`, as `ros2 topic echo` shows them readably.

    ros2 topic echo /unicon/debug            with parameter debug_states: [joint_pos, "action[0:3]"]

A diagnostic_msgs/DiagnosticArray with a status for each state: its name, unit and elements by
name. A timer publishes it, in the slack of the ticks, and only while somebody listens.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

from unicon_core.errors import UniconError, alternatives
from unicon_core.workflow import Program
from unicon_msgs_map import Encoder, FieldSpec, PublishSpec, Qos
from unicon_msgs_map.codec.binding import Arrays, Bound, Names, bind_state
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.layout.paths import PathError, Reference, parse_path, parse_reference
from unicon_ros import compat
from unicon_ros.bridge.bindings import names_of
from unicon_ros.bridge.qos import qos_profile

TOPIC = "~/debug"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"
PARAMETER = "parameter debug_states"
MOST = 256
"""Numbers in a message: as texts they take 0.2 ms of the slack."""
FLOAT, WHOLE = "12.5g", "20d"
"""Of fixed width, so that the message has one layout; the longest are -1.2346e-308 and -2⁶³."""


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
        message = compat.message_class(TYPE)
        if message is None:
            raise UniconError(
                f"{PARAMETER} needs the type {TYPE}; install the ROS package diagnostic_msgs"
            )

        self._encode, self._running, self._node = encoder.encode, running, node
        self._publisher = node.create_publisher(message, TOPIC, qos_profile(encoder.spec.qos))
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
    entry = PublishSpec(TOPIC, TYPE, tuple(fields), types, qos=qos, where=PARAMETER)
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
