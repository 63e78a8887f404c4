"""What the registers of a ROHand mean, by its robot file.

Angles are int16 in 1/100 degree; oymotion/roh_firmware protocol/OHandModBusRTUProtocol_EN.md,
sections 4.1 to 4.3.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from unicon_core.errors import PlatformError
from unicon_core.robots import Robot
from unicon_core.schema.marks import Within
from unicon_ros.hardware.facts import Octet, Word, fact
from unicon_ros.hardware.modbus.frames import read_answer, read_request
from unicon_ros.hardware.modbus.link import Link
from unicon_ros.hardware.modbus.registers import HandRegisters, Told

SCALE = Annotated[float, Within(1e-3, 1.0)]


def registers_of(robot: Robot) -> HandRegisters:
    """Return the registers of a hand.

    Raises:
        RobotError: the robot file does not say them.
    """
    per_rad = math.degrees(1.0) / fact(robot, "angle_scale", SCALE)
    return HandRegisters(
        unit=fact(robot, "node_id", Octet),
        target=fact(robot, "register_angle_target", Word),
        angle=fact(robot, "register_angle", Word),
        at_zero=np.zeros(robot.num_joints),
        per_rad=np.full(robot.num_joints, per_rad),
        lowest=np.ceil(robot.lower.astype(np.float64) * per_rad).astype(np.int64),
        highest=np.floor(robot.upper.astype(np.float64) * per_rad).astype(np.int64),
        slow={"motor_status": Told(fact(robot, "register_status", Word))},
    )


def check_protocol(link: Link, robot: Robot) -> None:
    """Ask for the version of the hand's protocol.

    Raises:
        PlatformError: it is not the one of the robot file.
        Refused: it does not answer.
        OSError: the line is gone.
    """
    expected, unit = (fact(robot, key, Octet) for key in ("protocol_major", "node_id"))
    request = read_request(fact(robot, "register_protocol", Word), 1)
    answer = link.exchange(unit, request, timeout=0.5)
    version = int(read_answer(answer, 1)[0])
    if version >> 8 != expected:
        raise PlatformError(
            f"the hand speaks version {version >> 8}.{version & 0xFF} of its protocol, and "
            f"{robot.path.name} is of {expected}: registers may be others; use the firmware of "
            "that version, or a robot file of this one"
        )
