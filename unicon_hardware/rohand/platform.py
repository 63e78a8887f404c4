"""Platform `rohand`: an OYMotion ROHand over Modbus RTU, a serial line at 115200 baud.

    platform: {body: unitree, left_hand: rohand}
    platforms: {left_hand: {device: /dev/ttyUSB0}}

The hand closes its own position loop: stiffness and damping are not sent. It holds its last target
for as long as it has power; there is nothing that would let go by itself. Angles are int16 in 1/100
degree; oymotion/roh_firmware protocol/OHandModBusRTUProtocol_EN.md, sections 4.1 to 4.3.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated

import numpy as np

from unicon_base import PlatformError
from unicon_base.schema.marks import Within
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.facts import Octet, Word, fact
from unicon_hardware.modbus.hand import HandRegisters, HandWire, Told
from unicon_hardware.modbus.link import ModbusConnection, reached
from unicon_hardware.modbus.served import HandEndpoint, PtyServer
from unicon_hardware.wired_robot import WiredRobot, opened

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


def check_protocol(link: ModbusConnection, robot: Robot) -> None:
    """Ask for the version of the hand's protocol.

    Raises:
        PlatformError: it is not the one of the robot file.
        Refused: it does not answer.
        OSError: the line is gone.
    """
    expected, unit = (fact(robot, key, Octet) for key in ("protocol_major", "node_id"))
    register = fact(robot, "register_protocol", Word)
    version = int(link.read(unit, register, 1, timeout=0.5)[0])
    if version >> 8 != expected:
        raise PlatformError(
            f"the hand speaks version {version >> 8}.{version & 0xFF} of its protocol, and "
            f"{robot.path.name} is of {expected}: registers may be others; use the firmware of "
            "that version, or a robot file of this one"
        )


NAME = "rohand"


class Rohand(WiredRobot):
    """The hand as a platform; `joint_vel` is the difference of two measured angles."""

    facts = Facts(
        NAME, writes=("joint_pos", "joint_vel", "motor_status", "stamp_ns"), protocols=(NAME,)
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    device: str | None = None,
    connect: float = 5.0,
    silence: float = 0.2,
    silent: bool = False,
) -> Rohand:
    """Build the platform.

    Args:
        device: the serial line, such as /dev/ttyUSB0.
        connect: how long to wait for the first answer, [s].
        silence: of the hand that is a fault, [s].
        silent: it is only read.

    Raises:
        PlatformError: an option is wrong, the hand does not answer, or speaks another version.
        RobotError: the robot file does not say a register.
    """
    where, link = reached(robot, NAME, None, None, device)
    check = partial(check_protocol, robot=robot)
    wire = HandWire(states, registers_of(robot), link, where, silent=silent, first=check)
    return opened(Rohand(states, robot, period, wire, silence=silence, silent=silent), connect)


def face(states: States, robot: Robot, *, version: int = 0x0100) -> HandEndpoint:
    """Return the face of a hand on a pty, `face.where`.

    Args:
        version: of its protocol, the major one in the high byte.
    """
    extra = {fact(robot, "register_protocol", Word): version}
    return HandEndpoint(states, registers_of(robot), PtyServer(), "rohand", extra)
