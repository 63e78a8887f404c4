"""Where a hand is: the options `address`, `port` and `device` over what its robot file says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from unicon_core.errors import PlatformError, RobotError
from unicon_core.robots import Robot
from unicon_ros.hardware.modbus.link import Link, open_serial, open_tcp

__all__ = ["fact", "reached"]


def fact(robot: Robot, key: str) -> int:
    """Return a whole number of `transport`.

    Raises:
        RobotError: the robot file does not say it.
    """
    value = robot.transport.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= 0xFFFFFFFF:
        raise RobotError(
            f"robot {robot.name}: transport.{key} is {value!r}; give a whole number in {robot.path}"
        )
    return value


def reached(
    robot: Robot, platform: str, address: str | None, port: int | None, device: str | None
) -> tuple[str, Callable[[], Link]]:
    """Return where a hand is, in words, and what connects to it.

    Args:
        robot: its file, which may say `address` and `port`.
        platform: for messages.
        address: over TCP; None for the file's.
        port: over TCP; None for the file's.
        device: a serial line such as /dev/ttyUSB0, in place of TCP.

    Raises:
        PlatformError: an option is wrong, or none says where it is.
    """
    facts: Mapping[str, Any] = robot.transport
    if device is not None:
        if address is not None or port is not None:
            raise PlatformError(
                f"platform {platform!r}: device is a serial line, and address and port are of a "
                "network; give one of them"
            )
        baudrate = fact(robot, "baudrate")
        return f"{device} ({baudrate} baud)", lambda: open_serial(device, baudrate)
    address = facts.get("address") if address is None else address
    if not address:
        raise PlatformError(
            f"platform {platform!r}: where is the hand? give its serial line: platforms: "
            f"{{{platform}: {{device: /dev/ttyUSB0}}}}"
        )
    number = fact(robot, "port") if port is None else port
    if not 0 < number < 0x10000:
        raise PlatformError(f"platform {platform!r}: port is {number}; give 1 to 65535")
    return f"{address}:{number}", lambda: open_tcp(str(address), number)
