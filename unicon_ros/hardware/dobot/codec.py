"""Messages of an Atom, made of a robot file; for both ends of the wire.

Legs ("lower") and torso, arms, head ("upper") have topics of their own. Angular velocity is in
[deg/s] on the wire. Of UpperState there are two layouts of one name: the SDK's header has no IMU,
the ROS 2 package has one (Dobot-Arm/dobot_atom_sdk idl/upper_state.h, Dobot-Arm/dobot_atom_ros2
dobot_atom/msg/UpperState.msg).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PlatformError
from unicon_core.robots import Robot
from unicon_msgs_map import Encoder
from unicon_msgs_map.layout.messages import Struct, shared_messages
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.maps import COMMANDS, IMU, MEASURED, motors, publish, subscribe
from unicon_ros.hardware.dds.participant import LARGEST_DOMAIN
from unicon_ros.hardware.facts import TransportFacts
from unicon_ros.hardware.wire import Counts

LAYOUTS = {"sdk": "dobot_atom/msg/UpperState", "ros2": "dobot_atom/msg/UpperStateImu"}
"""Option `layout` to the type of UpperState."""
UPPER_NAME = "dobot_atom.msg.dds_.UpperState_"
FSM, SWITCH = "dobot_atom/msg/SetFsmId", "dobot_atom/msg/SwitchUpperControl"
REMOTE = 40
"""Bytes of the remote."""
LOWER, UPPER = 12, 17
PERCENT = 100.0
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Half:
    """Legs, or what is above them.

    Attributes:
        first: number of its first joint.
        count: of joints, and of motors in its messages.
        state_topic: of its state.
        command_topic: of its commands.
        state: type of its state.
        command: type of its commands.
        name: of the state in DDS, "" where it follows from the type.
        mode: byte `mode` of its motors' commands.
    """

    first: int
    count: int
    state_topic: str
    command_topic: str
    state: str
    command: str
    name: str
    mode: int

    def messages(self) -> tuple[Struct, Struct]:
        """Return the layouts of state and command."""
        known = shared_messages()
        return known.struct(self.state), known.struct(self.command)

    def state_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads its state into those arrays that are there."""
        spec = subscribe(self.state_topic, self.state, self._state(arrays, 1.0 / PERCENT))
        orientation = "" if self.first else "base_quat"
        return Frames(spec, arrays, counts, checked=False, orientation=orientation)

    def state_out(self, arrays: Arrays) -> Callable[[], bytes]:
        """Return what makes its state."""
        fields = self._state(arrays, PERCENT)
        return Encoder.build(publish(self.state_topic, self.state, fields), arrays).encode

    def command_out(self, arrays: Arrays) -> Callable[[], bytes]:
        """Return what makes its command."""
        fields: dict[str, Any] = motors("motor_cmd", range(self.count), COMMANDS, self.first)
        fields |= {f"motor_cmd[{slot}].mode": self.mode for slot in range(self.count)}
        return Encoder.build(publish(self.command_topic, self.command, fields), arrays).encode

    def command_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads its command, as the robot does."""
        told = COMMANDS | {"mode": "modes"}
        fields = motors("motor_cmd", range(self.count), told, self.first)
        spec = subscribe(self.command_topic, self.command, fields)
        return Frames(spec, arrays, counts, checked=False)

    def _state(self, known: Container[str], percent: float) -> dict[str, Any]:
        told = MEASURED | {"motor_temp": "motor_temperature", "mode": "modes"}
        told = {field: name for field, name in told.items() if name in known}
        fields: dict[str, Any] = motors("motor_state", range(self.count), told, self.first)
        if self.first:
            return fields | {"is_upper_control": "upper_control"}
        fields |= {f"imu_state.{field}": name for field, name in IMU.items()}
        fields["imu_state.gyroscope"] = {"state": IMU["gyroscope"], "unit": "deg/s"}
        fields |= {"fsm_id": "fsm_id", "wireless_remote": "remote"}
        if "battery_charge" in known:
            fields["bms_state.battery_level"] = {"state": "battery_charge", "scale": percent}
        return fields


@dataclass(frozen=True)
class DobotFacts:
    """`transport` of a robot file.

    Attributes:
        domain: of DDS.
        rate: of the states in [Hz].
        lower: legs.
        upper: torso, arms and head.
        waist: number of the joint between pelvis and the torso with the IMU.
        fsm_topic: takes the number of a state of the robot's own state machine.
        switch_topic: takes whether the arms are ours.
    """

    domain: int
    rate: float
    lower: Half
    upper: Half
    waist: int
    fsm_topic: str
    switch_topic: str

    @classmethod
    def of(cls, robot: Robot, layout: str) -> DobotFacts:
        """Read them.

        Args:
            layout: of UpperState, one of `LAYOUTS`.

        Raises:
            RobotError: one lacks, or is not what it must be.
            PlatformError: there is no such layout.
        """
        if layout not in LAYOUTS:
            raise PlatformError(
                f"platform 'dobot': layout is {layout!r}; the vendor's SDK and its ROS 2 package "
                "contradict each other in UpperState, so that it must be said: sdk (without an "
                "IMU) or ros2 (with one)"
            )
        facts = TransportFacts(robot)
        mode = facts.integer("motor_mode", 0, 255)
        waist = facts.one_of("waist_joint", robot.joint_names)
        lower = Half(
            0,
            LOWER,
            facts.text("lower_state_topic"),
            facts.text("lower_command_topic"),
            "dobot_atom/msg/LowerState",
            "dobot_atom/msg/LowerCmd",
            "",
            mode,
        )
        upper = Half(
            LOWER,
            UPPER,
            facts.text("upper_state_topic"),
            facts.text("upper_command_topic"),
            LAYOUTS[layout],
            "dobot_atom/msg/UpperCmd",
            UPPER_NAME,
            mode,
        )
        for half, key in ((lower, "lower_motors"), (upper, "upper_motors")):
            facts.run(key, half.first, half.count)
        return cls(
            facts.integer("domain", 0, LARGEST_DOMAIN),
            facts.number("rate_hz", 1.0, 10_000.0),
            lower,
            upper,
            robot.joint_names.index(waist),
            facts.text("fsm_topic"),
            facts.text("switch_topic"),
        )


def own_arrays() -> dict[str, NDArray[Any]]:
    """Return the arrays of the messages that are not states, zero; for both ends of the wire."""
    return {
        "fsm_id": np.zeros((), np.uint16),
        "upper_control": np.zeros((), np.uint8),
        "remote": np.zeros(REMOTE, np.uint8),
        "modes": np.zeros(LOWER + UPPER, np.uint8),
    }
