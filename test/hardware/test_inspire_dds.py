"""RH56 behind DDS, both interfaces: layouts, both ends on loopback, the other hand, attacks."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-inspire]'")

from dds_ends import DOMAIN, LOOPBACK, Ends, golden_frame, states_of, until

from unicon_base.errors import PlatformError
from unicon_core.robots import load_robot
from unicon_hardware.inspire.dds.wire import Both, HandFacts, InspireDdsWire, face
from unicon_hardware.inspire.platform import Inspire, make
from unicon_hardware.wire import Counts

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"

FTP, DFX, DFX_RIGHT = map(
    load_robot, ("inspire_rh56_ftp_left", "inspire_rh56_dfx_left", "inspire_rh56_dfx_right")
)


@pytest.fixture(params=[FTP, DFX], ids=["ftp", "dfx"])
def hand(request: pytest.FixtureRequest) -> Iterator[Ends]:
    made = Ends(request.param, InspireDdsWire, face)
    yield made
    made.close()


def sequence(code: str, values: list[int]) -> bytes:
    """Return a sequence as CDR has it, padded for the next length word."""
    raw = struct.pack(f"<I{len(values)}{code}", len(values), *values)
    return raw + bytes(-len(raw) % 4)


def ftp_command(angles: list[int], mode: int) -> bytes:
    zeros = sequence("h", [0] * 6)
    body = zeros + sequence("h", angles) + zeros + zeros + struct.pack("<b", mode)
    return b"\0\1\0\0" + body


def ftp_state(angles: list[int], errors: list[int], heat: list[int]) -> bytes:
    zeros = sequence("h", [0] * 6)
    raw = b"\0\1\0\0" + zeros + sequence("h", angles) + zeros + zeros
    raw += sequence("B", errors) + sequence("B", [0] * 6) + sequence("B", heat)
    return raw[:-2]  # nothing follows the last one


def test_the_ftp_s_messages_are_those_of_its_idl() -> None:
    facts = HandFacts.of(FTP)
    targets = np.array([0, 1, 500, 999, 1000, 250], np.int16)
    assert facts.command.encoder({"targets": targets}).encode() == ftp_command(targets.tolist(), 1)
    arrays = {"told": targets, "motor_error": np.arange(6, dtype=np.int32)}
    arrays["motor_temperature"] = np.arange(200.0, 206.0, dtype=np.float32)
    raw = facts.state.encoder(arrays).encode()
    assert raw == ftp_state(targets.tolist(), list(range(6)), list(range(200, 206)))
    read = {name: np.zeros_like(value) for name, value in arrays.items()}
    frames = facts.state_in(read, Counts())
    assert frames.good(raw + b"\0\0")
    assert frames.read(raw + b"\0\0")
    for name, value in arrays.items():
        np.testing.assert_array_equal(read[name], value)


def test_the_dfx_s_golden_command_is_read(assets: Path) -> None:
    raw, heard = golden_frame(assets, "go_motorcmds"), {"targets": np.zeros(12, np.float32)}
    facts = HandFacts.of(DFX)
    frames = facts.command_in(heard, Counts())
    assert frames.good(raw)
    assert frames.read(raw)
    element = struct.Struct("<B3x5f3I")
    told = [element.unpack_from(raw, 8 + k * element.size)[1] for k in range(12)]
    assert heard["targets"].tolist() == told
    ours = facts.command.encoder(heard).encode()
    assert len(ours) == len(raw)
    made = [element.unpack_from(ours, 8 + k * element.size) for k in range(12)]
    assert made == [(0, q, 0, 0, 0, 0, 0, 0, 0) for q in told]


@pytest.mark.parametrize("robot", [FTP, DFX], ids=["ftp", "dfx"])
def test_angles_run_from_open_to_closed(robot: Any) -> None:
    facts = HandFacts.of(robot)
    scale = 1000 if robot is FTP else 1
    for angles, told in ((robot.lower, scale), (robot.upper, 0.0)):
        sent, beyond = facts.to_wire(angles)
        np.testing.assert_allclose(sent, told, atol=1e-6)
        assert not beyond
        np.testing.assert_allclose(facts.to_angles(sent), angles, atol=1e-6)
    sent, beyond = facts.to_wire(robot.upper + 1.0)
    assert beyond
    assert not sent.any()
    assert facts.to_wire(robot.lower - 1.0)[1]
    middle = (robot.lower + robot.upper) / 2
    np.testing.assert_allclose(facts.to_wire(middle)[0], scale / 2, rtol=1e-6)


def test_both_ways_angles_are_equal(hand: Ends) -> None:
    robot, rng = hand.robot, np.random.default_rng(3)
    step = (robot.upper - robot.lower).max() / 1000 if robot is FTP else 1e-5
    for _ in range(10):
        hand.theirs["joint_pos"][...] = rng.uniform(robot.lower, robot.upper)
        hand.ours["joint_pos_target"][...] = rng.uniform(robot.lower, robot.upper)
        assert hand.told() == 1
        np.testing.assert_allclose(hand.ours["joint_pos"], hand.theirs["joint_pos"], atol=step)
        hand.heard()
        target = hand.theirs["joint_pos_target"]
        np.testing.assert_allclose(target, hand.ours["joint_pos_target"], atol=step)
    assert np.isfinite(hand.ours["joint_vel"]).all()
    assert not hand.wire.counts.refused
    assert hand.wire.counts.clamped == 0
    hand.ours["joint_pos_target"][...] = 5.0
    hand.heard()
    np.testing.assert_allclose(hand.theirs["joint_pos_target"], robot.upper, atol=1e-6)
    assert hand.wire.counts.clamped == 1
    assert list(hand.wire.commanders().values()) == [0]


def test_wrong_frames_are_counted_and_left(hand: Ends) -> None:
    hand.told()
    before, refused = hand.ours["joint_pos"].copy(), hand.wire.counts.refused
    good = bytearray(hand.face._outlets[0][1]())
    good += bytes(-len(good) % 4)
    if hand.robot is DFX:
        struct.pack_into("<f", good, 12, np.nan)
        assert hand.sent(bytes(good)) == 0
        assert refused["impossible values"] == 1
        good[4] = 11
        assert hand.sent(bytes(good)) == 0
        assert refused["another length of states"] == 1
    else:
        good[4:20] = sequence("h", [0] * 5)[:4] + good[8:20]
        assert hand.sent(bytes(good)) == 0
        assert refused["another length of pos_act"] == 1
    np.testing.assert_array_equal(hand.ours["joint_pos"], before)


def test_fingers_that_are_left_and_modes_without_angles(hand: Ends) -> None:
    if hand.robot is DFX:
        return
    hand.ours["joint_pos_target"][...] = 0.3
    hand.heard()
    writer = hand.wire._outlets[0][0]

    def sent(angles: list[int], mode: int) -> None:
        raw = ftp_command(angles, mode)
        writer.write(raw + bytes(-len(raw) % 4))

    sent([-1, 1000, -1, -1, -1, -1], 1)
    until(hand.face.hear)
    assert hand.theirs["joint_pos_target"][0] == pytest.approx(0.3, abs=2e-3)
    assert hand.theirs["joint_pos_target"][1] == 0.0
    sent([0] * 6, 2)
    until(lambda: hand.face.hear() or hand.face.counts.refused["mode"])
    assert hand.theirs["joint_pos_target"][1] == 0.0


def test_of_the_dfx_the_other_hand_stays_where_it_was_found() -> None:
    left = Ends(DFX, InspireDdsWire, face)
    other = slice(0, 6)
    try:
        assert left.face.told[other].tolist() == [1.0] * 6
        left.heard()
        assert left.face.asked[other].tolist() == [1.0] * 6
        left.face.told[other] = 0.25  # somebody moves it: it is not held
        left.told()
        left.heard()
        assert left.face.asked[other].tolist() == [1.0] * 6
        states = states_of(DFX_RIGHT)
        right = InspireDdsWire(states, DFX_RIGHT, DOMAIN, LOOPBACK)
        until(right.take, left.face.tell)
        states["joint_pos_target"][...] = DFX_RIGHT.upper
        until(lambda: right.matched)
        right.put()
        until(lambda: left.face.hear() and not left.face.asked[other].any())
        left.heard()  # and the left one's command keeps the right one's
        assert not left.face.asked[other].any()
        until(lambda: left.wire.participant.others("rt/inspire/cmd") == 1)
        assert left.wire.commanders() == {"rt/inspire/cmd": 0}
        right.close()
        right.close()
    finally:
        left.close()
    again = Both.of(DOMAIN, "rt/inspire/cmd", 12)  # nothing is left of them
    assert again.users == 1
    again.leave(DOMAIN, "rt/inspire/cmd")


def test_check_knows_what_each_interface_tells() -> None:
    examine = Inspire.facts.examine
    assert examine is not None
    for robot, told in ((FTP, {"motor_error", "motor_temperature"}), (DFX, set())):
        writes = set(examine(states_of(robot), robot, 0.01).facts.writes)
        assert writes == {"joint_pos", "joint_vel", "stamp_ns"} | told


def test_options_of_the_other_protocol_are_refused() -> None:
    for option in ({"port": 6000}, {"device": "/dev/ttyUSB0"}):
        with pytest.raises(PlatformError, match=r"option of hands over Modbus.*speaks inspire_ftp"):
            make(states_of(FTP), FTP, 0.02, **option)
