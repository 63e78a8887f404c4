"""Calls that equal those of ros2cli and launch, with their words, where their code is not at hand.

    python equal_calls.py node list | topic list -t | topic echo --once TOPIC TYPE
    python equal_calls.py service call NAME TYPE
    python equal_calls.py lifecycle get NODE | lifecycle set NODE TRANSITION
    python equal_calls.py param get NODE NAME | param set NODE NAME VALUE
    python equal_calls.py run PACKAGE PROGRAM … | launch PACKAGE FILE argument:=value …

`launch` starts the node with the command line that launch_ros makes of the launch file, which needs
launch to be read: parameters in a file, name and namespace as rules; it hands SIGINT on, once, and
leaves its child where it is killed.
"""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

PATIENCE = 15.0


class Node:
    """An rclpy node that asks."""

    def __init__(self) -> None:
        import rclpy

        self._rclpy = rclpy
        rclpy.init()
        self.node = rclpy.create_node(f"equal_calls_{os.getpid()}")

    def call(self, name: str, kind: Any, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        if not client.wait_for_service(PATIENCE):
            sys.exit(f"no service {name}")
        future = client.call_async(request)
        self._rclpy.spin_until_future_complete(self.node, future, timeout_sec=PATIENCE)
        return future.result()

    def found(self, ask: Callable[[], Any]) -> Any:
        """Return what is found once it stays the same, as with `--spin-time`."""
        time.sleep(3.0)
        return ask()


def _type(name: str) -> Any:
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


def node_list() -> str:
    found = Node()
    names = found.found(found.node.get_node_names_and_namespaces)
    paths = {f"{space.rstrip('/')}/{name}" for name, space in names}
    return "\n".join(sorted(path for path in paths if "equal_calls" not in path))


def topic_list(_: str) -> str:
    found = Node()
    topics = found.found(found.node.get_topic_names_and_types)
    return "\n".join(f"{name} [{', '.join(types)}]" for name, types in sorted(topics))


def topic_echo(_: str, topic: str, kind: str) -> str:
    import rclpy
    from rclpy.qos import qos_profile_sensor_data

    node, heard = Node().node, []
    node.create_subscription(_type(kind), topic, heard.append, qos_profile_sensor_data)
    end = time.monotonic() + PATIENCE
    while not heard and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    return str(heard[0]) if heard else sys.exit(f"nothing on {topic}")


def service_call(name: str, kind: str) -> str:
    service = _type(kind)
    return f"response:\n{Node().call(name, service, service.Request())}"


def lifecycle_get(node: str) -> str:
    from lifecycle_msgs.srv import GetState

    state = Node().call(f"{node}/get_state", GetState, GetState.Request()).current_state
    return f"{state.label} [{state.id}]"


def lifecycle_set(node: str, label: str) -> str:
    from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions

    asks = Node()
    there = asks.call(
        f"{node}/get_available_transitions",
        GetAvailableTransitions,
        GetAvailableTransitions.Request(),
    ).available_transitions
    ids = {each.transition.label: each.transition for each in there}
    if label not in ids:
        sys.exit(f"Unknown transition requested, available ones are: {', '.join(ids)}")
    request = ChangeState.Request(transition=ids[label])
    done = asks.call(f"{node}/change_state", ChangeState, request).success
    return "Transitioning successful" if done else sys.exit("Transitioning failed")


def param_get(node: str, name: str) -> str:
    from rcl_interfaces.srv import GetParameters
    from rclpy.parameter import Parameter, parameter_value_to_python

    request = GetParameters.Request(names=[name])
    (value,) = Node().call(f"{node}/get_parameters", GetParameters, request).values
    kind = Parameter.Type(value.type).name.title()
    return f"{kind} value is: {parameter_value_to_python(value)}"


def param_set(node: str, name: str, text: str) -> str:
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    given = Parameter(name, value=yaml.safe_load(text)).to_parameter_msg()
    request = SetParameters.Request(parameters=[given])
    (result,) = Node().call(f"{node}/set_parameters", SetParameters, request).results
    if result.successful:
        return "Set parameter successful"
    return sys.exit(f"Setting parameter failed: {result.reason}")


def run(package: str, program: str, *arguments: str) -> str:
    path = _program(package, program)
    os.execv(path, [str(path), *arguments])


def launch(package: str, _: str, *given: str) -> str:
    values = {"workflow": "go2_stand", "namespace": ""}
    values |= dict(each.split(":=", 1) for each in given)
    namespace = values.pop("namespace")
    file = Path(tempfile.mkdtemp()) / "launch_params"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
    rules = ["-r", "__node:=unicon"]
    rules += ["-r", f"__ns:=/{namespace}"] if namespace else []
    command = [str(_program(package, "unicon_node")), "--end-with", str(os.getpid())]
    child = subprocess.Popen([*command, "--ros-args", *rules, "--params-file", str(file)])
    signal.signal(signal.SIGINT, lambda *_: child.send_signal(signal.SIGINT))
    sys.exit(child.wait())


def _program(package: str, name: str) -> Path:
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        path = Path(prefix, "lib", package, name)
        if os.access(path, os.X_OK):
            return path
    sys.exit(f"no executable {name} of package {package}")


def main() -> None:
    """Do what the words say."""
    verb, *rest = sys.argv[1:]
    calls: dict[str, Callable[..., str]] = {"run": run, "launch": launch}
    if verb not in calls:
        verb, rest = f"{verb}_{rest[0]}", rest[1:]
        calls = {name: value for name, value in globals().items() if callable(value)}
    print(calls[verb](*rest), flush=True)


if __name__ == "__main__":
    main()
