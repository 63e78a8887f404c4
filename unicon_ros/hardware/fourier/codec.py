"""Datagrams of Fourier's FSA v2 actuators, port 2335, big endian; for their wire and their face.

The first byte is a code. A query is answered under its own code; a setting that is acknowledged
carries a count, and its answer that count and a result. Source: PyPI fi_fsa 0.3.17,
fi_fsa/v2/fi_fsa_v2.py. Positions are in [deg], speeds in [deg/s], currents in [A]; gains are the
actuator's own, and the robot file says what they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from unicon_core.robots import Robot
from unicon_core.schema.marks import Key
from unicon_ros.hardware.facts import Numbers, Octet, each
from unicon_ros.hardware.fourier.addresses import Addressed, addressed, complete

DISABLE, COMMAND, GAINS = 0x02, 0x0E, 0xA1
STATE, TEMPERATURE = 0x21, 0x22
ENABLE, PD_MODE, ACKNOWLEDGED_GAINS, ARM_DEAD_MAN, CLEAR_DEAD_MAN = 0x51, 0x59, 0x61, 0x64, 0x65

COMMAND_TYPE = np.dtype([("code", "u1"), ("pos", ">f4"), ("vel", ">f4"), ("current", ">f4")])
"""Targets of PD mode: position, and feed-forward of speed and current."""
GAINS_TYPE = np.dtype([("code", "u1"), ("kp", ">f4"), ("kd", ">f4")])
STATE_TYPE = np.dtype([("code", "u1"), ("measured", ">f4", (4,)), ("errors", ">u4", (8,))])
"""Position, speed, current and torque; the main error and seven words of extended ones."""
TEMPERATURE_TYPE = np.dtype([("code", "u1"), ("celsius", ">f4", (2,))])
"""Of the transistors and of the windings."""
ACKNOWLEDGED = np.dtype([("code", "u1"), ("count", ">u4"), ("result", ">u4")])

TIMED_OUT = 7, 0x01
"""Of `errors`: the word and the bit which say that no command came in time."""

UNITS = ("stiffness_scale", "damping_scale", "timeout_mode")
WHY = "what its actuators' gains are in N·m/rad, nor what they do when commands stop"


@dataclass(frozen=True)
class Actuators(Addressed):
    """What the robot file says of the actuators; arrays of shape (n,).

    Attributes:
        kp: of an actuator for 1 N·m/rad of the joint.
        kd: of an actuator for 1 N·m·s/rad of the joint.
        timeout_mode: which mode an actuator enters that gets no commands.
        scale: of the current for 1 N·m of the joint in [A]; None where nobody knows.
    """

    kp: Annotated[Numbers, Key("stiffness_scale"), each(1e-9, 1e9)]
    kd: Annotated[Numbers, Key("damping_scale"), each(1e-9, 1e9)]
    timeout_mode: Octet
    scale: Annotated[Numbers | None, Key("current_scale"), each(1e-9, 1e9)] = None

    @classmethod
    def of(cls, robot: Robot, network: str = "") -> Actuators:
        """Return those of a robot file.

        Args:
            robot: the file.
            network: an address in another network of 256 in which they are; the last number of
                each address stays.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        complete(robot, 2, UNITS, WHY)
        return addressed(cls, robot, network)

    @cached_property
    def current(self) -> Numbers | None:
        """For 1 N·m of the joint in [A], with its sign; None where nobody knows."""
        return None if self.scale is None else self.signs * self.scale
