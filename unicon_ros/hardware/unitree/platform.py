"""Platform `unitree`: Go2, H1, G1 and H1-2 over CycloneDDS, for workflows.

    platform: unitree
    platforms:
      unitree: {address: eth0}        # of this machine, towards the robot

Topics, modes and motor slots stand in the robot file. It needs the extra `hw-unitree`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from unicon_core.errors import PlatformError
from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, HARDWARE_STATES
from unicon_ros.hardware.unitree.facts import PROTOCOLS, UnitreeFacts
from unicon_ros.hardware.unitree.wire import FOOT_FORCE, TOLD, UnitreeWire
from unicon_ros.hardware.wired_robot import SILENCE, WiredRobot, opened

SIMULATOR = "unitree_mujoco"
REMOTE = ("wireless_remote", FOOT_FORCE)
"""States that it writes where a workflow declares them: 40 bytes; four forces, without a unit."""


def _facts(robot: Robot, states: States, peer: str) -> Facts:
    """Return what it writes of a robot."""
    facts = UnitreeFacts.of(robot)
    lacking = {"motor_error"} if facts.go else {FOOT_FORCE}
    if not facts.battery:
        lacking |= {"battery_charge", "battery_voltage"}
    if peer == SIMULATOR:  # it sends zeros, of a battery too
        lacking |= set(HARDWARE_STATES)
    every = (*Unitree.facts.writes, *REMOTE)
    writes = tuple(name for name in every if name in states and name not in lacking)
    return replace(Unitree.facts, writes=writes)


def _examined(states: States, robot: Robot, period: float, **options: Any) -> Binding:
    return Binding(_facts(robot, states, options.get("peer", "robot")))


class Unitree(WiredRobot):
    """A robot behind Unitree's DDS; build it with `make`."""

    facts = Facts(
        "unitree",
        writes=(*TOLD, "projected_gravity", "stamp_ns", *CONTROL_STATES),
        protocols=PROTOCOLS,
        examine=_examined,
    )

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        wire: UnitreeWire,
        *,
        peer: str,
        silence: float,
        silent: bool,
    ) -> None:
        self.facts = _facts(robot, states, peer)
        super().__init__(states, robot, period, wire, silence=silence, silent=silent)
        self._unitree = wire
        self._simulated = peer == SIMULATOR

    def variant(self) -> Mapping[str, Any]:
        """Return what the robot tells of itself: its protocol, and G1 and H1-2 `mode_machine`.

        unitree_mujoco leaves the latter at 0, whatever it simulates.
        """
        told = self._unitree.variant
        if self._simulated:
            return {name: value for name, value in told.items() if name != "mode_machine"}
        return told

    @property
    def remote(self) -> bytearray:
        """The wireless remote's 40 bytes, as they came last."""
        return self._unitree.remote


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str | None = None,
    domain: int | None = None,
    peer: Literal["robot", "unitree_mujoco"] = "robot",
    connect: float = 5.0,
    silence: float = SILENCE,
    silent: bool = False,
) -> Unitree:
    """Build the platform and wait for the robot.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name;
            without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
        domain: of DDS, instead of the robot file's.
        peer: `unitree_mujoco` sends no checksums, frame numbers, temperatures and battery, and has
            no controller of its own that must let go.
        connect: how long to wait for the first frame in [s].
        silence: of the robot that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: the network cannot be used, or no frame came in time.
    """
    if peer not in ("robot", SIMULATOR):
        raise PlatformError(f"platform 'unitree': no peer {peer!r}; known: robot, {SIMULATOR}")
    facts, real = UnitreeFacts.of(robot), peer == "robot"
    wire = UnitreeWire(
        states, robot, facts, domain, address, checked=real, release=real, silent=silent
    )
    built = Unitree(states, robot, period, wire, peer=peer, silence=silence, silent=silent)
    return opened(built, connect)
