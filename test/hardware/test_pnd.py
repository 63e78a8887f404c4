"""Adam's driver: golden frames, both LowStates, both ends on loopback, attacks."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-pnd]'")

from dds_ends import DOMAIN, LOOPBACK, Ends, golden_frame, until, whole_states

from unicon_core.robots import load_robot
from unicon_core.states.standard import BUTTONS, COMMAND_STATES
from unicon_hardware.dds import maps
from unicon_hardware.pnd.platform import REMOTE, LowStates, PndFacts, PndWire, face
from unicon_hardware.wire import Counts

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "frames"

ADAM = load_robot("adam_lite")
FACTS = PndFacts.of(ADAM)
TELLS = ("joint_pos", "joint_vel", "joint_effort", "base_ang_vel", "base_lin_acc")
TARGETS = ("joint_pos_target", "joint_vel_target", "joint_effort_ff", "joint_stiffness")
TARGETS += ("joint_damping",)
MOTORS = 23
# Places in a frame, of the golden ones: 4 bytes of header, then the body.
COMMAND = struct.Struct("<B3x6fI")
STATE = struct.Struct("<B3x4fII")
FIRST_COMMAND, FIRST_STATE, TICK_AT, QUAT_AT = 12, 72, 8, 12
# Of a LowState without battery: reserve stands at 788 of the body.
PLAIN_SIZE = 796


def arrays_of() -> dict[str, Any]:
    own = {"remote": np.zeros(REMOTE, np.float32), "tick": np.zeros((), np.uint32)}
    made = maps.arrays_of(whole_states(ADAM)) | own
    made["base_quat"][...] = (1, 0, 0, 0)
    return made


@pytest.fixture(params=[True, False], ids=["battery", "plain"])
def adam(request: pytest.FixtureRequest) -> Iterator[Ends]:
    made = Ends(ADAM, PndWire, face, states=whole_states, battery=request.param)
    yield made
    made.close()


def test_the_golden_state_is_read(assets: Path) -> None:
    raw = bytearray(golden_frame(assets, "adam_lowstate"))
    arrays, counts = arrays_of(), Counts()
    frames = LowStates(replace(FACTS, battery=True), arrays, counts)
    assert frames.good(bytes(raw))
    assert not frames.read(bytes(raw))  # its quaternion has not norm 1
    assert "norm" in counts.last or "orientation" in counts.last
    struct.pack_into("<4f", raw, QUAT_AT, 0.5, -0.5, 0.5, 0.5)
    frames.forget()
    assert frames.good(bytes(raw))
    assert frames.read(bytes(raw))
    assert arrays["base_quat"].tolist() == [0.5, -0.5, 0.5, 0.5]
    for slot in range(MOTORS):
        _, q, dq, _, tau, code, _ = STATE.unpack_from(raw, FIRST_STATE + slot * STATE.size)
        assert [float(arrays[name][slot]) for name in TELLS[:3]] == [q, dq, tau]
        assert arrays["motor_error"][slot] == code
    remote = struct.unpack_from("<19f", raw, FIRST_STATE + MOTORS * STATE.size)
    assert arrays["remote"].tolist() == list(remote)
    assert arrays["tick"] == struct.unpack_from("<I", raw, TICK_AT)[0]
    plain = LowStates(FACTS, arrays, counts)
    assert not plain.good(bytes(raw))
    assert counts.refused["long"] == 1
    cut = bytes(raw[: PLAIN_SIZE - 4]) + b"\7\0\0\0"  # what the C++ programs construct
    assert plain.good(cut)
    assert plain.read(cut)
    assert not frames.good(cut)


def test_commands_are_those_of_the_vendor_s_layout(assets: Path) -> None:
    golden, arrays = golden_frame(assets, "adam_lowcmd"), arrays_of()
    rng = np.random.default_rng(1)
    for name in COMMAND_STATES:
        arrays[name][...] = rng.normal(size=MOTORS)
    raw = FACTS.command.encoder(arrays).encode()
    assert len(raw) == len(golden)
    assert raw[:5] == b"\0\1\0\0\0"
    assert raw[8:12] == golden[8:12]  # 23
    for slot in range(MOTORS):
        read = COMMAND.unpack_from(raw, FIRST_COMMAND + slot * COMMAND.size)
        assert read == (1, *(float(arrays[name][slot]) for name in TARGETS), 0.0, 0)
    heard = {name: np.zeros(MOTORS, np.float32) for name in COMMAND_STATES}
    heard |= {"modes": np.zeros(MOTORS, np.uint8), "mode_pr": np.zeros((), np.uint8)}
    frames = FACTS.command_in(heard, Counts())
    assert frames.good(golden)
    assert frames.read(golden)
    for slot in range(MOTORS):
        mode, *numbers, _, _ = COMMAND.unpack_from(golden, FIRST_COMMAND + slot * COMMAND.size)
        assert heard["modes"][slot] == mode
        assert [float(heard[name][slot]) for name in TARGETS] == numbers


def test_both_ways_everything_is_equal(adam: Ends) -> None:
    rng = np.random.default_rng(3)
    for seed in range(10):
        adam.drawn(TELLS, seed)
        quat = rng.normal(size=4)
        adam.theirs["base_quat"][...] = quat / np.linalg.norm(quat)
        adam.theirs["motor_error"][...] = rng.integers(-(2**31), 2**31, MOTORS)
        for name in COMMAND_STATES:
            adam.ours[name][...] = rng.normal(size=MOTORS)
        assert adam.told() == 1
        for name in (*TELLS, "base_quat", "motor_error"):
            np.testing.assert_array_equal(adam.ours[name], adam.theirs[name])
        adam.heard()
        for name in COMMAND_STATES:
            np.testing.assert_array_equal(adam.theirs[name], adam.ours[name])
    assert not adam.face.counts.refused
    assert adam.wire.commanders() == {"rt/lowcmd": 0}


def test_its_remote_is_heard(adam: Ends) -> None:
    adam.face.remote[:4] = (32767.0, -16383.5, 4000.0, np.nan)
    adam.face.remote[8] = 1.0
    assert adam.told() == 0  # not a number anywhere: a damaged frame
    adam.face.remote[3] = 32767.0
    assert adam.told() == 1
    assert adam.ours["sticks"].tolist() == [1.0, -0.5, 0.0, 1.0]
    assert adam.ours["buttons"][BUTTONS.index("A")] == 1
    assert adam.ours["controls_alive"] == 1


def test_wrong_frames_are_counted_and_left(adam: Ends) -> None:
    adam.face.own["tick"][...] = 1000
    adam.told()
    good = bytearray(adam.face._outlets[0][1]())
    before, refused = adam.ours["joint_pos"].copy(), adam.wire.counts.refused
    refused.clear()
    assert adam.sent(bytes(good)) == 0
    assert refused == {"old tick": 1}
    for number, (at, value) in enumerate(
        [(FIRST_STATE + 4, np.nan), (FIRST_STATE + 8, np.inf), (QUAT_AT, 0.0)], 1
    ):
        bad = bytearray(good)
        struct.pack_into("<I", bad, TICK_AT, 1001 + number)
        struct.pack_into("<f", bad, at, value)
        assert adam.sent(bytes(bad)) == 0
        assert refused["impossible values"] == number
    np.testing.assert_array_equal(adam.ours["joint_pos"], before)
    struct.pack_into("<I", good, TICK_AT, 1010)
    assert adam.sent(bytes(good)) == 1
    struct.pack_into("<I", good, TICK_AT, 900)  # reordered
    assert adam.sent(bytes(good)) == 0
    assert refused["old tick"] == 2


def test_another_adam_is_told_by_its_number_of_motors() -> None:
    def cut(values: Any) -> Any:
        return values[:19]

    arrays = {name: cut(getattr(ADAM, name)) for name in ("lower", "upper", "joint_names")}
    fields = ("velocity_limit", "effort_limit", "default_joint_pos", "rest_joint_pos")
    fields += ("joint_stiffness", "joint_damping")
    arrays |= {name: cut(getattr(ADAM, name)) for name in fields if hasattr(ADAM, name)}
    small = replace(ADAM, transport={**ADAM.transport, "motors": list(range(19))}, **arrays)
    made = face(whole_states(small), small, domain=DOMAIN)
    wire = PndWire(whole_states(ADAM), ADAM, DOMAIN, LOOPBACK)
    try:
        refused = wire.counts.refused
        until(lambda: refused["another length of motor_state"], lambda: (made.tell(), wire.take()))
        assert "19, not 23" in wire.counts.last
        assert wire.counts.good == 0
    finally:
        wire.close()
        made.close()


def test_strangers_and_a_robot_that_comes_back() -> None:
    adam = Ends(ADAM, PndWire, face, states=whole_states, battery=True)
    adam.face.own["tick"][...] = 10**6
    stranger = face(whole_states(ADAM), ADAM, domain=DOMAIN)
    try:
        adam.theirs["joint_pos"][...] = 0.5
        adam.told()
        refused = adam.wire.counts.refused
        until(lambda: refused["another sender"], lambda: (stranger.tell(), adam.wire.take()))
        assert adam.ours["joint_pos"][0] == 0.5
        adam.face.close()  # it dies, and whoever tells now is the robot, whatever its number
        until(adam.wire.take, stranger.tell)
        assert adam.ours["joint_pos"][0] == 0.0
    finally:
        stranger.close()
        adam.close()


def test_the_robot_leaves_other_modes(adam: Ends) -> None:
    raw = bytearray(adam.wire._outlets[0][1]())
    refused = adam.face.counts.refused
    raw[4] = 1
    adam.wire._outlets[0][0].write(bytes(raw))
    until(lambda: adam.face.hear() or refused["mode_pr"])
    raw[4], raw[FIRST_COMMAND] = 0, 0
    adam.wire._outlets[0][0].write(bytes(raw))
    until(lambda: adam.face.hear() or refused["motor mode"])
