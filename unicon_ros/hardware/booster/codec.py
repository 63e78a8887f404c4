"""Messages of a T1, made of a robot file; for both ends of the wire.

Layouts are those of BoosterRobotics/booster_robotics_sdk include/booster/idl/b1. LowState has
neither number nor checksum, and roll, pitch and yaw in place of a quaternion (R = Rz Ry Rx;
BoosterRobotics/booster_gym deploy/utils/rotate.py).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import RobotError
from unicon_core.robots import Robot
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map import Encoder
from unicon_msgs_map.layout.messages import Struct, shared_messages
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.maps import COMMANDS, MEASURED, motors, publish, subscribe
from unicon_ros.hardware.dds.participant import LARGEST_DOMAIN
from unicon_ros.hardware.facts import TransportFacts
from unicon_ros.hardware.wire import Counts

COMMAND, STATE = "booster_interface/msg/LowCmd", "booster_interface/msg/LowState"
BATTERY = "booster_interface/msg/BatteryState"
MODE = "booster_interface/msg/RobotStatesMsg"
REMOTE = "booster_interface/msg/RemoteControllerState"
MODES = ("damping", "prepare", "walking", "custom")
REQUESTS = ("change_mode", "get_mode")
MOTOR = MEASURED | {"temperature": "motor_temperature", "reserve[0]": "motor_error"}
"""Field of MotorState to state."""
PERCENT = 100.0
_PARALLEL_AT, _MOTOR = 40, 36
"""Place of the first length in a LowState, and bytes of a motor in it."""
MOST_MOTORS = 64
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class BoosterFacts:
    """`transport` of a robot file.

    Attributes:
        domain: of DDS.
        rate: of LowState in [Hz].
        topics: `state`, `command`, `mode`, `battery`, `remote` and `rpc`, the last without its end.
        slots: motor of each joint; there are as many motors as joints.
        kind: `cmd_type` of commands by joints.
        servo: numbers of the joints whose stiffness is ours to close.
        modes: number of each mode of the robot.
        requests: number of each request.
    """

    domain: int
    rate: float
    topics: Mapping[str, str]
    slots: tuple[int, ...]
    kind: int
    servo: NDArray[np.intp]
    modes: Mapping[str, int]
    requests: Mapping[str, int]

    @classmethod
    def of(cls, robot: Robot) -> BoosterFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        facts = TransportFacts(robot)
        kinds = facts.mapping("command_types", ("PARALLEL", "SERIAL"), 0, 1)
        slots = facts.slots("motors", robot.num_joints)
        return cls(
            facts.integer("domain", 0, LARGEST_DOMAIN),
            facts.number("rate_hz", 1.0, 10_000.0),
            {
                name: facts.text(f"{name}_topic")
                for name in ("state", "command", "mode", "battery", "remote", "rpc")
            },
            slots,
            kinds[facts.one_of("command_type", ("SERIAL",))],
            _servo(robot, slots),
            facts.mapping("robot_modes", MODES, 0, 255),
            facts.mapping("rpc", REQUESTS, 0, 65535),
        )

    @staticmethod
    def message(name: str) -> Struct:
        """Return the layout of a message."""
        return shared_messages().struct(name)

    def state_in(self, arrays: Arrays, counts: Counts) -> LowStates:
        """Return what reads LowState into those arrays that are there, `rpy` among them."""
        fields = self._state("motor_state_serial", arrays)
        spec = subscribe(self.topics["state"], STATE, fields)
        frames = Frames(spec, arrays, counts, checked=False)
        return LowStates(frames, len(self.slots), counts)

    def state_out(self, arrays: Arrays) -> Callable[[], bytes]:
        """Return what makes LowState; its cranks are told as its joints."""
        fields = self._state("motor_state_serial", arrays)
        fields |= self._state("motor_state_parallel", arrays)
        return Encoder.build(publish(self.topics["state"], STATE, fields), arrays).encode

    def command_out(self, arrays: Arrays) -> Callable[[], bytes]:
        """Return what makes LowCmd."""
        fields: dict[str, Any] = motors("motor_cmd", self.slots, COMMANDS)
        fields["cmd_type"] = self.kind
        return Encoder.build(publish(self.topics["command"], COMMAND, fields), arrays).encode

    def command_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads LowCmd, as the robot does; `cmd_type` is among the arrays."""
        fields = motors("motor_cmd", self.slots, COMMANDS) | {"cmd_type": "cmd_type"}
        spec = subscribe(self.topics["command"], COMMAND, fields)
        lengths = {"motor_cmd": len(self.slots)}
        return Frames(spec, arrays, counts, checked=False, lengths=lengths)

    def battery(self, way: Callable[..., Any], scale: float) -> Any:
        """Return the mapping of the battery's message."""
        charge = {"state": "battery_charge", "scale": scale}
        fields = {"soc": charge, "voltage": "battery_voltage"}
        return way(self.topics["battery"], BATTERY, fields)

    def _state(self, array: str, known: Container[str]) -> dict[str, Any]:
        told = {field: name for field, name in MOTOR.items() if name in known}
        fields: dict[str, Any] = motors(array, self.slots, told)
        fields["imu_state.rpy"] = "rpy"
        return fields | {"imu_state.gyro": "base_ang_vel", "imu_state.acc": "base_lin_acc"}


def _servo(robot: Robot, slots: tuple[int, ...]) -> NDArray[np.intp]:
    """Return the joints that are driven by torques.

    Raises:
        RobotError: `torque_servo` is not `{motors: …, motor_stiffness: 0.0}` of this robot.
    """
    servo: Any = robot.transport.get("torque_servo")
    chosen = servo.get("motors") if isinstance(servo, dict) else None
    if not isinstance(chosen, list | tuple) or not all(slot in slots for slot in chosen):
        raise RobotError(
            f"robot {robot.name}: transport.torque_servo is {str(servo)[:60]}; write {{motors: …, "
            f"motor_stiffness: 0.0}} into {robot.path.name}, with motors of this robot"
        )
    if servo.get("motor_stiffness") != 0:
        raise RobotError(
            f"robot {robot.name}: transport.torque_servo.motor_stiffness is "
            f"{servo.get('motor_stiffness')}; write 0.0 into {robot.path.name}, all that is known"
        )
    return np.array([slots.index(slot) for slot in chosen], np.intp)


class LowStates:
    """Checks and reads LowState; a `Checked` of `DdsEnd`.

    The cranks in front of the joints may be any number; the joints must be the robot's own: a T1
    with arms of 7 joints has 29, a K1 has 22.
    """

    def __init__(self, frames: Frames, joints: int, counts: Counts) -> None:
        self._frames, self._joints, self._counts = frames, joints, counts
        self.read = frames.read

    def good(self, raw: bytes) -> bool:
        """Tell whether a message is whole, and of this robot."""
        if not self._frames.good(raw):
            return False
        cranks = _uint(raw, _PARALLEL_AT)
        at = _PARALLEL_AT + 4 + _MOTOR * cranks
        if cranks > MOST_MOTORS or len(raw) < at + 4:
            self._counts.refuse("short", f"{len(raw)} bytes for {cranks} cranks")
            return False
        joints = _uint(raw, at)
        if joints != self._joints:
            self._counts.refuse(
                "another length of motor_state_serial",
                f"{joints}, not {self._joints}: another variant of the robot",
            )
            return False
        whole = at + 4 + _MOTOR * joints
        if len(raw) != whole:
            self._counts.refuse("short" if len(raw) < whole else "long", f"{len(raw)}, not {whole}")
            return False
        return True


def _uint(raw: bytes, at: int) -> int:
    return int.from_bytes(raw[at : at + 4], "little")


def command_arrays(joints: int) -> dict[str, NDArray[Any]]:
    """Return arrays for a command, zero."""
    return {name: np.zeros(joints, np.float32) for name in COMMAND_STATES}
