"""Addressed: where the actuators of a robot file are, and which way they turn."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, TypeVar

import numpy as np

from unicon_core.errors import RobotError
from unicon_core.robots import Robot
from unicon_core.schema.marks import Key
from unicon_ros.hardware.facts import (
    AskingRate,
    Numbers,
    Port,
    each,
    each_text,
    fact,
    facts_of,
    wrong_fact,
)

A = TypeVar("A", bound="Addressed")


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
    signs: Annotated[Numbers, Key("actuator_sign"), each(-1.0, 1.0)]

    @cached_property
    def degrees(self) -> Numbers:
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
