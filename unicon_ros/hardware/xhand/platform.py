"""Platform `xhand`: a RobotEra XHand1 through its maker's module, best in a process of its own.

    platform: {body: unitree, left_hand: {child: xhand}}
    platforms: {left_hand: {device: /dev/ttyUSB0}}          # without a device: EtherCAT

The maker's code may wait, hold Python's lock or crash: as a child it keeps all that to itself.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.wired_robot import WiredRobot, opened
from unicon_ros.hardware.xhand.wire import XhandWire

NAME = "xhand"


class Xhand(WiredRobot):
    """The hand as a platform."""

    facts = Facts(
        NAME,
        writes=("joint_pos", "motor_error", "motor_temperature", "stamp_ns"),
        protocols=(NAME,),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    device: str = "",
    hand_id: int | None = None,
    connect: float = 2.0,
    silence: float = 0.2,
    silent: bool = False,
) -> Xhand:
    """Build the platform.

    Args:
        device: of an RS-485 adapter such as /dev/ttyUSB0; without one EtherCAT.
        hand_id: which hand of the line; None for the only one.
        connect: how long to wait for the first state, [s].
        silence: of the hand that is a fault, [s].
        silent: it is only read.

    Raises:
        MissingDependencyError: the maker's module is not installed.
        PlatformError: the hand does not answer, or it is not clear which is meant.
    """
    wire = XhandWire(states, robot, device, hand_id)
    return opened(Xhand(states, robot, period, wire, silence=silence, silent=silent), connect)
