"""`unicon pub TOPIC VALUES` and `unicon call SERVICE`: a word to a node, without ros2cli.

unicon pub cmd_vel '{linear: {x: 0.3}}'            at 10 Hz until Ctrl-C
unicon pub cmd_vel '{angular: {z: 0.5}}' --rate 20 --duration 3
unicon call stop                                   /unicon/stop, of type std_srvs/srv/Trigger
unicon call /robot1/unicon/estop
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections.abc import Callable, Mapping
from typing import Any

from unicon_base import UniconError, alternatives
from unicon_core.signals import SIGNALS
from unicon_ros.cli.options import EXAMPLES, argument, command, flag, positive, together

PATIENCE = 5.0
"""In [s], for somebody to be there, and for an answer."""
LINGER = 0.2
"""In [s], for the middleware to send what was published last."""


def filled(message: Any, values: Any, place: str = "") -> Any:
    """Set fields of a message and return it.

    Args:
        message: of any type.
        values: a mapping of fields to values, nested as the message is.
        place: of the message in a larger one, for errors.

    Raises:
        UniconError: there is no such field, or it takes another value.
    """
    fields = message.get_fields_and_field_types()
    if not isinstance(values, Mapping):
        raise UniconError(f"{place or 'VALUES'}: give a mapping of fields: {', '.join(fields)}")
    for name, value in values.items():
        where = f"{place}.{name}" if place else str(name)
        if name not in fields:
            raise UniconError(f"no field {where!r}; {alternatives(str(name), fields)}")
        setattr(message, name, _fitted(getattr(message, name), value, fields[name], where))
    return message


def _fitted(present: Any, value: Any, kind: str, where: str) -> Any:
    """Return a value as a field of some type takes it."""
    if hasattr(present, "get_fields_and_field_types"):
        return filled(present, value, where)
    wanted = (int, float) if isinstance(present, float) else type(present)
    if isinstance(present, str | bool | int | float):
        if not isinstance(value, wanted) or isinstance(value, bool) != isinstance(present, bool):
            raise UniconError(f"field {where} of type {kind} cannot be {value!r}")
        return float(value) if isinstance(present, float) else value
    from unicon_ros import compat

    element = re.search(r"([a-z][a-z0-9_]*)/([A-Za-z0-9]+)", kind)
    try:
        if element is not None:
            make = compat.message_class(f"{element[1]}/msg/{element[2]}")
            return [filled(make(), each, f"{where}.{k}") for k, each in enumerate(value)]
        if not hasattr(present, "dtype"):
            return [*value]
        present[:] = value  # of a fixed length, an array of NumPy
        return present
    except (TypeError, ValueError) as error:
        raise UniconError(f"field {where} of type {kind} cannot be {value!r}") from error


def _pub(arguments: argparse.Namespace) -> int:
    from unicon_base.bounded_yaml import YamlError
    from unicon_base.located_yaml import parse_value
    from unicon_ros import compat
    from unicon_ros.bridge.own_node import OwnNode

    try:
        values = parse_value(arguments.values)
    except YamlError as error:
        raise UniconError(f"pub: VALUES {arguments.values!r} is not YAML: {error}") from error
    own = OwnNode("unicon_pub", None, ())
    try:
        topic = own.node.resolve_topic_name(arguments.topic)

        def used() -> str:
            there = own.node.get_topic_names_and_types()
            return next((types[0] for name, types in there if name == topic), "")

        kind = arguments.type or _waited(used, topic)
        message_class = compat.message_class(kind)
        if message_class is None:
            raise UniconError(f"type {kind} is not installed; give --type PACKAGE/msg/NAME")
        message = filled(message_class(), values)
        publisher = own.node.create_publisher(message_class, topic, 10)
        _waited(publisher.get_subscription_count, topic)
        end = time.monotonic() + (arguments.duration or float("inf"))
        due, sent = time.monotonic(), 0
        while True:
            publisher.publish(message)
            sent, due = sent + 1, due + 1.0 / arguments.rate
            if arguments.once or due > end:
                break
            time.sleep(max(due - time.monotonic(), 0.0))
            SIGNALS.check()
        time.sleep(LINGER)
        print(f"{sent} messages to {topic}")
        return 0
    finally:
        own.close()


def _waited(look: Callable[[], Any], topic: str) -> Any:
    end = time.monotonic() + PATIENCE
    while not (found := look()):
        if time.monotonic() > end:
            raise UniconError(
                f"nobody listens to {topic} after {PATIENCE:g} s; start one with the same "
                "ROS_DOMAIN_ID: unicon run WORKFLOW --ros; see what there is: ros2 topic list"
            )
        time.sleep(0.05)
        SIGNALS.check()
    return found


def _call(arguments: argparse.Namespace) -> int:
    from std_srvs.srv import Trigger

    from unicon_ros.bridge.own_node import OwnNode
    from unicon_ros.parameter_table import SERVICES

    given = arguments.service.removeprefix("~/")
    name = given if given.startswith("/") else f"/unicon/{given}"
    own = OwnNode("unicon_call", None, ())
    try:
        client = own.node.create_client(Trigger, name)
        if not client.wait_for_service(timeout_sec=PATIENCE):
            known = [n for n, types in own.node.get_service_names_and_types()
                     if "std_srvs/srv/Trigger" in types and n != name]  # fmt: skip
            there = alternatives(name, known) if known else "no node offers any"
            raise UniconError(
                f"no service {name} after {PATIENCE:g} s; {there}; a node's are "
                f"{', '.join(SERVICES)}; is its ROS_DOMAIN_ID another?"
            )
        answer = client.call_async(Trigger.Request())
        own.executor.spin_until_future_complete(answer, timeout_sec=PATIENCE)
        if not answer.done():
            raise UniconError(f"{name} did not answer within {PATIENCE:g} s")
        told = answer.result()
        text = told.message
        if text.startswith("{"):
            text = json.dumps(json.loads(text), indent=2)
        print(text or ("done" if told.success else "refused"))
        return 0 if told.success else 1
    finally:
        own.close()


add = together(
    command(
        "pub",
        _pub,
        "publish a message to a topic",
        __doc__,
        argument("topic", "TOPIC", "such as cmd_vel, which is /cmd_vel"),
        argument("values", "VALUES", "fields as YAML; the others are zero"),
        argument("--type", "TYPE", "of the message; else what others use"),
        argument("--rate", "HZ", "10 unless given", type=positive, default=10.0),
        argument("--duration", "S", "end after S seconds", type=positive),
        flag("--once", "publish one message and end"),
        **EXAMPLES,
    ),
    command(
        "call",
        _call,
        "call a service of type Trigger",
        __doc__,
        argument("service", "SERVICE", "of the node /unicon, such as stop; or /NAMESPACE/…"),
        **EXAMPLES,
    ),
)
