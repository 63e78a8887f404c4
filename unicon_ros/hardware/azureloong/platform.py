"""Platform `azureloong`: AzureLoong through its joint interface, UDP port 8006."""

from __future__ import annotations

from typing import Annotated

from unicon_core.bounds import within
from unicon_core.errors import PlatformError
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.schema.marks import Within
from unicon_core.states import States
from unicon_ros.hardware.azureloong.wire import AzureWire
from unicon_ros.hardware.facts import fact, ipv4
from unicon_ros.hardware.wired_robot import WiredRobot, opened

SHARE = Annotated[float, Within(0.001, 1.0)]
SILENCE = 0.1
"""In [s]: 20 frames at 200 Hz, a fifth of what the robot allows us."""


class AzureLoong(WiredRobot):
    """See the module."""

    facts = Facts(
        "azureloong",
        writes=(
            "joint_pos",
            "joint_vel",
            "joint_effort",
            "base_quat",
            "base_ang_vel",
            "base_lin_acc",
            "projected_gravity",
            "motor_temperature",
            "motor_error",
            "stamp_ns",
        ),
        protocols=("azureloong",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str = "",
    connect: float = 5.0,
    silence: float = SILENCE,
    torque_limit_rate: float | None = None,
    filter_rate: float | None = None,
    silent: bool = False,
) -> AzureLoong:
    """Open the robot.

    Args:
        states: of the workflow.
        robot: its file.
        period: of a tick in [s].
        address: of the robot; the vendor documents none.
        connect: how long to wait for the first frame, [s].
        silence: of the robot that is a fault, [s].
        torque_limit_rate: share of the drives' largest current, 0 to 1; the robot file's.
        filter_rate: share of a new command that the robot follows in each step, 0 to 1; the robot
            file's.
        silent: no command is sent; to hear the robot, frames that it does not carry out are.

    Raises:
        PlatformError: an option is wrong, or the robot does not answer.
        RobotError: the robot file lacks a fact.
        WorkflowError: a share is not one.
    """
    if not address:
        raise PlatformError(
            "platform 'azureloong' needs the robot's address, which its vendor does not document; "
            "write platforms: {azureloong: {address: …}}"
        )
    shares = [
        fact(robot, key, SHARE) if given is None else within(given, key, "", 1.0)
        for key, given in (("torque_limit_rate", torque_limit_rate), ("filter_rate", filter_rate))
    ]
    wire = AzureWire(states, robot, ipv4(address, "azureloong"), *shares)
    return opened(AzureLoong(states, robot, period, wire, silence=silence, silent=silent), connect)
