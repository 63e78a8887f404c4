"""Platform `inspire`: an Inspire RH56 hand over Modbus TCP or a serial line.

    platform: {body: unitree, hands: inspire}
    platforms: {right_hand: {address: 192.168.11.211}}      # the robot file has the maker's address

The hand closes its own position loop: stiffness and damping are not sent. It holds its last target
for as long as it has power; there is nothing that would let go by itself.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.inspire.codec import registers_of
from unicon_ros.hardware.modbus.hand import HandWire
from unicon_ros.hardware.modbus.reached import reached
from unicon_ros.hardware.wired_robot import WiredRobot, opened

__all__ = ["Inspire", "make"]

NAME = "inspire"


class Inspire(WiredRobot):
    """The hand as a platform; `joint_vel` is the difference of two measured angles."""

    facts = Facts(
        NAME,
        writes=(
            "joint_pos",
            "joint_vel",
            "motor_error",
            "motor_status",
            "motor_temperature",
            "stamp_ns",
        ),
        protocols=(NAME,),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str | None = None,
    port: int | None = None,
    device: str | None = None,
    connect: float = 2.0,
    silence: float = 0.2,
    silent: bool = False,
) -> Inspire:
    """Build the platform.

    Args:
        address: of Modbus TCP; None for the robot file's.
        port: of Modbus TCP; None for the robot file's.
        device: a serial line such as /dev/ttyUSB0, in place of TCP.
        connect: how long to wait for the first answer, [s].
        silence: of the hand that is a fault, [s].
        silent: it is only read.

    Raises:
        PlatformError: an option is wrong, or the hand does not answer.
        RobotError: the robot file does not say a register.
    """
    where, link = reached(robot, NAME, address, port, device)
    wire = HandWire(states, registers_of(robot), link, where, silent=silent)
    return opened(Inspire(states, robot, period, wire, silence=silence, silent=silent), connect)
