"""Platform `dobot`: Atom over CycloneDDS, for workflows.

    platform: dobot
    platforms:
      dobot: {address: eth0, layout: sdk, fsm_id: 2}

What the vendor's sources contradict each other in, or do not say, must be said: `layout` of
UpperState, and `fsm_id`, in which joint commands act. It needs the extra `hw-dobot`.
"""

from __future__ import annotations

from typing import Literal

from unicon_core.errors import PlatformError
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_ros.hardware.dobot.wire import DobotWire
from unicon_ros.hardware.torso import IMU_STATES
from unicon_ros.hardware.wired_robot import SILENCE, WiredRobot, opened

LARGEST = 65535


class Dobot(WiredRobot):
    """An Atom; build it with `make`."""

    facts = Facts(
        "dobot",
        writes=(
            *JOINT_STATES,
            *IMU_STATES,
            "projected_gravity",
            "stamp_ns",
            "motor_temperature",
            "battery_charge",
            *CONTROL_STATES,
        ),
        protocols=("dobot_atom",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str | None = None,
    domain: int | None = None,
    layout: Literal["", "sdk", "ros2"] = "",
    fsm_id: int | None = None,
    connect: float = 5.0,
    silence: float = SILENCE,
    silent: bool = False,
) -> Dobot:
    """Build the platform and wait for the robot.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name;
            without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
        domain: of DDS, instead of the robot file's.
        layout: of UpperState: `sdk` has no IMU in it, `ros2` has one.
        fsm_id: state of the robot's own state machine in which joint commands act; not public.
        connect: how long to wait for the first frames in [s].
        silence: of the robot that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: an option lacks, the network cannot be used, or no frame came in time.
    """
    if fsm_id is None and silent:
        fsm_id = 0
    if type(fsm_id) is not int or not 0 <= fsm_id <= LARGEST:
        raise PlatformError(
            f"platform 'dobot': fsm_id is {fsm_id}; give the number (0 to {LARGEST}) of the state "
            "of the robot's own state machine in which joint commands act; it is not public, ask "
            "Dobot"
        )
    wire = DobotWire(states, robot, domain, address, layout=layout, fsm_id=fsm_id, silent=silent)
    return opened(Dobot(states, robot, period, wire, silence=silence, silent=silent), connect)
