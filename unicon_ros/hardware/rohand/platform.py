"""Platform `rohand`: an OYMotion ROHand over Modbus RTU, a serial line at 115200 baud.

    platform: {body: unitree, left_hand: rohand}
    platforms: {left_hand: {device: /dev/ttyUSB0}}

The hand closes its own position loop: stiffness and damping are not sent. It holds its last target
for as long as it has power; there is nothing that would let go by itself.
"""

from __future__ import annotations

from functools import partial

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.modbus.hand import HandWire
from unicon_ros.hardware.modbus.reached import reached
from unicon_ros.hardware.rohand.codec import check_protocol, registers_of
from unicon_ros.hardware.wired_robot import WiredRobot, opened

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
