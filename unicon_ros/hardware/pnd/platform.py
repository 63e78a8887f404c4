"""Platform `pnd`: Adam over CycloneDDS, for workflows.

    platform: pnd
    platforms:
      pnd: {address: eth0}        # of this machine, towards the robot

Topics, domain and motor slots stand in the robot file. It needs the extra `hw-pnd`.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_ros.hardware.pnd.wire import PndWire
from unicon_ros.hardware.wired_robot import SILENCE, WiredRobot, opened

__all__ = ["Pnd", "make"]


class Pnd(WiredRobot):
    """An Adam; build it with `make`."""

    facts = Facts(
        "pnd",
        writes=(
            *JOINT_STATES,
            "base_quat",
            "base_ang_vel",
            "base_lin_acc",
            "projected_gravity",
            "stamp_ns",
            "motor_error",
            *CONTROL_STATES,
        ),
        protocols=("pnd_adam",),
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
) -> Pnd:
    """Build the platform and wait for the robot.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name;
            without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
        domain: of DDS, instead of the robot file's.
        connect: how long to wait for the first frame in [s].
        silence: of the robot that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: the network cannot be used, or no frame came in time.
    """
    wire = PndWire(states, robot, domain, address, silent=silent)
    return opened(Pnd(states, robot, period, wire, silence=silence, silent=silent), connect)
