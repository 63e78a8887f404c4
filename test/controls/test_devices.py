"""Gamepad, keyboard and remotes: presses become states, and who is gone presses nothing."""

from __future__ import annotations

import os
import pty
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from unicon_base.errors import WorkflowError
from unicon_core.blocks.controls.device import (
    BUTTON_KEYS,
    HELP,
    REMOTES,
    STICK_KEYS,
    Controls,
    Keyboard,
    device_block,
    keyboard,
)
from unicon_core.blocks.controls.gamepad import EVENT, Gamepad, gamepad
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.states.standard import BUTTONS, control_states, standard_states
from unicon_core.workflow.autowire import BuildContext, autowire

KEY = 1
ABS = 3
SYN = 0


class Pad:
    """A pipe that is read as a device, and what its reader says."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "pad"
        os.mkfifo(self.path)
        robot = load_robot("go2")
        self.states = States(standard_states(robot.joint_names) | control_states())
        self.told: list[str] = []
        self.context = BuildContext(self.states, robot, 0.02, tell=self.told.append)
        self.controls = Controls(self.states)
        self.pad = Gamepad(self.controls, str(self.path), self.context)
        self.pad()  # opens it
        self.writer = os.open(self.path, os.O_WRONLY)

    def says(self, *events: tuple[int, int, int]) -> None:
        os.write(self.writer, b"".join(EVENT.pack(0, 0, *event) for event in events))
        self.pad()

    def pressed(self) -> set[str]:
        return {name for name, value in zip(BUTTONS, self.controls.buttons) if value}


@pytest.fixture
def pad(tmp_path):
    return Pad(tmp_path)


def test_events_become_sticks_and_buttons(pad):
    pad.says((KEY, 0x130, 1), (KEY, 0x13B, 1), (ABS, 0x01, -32768), (ABS, 0x00, 32767), (SYN, 0, 0))
    assert pad.pressed() == {"A", "start"}
    assert pad.controls.sticks.tolist() == [1.0, 1.0, 0.0, 0.0]  # right, and up
    pad.says((KEY, 0x130, 0), (ABS, 0x03, 0), (ABS, 0x10, -1), (ABS, 0x02, 255), (KEY, 0x2FF, 1))
    assert pad.pressed() == {"start", "left", "L2"}
    assert pad.controls.sticks[2] == pytest.approx(0.0, abs=1e-4)
    pad.says((ABS, 0x10, 1), (ABS, 0x11, -1), (ABS, 0x02, 0))
    assert pad.pressed() == {"start", "right", "up"}
    assert pad.controls.alive == 1


def test_half_an_event_is_kept_and_garbage_presses_nothing_unknown(pad):
    whole = EVENT.pack(0, 0, KEY, 0x131, 1)
    os.write(pad.writer, whole[:10])
    pad.pad()
    assert pad.pressed() == set()
    os.write(pad.writer, whole[10:])
    pad.pad()
    assert pad.pressed() == {"B"}
    noise = np.random.default_rng(0).bytes(EVENT.size * 2000)
    for at in range(0, len(noise), 4096):
        os.write(pad.writer, noise[at : at + 4096])
        for _ in range(4):
            pad.pad()
    assert (np.abs(pad.controls.sticks) <= 1.0).all()
    assert set(pad.controls.buttons.tolist()) <= {0, 1}


def test_who_is_gone_presses_nothing_and_may_come_back(pad):
    pad.says((KEY, 0x137, 1), (ABS, 0x01, -32768))
    assert pad.pressed() == {"R1"}
    os.close(pad.writer)
    pad.pad()
    assert (pad.pressed(), pad.controls.sticks.any(), int(pad.controls.alive)) == (set(), False, 0)
    assert "all is let go until it comes back" in pad.told[-1]
    pad.pad()
    assert len(pad.told) == 1  # told once
    pad.writer = os.open(pad.path, os.O_WRONLY)
    pad.says((KEY, 0x131, 1))
    assert pad.pressed() == {"B"}


def test_events_that_the_kernel_dropped_let_go_of_all(pad):
    pad.says((KEY, 0x137, 1), (ABS, 0x01, -32768))
    pad.says((SYN, 3, 0))
    assert (pad.pressed(), pad.controls.sticks.any(), int(pad.controls.alive)) == (set(), False, 1)


def test_a_device_that_is_not_there_is_looked_for_and_told_once(tmp_path, pad):
    absent = Gamepad(pad.controls, str(tmp_path / "none"), pad.context)
    absent()
    absent()
    assert len(pad.told) == 1
    assert "No such file" in pad.told[0]
    dry = BuildContext(pad.states, pad.context.robot, 0.02, dry=True, tell=pad.told.append)
    Gamepad(pad.controls, str(pad.path), dry)()
    assert len(pad.told) == 1
    plain = tmp_path / "a file"
    plain.write_text("")
    with pytest.raises(WorkflowError, match="is not an input device"):
        gamepad(context=pad.context, device=str(plain))
    with pytest.raises(WorkflowError, match=r"hold is 9\.0; write a number from 0.05 to 2"):
        autowire(keyboard, "keyboard", pad.context, {"hold": 9.0})


def test_a_robot_that_tells_its_own_remote_needs_no_device(pad):
    class Told:
        facts = type("Facts", (), {"writes": ("sticks", "buttons", "controls_alive")})

    pad.context.platform = Told()  # type: ignore[assignment]
    assert device_block("gamepad", pad.pad, pad.context).writes == ()
    pad.context.platform = None
    assert device_block("gamepad", pad.pad, pad.context).writes == tuple(control_states())


def test_keys_count_for_a_while_and_once_commands_leave(pad, monkeypatch):
    master, slave = pty.openpty()
    before = os.dup(0)
    os.dup2(slave, 0)
    monkeypatch.setattr(sys, "stdin", os.fdopen(0, closefd=False))
    driving = [False]
    pad.context.driving = lambda: driving[0]
    keys = Keyboard(pad.controls, 3, pad.context)
    try:
        keys()
        assert pad.controls.alive == 0
        driving[0] = True
        keys()
        os.write(master, b"wA15\x1b[A")  # arrows are not keys of ours
        keys()
        assert (pad.pressed(), pad.controls.sticks.any()) == (set(), False)
        os.write(master, b"w15")
        keys()
        assert pad.pressed() == {"A", "start"}
        assert pad.controls.sticks.tolist() == [0.0, 1.0, 0.0, 0.0]
        for _ in range(3):
            keys()
        assert (pad.pressed(), pad.controls.sticks.any()) == (set(), False)
        os.write(master, b"s ")
        keys()
        assert not pad.controls.sticks.any()
        os.write(master, b"?")
        keys()
        assert pad.told == [HELP, HELP]  # when it begins, and where it is asked for
        assert not pad.controls.sticks.any()
        assert all(f" {key} " in HELP for key in STICK_KEYS)
        assert " ".join(BUTTON_KEYS.values()) in HELP
        os.write(master, b"q")
        keys()
        os.close(slave)
        os.close(master)  # the terminal is closed
        keys()
        assert (pad.controls.sticks.any(), int(pad.controls.alive)) == (False, 0)
        assert "the terminal has gone" in pad.told[-1]
    finally:
        keys.close()
        os.dup2(before, 0)
        os.close(before)


def test_no_terminal_is_told(pad):
    keys = Keyboard(pad.controls, 3, pad.context)
    keys()
    keys()
    assert pad.told == ["keyboard: standard input is not a terminal; nothing is pressed"]


def test_bytes_of_remotes(pad):
    bits = 1 << BUTTONS.index("L2") | 1 << BUTTONS.index("A")
    raw = bytearray(40)
    struct.pack_into("<H", raw, 2, bits)
    for at, value in ((4, 0.5), (8, -0.25), (12, 2.0), (16, 9.0), (20, float("nan"))):
        struct.pack_into("<f", raw, at, value)
    REMOTES["unitree"][1](bytes(raw), pad.controls)
    assert pad.pressed() == {"L2", "A"}
    assert pad.controls.sticks.tolist() == [0.5, 0.0, -0.25, 1.0]
    dobot = bytearray(40)
    dobot[2], dobot[3] = 0b100001, 0b1000_0010
    struct.pack_into("<4f", dobot, 4, 0.1, 0.2, 0.3, 0.4)
    REMOTES["dobot"][1](bytes(dobot), pad.controls)
    assert pad.pressed() == {"R1", "L2", "B", "left"}
    assert pad.controls.sticks.tolist() == pytest.approx([0.1, 0.4, 0.2, 0.3])
    pnd = struct.pack("<19f", 32767, -16384, 4000, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, *[0] * 3)
    REMOTES["pnd"][1](pnd, pad.controls)
    assert pad.pressed() == {"A", "R1", "L2"}
    assert pad.controls.sticks.tolist() == pytest.approx([1.0, -0.5, 0.0, 0.0], abs=1e-3)
    held = [1, 0, 0, 0, 0, 1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]  # A, RB, left stick
    booster = struct.pack("<I4f22B", 0x603, 0.5, -1.0, 0.0, 0.25, *held, 9)
    REMOTES["booster"][1](booster, pad.controls)
    assert pad.pressed() == {"A", "R1", "select", "up", "left"}
    assert pad.controls.sticks.tolist() == [0.5, 1.0, 0.0, -0.25]
    REMOTES["booster"][1](struct.pack("<I4f22B", 0x606, 0.5, 0, 0, 0, *held, 9), pad.controls)
    assert (pad.pressed(), pad.controls.alive) == (set(), 0)


@pytest.mark.parametrize("name", sorted(REMOTES))
@settings(max_examples=60)
@given(data=some.data())
def test_whatever_a_remote_sends_is_within_its_range(name, data):
    states = States(control_states())
    controls = Controls(states)
    size, take = REMOTES[name]
    take(data.draw(some.binary(min_size=size, max_size=size)), controls)
    assert (np.abs(controls.sticks) <= 1.0).all()
    assert set(controls.buttons.tolist()) <= {0, 1}
