"""Dex3-1's driver: golden frames, mode bytes, both ends on loopback, attacks."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")

from dds_ends import Ends, golden_frame, states_of, until

from unicon_base.errors import RobotError
from unicon_core.robots import load_robot
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.hardware import declared_facts, refuse_incomplete
from unicon_hardware.dds import maps
from unicon_hardware.unitree_dex3.platform import Dex3, Dex3Facts, Dex3Wire, face, make
from unicon_hardware.wire import Counts

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "frames"

HAND = load_robot("dex3_left")
FACTS = Dex3Facts.of(HAND)
TELLS = ("joint_pos", "joint_vel", "joint_effort")
# Element of HandCmd: mode, three bytes that nobody sets, q, dq, tau, kp, kd, reserve.
COMMAND = struct.Struct("<B3x5fI")
STATE = struct.Struct("<B3x4f2hf2II4I")


def arrays_of() -> dict[str, np.ndarray]:
    return maps.arrays_of(states_of(HAND)) | FACTS.own(HAND.num_joints)


@pytest.fixture
def hand() -> Iterator[Ends]:
    made = Ends(HAND, Dex3Wire, face)
    yield made
    made.close()


def test_golden_frames_are_read(assets: Path) -> None:
    arrays, counts = arrays_of(), Counts()
    raw = golden_frame(assets, "hg_handstate")
    frames = FACTS.state_in(arrays, counts)
    assert frames.good(raw)
    assert frames.read(raw)
    for slot in range(7):
        told = STATE.unpack_from(raw, 8 + slot * STATE.size)
        assert tuple(float(arrays[name][slot]) for name in TELLS) == (told[1], told[2], told[4])
        assert tuple(arrays["temperatures"][2 * slot : 2 * slot + 2]) == told[5:7]
        assert arrays["motor_error"][slot] == told[10]
    raw = golden_frame(assets, "hg_handcmd")
    frames = FACTS.command_in(arrays, counts)
    assert frames.good(raw)
    assert frames.read(raw)
    for slot in range(7):
        mode, *numbers, _ = COMMAND.unpack_from(raw, 8 + slot * COMMAND.size)
        assert arrays["modes"][slot] == mode
        found = [float(arrays[name][slot]) for name in COMMAND_STATES]
        assert sorted(found) == sorted(numbers)
    assert not counts.refused


def test_commands_have_the_vendor_s_mode_bytes() -> None:
    arrays = arrays_of()
    rng = np.random.default_rng(1)
    for name in COMMAND_STATES:
        arrays[name][...] = rng.normal(size=7)
    raw = FACTS.command.encoder(arrays).encode()
    assert raw[:8] == b"\0\1\0\0\7\0\0\0"
    assert len(raw) == 8 + 7 * COMMAND.size + 16
    names = ("joint_pos_target", "joint_vel_target", "joint_effort_ff")
    names += ("joint_stiffness", "joint_damping")
    for slot in range(7):
        mode, *numbers, _ = COMMAND.unpack_from(raw, 8 + slot * COMMAND.size)
        assert mode == slot | 1 << 4
        assert numbers == [float(arrays[name][slot]) for name in names]
    stop = FACTS.stop_out()()
    assert len(stop) == len(raw)
    for slot in range(7):
        read = COMMAND.unpack_from(stop, 8 + slot * COMMAND.size)
        assert read == (slot | 1 << 4 | 1 << 7, 0, 0, 0, 0, 0, 0)


def test_both_ways_everything_is_equal(hand: Ends) -> None:
    rng = np.random.default_rng(3)
    for seed in range(10):
        hand.drawn(TELLS, seed)
        hand.theirs["motor_temperature"][...] = rng.integers(20, 60, 7)
        for name in COMMAND_STATES:
            hand.ours[name][...] = rng.normal(size=7)
        assert hand.told() == 1
        for name in (*TELLS, "motor_temperature"):
            np.testing.assert_array_equal(hand.ours[name], hand.theirs[name])
        hand.heard()
        for name in COMMAND_STATES:
            np.testing.assert_array_equal(hand.theirs[name], hand.ours[name])
    assert not hand.wire.counts.refused
    assert not hand.face.counts.refused
    assert hand.wire.commanders() == {"rt/dex3/left/cmd": 0}


def test_wrong_frames_are_counted_and_left(hand: Ends) -> None:
    hand.told()
    good = hand.face._outlets[0][1]()
    before = hand.ours["joint_pos"].copy()
    refused = hand.wire.counts.refused
    bad = bytearray(good)
    struct.pack_into("<f", bad, 12, np.nan)
    assert hand.sent(bytes(bad)) == 0
    assert refused["impossible values"] == 1
    six = bytearray(good)
    six[4] = 6
    assert hand.sent(bytes(six)) == 0
    assert refused["another length of motor_state"] == 1
    np.testing.assert_array_equal(hand.ours["joint_pos"], before)
    hand.face._outlets[0][0].write(good)
    assert until(hand.wire.take) == 1


def test_the_hand_leaves_commands_with_other_modes(hand: Ends) -> None:
    raw = bytearray(FACTS.command.encoder(arrays_of()).encode())
    raw[8] = 0x21  # motor 1 in the place of motor 0, status 2
    hand.wire._outlets[0][0].write(bytes(raw))
    until(lambda: hand.face.hear() or hand.face.counts.refused["motor mode"])
    raw[8] = 0x90  # one motor stops, the others do not
    hand.wire._outlets[0][0].write(bytes(raw))
    until(lambda: hand.face.hear() or hand.face.counts.refused["motor mode"] == 2)


def test_the_right_hand_is_refused_for_its_order() -> None:
    with pytest.raises(RobotError, match=r"driven.*joint_order; .*order `joints:` as the robot"):
        refuse_incomplete(load_robot("dex3_right"), "unitree_dex3")


def test_workflows_and_children_find_what_make_is() -> None:
    assert declared_facts(make, "x") is Dex3.facts
    assert getattr(sys.modules[make.__module__], make.__qualname__) is make
