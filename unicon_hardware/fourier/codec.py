"""Datagrams of Fourier's FSA v2 actuators, port 2335, big endian; for their wire and their face.

The first byte is a code. A query is answered under its own code; a setting that is acknowledged
carries a count, and its answer that count and a result. Source: PyPI fi_fsa 0.3.17,
fi_fsa/v2/fi_fsa_v2.py. Positions are in [deg], speeds in [deg/s], currents in [A]; gains are the
actuator's own, and the robot file says what they are.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, TypeVar

import numpy as np

from unicon_base.arrays import Float64
from unicon_base.errors import RobotError
from unicon_base.schema.marks import Key
from unicon_core.robots import Robot
from unicon_hardware.facts import (
    AskingRate,
    Octet,
    Port,
    each,
    each_text,
    fact,
    facts_of,
    wrong_fact,
)

DISABLE, COMMAND, GAINS = 0x02, 0x0E, 0xA1
STATE, TEMPERATURE = 0x21, 0x22
ENABLE, PD_MODE, ACKNOWLEDGED_GAINS, ARM_DEAD_MAN, CLEAR_DEAD_MAN = 0x51, 0x59, 0x61, 0x64, 0x65

COMMAND_TYPE = np.dtype([("code", "u1"), ("pos", ">f4"), ("vel", ">f4"), ("current", ">f4")])
"""Targets of PD mode: position, and feed-forward of speed and current."""
GAINS_TYPE = np.dtype([("code", "u1"), ("kp", ">f4"), ("kd", ">f4")])
STATE_TYPE = np.dtype([("code", "u1"), ("measured", ">f4", (4,)), ("errors", ">u4", (8,))])
"""Position, speed, current and torque; the main error and seven words of extended ones."""
TEMPERATURE_TYPE = np.dtype([("code", "u1"), ("celsius", ">f4", (2,))])
"""Of the transistors and of the windings."""
ACKNOWLEDGED = np.dtype([("code", "u1"), ("count", ">u4"), ("result", ">u4")])

TIMED_OUT = 7, 0x01
"""Of `errors`: the word and the bit which say that no command came in time."""

A = TypeVar("A", bound="Addressed")
UNITS = ("stiffness_scale", "damping_scale", "timeout_mode")
WHY = "what its actuators' gains are in N·m/rad, nor what they do when commands stop"


@dataclass(frozen=True)
class Addressed:
    """What the robot file says of the actuators of either version; arrays of shape (n,).

    Attributes:
        names: of the joints.
        addresses: of the actuators.
        port: for codes.
        rate: at which they may be asked, [Hz].
        signs: 1 or -1: which way an actuator turns with its joint.
    """

    names: tuple[str, ...]
    addresses: tuple[str, ...]
    port: Annotated[Port, Key("port_fast")]
    rate: AskingRate
    signs: Annotated[Float64, Key("actuator_sign"), each(-1.0, 1.0)]

    @cached_property
    def degrees(self) -> Float64:
        """Of an actuator for one radian of the joint, with its sign."""
        return np.rad2deg(self.signs)


def addressed(kind: type[A], robot: Robot, network: str, **given: Any) -> A:
    """Return the facts of one version.

    Args:
        kind: class of its facts.
        robot: the file.
        network: see `addresses`.
        given: as of `facts_of`.

    Raises:
        RobotError: a fact is missing or wrong.
    """
    where = of_actuators(robot, network)
    found = facts_of(kind, robot, names=robot.joint_names, addresses=where, **given)
    if not (np.abs(found.signs) == 1.0).all():
        raise wrong_fact(robot, "actuator_sign", "1 or -1 for each joint")
    return found


def of_actuators(robot: Robot, network: str) -> tuple[str, ...]:
    """Return the addresses of the actuators; see `addresses`."""
    listed = fact(robot, "actuators", Annotated[list[str], each_text])
    return addresses(robot, "actuators", listed, network)


def complete(robot: Robot, version: int, keys: tuple[str, ...], why: str) -> None:
    """Look whether a robot file is of this version of FSA, with facts that no vendor publishes.

    Args:
        robot: the file.
        version: of FSA.
        keys: of the facts.
        why: what is not known without them.

    Raises:
        RobotError: it is not, or a fact is missing.
    """
    transport = robot.transport
    if transport.get("fsa") != version:
        raise RobotError(
            f"robot {robot.name}: transport.fsa is {transport.get('fsa')}; write 1 (GR-1) or 2 "
            f"(N1) into {robot.path.name}, the version of FSA that its actuators have"
        )
    missing = [f"transport.{key}" for key in keys if transport.get(key) is None]
    if missing:
        raise RobotError(
            f"robot {robot.name}: its vendor does not say {why}; measure it, and write "
            f"{', '.join(missing)} into {robot.path.name} with its source"
        )


def addresses(robot: Robot, key: str, listed: Sequence[str], network: str) -> tuple[str, ...]:
    """Return addresses, each once.

    Args:
        robot: the file.
        key: of its transport, for messages.
        listed: there.
        network: an address in another network of 256 in which they are; the last number of each
            address stays.

    Raises:
        RobotError: one is none, or stands there twice.
    """
    if network:
        start = network.rpartition(".")[0]
        listed = tuple(f"{start}.{address.rpartition('.')[2]}" for address in listed)
    try:
        found = tuple(str(ipaddress.IPv4Address(address)) for address in listed)
    except ValueError as error:
        raise wrong_fact(robot, key, f"IPv4 addresses ({error})") from error
    if len(set(found)) < len(found):
        raise wrong_fact(robot, key, "an address of its own for each")
    return found


@dataclass(frozen=True)
class Actuators(Addressed):
    """What the robot file says of the actuators; arrays of shape (n,).

    Attributes:
        kp: of an actuator for 1 N·m/rad of the joint.
        kd: of an actuator for 1 N·m·s/rad of the joint.
        timeout_mode: which mode an actuator enters that gets no commands.
        scale: of the current for 1 N·m of the joint in [A]; None where nobody knows.
    """

    kp: Annotated[Float64, Key("stiffness_scale"), each(1e-9, 1e9)]
    kd: Annotated[Float64, Key("damping_scale"), each(1e-9, 1e9)]
    timeout_mode: Octet
    scale: Annotated[Float64 | None, Key("current_scale"), each(1e-9, 1e9)] = None

    @classmethod
    def of(cls, robot: Robot, network: str = "") -> Actuators:
        """Return those of a robot file.

        Args:
            robot: the file.
            network: an address in another network of 256 in which they are; the last number of
                each address stays.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        complete(robot, 2, UNITS, WHY)
        return addressed(cls, robot, network)

    @cached_property
    def current(self) -> Float64 | None:
        """For 1 N·m of the joint in [A], with its sign; None where nobody knows."""
        return None if self.scale is None else self.signs * self.scale
