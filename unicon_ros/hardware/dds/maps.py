"""Message maps that drivers make of a robot file, instead of reading a map's YAML file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.states import States
from unicon_msgs_map import MessageMap, PublishSpec, SubscribeSpec, parse_map
from unicon_msgs_map.layout.messages import shared_messages

COMMANDS = {
    "q": "joint_pos_target",
    "dq": "joint_vel_target",
    "tau": "joint_effort_ff",
    "kp": "joint_stiffness",
    "kd": "joint_damping",
}
"""Field of MotorCmd, which Unitree, PND and Dobot call the same, to state."""
MEASURED = {"q": "joint_pos", "dq": "joint_vel", "tau_est": "joint_effort"}
"""Field of MotorState to state."""
IMU = {"quaternion": "base_quat", "gyroscope": "base_ang_vel", "accelerometer": "base_lin_acc"}
"""Field of IMUState to state."""


def arrays_of(states: States) -> dict[str, NDArray[Any]]:
    """Return the states for maps: error codes of motors, 32 bits, are read without their sign."""
    arrays = {name: states[name] for name in states}
    if "motor_error" in arrays:
        arrays["motor_error"] = arrays["motor_error"].view(np.uint32)
    return arrays


def motors(
    array: str, slots: Sequence[int], fields: Mapping[str, str], first: int = 0
) -> dict[str, str]:
    """Return paths of motors with the part of the array that each stands for.

    Args:
        array: of motors in the message.
        slots: of neighbouring joints.
        fields: of a motor, with the array that has one element for each joint.
        first: number of the first joint.
    """
    made: dict[str, str] = {}
    begin = 0
    for end in range(1, len(slots) + 1):
        if end == len(slots) or slots[end] != slots[begin] + end - begin:
            run = f"{array}[{slots[begin]}:{slots[begin] + end - begin}]"
            part = f"[{first + begin}:{first + end}]"
            made |= {f"{run}.{field}": name + part for field, name in fields.items()}
            begin = end
    return made


def subscribe(topic: str, message: str, fields: Mapping[str, Any]) -> SubscribeSpec:
    """Return how a message is read.

    Args:
        topic: for error messages.
        message: its type, such as `unitree_go/msg/LowState`.
        fields: path in it to what it is written to, as in `subscribe` of a map.

    Raises:
        MapFileError: a field is wrong.
    """
    return _parsed("subscribe", topic, message, fields).subscribe[0]


def publish(topic: str, message: str, fields: Mapping[str, Any]) -> PublishSpec:
    """Return how a message is made; see `subscribe`.

    Raises:
        MapFileError: a field is wrong.
    """
    return _parsed("publish", topic, message, fields).publish[0]


def _parsed(way: str, topic: str, message: str, fields: Mapping[str, Any]) -> MessageMap:
    entry = {"topic": topic, "type": message, "fields": dict(fields)}
    return parse_map(json.dumps({way: [entry]}), shared_messages(), name=topic)
