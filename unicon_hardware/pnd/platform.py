"""Platform `pnd`: Adam over CycloneDDS, and its emulator endpoint.

    platform: pnd
    platforms:
      pnd: {address: eth0}        # of this machine, towards the robot

Topics, domain and motor slots stand in the robot file. It needs the extra `hw-pnd`.

There are two LowStates of one name in DDS: the Python SDK's has the battery, with a text of any
length, and what the vendor's C++ programs construct has none. All before it is the same
(pndbotics/pnd_sdk_python pndbotics_sdk_py/idl/pnd_adam, pndbotics/pnd_rl_gym deploy). There is no
checksum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from unicon_base.schema.marks import Key, Within
from unicon_core.blocks.controls.device import pnd
from unicon_core.platforms.kit.base import IMU_STATES, Mounting
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_hardware.dds.end import DdsEndpoint, DdsWire, factory_of
from unicon_hardware.dds.maps import (
    COMMANDS,
    IMU,
    MEASURED,
    Arrays,
    DdsFacts,
    Message,
    motors,
)
from unicon_hardware.facts import Octet, slots
from unicon_hardware.wire import Counts, newer
from unicon_hardware.wired_robot import WiredRobot
from unicon_msgs_map import Decoder

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
        modes: byte `mode` of every motor's command.
        mode_pr: 0 for ankles by pitch and roll, 1 by their two motors.
        battery: LowState is the kind that has it.
    """

    slots: Annotated[list[int], Key("motors"), slots()]
    modes: Annotated[Octet, Key("motor_mode")]
    mode_pr: Annotated[int, Within(0, 1)]
    battery: bool = False
    arrays = f"remote f4 {REMOTE}, tick u4, modes u1 {{n}}, mode_pr u1"

    @property
    def state(self) -> Message:
        """LowState, with the battery or without."""
        motor = MEASURED | {"state": "motor_error", "mode": "modes"}
        sent = {"battery_data.voltage": VOLTAGE, "battery_data.status": STATUS}
        return Message(
            self.state_topic,
            STATES[self.battery],
            IMU
            | motors("motor_state", self.slots, motor)
            | {"tick": "tick", "wireless_remote": "remote"},
            sent=sent if self.battery else {},
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
            sent={f"motor_cmd[{slot}].mode": self.modes for slot in self.slots}
            | {"mode_pr": self.mode_pr},
            taken=motors("motor_cmd", self.slots, {"mode": "modes"}) | {"mode_pr": "mode_pr"},
            lengths={"motor_cmd": len(self.slots)},
        )

    def state_in(self, arrays: Arrays, counts: Counts) -> LowStates:
        """Return what reads LowState into those arrays that are there."""
        return LowStates(self, arrays, counts)


class LowStates:
    """Checks and reads LowState of one of the two kinds, for `Inlet`.

    Args:
        facts: of the robot.
        arrays: what it is read into.
        counts: gets what is refused.

    Attributes:
        good_ones: how many were good.
    """

    def __init__(self, facts: PndFacts, arrays: Arrays, counts: Counts) -> None:
        self.good_ones = 0
        self._counts, self._last = counts, -1
        message = facts.state
        size = 0 if facts.battery else message.encoder(arrays).size
        self._frames = message.frames(arrays, counts, size=size)
        self.read = self._frames.read
        number = {"tick": np.zeros((), np.uint32)}
        self._tick = number["tick"]
        self._number = Decoder.build(message.subscribe(number), number)

    def good(self, raw: bytes) -> bool:
        """Return whether a message is whole and newer than the last."""
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


class PndWire(DdsWire):
    """The connection to a robot, which sends one of the two LowStates: both are listened to.

    No public source says which modes motors report.
    """

    label, extra, table = "platform 'pnd'", "hw-pnd", PndFacts

    def _built(self) -> None:
        self._mounting = Mounting.of(self._robot)
        self._imu = {name: self._states[name] for name in IMU_STATES}

    def _listen(self) -> None:
        kinds = [replace(self._facts, battery=battery) for battery in STATES]
        self._kinds = [kind.state_in(self._arrays, self.counts) for kind in kinds]
        for kind, frames in zip(kinds, self._kinds):
            self.listen(kind.state, frames, forget=frames.forget)

    def _measured(self) -> None:
        if len(self._inlets) > 1:  # from now on only that kind of LowState which the robot sends
            kept = next(k for k, frames in enumerate(self._kinds) if frames.good_ones)
            self._inlets = [self._inlets[kept]]
        if self._mounting.turned:
            self._mounting.turn(self._imu, self._imu)
        if self._controls is not None:
            pnd(self._own["remote"], self._controls)


class Pnd(WiredRobot):
    """An Adam; build it with `make`."""

    facts = Facts(
        "pnd",
        writes=(
            *JOINT_STATES,
            *IMU_STATES,
            "projected_gravity",
            "stamp_ns",
            "motor_error",
            *CONTROL_STATES,
        ),
        protocols=("pnd_adam",),
    )


make = factory_of(Pnd, PndWire)


class PndEndpoint(DdsEndpoint):
    """An emulated Adam: LowState, with its battery or without, and LowCmd.

    Not emulated, as it is not public: what the robot does when LowCmd stops, and yaw, pitch and
    roll, which stay zero.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        battery: LowState is the one with the battery.

    Attributes:
        remote: the 19 numbers of its remote, to be pressed.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, table, platform = "emulated pnd", "hw-pnd", PndFacts, "pnd"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
        battery: bool = True,
    ) -> None:
        facts = replace(PndFacts.of(robot), battery=battery)
        self._build(states, robot, facts, address, domain)
        self.remote = self.own["remote"]

    def tell(self) -> None:
        """Send what the robot measures."""
        self.own["tick"] += 1
        self.put()

    def _acts(self) -> bool:
        facts, heard = self._facts, self._heard
        return self._right("mode_pr", heard["mode_pr"], facts.mode_pr) and self._right(
            "motor mode", heard["modes"], facts.modes
        )


face = PndEndpoint
