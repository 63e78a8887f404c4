"""A stand-in for `xhand_controller.xhand_control`: it knows every call, and minds its arguments.

An XHand1 behind it follows its targets. What is wrong with it is said by `TROUBLE`, or by the
environment's XHAND_TROUBLE in a process of its own; each call goes into `CALLS` and, where
XHAND_CALLS names a file, there.
"""

from __future__ import annotations

import json
import os
from types import SimpleNamespace
from typing import Any

CALLS: list[tuple[Any, ...]] = []
TROUBLE: set[str] = set(filter(None, os.environ.get("XHAND_TROUBLE", "").split(",")))
FIELDS = {
    "id": int,
    "kp": int,
    "ki": int,
    "kd": int,
    "position": float,
    "tor_max": int,
    "mode": int,
}


def _note(*call: Any) -> None:
    CALLS.append(call)
    if path := os.environ.get("XHAND_CALLS"):
        with open(path, "a", encoding="utf-8") as file:
            file.write(json.dumps(call) + "\n")


def _error(code: int = 0) -> SimpleNamespace:
    return SimpleNamespace(error_code=code, error_message=f"trouble {code}" if code else "")


class FingerCommand_t:
    """One joint; it has the maker's fields and no others."""

    __slots__ = tuple(FIELDS)


class HandCommand_t:
    """Twelve joints."""

    def __init__(self) -> None:
        self.finger_command = [FingerCommand_t() for _ in range(12)]


class XHandControl:
    """A device; calls out of order are errors."""

    def __init__(self) -> None:
        _note("XHandControl")
        self._open = False
        self._position = [0.1] * 12
        self._reads = 0

    def open_serial(self, port: str, baud: int) -> SimpleNamespace:
        """Open a serial line."""
        _note("open_serial", port, baud)
        assert type(port) is str
        assert type(baud) is int
        self._open = "closed" not in TROUBLE
        return _error(0 if self._open else 7)

    def enumerate_devices(self, protocol: str) -> list[str]:
        """Find network interfaces."""
        _note("enumerate_devices", protocol)
        assert protocol == "EtherCAT"
        return [] if "no_ethercat" in TROUBLE else ["eth9"]

    def open_ethercat(self, name: str) -> SimpleNamespace:
        """Open a network interface."""
        _note("open_ethercat", name)
        self._open = True
        return _error()

    def list_hands_id(self) -> list[int]:
        """List the hands."""
        _note("list_hands_id")
        assert self._open
        return [] if "no_hand" in TROUBLE else [0, 5] if "two_hands" in TROUBLE else [5]

    def send_command(self, hand_id: int, command: HandCommand_t) -> SimpleNamespace:
        """Take a command, whole and of the right types."""
        assert self._open
        assert type(hand_id) is int
        assert type(command) is HandCommand_t
        told = []
        for joint, each in enumerate(command.finger_command):
            for field, kind in FIELDS.items():
                assert type(getattr(each, field)) is kind, field
            assert each.id == joint
            told.append([getattr(each, field) for field in FIELDS])
            if each.mode == 3:
                self._position[joint] = each.position
        _note("send_command", hand_id, told)
        return _error(9 if "deaf" in TROUBLE else 0)

    def read_state(self, hand_id: int, force_update: bool) -> tuple[SimpleNamespace, Any]:
        """Tell what the hand told last; the noise of its currents shows that it is new."""
        assert self._open
        assert type(hand_id) is int
        assert force_update is False  # True sends the last command again
        self._reads += 1
        noise = 0.0 if "frozen" in TROUBLE else self._reads % 7
        fingers = [
            SimpleNamespace(
                id=joint,
                position=position,
                torque=noise,
                temperature=0x1200 + 30 + joint,
                commboard_err=1 if "board" in TROUBLE and joint == 2 else 0,
                jonitboard_err=0,
                tipboard_err=0,
            )
            for joint, position in enumerate(self._position)
        ]
        if "nan" in TROUBLE:
            fingers[4].position = float("nan")
        if "swapped" in TROUBLE:
            fingers[0], fingers[1] = fingers[1], fingers[0]
        return _error(3 if "mute" in TROUBLE else 0), SimpleNamespace(finger_state=fingers)

    def close_device(self) -> None:
        """Let go."""
        _note("close_device")
        self._open = False
