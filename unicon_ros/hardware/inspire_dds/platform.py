"""Platform `inspire_dds`: an Inspire RH56 hand behind a DDS service, for workflows.

    platform: inspire_dds
    platforms:
      inspire_dds: {address: eth0}        # of this machine, towards the robot

The robot file's protocol says which interface: `inspire` is the FTP, `inspire_dfx` the DFX. The
hand closes its own position loop: stiffness and damping are not sent, and it holds its last target.
It needs the extra `hw-inspire-dds`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.inspire_dds.codec import KINDS, HandFacts
from unicon_ros.hardware.inspire_dds.wire import InspireDdsWire
from unicon_ros.hardware.wired_robot import WiredRobot, opened

__all__ = ["InspireDds", "make"]

SILENCE = 0.2
"""In [s]: 20 states at 100 Hz."""


def _facts(robot: Robot) -> Facts:
    """Return what it writes of a robot: the DFX tells nothing but positions."""
    told = {*HandFacts.of(robot).kind.state_fields.values(), "joint_pos", "joint_vel", "stamp_ns"}
    facts = InspireDds.facts
    return replace(facts, writes=tuple(name for name in facts.writes if name in told))


def _examined(states: States, robot: Robot, period: float, **options: Any) -> Binding:
    return Binding(_facts(robot))


class InspireDds(WiredRobot):
    """One hand; build it with `make`. `joint_vel` is the difference of measured angles."""

    facts = Facts(
        "inspire_dds",
        writes=("joint_pos", "joint_vel", "motor_error", "motor_temperature", "stamp_ns"),
        protocols=tuple(KINDS),
        examine=_examined,
    )

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        wire: InspireDdsWire,
        *,
        silence: float,
        silent: bool,
    ) -> None:
        self.facts = _facts(robot)
        super().__init__(states, robot, period, wire, silence=silence, silent=silent)


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
) -> InspireDds:
    """Build the platform and wait for the hand.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name;
            without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
        domain: of DDS, instead of the robot file's.
        connect: how long to wait for the first state in [s].
        silence: of the hand that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: the network cannot be used, or no state came in time.
    """
    wire = InspireDdsWire(states, robot, domain, address, silent=silent)
    with wire.closing():
        built = InspireDds(states, robot, period, wire, silence=silence, silent=silent)
    return opened(built, connect)
