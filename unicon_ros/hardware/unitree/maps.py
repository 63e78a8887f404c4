"""The message maps of LowState and LowCmd, made of a robot file; for both ends of the wire.

The names on our side are states, and a few arrays that driver and emulator have of their own:
`tick`, `mode_machine`, `mode_pr`, `modes` (of motors), `temperatures` (two of each motor) and
`remote` (40 bytes).
"""

from __future__ import annotations

from collections.abc import Container
from typing import Any

from unicon_msgs_map import PublishSpec, SubscribeSpec
from unicon_ros.hardware.dds.maps import (
    COMMANDS,
    IMU,
    MEASURED,
    Message,
    motors,
    publish,
    subscribe,
)
from unicon_ros.hardware.unitree.facts import UnitreeFacts

_CHECKSUM = {"crc": {"checksum": "unitree"}}


def state(facts: UnitreeFacts) -> Message:
    """Return LowState."""
    fields: dict[str, Any] = {f"imu_state.{key}": name for key, name in IMU.items()}
    fields |= {"tick": "tick", "wireless_remote": "remote"}
    told, slots = MEASURED | {"mode": "modes"}, facts.slots
    if facts.go:
        told["temperature"] = "motor_temperature"
        fields["foot_force"] = "foot_force"
        if facts.battery:
            fields["bms_state.soc"] = {"state": "battery_charge", "scale": 0.01}
            fields["power_v"] = "battery_voltage"
    else:
        told["motorstate"] = "motor_error"
        fields["mode_machine"] = "mode_machine"
        fields |= motors("motor_state", slots, {"temperature": "temperatures"}, size=2)
    fields |= motors("motor_state", slots, told)
    name = facts.message("LowState").name
    return Message(facts.state_topic, name, fields, sent=_CHECKSUM, orientation="base_quat")


def command(facts: UnitreeFacts) -> Message:
    """Return LowCmd; who reads it refuses a command for its modes."""
    fields, taken = motors("motor_cmd", facts.slots, COMMANDS), {"mode": "modes"}
    read: dict[str, Any] = motors("motor_cmd", facts.slots, taken)
    if facts.go:
        read["level_flag"] = facts.constants["level_flag"]  # required
    else:
        fields["mode_machine"] = "mode_machine"
        read["mode_pr"] = "mode_pr"
    name, sent = facts.message("LowCmd").name, {**facts.constants, **_CHECKSUM}
    return Message(facts.command_topic, name, fields, sent=sent, taken=read)


def state_in(facts: UnitreeFacts, known: Container[str]) -> SubscribeSpec:
    """Return how LowState is read into those arrays that are there."""
    return state(facts).subscribe(known)


def state_out(facts: UnitreeFacts, known: Container[str]) -> PublishSpec:
    """Return how LowState is made."""
    return state(facts).publish(known)


def head_in(facts: UnitreeFacts) -> SubscribeSpec:
    """Return what of LowState is looked at before anything is written: its number and variant."""
    return state(facts).subscribe(("tick", "mode_machine"))


def command_in(facts: UnitreeFacts) -> SubscribeSpec:
    """Return how a robot reads LowCmd, with what it refuses a command for."""
    message = command(facts)
    return subscribe(message.topic, message.type, {**message.fields, **message.taken})


def command_out(facts: UnitreeFacts) -> PublishSpec:
    """Return how LowCmd is made."""
    message = command(facts)
    return publish(message.topic, message.type, {**message.sent, **message.fields})
