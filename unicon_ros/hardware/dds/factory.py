"""factory_of: `make` of a platform over DDS that has no options of its own; for vendors' platforms.

make = factory_of(Pnd, PndWire)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.wired_robot import SILENCE, WiredRobot, opened

R = TypeVar("R", bound=WiredRobot)


def factory_of(
    kind: type[R], wire: Callable[..., DdsEnd], silence: float = SILENCE
) -> Callable[..., R]:
    """Return the factory of a platform, which stands as `make` in the module of its class.

    Args:
        kind: its class.
        wire: makes the wire of states, robot, domain, address and `silent`.
        silence: default of the option, in [s].
    """
    usual = silence

    def make(
        states: States,
        robot: Robot,
        period: float,
        *,
        address: str | None = None,
        domain: int | None = None,
        connect: float = 5.0,
        silence: float = usual,
        silent: bool = False,
    ) -> R:
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
        opening = wire(states, robot, domain, address, silent=silent)
        return opened(kind(states, robot, period, opening, silence=silence, silent=silent), connect)

    # A workflow reads the class in the annotation, and a child process imports the factory by name.
    make.__annotations__["return"] = kind
    make.__module__, make.__qualname__ = kind.__module__, "make"
    return make
