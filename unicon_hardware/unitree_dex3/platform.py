"""Platform `unitree_dex3`: a Dex3-1 hand over CycloneDDS, and its emulator endpoint.

    platform: {hand: unitree_dex3}
    platforms:
      hand: {address: eth0}        # of this machine, towards the robot

It needs the extra `hw-unitree`.

Byte `mode` of a motor's command is id | status << 4 | timeout << 7; a stop is a command whose
timeout bit is set and whose gains are 0 (unitreerobotics/unitree_sdk2
example/g1/dex3/g1_dex3_example.cpp: RIS_Mode_t, stopMotors). HandState has neither number nor
checksum: a hand that repeats itself is not distinguished from one that does not move.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from unicon_base.schema.marks import Key, Within
from unicon_core.platforms.platform import Facts
from unicon_core.states.standard import JOINT_STATES
from unicon_hardware.dds.end import DdsEndpoint, DdsWire, factory_of
from unicon_hardware.dds.maps import COMMANDS, MEASURED, DdsFacts, Message, motors
from unicon_hardware.facts import slots
from unicon_hardware.wired_robot import WiredRobot

MOTORS, SENSORS = 7, 9
"""Lengths of the sequences (same example: MOTOR_MAX, SENSOR_MAX)."""
TIMEOUT = 1 << 7
STOPS, STOP_PERIOD = 5, 0.01
"""How often and at which distance in [s] the stop is sent: at the 100 Hz of commands."""
SILENCE = 0.1
"""In [s]: ten frames at the 100 Hz at which the vendor's example commands it."""


@dataclass(frozen=True)
class Dex3Facts(DdsFacts):
    """`transport` of a robot file.

    Attributes:
        slots: motor of each joint.
        status: of each motor that shall run.
    """

    slots: Annotated[list[int], Key("motors"), slots(MOTORS)]
    status: Annotated[int, Within(0, 7)]
    arrays = "temperatures f4 {twice}, modes u1 {n}"

    @property
    def modes(self) -> list[int]:
        """Byte `mode` of each joint's motor that shall run."""
        return [slot | self.status << 4 for slot in self.slots]

    @property
    def state(self) -> Message:
        """HandState; its sensors of pressure send 0."""
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


class Dex3Wire(DdsWire):
    """The connection to one hand.

    No public source says whether a hand reports the commanded modes.
    """

    label, table = "platform 'unitree_dex3'", Dex3Facts

    def _built(self) -> None:
        heat = self._own["temperatures"]
        self._pairs, self._hottest = (heat[0::2], heat[1::2]), self._arrays.get("motor_temperature")
        self._stop, self._commands_it = self._facts.stop_out(), False

    def _measured(self) -> None:
        if self._hottest is not None:
            np.maximum(*self._pairs, out=self._hottest)

    def put(self) -> None:
        """Send the command states.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        super().put()
        self._commands_it = True

    def close(self) -> None:
        """Stop the motors that were commanded, and leave the domain."""
        try:
            if self._commands_it:
                self._commands_it = False
                for _ in range(STOPS):
                    self._outlets[0][0].write(self._stop())
                    time.sleep(STOP_PERIOD)
        finally:
            super().close()


class Dex3(WiredRobot):
    """One hand; build it with `make`."""

    facts = Facts(
        "unitree_dex3",
        writes=(*JOINT_STATES, "motor_temperature", "motor_error", "stamp_ns"),
        protocols=("unitree_dex3",),
    )


make = factory_of(Dex3, Dex3Wire, SILENCE)


class Dex3Endpoint(DdsEndpoint):
    """An emulated hand: HandState, and HandCmd with its mode bytes.

    Not emulated, as it is not public: what the hand does when commands stop, its press sensors,
    which send 0, and its IMU.

    Attributes:
        stopped: the last command was a stop.
    """

    label, table, platform = "emulated unitree_dex3", Dex3Facts, "unitree_dex3"
    stopped = False

    def tell(self) -> None:
        """Send what the hand measures."""
        self.own["temperatures"][...] = np.repeat(self._arrays["motor_temperature"], 2)
        self.put()

    def _acts(self) -> bool:
        modes = self._heard["modes"]
        stops = modes >= TIMEOUT
        if stops.any() != stops.all() or ((modes & ~np.uint8(TIMEOUT)) != self._facts.modes).any():
            self.counts.refuse("motor mode", f"{modes.tolist()}")
            return False
        self.stopped = bool(stops.all())
        return True


face = Dex3Endpoint
