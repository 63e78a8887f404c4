"""What a ROHand looks like on the wire, for the emulator and tests."""

from __future__ import annotations

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.facts import Word, fact
from unicon_hardware.modbus.served import HandEndpoint, PtyServer
from unicon_hardware.rohand.platform import registers_of


def face(states: States, robot: Robot, *, version: int = 0x0100) -> HandEndpoint:
    """Return the face of a hand on a pty, `face.where`.

    Args:
        version: of its protocol, the major one in the high byte.
    """
    extra = {fact(robot, "register_protocol", Word): version}
    return HandEndpoint(states, registers_of(robot), PtyServer(), "rohand", extra)
