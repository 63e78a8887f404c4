"""Platform `inspire`: an Inspire RH56 hand, over whatever its robot file's protocol is.

    platform: {body: unitree, hands: inspire}
    platforms: {right_hand: {address: 192.168.11.211}}      # the robot file has the maker's address

Protocol `inspire` is Modbus over TCP or a serial line; `inspire_ftp` and `inspire_dfx` are the DDS
services in front of the two generations, and need the extra `hw-inspire`. The hand closes its own
position loop: stiffness and damping are not sent. It holds its last target for as long as it has
power; there is nothing that would let go by itself.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from unicon_base import PlatformError
from unicon_base.schema.marks import Within
from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.facts import Octet, Port, Word, fact
from unicon_hardware.inspire.dds.wire import InspireDdsWire
from unicon_hardware.modbus.hand import HandRegisters, HandWire, Told
from unicon_hardware.modbus.link import reached
from unicon_hardware.modbus.served import HandEndpoint, PtyServer, TcpServer
from unicon_hardware.wire import Wire
from unicon_hardware.wired_robot import WiredRobot, opened

RAW = Annotated[float, Within(-32768.0, 32767.0)]


def registers_of(robot: Robot) -> HandRegisters:
    """Return the registers of a hand: angles from `raw_lower` (open) to `raw_upper` (closed).

    Raises:
        RobotError: the robot file does not say them.
    """
    register = partial(fact, robot, hint=Word)
    open_, closed = (fact(robot, key, RAW) for key in ("raw_lower", "raw_upper"))
    lower, upper = robot.lower.astype(np.float64), robot.upper.astype(np.float64)
    per_rad = (closed - open_) / (upper - lower)
    ends = np.array([[min(open_, closed)], [max(open_, closed)]]).astype(np.int64)
    lowest, highest = np.repeat(ends, robot.num_joints, axis=1)
    return HandRegisters(
        unit=fact(robot, "device_id", Octet),
        target=register("register_angle_set"),
        angle=register("register_angle_actual"),
        at_zero=open_ - per_rad * lower,
        per_rad=per_rad,
        lowest=lowest,
        highest=highest,
        slow={
            "motor_error": Told(register("register_error"), bytes=True),
            "motor_status": Told(register("register_status"), bytes=True),
            "motor_temperature": Told(register("register_temperature"), bytes=True),
        },
        clear=(register("register_clear_error"), 1),
    )


NAME = MODBUS = "inspire"
SILENCE = 0.2
"""In [s]: 20 answers, or states, at 100 Hz."""
TOLD = {
    MODBUS: ("motor_error", "motor_status", "motor_temperature"),
    "inspire_ftp": ("motor_error", "motor_temperature"),
    "inspire_dfx": (),
}
"""Protocol to what is told besides joints."""


def _facts(robot: Robot) -> Facts:
    """Return what it writes of a robot."""
    lacking = {*TOLD[MODBUS]} - {*TOLD[robot.transport["protocol"]]}
    facts = Inspire.facts
    return replace(facts, writes=tuple(name for name in facts.writes if name not in lacking))


def _examined(states: States, robot: Robot, period: float, **options: Any) -> Binding:
    return Binding(_facts(robot))


class Inspire(WiredRobot):
    """One hand; build it with `make`. `joint_vel` is the difference of measured angles."""

    facts = Facts(
        NAME,
        writes=("joint_pos", "joint_vel", *TOLD[MODBUS], "stamp_ns"),
        protocols=tuple(TOLD),
        examine=_examined,
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str | None = None,
    port: int | None = None,
    device: str | None = None,
    domain: int | None = None,
    connect: float = 5.0,
    silence: float = SILENCE,
    silent: bool = False,
) -> Inspire:
    """Build the platform and wait for the hand.

    Args:
        period: of a tick in [s].
        address: of the hand over Modbus TCP, in place of the robot file's; over DDS that of this
            machine's network interface to the robot, or its name, which else CycloneDDS chooses.
        port: of Modbus TCP, in place of the robot file's.
        device: a serial line such as /dev/ttyUSB0, in place of Modbus TCP.
        domain: of DDS, in place of the robot file's.
        connect: how long to wait for the hand's first word in [s].
        silence: of the hand that is a fault, in [s].
        silent: it is only listened to.

    Raises:
        MissingDependencyError: cyclonedds is not installed, and the hand is behind DDS.
        RobotError: the robot file lacks a fact.
        PlatformError: an option is wrong or of another protocol, or the hand does not tell.
    """
    protocol = robot.transport["protocol"]
    modbus = protocol == MODBUS
    foreign = {"domain": domain} if modbus else {"port": port, "device": device}
    for option, given in foreign.items():
        if given is not None:
            raise PlatformError(
                f"platform {NAME!r}: {option} is an option of hands over "
                f"{'DDS' if modbus else 'Modbus'}, and robot {robot.name} speaks {protocol}; leave "
                "it out, or choose another robot file"
            )
    wire: Wire
    if modbus:
        where, link = reached(robot, NAME, address, port, device)
        wire = HandWire(states, registers_of(robot), link, where, silent=silent)
    else:
        wire = InspireDdsWire(states, robot, domain, address, silent=silent)
    told = _facts(robot)
    made = Inspire(states, robot, period, wire, silence=silence, silent=silent, facts=told)
    return opened(made, connect)


def face(
    states: States, robot: Robot, *, port: int | None = None, serial: bool = False
) -> HandEndpoint:
    """Return the face of a hand.

    Args:
        port: to listen at on loopback, 0 for any; None for the robot file's.
        serial: it is reached over a pty, `face.where`.
    """
    if port is None:
        port = fact(robot, "port", Port)
    server = PtyServer() if serial else TcpServer(port)
    return HandEndpoint(states, registers_of(robot), server, "inspire")
