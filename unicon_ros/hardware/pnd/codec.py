"""LowCmd and LowState of an Adam, made of a robot file; for both ends of the wire.

There are two LowStates of one name in DDS: the Python SDK's has the battery, with a text of any
length, and what the vendor's C++ programs construct has none. All before it is the same
(pndbotics/pnd_sdk_python pndbotics_sdk_py/idl/pnd_adam, pndbotics/pnd_rl_gym deploy). There is no
checksum.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_msgs_map import Decoder, Encoder
from unicon_msgs_map.layout.messages import Struct, shared_messages
from unicon_ros.hardware.dds.frames import Frames
from unicon_ros.hardware.dds.maps import COMMANDS, IMU, MEASURED, motors, publish, subscribe
from unicon_ros.hardware.dds.participant import LARGEST_DOMAIN
from unicon_ros.hardware.facts import TransportFacts
from unicon_ros.hardware.wire import Counts, newer

COMMAND = "pnd_adam/msg/LowCmd"
STATES = {True: "pnd_adam/msg/LowState", False: "pnd_adam/msg/PlainLowState"}
"""LowState with the battery and without."""
STATE_NAME = "pnd_adam.msg.dds_.LowState_"
REMOTE = 19
"""Numbers of the remote."""
VOLTAGE, STATUS = 48.0, "=normal"
"""Of an emulated battery; what a real one says is not public."""
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class PndFacts:
    """`transport` of a robot file.

    Attributes:
        domain: of DDS.
        state_topic: of LowState.
        command_topic: of LowCmd.
        rate: of LowState in [Hz].
        slots: motor of each joint; there are as many motors as joints.
        mode: byte `mode` of every motor's command.
        mode_pr: 0 for ankles by pitch and roll, 1 by their two motors.
    """

    domain: int
    state_topic: str
    command_topic: str
    rate: float
    slots: tuple[int, ...]
    mode: int
    mode_pr: int

    @classmethod
    def of(cls, robot: Robot) -> PndFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        facts = TransportFacts(robot)
        return cls(
            facts.integer("domain", 0, LARGEST_DOMAIN),
            facts.text("state_topic"),
            facts.text("command_topic"),
            facts.number("rate_hz", 1.0, 10_000.0),
            facts.slots("motors", robot.num_joints),
            facts.integer("motor_mode", 0, 255),
            facts.integer("mode_pr", 0, 1),
        )

    @staticmethod
    def message(name: str) -> Struct:
        """Return the layout of a message."""
        return shared_messages().struct(name)

    def state_out(self, arrays: Arrays, *, battery: bool) -> Encoder:
        """Return what makes LowState."""
        fields = self._state(arrays)
        if battery:
            fields |= {"battery_data.voltage": VOLTAGE, "battery_data.status": STATUS}
        return Encoder.build(publish(self.state_topic, STATES[battery], fields), arrays)

    def state_in(self, arrays: Arrays, counts: Counts, *, battery: bool) -> Frames:
        """Return what reads LowState into those arrays that are there."""
        fields = self._state(arrays)
        spec = subscribe(self.state_topic, STATES[battery], fields)
        size = 0 if battery else self.state_out(arrays, battery=False).size
        return Frames(
            spec,
            arrays,
            counts,
            checked=False,
            orientation="base_quat",
            lengths={"motor_state": len(self.slots)},
            size=size,
        )

    def tick_in(self, tick: NDArray[Any], *, battery: bool) -> Decoder:
        """Return what reads the number of a LowState."""
        spec = subscribe(self.state_topic, STATES[battery], {"tick": "tick"})
        return Decoder.build(spec, {"tick": tick})

    def command_out(self, arrays: Arrays) -> Callable[[], bytes]:
        """Return what makes LowCmd."""
        fields: dict[str, Any] = motors("motor_cmd", self.slots, COMMANDS)
        fields |= {f"motor_cmd[{slot}].mode": self.mode for slot in self.slots}
        fields["mode_pr"] = self.mode_pr
        return Encoder.build(publish(self.command_topic, COMMAND, fields), arrays).encode

    def command_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads LowCmd, as the robot does."""
        fields = motors("motor_cmd", self.slots, COMMANDS | {"mode": "modes"})
        spec = subscribe(self.command_topic, COMMAND, fields | {"mode_pr": "mode_pr"})
        lengths = {"motor_cmd": len(self.slots)}
        return Frames(spec, arrays, counts, checked=False, lengths=lengths)

    def _state(self, known: Container[str]) -> dict[str, Any]:
        told = MEASURED | {"state": "motor_error", "mode": "modes"}
        told = {field: name for field, name in told.items() if name in known}
        fields: dict[str, Any] = {f"imu_state.{key}": name for key, name in IMU.items()}
        fields |= motors("motor_state", self.slots, told)
        fields |= {"tick": "tick", "wireless_remote": "remote"}
        return fields


class LowStates:
    """Checks and reads LowState of one of the two kinds; a `Checked` of `DdsEnd`.

    Args:
        facts: of the robot.
        arrays: what it is read into.
        counts: gets what is refused.
        battery: the kind.

    Attributes:
        good_ones: how many were good.
    """

    def __init__(self, facts: PndFacts, arrays: Arrays, counts: Counts, *, battery: bool) -> None:
        self.good_ones = 0
        self._counts, self._last = counts, -1
        self._frames = facts.state_in(arrays, counts, battery=battery)
        self._tick = np.zeros((), np.uint32)
        self._number = facts.tick_in(self._tick, battery=battery)

    def good(self, raw: bytes) -> bool:
        """Tell whether a message is whole and newer than the last."""
        if not self._frames.good(raw):
            return False
        if not self._number.decode(raw):
            self._counts.refuse("impossible values", self._number.last_error)
            return False
        number = int(self._tick)
        if self._last >= 0 and not newer(number, self._last):
            self._counts.refuse("old tick", f"{number} behind {self._last}")
            return False
        self._last = number
        self.good_ones += 1
        return True

    def read(self, raw: bytes) -> bool:
        """Read a good message; where it is refused nothing is written."""
        return self._frames.read(raw)

    def forget(self) -> None:
        """Take any number from now on: another sender has come."""
        self._last = -1
