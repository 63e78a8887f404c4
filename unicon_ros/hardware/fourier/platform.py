"""Platform `fourier`: robots of Fourier's FSA actuators, each at an address of its own.

The robot file says the version: v2 (N1), or v1 (GR-1), which has no dead man and no PD mode.

Their IMU is a serial device whose frames the vendor does not document: no state of the base.
"""

from __future__ import annotations

from unicon_core.bounds import within
from unicon_core.errors import PlatformError
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.facts import ipv4
from unicon_ros.hardware.fourier.codec import Actuators
from unicon_ros.hardware.fourier.fsa1_codec import Servos
from unicon_ros.hardware.fourier.fsa1_wire import Fsa1Wire
from unicon_ros.hardware.fourier.wire import FourierWire
from unicon_ros.hardware.wired_robot import WiredRobot, opened

SILENCE = 0.1
"""In [s]: ten answers at the 100 Hz at which the vendor asks."""
DEAD_MAN = 0.2
"""In [s]: as a child process's watchdog, with a tick of 50 Hz to spare eight times."""


class Fourier(WiredRobot):
    """See the module."""

    facts = Facts(
        "fourier",
        writes=(
            "joint_pos",
            "joint_vel",
            "joint_effort",
            "motor_temperature",
            "motor_error",
            "stamp_ns",
        ),
        protocols=("fourier_fsa",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str = "",
    connect: float = 5.0,
    silence: float = SILENCE,
    dead_man: float | None = None,
    silent: bool = False,
) -> Fourier:
    """Open the robot.

    Args:
        states: of the workflow.
        robot: its file.
        period: of a tick in [s].
        address: any of another network of 256 addresses in which the actuators are, such as
            127.0.0.1; the last number of each stays.
        connect: how long to wait until all have answered, [s].
        silence: of any actuator that is a fault, [s].
        dead_man: after so long without a command each actuator of FSA v2 lets go by itself, [s];
            0.2 unless said. Those of FSA v1 cannot.
        silent: nothing is sent but questions.

    Raises:
        PlatformError: an option is wrong, or an actuator does not answer.
        RobotError: the robot file lacks a fact.
        WorkflowError: `dead_man` is out of range.
    """
    network = ipv4(address, "fourier") if address else ""
    wire: FourierWire | Fsa1Wire
    if robot.transport.get("fsa") == 1:
        if dead_man is not None:
            raise PlatformError(
                "platform 'fourier': dead_man is given, and actuators of FSA v1 have none; leave "
                "it out, and write platform: {child: fourier}"
            )
        wire = Fsa1Wire(states, Servos.of(robot, network))
    else:
        limit = DEAD_MAN if dead_man is None else dead_man
        limit = within(limit, "dead_man", "s", 5.0, max(0.01, period))
        wire = FourierWire(states, Actuators.of(robot, network), limit)
    return opened(Fourier(states, robot, period, wire, silence=silence, silent=silent), connect)
