"""Messages of a T1, made of a robot file; for both ends of the wire.

Layouts are those of BoosterRobotics/booster_robotics_sdk include/booster/idl/b1. LowState has
neither number nor checksum, and roll, pitch and yaw in place of a quaternion (R = Rz Ry Rx;
BoosterRobotics/booster_gym deploy/utils/rotate.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from unicon_base import RobotError
from unicon_base.arrays import Index
from unicon_base.schema.marks import Key, Text
from unicon_core.robots import Robot
from unicon_hardware.dds.maps import (
    COMMANDS,
    MEASURED,
    Arrays,
    DdsFacts,
    Frames,
    Message,
    motors,
)
from unicon_hardware.facts import fact, facts_of, named, one_of, slots, wrong_fact
from unicon_hardware.wire import Counts

MODES = ("damping", "prepare", "walking", "custom")
REQUESTS = ("change_mode", "get_mode")
MOTOR = MEASURED | {"temperature": "motor_temperature", "reserve[0]": "motor_error"}
"""Field of MotorState to state."""
# Place of the first length in a LowState, and bytes of a motor in it.
_PARALLEL_AT, _MOTOR = 40, 36
MOST_MOTORS = 64
REMOTE = "booster_interface/msg/RemoteControllerState"
SLOTS = Annotated[list[int], Key("motors"), slots()]


@dataclass(frozen=True)
class BoosterFacts(DdsFacts):
    """`transport` of a robot file.

    Attributes:
        mode_topic, battery_topic, remote_topic: of what it tells besides LowState.
        rpc_topic: of its service, without its end.
        slots: motor of each joint; there are as many motors as joints.
        command_type: how commands are meant.
        command_types: number of each such word.
        modes: number of each mode of the robot.
        requests: number of each request.
        servo: numbers of the joints whose stiffness is ours to close.
    """

    mode_topic: Text
    battery_topic: Text
    remote_topic: Text
    rpc_topic: Text
    slots: SLOTS
    command_type: Annotated[str, one_of("SERIAL")]
    command_types: Annotated[dict[str, int], named(("PARALLEL", "SERIAL"), 0, 1)]
    modes: Annotated[dict[str, int], Key("robot_modes"), named(MODES, 0, 255)]
    requests: Annotated[dict[str, int], Key("rpc"), named(REQUESTS, 0, 65535)]
    servo: Index
    arrays = "rpy f4 3, mode i4, cmd_type u4"

    @classmethod
    def of(cls, robot: Robot) -> BoosterFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        return facts_of(cls, robot, servo=_servo(robot, fact(robot, "motors", SLOTS)))

    def mode_name(self, number: int) -> str:
        """Return what a mode of the robot is called, its number where that is not known."""
        names = {value: name for name, value in self.modes.items()}
        return names.get(number, str(number))

    @property
    def kind(self) -> int:
        """`cmd_type` of commands by joints."""
        return self.command_types[self.command_type]

    @property
    def state(self) -> Message:
        """LowState; an emulated robot's cranks are told as its joints."""
        imu = {"rpy": "rpy", "gyro": "base_ang_vel", "acc": "base_lin_acc"}
        return Message(
            self.state_topic,
            "booster_interface/msg/LowState",
            motors("motor_state_serial", self.slots, MOTOR)
            | {f"imu_state.{key}": name for key, name in imu.items()},
            sent=motors("motor_state_parallel", self.slots, MOTOR),
        )

    @property
    def command(self) -> Message:
        """LowCmd."""
        return Message(
            self.command_topic,
            "booster_interface/msg/LowCmd",
            motors("motor_cmd", self.slots, COMMANDS),
            sent={"cmd_type": self.kind},
            taken={"cmd_type": "cmd_type"},
            lengths={"motor_cmd": len(self.slots)},
        )

    @property
    def battery(self) -> Message:
        """The battery's message."""
        charge = {"state": "battery_charge", "scale": 0.01}
        fields = {"soc": charge, "voltage": "battery_voltage"}
        return Message(self.battery_topic, "booster_interface/msg/BatteryState", fields)

    @property
    def mode(self) -> Message:
        """What tells the robot's mode."""
        kind = "booster_interface/msg/RobotStatesMsg"
        return Message(self.mode_topic, kind, {"current_mode": "mode"})

    @property
    def remote(self) -> Message:
        """What tells the gamepad."""
        return Message(self.remote_topic, REMOTE, {})

    def state_in(self, arrays: Arrays, counts: Counts) -> LowStates:
        """Return what reads LowState into those arrays that are there, `rpy` among them."""
        return LowStates(super().state_in(arrays, counts), len(self.slots), counts)


def _servo(robot: Robot, slots: list[int]) -> Index:
    """Return the joints that are driven by torques.

    Raises:
        RobotError: `torque_servo` is not `{motors: …, motor_stiffness: 0.0}` of this robot.
    """
    servo: Any = robot.transport.get("torque_servo")
    chosen = servo.get("motors") if isinstance(servo, dict) else None
    if not isinstance(chosen, list | tuple) or not all(slot in slots for slot in chosen):
        wanted = "{motors: …, motor_stiffness: 0.0} with motors of this robot"
        raise wrong_fact(robot, "torque_servo", wanted)
    if servo.get("motor_stiffness") != 0:
        raise RobotError(
            f"robot {robot.name}: transport.torque_servo.motor_stiffness is "
            f"{servo.get('motor_stiffness')}; write 0.0 into {robot.path.name}, all that is known"
        )
    return np.array([slots.index(slot) for slot in chosen], np.intp)


class LowStates:
    """Checks and reads LowState, for `Inlet`.

    The cranks in front of the joints may be any number; the joints must be the robot's own: a T1
    with arms of 7 joints has 29, a K1 has 22.
    """

    def __init__(self, frames: Frames, joints: int, counts: Counts) -> None:
        self._frames, self._joints, self._counts = frames, joints, counts
        self.read = frames.read

    def good(self, raw: bytes) -> bool:
        """Return whether a message is whole, and of this robot."""
        if not self._frames.good(raw):
            return False
        cranks = int.from_bytes(raw[_PARALLEL_AT : _PARALLEL_AT + 4], "little")
        at = _PARALLEL_AT + 4 + _MOTOR * cranks
        joints = int.from_bytes(raw[at : at + 4], "little")
        whole, refuse = at + 4 + _MOTOR * joints, self._counts.refuse
        if cranks > MOST_MOTORS or len(raw) < at + 4:
            refuse("short", f"{len(raw)} bytes for {cranks} cranks")
        elif joints != self._joints:
            refuse(
                "another length of motor_state_serial",
                f"{joints}, not {self._joints}: another variant of the robot",
            )
        elif len(raw) != whole:
            refuse("short" if len(raw) < whole else "long", f"{len(raw)}, not {whole}")
        else:
            return True
        return False
