"""TransportFacts: what a driver reads of a robot file's `transport`, checked; for vendors' drivers.

facts = TransportFacts(robot)
port = facts.integer("port", 1, 65535)
limit = facts.numbers("stiffness_limit", 0.0, 2000.0)  # one for each joint
"""

from __future__ import annotations

import ipaddress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PlatformError, RobotError
from unicon_core.robots import Robot

__all__ = ["TransportFacts", "ipv4"]


class TransportFacts:
    """Reads facts; each method raises where the file does not say it, or says nonsense.

    Args:
        robot: the robot file.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def _wrong(self, key: str, wanted: str) -> RobotError:
        value, path = self._robot.transport.get(key), self._robot.path.name
        return RobotError(
            f"robot {self._robot.name}: transport.{key} is {str(value)[:60]}; write {wanted} into "
            f"{path}, with its source"
        )

    def integer(self, key: str, least: int, most: int) -> int:
        """Return a whole number within bounds.

        Raises:
            RobotError: it is none.
        """
        value = self._robot.transport.get(key)
        if type(value) is not int or not least <= value <= most:
            raise self._wrong(key, f"a whole number from {least} to {most}")
        return value

    def number(self, key: str, least: float, most: float) -> float:
        """Return a number within bounds.

        Raises:
            RobotError: it is none.
        """
        value: Any = self._robot.transport.get(key)
        if type(value) not in (int, float) or not least <= value <= most:
            raise self._wrong(key, f"a number from {least:g} to {most:g}")
        return float(value)

    def numbers(self, key: str, least: float, most: float) -> NDArray[np.float64]:
        """Return a number of each joint within bounds, shape (n,).

        Raises:
            RobotError: it is not a list of so many.
        """
        values: Any = self._robot.transport.get(key)
        count = self._robot.num_joints
        good = isinstance(values, list | tuple) and len(values) == count
        if not good or not all(type(v) in (int, float) and least <= v <= most for v in values):
            raise self._wrong(
                key, f"{count} numbers from {least:g} to {most:g}, one for each joint"
            )
        return np.array(values, np.float64)

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a text of each joint.

        Raises:
            RobotError: it is not a list of so many.
        """
        values: Any = self._robot.transport.get(key)
        count = self._robot.num_joints
        good = isinstance(values, list | tuple) and len(values) == count
        if not good or not all(isinstance(value, str) for value in values):
            raise self._wrong(key, f"{count} texts, one for each joint")
        return tuple(values)

    def text(self, key: str) -> str:
        """Return a text, such as a topic.

        Raises:
            RobotError: it is none, or empty.
        """
        value = self._robot.transport.get(key)
        if not isinstance(value, str) or not value:
            raise self._wrong(key, "a text")
        return value

    def one_of(self, key: str, known: tuple[str, ...]) -> str:
        """Return a word that is one of some.

        Raises:
            RobotError: it is none.
        """
        value = self._robot.transport.get(key)
        if value not in known:
            raise self._wrong(key, f"one of {', '.join(known)}")
        return str(value)

    def run(self, key: str, first: int, count: int) -> None:
        """Look whether a list is `count` whole numbers in a row from `first` on.

        Raises:
            RobotError: it is not.
        """
        values = self._robot.transport.get(key)
        if not isinstance(values, list | tuple) or list(values) != [*range(first, first + count)]:
            raise self._wrong(key, f"{first} to {first + count - 1}, the only order known")

    def slots(self, key: str, count: int) -> tuple[int, ...]:
        """Return the motor slot of each joint.

        Raises:
            RobotError: they are not as many different ones of 0 to `count` - 1.
        """
        values: Any = self._robot.transport.get(key)
        joints = self._robot.num_joints
        good = isinstance(values, list | tuple) and all(type(value) is int for value in values)
        if not good or len(set(values)) != joints or not all(0 <= v < count for v in values):
            raise self._wrong(key, f"{joints} different slots of 0 to {count - 1}")
        return tuple(values)

    def mapping(self, key: str, keys: tuple[str, ...], least: int, most: int) -> dict[str, int]:
        """Return whole numbers by name.

        Raises:
            RobotError: one of `keys` is not there, or out of bounds.
        """
        values: Any = self._robot.transport.get(key)
        good = isinstance(values, dict) and all(
            type(values.get(k)) is int and least <= values[k] <= most for k in keys
        )
        if not good:
            raise self._wrong(key, f"{{{': …, '.join(keys)}: …}} of {least} to {most}")
        return {k: values[k] for k in keys}


def ipv4(address: object, platform: str) -> str:
    """Return an option that is an IPv4 address.

    Raises:
        PlatformError: it is none.
    """
    try:
        if isinstance(address, str):
            return str(ipaddress.IPv4Address(address))
    except ValueError:
        pass
    raise PlatformError(
        f"platform {platform!r}: address is {str(address)[:60]!r}; give an IPv4 address such as "
        "192.168.1.201"
    )
