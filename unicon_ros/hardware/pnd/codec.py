"""LowCmd and LowState of an Adam, made of a robot file; for both ends of the wire.

There are two LowStates of one name in DDS: the Python SDK's has the battery, with a text of any
length, and what the vendor's C++ programs construct has none. All before it is the same
(pndbotics/pnd_sdk_python pndbotics_sdk_py/idl/pnd_adam, pndbotics/pnd_rl_gym deploy). There is no
checksum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from unicon_core.schema.marks import Key, Within
from unicon_msgs_map import Decoder
from unicon_ros.hardware.dds.maps import (
    COMMANDS,
    IMU,
    MEASURED,
    Arrays,
    DdsFacts,
    Message,
    motors,
    subscribe,
)
from unicon_ros.hardware.facts import Octet, slots
from unicon_ros.hardware.wire import Counts, newer

STATES = {True: "pnd_adam/msg/LowState", False: "pnd_adam/msg/PlainLowState"}
"""LowState with the battery and without."""
REMOTE = 19
"""Numbers of the remote."""
VOLTAGE, STATUS = 48.0, "=normal"
"""Of an emulated battery; what a real one says is not public."""


@dataclass(frozen=True)
class PndFacts(DdsFacts):
    """`transport` of a robot file.

    Attributes:
        slots: motor of each joint; there are as many motors as joints.
        mode: byte `mode` of every motor's command.
        mode_pr: 0 for ankles by pitch and roll, 1 by their two motors.
    """

    slots: Annotated[list[int], Key("motors"), slots()]
    mode: Annotated[Octet, Key("motor_mode")]
    mode_pr: Annotated[int, Within(0, 1)]

    def told(self, *, battery: bool) -> Message:
        """Return LowState, with the battery or without."""
        motor = MEASURED | {"state": "motor_error", "mode": "modes"}
        imu = {f"imu_state.{key}": name for key, name in IMU.items()}
        sent = {"battery_data.voltage": VOLTAGE, "battery_data.status": STATUS}
        return Message(
            self.state_topic,
            STATES[battery],
            imu
            | motors("motor_state", self.slots, motor)
            | {"tick": "tick", "wireless_remote": "remote"},
            sent=sent if battery else {},
            name="pnd_adam.msg.dds_.LowState_",
            lengths={"motor_state": len(self.slots)},
            orientation="base_quat",
        )

    @property
    def command(self) -> Message:
        """LowCmd."""
        return Message(
            self.command_topic,
            "pnd_adam/msg/LowCmd",
            motors("motor_cmd", self.slots, COMMANDS),
            sent={f"motor_cmd[{slot}].mode": self.mode for slot in self.slots}
            | {"mode_pr": self.mode_pr},
            taken=motors("motor_cmd", self.slots, {"mode": "modes"}) | {"mode_pr": "mode_pr"},
            lengths={"motor_cmd": len(self.slots)},
        )

    def state_out(self, arrays: Arrays, *, battery: bool = False) -> Callable[[], bytes]:
        """Return what makes LowState."""
        return self.told(battery=battery).encoder(arrays).encode


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
        message = facts.told(battery=battery)
        size = 0 if battery else message.encoder(arrays).size
        self._frames = message.frames(arrays, counts, size=size)
        self.read = self._frames.read
        self._tick = np.zeros((), np.uint32)
        spec = subscribe(message.topic, message.type, {"tick": "tick"})
        self._number = Decoder.build(spec, {"tick": self._tick})

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

    def forget(self) -> None:
        """Take any number from now on: another sender has come."""
        self._last = -1
