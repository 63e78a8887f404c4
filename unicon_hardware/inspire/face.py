"""What an Inspire RH56 looks like on the wire, for the emulator and tests."""

from __future__ import annotations

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.facts import Port, fact
from unicon_hardware.inspire.platform import registers_of
from unicon_hardware.modbus.served import HandEndpoint, PtyServer, TcpServer


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
