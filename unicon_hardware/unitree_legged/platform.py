"""Platform `unitree_legged`: an A1, Aliengo or Go1 over UDP, for workflows.

platform: unitree_legged
platforms:
  unitree_legged: {generation: legged_sdk_3.8.4}     # of an Aliengo, which has several
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from unicon_base.errors import PlatformError
from unicon_core.platforms.kit.base import IMU_STATES
from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_hardware.unitree_legged.codec import NAME, LeggedTransport, link_of
from unicon_hardware.unitree_legged.wire import FOOT_FORCE, LeggedWire
from unicon_hardware.wired_robot import SILENCE, WiredRobot, opened

WATCHDOG = 0.25
"""A tick that is later damps the robot, [s]; three ticks where those are longer. So late a tick may
be before the runner calls it hung (`pacing.hang`)."""
OPTIONS = ("generation", "address", "port", "local_port")
"""Of the link."""
_BATTERY = ("battery_charge", "battery_voltage")
_WRITES = (
    *JOINT_STATES,
    *IMU_STATES,
    "projected_gravity",
    "motor_temperature",
    "motor_error",
    *_BATTERY,
    "stamp_ns",
    *CONTROL_STATES,
)


def _told(states: States, link: LeggedTransport) -> tuple[str, ...]:
    """Return the states that a robot of this generation tells, as far as they are there."""
    without = () if "bms" in (link.layout.state.names or ()) else _BATTERY
    names = (*_WRITES, FOOT_FORCE)
    return tuple(name for name in names if name in states and name not in without)


def _examined(
    states: States,
    robot: Robot,
    period: float,
    **options: Any,
) -> Binding:
    """Tell `unicon check` what would be told, without opening anything.

    Raises:
        PlatformError: an option is wrong.
        RobotError: the robot file lacks a fact.
    """
    link = link_of(robot, **{name: options.get(name) for name in OPTIONS})
    return Binding(replace(UnitreeLegged.facts, writes=_told(states, link)))


class UnitreeLegged(WiredRobot):
    """The robot; build it with `make`."""

    facts = Facts(NAME, writes=_WRITES, protocols=(NAME,), examine=_examined)
    _wire: LeggedWire

    def info(self) -> Mapping[str, Any]:
        """Return the generation too, and how many came from others."""
        return {
            **super().info(),
            "generation": self._wire.link.generation,
            "strangers": self._wire.strangers,
        }


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    generation: str | None = None,
    address: str | None = None,
    port: int | None = None,
    local_port: int | None = None,
    encrypted: bool = False,
    check_mode: bool = True,
    poll: bool = False,
    connect: float = 5.0,
    silence: float = SILENCE,
    watchdog: float | None = None,
    silent: bool = False,
) -> UnitreeLegged:
    """Build the platform and wait for the robot's first answer.

    Args:
        period: of a tick in [s].
        generation: of the protocol, a word of the robot file's `generations`; needed where there
            are several.
        address: of the robot, in place of the file's.
        port: of the robot, in place of the file's.
        local_port: of this machine, in place of the file's.
        encrypted: with the checksum of a Go1 that is not an EDU.
        check_mode: wait until every motor tells that it is in servo mode.
        poll: send idle commands where nothing may be sent (`--dry`, `preflight`): the robot says
            nothing without.
        connect: how long to wait for the first answer, [s].
        silence: of the robot that is a fault, [s].
        watchdog: a tick that is later damps the robot, [s]; None for 0.25 or three ticks.
        silent: nothing is sent, but for idle commands with `poll`.

    Raises:
        PlatformError: an option is wrong, the port is taken, or no good answer came.
        RobotError: the robot file lacks a fact.
    """
    link = link_of(robot, generation=generation, address=address, port=port, local_port=local_port)
    if encrypted and not link.layout.head:
        raise PlatformError(
            f"platform {NAME!r}: encrypted is known of Go1's datagrams alone; leave it out"
        )
    if watchdog is None:
        watchdog = max(WATCHDOG, 3.0 * period)
    if not period < watchdog <= 10.0:
        raise PlatformError(
            f"platform {NAME!r}: watchdog is {watchdog} s; give more than a tick of {period:g} s, "
            "at most 10 s"
        )
    if silent and not poll:
        raise PlatformError(
            f"platform {NAME!r}: {robot.name} answers commands and says nothing by itself, so that "
            "it cannot be heard silently; lay it down and let idle commands ask it, without "
            f"stiffness, damping and torque: platforms: {{{NAME}: {{poll: true}}}}"
        )
    wire = LeggedWire(states, robot, link, watchdog, encrypted=encrypted, check_mode=check_mode)
    told = replace(UnitreeLegged.facts, writes=_told(states, link))
    built = UnitreeLegged(states, robot, period, wire, silence=silence, silent=silent, facts=told)
    return opened(built, connect)
