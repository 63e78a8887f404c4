"""What the registers of a ROHand mean, by its robot file.

Angles are int16 in 1/100 degree; oymotion/roh_firmware protocol/OHandModBusRTUProtocol_EN.md,
sections 4.1 to 4.3.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from unicon_core.errors import PlatformError
from unicon_core.robots import Robot
from unicon_ros.hardware.facts import TransportFacts
from unicon_ros.hardware.modbus.frames import read_answer, read_request
from unicon_ros.hardware.modbus.link import Link
from unicon_ros.hardware.modbus.registers import HandRegisters, Told


def registers_of(robot: Robot) -> HandRegisters:
    """Return the registers of a hand.

    Raises:
        RobotError: the robot file does not say them.
    """
    facts = TransportFacts(robot)
    register = partial(facts.integer, least=0, most=0xFFFF)
    per_rad = math.degrees(1.0) / facts.number("angle_scale", 1e-3, 1.0)
    return HandRegisters(
        unit=facts.integer("node_id", 0, 0xFF),
        target=register("register_angle_target"),
        angle=register("register_angle"),
        at_zero=np.zeros(robot.num_joints),
        per_rad=np.full(robot.num_joints, per_rad),
        lowest=np.ceil(robot.lower.astype(np.float64) * per_rad).astype(np.int64),
        highest=np.floor(robot.upper.astype(np.float64) * per_rad).astype(np.int64),
        slow={"motor_status": Told(register("register_status"))},
    )


def check_protocol(link: Link, robot: Robot) -> None:
    """Ask for the version of the hand's protocol.

    Raises:
        PlatformError: it is not the one of the robot file.
        Refused: it does not answer.
        OSError: the line is gone.
    """
    facts = TransportFacts(robot)
    expected, unit = (facts.integer(key, 0, 0xFF) for key in ("protocol_major", "node_id"))
    request = read_request(facts.integer("register_protocol", 0, 0xFFFF), 1)
    answer = link.exchange(unit, request, timeout=0.5)
    version = int(read_answer(answer, 1)[0])
    if version >> 8 != expected:
        raise PlatformError(
            f"the hand speaks version {version >> 8}.{version & 0xFF} of its protocol, and "
            f"{robot.path.name} is of {expected}: registers may be others; use the firmware of "
            "that version, or a robot file of this one"
        )
