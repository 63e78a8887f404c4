"""Platform `unitree_dex3`: a Dex3-1 hand over CycloneDDS, for workflows.

    platform: {hand: unitree_dex3}
    platforms:
      hand: {address: eth0}        # of this machine, towards the robot

It needs the extra `hw-unitree`.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_ros.hardware.unitree_dex3.wire import Dex3Wire
from unicon_ros.hardware.wired_robot import WiredRobot, opened

__all__ = ["Dex3", "make"]

SILENCE = 0.1
"""In [s]: ten frames at the 100 Hz at which the vendor's example commands it."""


class Dex3(WiredRobot):
    """One hand; build it with `make`."""

    facts = Facts(
        "unitree_dex3",
        writes=(*JOINT_STATES, "motor_temperature", "motor_error", "stamp_ns"),
        protocols=("unitree_dex3",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str | None = None,
    domain: int | None = None,
    connect: float = 5.0,
    silence: float = SILENCE,
    silent: bool = False,
) -> Dex3:
    """Build the platform and wait for the hand.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name;
            without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
        domain: of DDS, instead of the robot file's.
        connect: how long to wait for the first frame in [s].
        silence: of the hand that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: the network cannot be used, or no frame came in time.
    """
    wire = Dex3Wire(states, robot, domain, address, silent=silent)
    return opened(Dex3(states, robot, period, wire, silence=silence, silent=silent), connect)
