"""TransportFacts: what a driver reads of a robot file's `transport`, checked; for vendors' drivers.

facts = TransportFacts(robot)
port = facts.integer("port", 1, 65535)
limit = facts.numbers("stiffness_limit", 0.0, 2000.0)  # one for each joint
raise facts.wrong("release", "{wait: seconds}")         # of what only this vendor has
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PlatformError, RobotError
from unicon_core.robots import Robot

K = TypeVar("K", int, str)


class TransportFacts:
    """Reads facts; each method raises where the file does not say it, or says nonsense.

    Args:
        robot: the robot file.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self._said = robot, robot.transport

    def wrong(self, key: str, wanted: str) -> RobotError:
        """Return the error of a fact that lacks or is wrong.

        Args:
            key: of the fact.
            wanted: what is to be written instead.
        """
        return RobotError(
            f"robot {self._robot.name}: transport.{key} is {self._said.get(key)!r:.60}; write "
            f"{wanted} into {self._robot.path.name}, with its source"
        )

    def integer(self, key: str, least: int, most: int) -> int:
        """Return a whole number within bounds.

        Raises:
            RobotError: it is none.
        """
        value: Any = self._said.get(key)
        if not _whole(value, least, most):
            raise self.wrong(key, f"a whole number from {least} to {most}")
        return int(value)

    def number(self, key: str, least: float, most: float) -> float:
        """Return a number within bounds.

        Raises:
            RobotError: it is none.
        """
        value: Any = self._said.get(key)
        if not _within(value, least, most):
            raise self.wrong(key, f"a number from {least:g} to {most:g}")
        return float(value)

    def integers(self, key: str, count: int, least: int, most: int) -> tuple[int, ...]:
        """Return so many whole numbers within bounds.

        Raises:
            RobotError: it is not a list of them.
        """
        wanted = f"{count} whole numbers from {least} to {most}"
        return tuple(self._list(key, count, lambda value: _whole(value, least, most), wanted))

    def numbers(self, key: str, least: float, most: float) -> NDArray[np.float64]:
        """Return a number of each joint within bounds, shape (n,).

        Raises:
            RobotError: it is not a list of so many.
        """
        count = self._robot.num_joints
        wanted = f"{count} numbers from {least:g} to {most:g}, one for each joint"
        found = self._list(key, count, lambda value: _within(value, least, most), wanted)
        return np.array(found, np.float64)

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a text of each joint.

        Raises:
            RobotError: it is not a list of so many.
        """
        count = self._robot.num_joints
        wanted = f"{count} texts, one for each joint"
        return tuple(self._list(key, count, lambda value: isinstance(value, str), wanted))

    def _list(
        self, key: str, count: int, good: Callable[[Any], bool], wanted: str
    ) -> list[Any] | tuple[Any, ...]:
        values = self._said.get(key)
        if isinstance(values, list | tuple) and len(values) == count and all(map(good, values)):
            return values
        raise self.wrong(key, wanted)

    def text(self, key: str) -> str:
        """Return a text, such as a topic.

        Raises:
            RobotError: it is none, or empty.
        """
        value = self._said.get(key)
        if not isinstance(value, str) or not value:
            raise self.wrong(key, "a text")
        return value

    def one_of(self, key: str, known: tuple[str, ...]) -> str:
        """Return a word that is one of some.

        Raises:
            RobotError: it is none.
        """
        value = self._said.get(key)
        if value not in known:
            raise self.wrong(key, f"one of {', '.join(known)}")
        return str(value)

    def run(self, key: str, first: int, count: int) -> None:
        """Look whether a list is `count` whole numbers in a row from `first` on.

        Raises:
            RobotError: it is not.
        """
        values = self._said.get(key)
        if not isinstance(values, list | tuple) or list(values) != [*range(first, first + count)]:
            raise self.wrong(key, f"{first} to {first + count - 1}, the only order known")

    def slots(self, key: str, count: int) -> tuple[int, ...]:
        """Return the motor slot of each joint.

        Raises:
            RobotError: they are not as many different ones of 0 to `count` - 1.
        """
        joints = self._robot.num_joints
        wanted = f"{joints} different slots of 0 to {count - 1}"
        found = self._list(key, joints, lambda value: _whole(value, 0, count - 1), wanted)
        if len(set(found)) < joints:
            raise self.wrong(key, wanted)
        return tuple(found)

    def mapping(self, key: str, keys: tuple[K, ...], least: int, most: int) -> dict[K, int]:
        """Return whole numbers by name.

        Raises:
            RobotError: one of `keys` is not there, or out of bounds.
        """
        values = self._said.get(key)
        if not isinstance(values, dict) or not all(
            _whole(values.get(k), least, most) for k in keys
        ):
            names = ": …, ".join(map(str, keys))
            raise self.wrong(key, f"{{{names}: …}} of {least} to {most}")
        return {k: values[k] for k in keys}


def _whole(value: Any, least: int, most: int) -> bool:
    return type(value) is int and least <= value <= most


def _within(value: Any, least: float, most: float) -> bool:
    return type(value) in (int, float) and least <= value <= most


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
        f"platform {platform!r}: address is {address!r:.60}; give an IPv4 address such as "
        "192.168.1.201"
    )


def port_number(value: object, platform: str, key: str = "port") -> int:
    """Return an option that is the number of a port.

    Raises:
        PlatformError: it is none.
    """
    if isinstance(value, int) and _whole(value, 1, 65535):
        return value
    raise PlatformError(f"platform {platform!r}: {key} is {value!r:.60}; give one from 1 to 65535")
