"""Addressed: where the actuators of a robot file are, and which way they turn."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import RobotError
from unicon_core.robots import Robot
from unicon_ros.hardware.facts import TransportFacts


@dataclass(frozen=True)
class Addressed:
    """What the robot file says of the actuators of either version; arrays of shape (n,).

    Attributes:
        names: of the joints.
        addresses: of the actuators.
        port: for codes.
        rate: at which they may be asked, [Hz].
        degrees: of an actuator for one radian of the joint, with its sign.
    """

    names: tuple[str, ...]
    addresses: tuple[str, ...]
    port: int
    rate: float
    degrees: NDArray[np.float64]

    @staticmethod
    def facts(robot: Robot, network: str) -> dict[str, Any]:
        """Return the attributes above by name.

        Args:
            robot: the file.
            network: see `addresses`.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        facts = TransportFacts(robot)
        listed = addresses(robot, "actuators", facts.texts("actuators"), network)
        signs = facts.numbers("actuator_sign", -1.0, 1.0)
        if not (np.abs(signs) == 1.0).all():
            raise facts.wrong("actuator_sign", "1 or -1 for each joint")
        return {
            "names": robot.joint_names,
            "addresses": listed,
            "port": facts.integer("port_fast", 1, 65535),
            "rate": facts.number("rate_hz", 1.0, 1000.0),
            "degrees": np.rad2deg(signs),
        }


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


def addresses(robot: Robot, key: str, listed: tuple[str, ...], network: str) -> tuple[str, ...]:
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
        raise TransportFacts(robot).wrong(key, f"IPv4 addresses ({error})") from error
    if len(set(found)) < len(found):
        raise TransportFacts(robot).wrong(key, "an address of its own for each")
    return found
