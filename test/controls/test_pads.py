"""Game pads of several makers: the same place is the same button; unplugged, all is let go of."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.blocks.controls import gamepad as module
from unicon_core.blocks.controls import gamepad as pads
from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.gamepad import (
    ABS,
    EVENT,
    KEY,
    SYN,
    Finder,
    Gamepad,
    Identity,
    Mapped,
    gamepad,
    pad_of,
)
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.states.standard import BUTTONS, control_states
from unicon_core.workflow.autowire import BuildContext, autowire

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"

BELOW_RIGHT_LEFT_ABOVE = {
    "xbox": (0x130, 0x131, 0x133, 0x134),  # xpad.c: BTN_A, BTN_B, BTN_X, BTN_Y
    "playstation": (0x130, 0x131, 0x134, 0x133),  # cross, circle, square, triangle
    "nintendo": (0x130, 0x131, 0x134, 0x133),  # B, A, Y, X
    "8bitdo": (0x131, 0x130, 0x134, 0x133),  # B, A, Y, X, as plain HID
    "generic": (0x121, 0x122, 0x120, 0x123),  # Logitech: 2, 3, 1, 4
}
PAD_KEYS = 1 << 0x130 | 1 << 0x131
JOYSTICK_KEYS = 1 << 0x120
WITH_RX = 0b11_1111
WITH_RZ = 0b110_0010_0111


class Rig:
    """A pipe that is read as a pad."""

    def __init__(self, folder: Path, mapping: str = "auto") -> None:
        self.path = folder / "pad"
        os.mkfifo(self.path)
        self.states = States(control_states())
        self.told = list[str]()
        self.context = BuildContext(self.states, load_robot("go2"), 0.02, tell=self.told.append)
        self.controls = Controls(self.states)
        self.pad = Gamepad(self.controls, str(self.path), self.context, mapping)
        self.pad()
        self.writer = os.open(self.path, os.O_WRONLY)

    def says(self, *events: tuple[int, int, int]) -> None:
        """Write events, and a report."""
        os.write(self.writer, b"".join(EVENT.pack(0, 0, *e) for e in (*events, (SYN, 0, 0))))
        self.pad()

    @property
    def pressed(self) -> list[str]:
        return [name for name, value in zip(BUTTONS, self.controls.buttons) if value]


@pytest.mark.parametrize("mapping", get_args(Mapped)[1:])
def test_the_same_place_is_the_same_button(mapping, tmp_path):
    rig = Rig(tmp_path, mapping)
    for code, name in zip(BELOW_RIGHT_LEFT_ABOVE[mapping], "ABXY"):
        rig.says((KEY, code, 1))
        assert rig.pressed == [name]
        rig.says((KEY, code, 0))
    if mapping == "generic":
        rig.says(*((KEY, code, 1) for code in range(0x124, 0x12C)))
    else:
        rig.says(*((KEY, c, 1) for c in (0x136, 0x137, 0x138, 0x139, 0x13A, 0x13B, 0x13D, 0x13E)))
    assert set(rig.pressed) == {"L1", "R1", "L2", "R2", "select", "start", "F1", "F2"}


@pytest.mark.parametrize(
    ("mapping", "right", "triggers", "wide"),
    [
        ("xbox", (0x03, 0x04), (0x02, 0x05), (-32768, 32767)),
        ("nintendo", (0x03, 0x04), (0x02, 0x05), (-32768, 32767)),
        ("playstation", (0x03, 0x04), (0x02, 0x05), (0, 255)),
        ("8bitdo", (0x02, 0x05), (0x0A, 0x09), (0, 255)),
        ("generic", (0x02, 0x05), (0x0A, 0x09), (0, 255)),
    ],
)
def test_sticks_and_triggers(
    mapping, right, triggers, wide,
    tmp_path,
):  # fmt: skip
    rig, (low, high) = Rig(tmp_path, mapping), wide
    rig.says((ABS, 0, high), (ABS, 1, low), (ABS, right[0], low), (ABS, right[1], high))
    assert rig.controls.sticks.tolist() == [1.0, 1.0, -1.0, -1.0]
    rig.says(*((ABS, axis, (low + high + 1) // 2) for axis in (0, 1, *right)))
    assert np.abs(rig.controls.sticks).max() < 0.005
    rig.says((ABS, triggers[0], 255), (ABS, triggers[1], 100))
    assert rig.pressed == ["L2"]
    rig.says((ABS, triggers[0], 0), (ABS, triggers[1], 200), (ABS, 0x10, 1), (ABS, 0x11, -1))
    assert set(rig.pressed) == {"R2", "right", "up"}


@pytest.mark.parametrize(
    ("vendor", "product", "keys", "axes", "mapping", "right"),
    [
        (0x045E, 0x028E, PAD_KEYS, WITH_RX, "xbox", 0x03),  # Xbox 360, by xpad
        (0x045E, 0x0B13, PAD_KEYS, WITH_RZ, "xbox", 0x02),  # Xbox Series, by Bluetooth
        (0x054C, 0x0CE6, PAD_KEYS, WITH_RX, "playstation", 0x03),  # DualSense
        (0x054C, 0x09CC, PAD_KEYS, WITH_RX, "playstation", 0x03),  # DualShock 4
        (0x057E, 0x2009, PAD_KEYS, WITH_RX, "nintendo", 0x03),  # Switch Pro
        (0x2DC8, 0x6001, PAD_KEYS, WITH_RZ, "8bitdo", 0x02),  # SN30 Pro
        (0x2DC8, 0x3012, PAD_KEYS, WITH_RZ, "xbox", 0x02),  # Ultimate
        (0x2DC8, 0x310A, PAD_KEYS, WITH_RX, "xbox", 0x03),  # Ultimate 2C, by xpad
        (0x046D, 0xC219, JOYSTICK_KEYS, WITH_RZ, "generic", 0x02),  # F710, switch at D
        (0x1234, 0x5678, PAD_KEYS, WITH_RX, "xbox", 0x03),
        (0x1234, 0x5678, JOYSTICK_KEYS, WITH_RX, "generic", 0x03),
    ],
)
def test_a_pad_is_known_by_what_it_is(vendor, product, keys, axes, mapping, right):
    found = pad_of(Identity(vendor, product, keys, axes))
    assert found.name == mapping
    assert found.sticks[right] == (2, 1.0)
    assert len(found.sticks) == 4
    assert not found.sticks.keys() & found.triggers.keys()
    assert found.ranges.keys() == found.sticks.keys() | found.triggers.keys()


def test_an_unknown_mapping_is_named(tmp_path):
    rig = Rig(tmp_path)
    with pytest.raises(WorkflowError, match="mapping 'xbax' is not known; did you mean 'xbox'"):
        autowire(gamepad, "gamepad", rig.context, {"mapping": "xbax"})


def test_a_pad_without_a_cable_is_found_among_the_others(tmp_path, monkeypatch):
    pad = Identity(0x054C, 0x0CE6, PAD_KEYS, WITH_RX)
    mouse = Identity(0x046D, 0xC077, 1 << 0x110, 0)
    motion = Identity(0x054C, 0x0CE6, 0, 0b111111)  # a pad's own sensors
    there = {"event2": mouse, "event10": motion, "event11": pad, "mice": pad}
    asked = list[str]()

    def ask(file: int) -> Identity:
        name = os.path.basename(os.readlink(f"/proc/self/fd/{file}"))
        asked.append(name)
        return there[name]

    monkeypatch.setattr(pads, "ask", ask)
    for name in ("event2", "event10", "mice"):
        (tmp_path / name).touch()
    finder = Finder(tmp_path)
    assert finder.find() == ""
    assert asked == ["event2", "event10"]
    assert finder.find() == ""
    assert len(asked) == 2  # each is asked once
    (tmp_path / "event11").touch()
    assert finder.find() == str(tmp_path / "event11")
    assert asked[2:] == ["event11"]
    (tmp_path / "event11").unlink()
    there["event2"] = pad  # by the same name another device
    assert finder.find() == ""
    finder.forget()
    assert finder.find() == str(tmp_path / "event2")
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id" / "usb-Pad-event-joystick").touch()
    assert finder.find().endswith("usb-Pad-event-joystick")
    assert Finder(tmp_path / "none").find() == ""


def test_unplugged_it_lets_go_at_once_and_works_when_it_is_back(tmp_path, monkeypatch):
    (tmp_path / "event5").touch()
    there = Identity(0x054C, 0x0CE6, PAD_KEYS, WITH_RX)
    monkeypatch.setattr(pads, "ask", lambda _: there)
    monkeypatch.setattr(module, "ask", lambda _: there)
    monkeypatch.setattr(module, "AGAIN", 0.0)
    events = list[bytes | OSError]()

    def read(file: int, _: int) -> bytes:
        os.fstat(file)  # it is open
        if not events:
            raise BlockingIOError
        event = events.pop(0)
        if isinstance(event, OSError):
            raise event
        return event

    monkeypatch.setattr(module.os, "read", read)
    states = States(control_states())
    told = list[str]()
    context = BuildContext(states, load_robot("go2"), 0.02, tell=told.append)
    controls = Controls(states)
    pad = Gamepad(controls, "auto", context)
    pad._finder = Finder(tmp_path)
    events.append(EVENT.pack(0, 0, KEY, 0x134, 1) + EVENT.pack(0, 0, ABS, 0x01, -32768))
    pad()
    assert controls.alive == 1
    assert controls.buttons[BUTTONS.index("X")] == 1
    assert told == [f"gamepad {tmp_path / 'event5'}: 054c:0ce6, buttons as of playstation"]
    events.append(OSError(errno.ENODEV, "No such device"))
    (tmp_path / "event5").unlink()
    pad()
    assert (int(controls.alive), controls.buttons.any(), controls.sticks.any()) == (0, False, False)
    assert "No such device; all is let go until it comes back" in told[-1]
    pad()
    assert "no joystick in" in told[-1]
    there = Identity(0x045E, 0x028E, PAD_KEYS, WITH_RX)  # another one is plugged in
    (tmp_path / "event5").touch()
    events.append(EVENT.pack(0, 0, KEY, 0x134, 1))
    pad()
    assert controls.buttons[BUTTONS.index("Y")] == 1
    assert told[-1].endswith("045e:028e, buttons as of xbox")
    pad.close()
