"""HandCmd and HandState of a Dex3-1, made of a robot file; for both ends of the wire.

Byte `mode` of a motor's command is id | status << 4 | timeout << 7; a stop is a command whose
timeout bit is set and whose gains are 0 (unitreerobotics/unitree_sdk2
example/g1/dex3/g1_dex3_example.cpp: RIS_Mode_t, stopMotors).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_core.schema.marks import Key, Within
from unicon_ros.hardware.dds.maps import COMMANDS, MEASURED, DdsFacts, Message, motors
from unicon_ros.hardware.facts import slots

MOTORS, SENSORS = 7, 9
"""Lengths of the sequences (same example: MOTOR_MAX, SENSOR_MAX)."""
TIMEOUT = 1 << 7


@dataclass(frozen=True)
class Dex3Facts(DdsFacts):
    """`transport` of a robot file.

    Attributes:
        slots: motor of each joint.
        status: of each motor that shall run.
    """

    slots: Annotated[list[int], Key("motors"), slots(MOTORS)]
    status: Annotated[int, Within(0, 7)]

    @property
    def modes(self) -> list[int]:
        """Byte `mode` of each joint's motor that shall run."""
        return [slot | self.status << 4 for slot in self.slots]

    @property
    def state(self) -> Message:
        """HandState; its sensors of pressure tell 0."""
        told = MEASURED | {"motorstate": "motor_error", "mode": "modes"}
        heat = motors("motor_state", self.slots, {"temperature": "temperatures"}, size=2)
        return Message(
            self.state_topic,
            "unitree_hg/msg/HandState",
            motors("motor_state", self.slots, told) | heat,
            sent={f"press_sensor_state[{SENSORS - 1}].lost": 0},
            lengths={"motor_state": MOTORS},
        )

    @property
    def command(self) -> Message:
        """HandCmd."""
        return Message(
            self.command_topic,
            "unitree_hg/msg/HandCmd",
            motors("motor_cmd", self.slots, COMMANDS),
            sent=self._modes(0),
            taken=motors("motor_cmd", self.slots, {"mode": "modes"}),
            lengths={"motor_cmd": MOTORS},
        )

    def stop_out(self) -> Callable[[], bytes]:
        """Return what makes a stop: gains and targets are 0."""
        return replace(self.command, sent=self._modes(TIMEOUT)).encoder({}).encode

    def _modes(self, bits: int) -> dict[str, int]:
        return {f"motor_cmd[{k}].mode": mode | bits for k, mode in zip(self.slots, self.modes)}


def own_arrays(robot: Robot) -> dict[str, NDArray[Any]]:
    """Return the arrays of the messages that are not states, zero; for both ends of the wire."""
    n = robot.num_joints
    return {"temperatures": np.zeros(2 * n, np.float32), "modes": np.zeros(n, np.uint8)}
