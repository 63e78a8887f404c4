"""HandCmd and HandState of a Dex3-1, made of a robot file; for both ends of the wire.

Byte `mode` of a motor's command is id | status << 4 | timeout << 7; a stop is a command whose
timeout bit is set and whose gains are 0 (unitreerobotics/unitree_sdk2
example/g1/dex3/g1_dex3_example.cpp: RIS_Mode_t, stopMotors).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_msgs_map import Encoder
from unicon_msgs_map.layout.messages import Struct, shared_messages
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.maps import COMMANDS, MEASURED, motors, publish, subscribe
from unicon_ros.hardware.dds.participant import LARGEST_DOMAIN
from unicon_ros.hardware.facts import TransportFacts
from unicon_ros.hardware.wire import Counts

COMMAND, STATE = "unitree_hg/msg/HandCmd", "unitree_hg/msg/HandState"
MOTORS, SENSORS = 7, 9
"""Lengths of the sequences (same example: MOTOR_MAX, SENSOR_MAX)."""
TIMEOUT = 1 << 7
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Dex3Facts:
    """`transport` of a robot file.

    Attributes:
        domain: of DDS.
        state_topic: of HandState.
        command_topic: of HandCmd.
        rate: of HandState in [Hz].
        slots: motor of each joint.
        modes: byte `mode` of each joint's motor that shall run.
    """

    domain: int
    state_topic: str
    command_topic: str
    rate: float
    slots: tuple[int, ...]
    modes: tuple[int, ...]

    @classmethod
    def of(cls, robot: Robot) -> Dex3Facts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        facts = TransportFacts(robot)
        status = facts.integer("status", 0, 7)
        slots = facts.slots("motors", MOTORS)
        return cls(
            facts.integer("domain", 0, LARGEST_DOMAIN),
            facts.text("state_topic"),
            facts.text("command_topic"),
            facts.number("rate_hz", 1.0, 10_000.0),
            slots,
            tuple(slot | status << 4 for slot in slots),
        )

    @staticmethod
    def message(name: str) -> Struct:
        """Return the layout of a message."""
        return shared_messages().struct(name)

    def state_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads HandState into those arrays that are there."""
        spec = subscribe(self.state_topic, STATE, self._state(arrays))
        return Frames(spec, arrays, counts, checked=False, lengths={"motor_state": MOTORS})

    def state_out(self, arrays: Arrays) -> Callable[[], bytes]:
        """Return what makes HandState."""
        sensors = {f"press_sensor_state[{SENSORS - 1}].lost": 0}
        fields = self._state(arrays) | sensors
        return Encoder.build(publish(self.state_topic, STATE, fields), arrays).encode

    def command_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads HandCmd, as the hand does."""
        fields = motors("motor_cmd", self.slots, COMMANDS | {"mode": "modes"})
        spec = subscribe(self.command_topic, COMMAND, fields)
        return Frames(spec, arrays, counts, checked=False, lengths={"motor_cmd": MOTORS})

    def command_out(self, arrays: Arrays) -> Callable[[], bytes]:
        """Return what makes HandCmd."""
        return self._command(arrays, motors("motor_cmd", self.slots, COMMANDS), 0)

    def stop_out(self) -> Callable[[], bytes]:
        """Return what makes a stop: gains and targets are 0."""
        return self._command({}, {}, TIMEOUT)

    def _command(self, arrays: Arrays, fields: Mapping[str, Any], bits: int) -> Callable[[], bytes]:
        modes = {f"motor_cmd[{k}].mode": mode | bits for k, mode in zip(self.slots, self.modes)}
        spec = publish(self.command_topic, COMMAND, {**modes, **fields})
        return Encoder.build(spec, arrays).encode

    def _state(self, known: Container[str]) -> dict[str, Any]:
        told = MEASURED | {"motorstate": "motor_error", "mode": "modes"}
        told = {field: name for field, name in told.items() if name in known}
        fields: dict[str, Any] = motors("motor_state", self.slots, told)
        for joint, slot in enumerate(self.slots):
            pair = f"temperatures[{2 * joint}:{2 * joint + 2}]"
            fields[f"motor_state[{slot}].temperature"] = pair
        return fields


def own_arrays(robot: Robot) -> dict[str, NDArray[Any]]:
    """Return the arrays of the messages that are not states, zero; for both ends of the wire."""
    n = robot.num_joints
    return {"temperatures": np.zeros(2 * n, np.float32), "modes": np.zeros(n, np.uint8)}
