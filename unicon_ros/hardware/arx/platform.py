"""Platform `arx`: ARX arms of EC and DM motors on a CAN bus (X5)."""

from __future__ import annotations

from unicon_core.errors import PlatformError
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.arx.codec import EC, Motors
from unicon_ros.hardware.arx.wire import ArxWire, open_bus
from unicon_ros.hardware.wired_robot import WiredRobot, opened

SILENCE = 0.1
"""In [s]: 50 answers at the vendor's 500 Hz, 5 at a tick of 50 Hz."""


class Arx(WiredRobot):
    """See the module."""

    # No temperature: DM motors, half of an arm, do not tell theirs.
    facts = Facts(
        "arx",
        writes=(
            "joint_pos",
            "joint_vel",
            "joint_effort",
            "motor_error",
            "stamp_ns",
        ),
        protocols=("arx",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    channel: str = "",
    interface: str = "socketcan",
    unverified: bool = False,
    connect: float = 5.0,
    silence: float = SILENCE,
) -> Arx:
    """Open the arm. It cannot be opened to receive only: its motors answer to commands.

    Args:
        states: of the workflow.
        robot: its file.
        period: of a tick in [s].
        channel: of the bus; the robot file's `interface`, such as can0.
        interface: of python-can.
        unverified: drive EC motors too, whose torque is doubtful.
        connect: how long to wait until all motors have answered, [s].
        silence: of any motor that is a fault, [s].

    Raises:
        MissingDependencyError: python-can is not installed.
        PlatformError: an option is wrong, the bus cannot be opened, or a motor does not answer.
        RobotError: the robot file lacks a fact.
    """
    motors = Motors.of(robot)
    if not unverified and EC in motors.layouts:
        raise PlatformError(
            "platform 'arx': EC motors were never driven by this, and what their torque is in N·m "
            "is doubtful, even in the vendor's SDK; write platforms: {arx: {unverified: true}} to "
            "drive them all the same, with the arm clear of people"
        )
    wire = ArxWire(states, motors, open_bus(channel or motors.channel, interface), motors.rate)
    return opened(Arx(states, robot, period, wire, silence=silence), connect)
