"""Platform `booster`: T1 over DDS, for workflows.

    platform: {child: booster}
    platforms:
      booster: {address: eth0}        # of this machine, towards the robot

Topics, domain and motor slots stand in the robot file. It needs the extra `hw-booster`, and nothing
of the vendor's.
"""

from __future__ import annotations

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_ros.hardware.booster.wire import BoosterWire
from unicon_ros.hardware.torso import IMU_STATES
from unicon_ros.hardware.wired_robot import SILENCE, WiredRobot, opened

__all__ = ["Booster", "make"]


class Booster(WiredRobot):
    """A T1; build it with `make`."""

    facts = Facts(
        "booster",
        writes=(
            *JOINT_STATES,
            *IMU_STATES,
            "projected_gravity",
            "stamp_ns",
            "motor_temperature",
            "motor_error",
            "battery_charge",
            "battery_voltage",
            *CONTROL_STATES,
        ),
        protocols=("booster",),
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
) -> Booster:
    """Build the platform and wait for the robot.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name.
        domain: of DDS, instead of the robot file's.
        connect: how long to wait for the first frame in [s].
        silence: of the robot that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: the network cannot be used, or no frame came in time.
    """
    wire = BoosterWire(states, robot, domain, address, silent=silent)
    with wire.closing():
        built = Booster(states, robot, period, wire, silence=silence, silent=silent)
    return opened(built, connect)
