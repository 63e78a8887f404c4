"""Where a hand is: the options `address`, `port` and `device` over what its robot file says."""

from __future__ import annotations

from collections.abc import Callable

from unicon_core.errors import PlatformError
from unicon_core.robots import Robot
from unicon_ros.hardware.facts import Baud, Port, fact, port_number
from unicon_ros.hardware.modbus.link import Link, open_serial, open_tcp


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
        RobotError: the robot file does not say its port or baud rate.
    """
    if device is not None:
        if address is not None or port is not None:
            raise PlatformError(
                f"platform {platform!r}: device is a serial line, and address and port are of a "
                "network; give one of them"
            )
        baudrate = fact(robot, "baudrate", Baud)
        return f"{device} ({baudrate} baud)", lambda: open_serial(device, baudrate)
    address = robot.transport.get("address") if address is None else address
    if not address:
        raise PlatformError(
            f"platform {platform!r}: where is the hand? give its serial line: platforms: "
            f"{{{platform}: {{device: /dev/ttyUSB0}}}}"
        )
    number = fact(robot, "port", Port) if port is None else port_number(port, platform)
    return f"{address}:{number}", lambda: open_tcp(str(address), number)
