"""The message maps of LowState and LowCmd, made of a robot file; for both ends of the wire.

The names on our side are states, and a few arrays that driver and emulator have of their own:
`tick`, `mode_machine`, `mode_pr`, `modes` (of motors), `temperatures` (two of each motor) and
`remote` (40 bytes).
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

from unicon_msgs_map import PublishSpec, SubscribeSpec
from unicon_ros.hardware.dds.maps import COMMANDS, IMU, MEASURED, publish, subscribe
from unicon_ros.hardware.unitree.facts import UnitreeFacts

_CHECKSUM = {"crc": {"checksum": "unitree"}}
PERCENT = 100.0


def state_in(facts: UnitreeFacts, known: Container[str]) -> SubscribeSpec:
    """Return how LowState is read into those arrays that are there."""
    return _subscribe(facts, "LowState", _state(facts, known, 1.0 / PERCENT))


def state_out(facts: UnitreeFacts, known: Container[str]) -> PublishSpec:
    """Return how LowState is made."""
    return _publish(facts, "LowState", _state(facts, known, PERCENT))


def head_in(facts: UnitreeFacts) -> SubscribeSpec:
    """Return what of LowState is looked at before anything is written: its number and variant."""
    fields = {"tick": "tick"} | ({} if facts.go else {"mode_machine": "mode_machine"})
    return _subscribe(facts, "LowState", fields)


def command_out(facts: UnitreeFacts) -> PublishSpec:
    """Return how LowCmd is made."""
    fields = {**facts.constants, **_command(facts)}
    return _publish(
        facts, "LowCmd", fields | ({} if facts.go else {"mode_machine": "mode_machine"})
    )


def command_in(facts: UnitreeFacts) -> SubscribeSpec:
    """Return how a robot reads LowCmd, with what it refuses a command for."""
    fields: dict[str, Any] = dict(_command(facts))
    fields |= {_motors("motor_cmd", run.slots, "mode"): _part("modes", run) for run in facts.driven}
    if facts.go:
        fields["level_flag"] = facts.constants["level_flag"]  # required
    else:
        fields |= {"mode_machine": "mode_machine", "mode_pr": "mode_pr"}
    return _subscribe(facts, "LowCmd", fields)


def _state(facts: UnitreeFacts, known: Container[str], percent: float) -> dict[str, Any]:
    fields: dict[str, Any] = {f"imu_state.{key}": state for key, state in IMU.items()}
    fields |= {"tick": "tick", "wireless_remote": "remote"}
    motors = MEASURED | {"mode": "modes"}
    if facts.go:
        motors["temperature"] = "motor_temperature"
        fields["foot_force"] = "foot_force"
        if facts.battery:
            fields["bms_state.soc"] = {"state": "battery_charge", "scale": percent}
            fields["power_v"] = "battery_voltage"
    else:
        motors["motorstate"] = "motor_error"
        fields["mode_machine"] = "mode_machine"
    for run in facts.driven:
        for key, state in motors.items():
            if state in known:
                fields[_motors("motor_state", run.slots, key)] = _part(state, run)
        if not facts.go:
            first, last = run.joints
            pair = f"temperatures[{2 * first}:{2 * last}]"
            fields[_motors("motor_state", run.slots, "temperature")] = pair
    return {path: said for path, said in fields.items() if _name(said) in known}


def _name(said: Any) -> str:
    """Return the array that a field stands for."""
    return str(said["state"] if isinstance(said, dict) else said).split("[")[0]


def _command(facts: UnitreeFacts) -> dict[str, str]:
    return {
        _motors("motor_cmd", run.slots, key): _part(state, run)
        for run in facts.driven
        for key, state in COMMANDS.items()
    }


def _motors(array: str, slots: tuple[int, int], key: str) -> str:
    return f"{array}[{slots[0]}:{slots[1]}].{key}"


def _part(state: str, run: Any) -> str:
    first, last = run.joints
    return f"{state}[{first}:{last}]"


def _topic(facts: UnitreeFacts, name: str) -> str:
    return facts.state_topic if name == "LowState" else facts.command_topic


def _subscribe(facts: UnitreeFacts, name: str, fields: Mapping[str, Any]) -> SubscribeSpec:
    return subscribe(_topic(facts, name), facts.message(name).name, fields)


def _publish(facts: UnitreeFacts, name: str, fields: Mapping[str, Any]) -> PublishSpec:
    return publish(_topic(facts, name), facts.message(name).name, {**fields, **_CHECKSUM})
