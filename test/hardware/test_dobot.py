"""Atom's driver: layouts, both ends on loopback, its state machine, attacks."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-dobot]'")

from dds_ends import Ends, until, whole_states

from unicon_base.errors import Fault, PlatformError, RobotError
from unicon_core.robots import load_robot
from unicon_core.states.standard import BUTTONS, COMMAND_STATES
from unicon_core.workflow.hardware import refuse_incomplete
from unicon_hardware.dds.maps import zeros
from unicon_hardware.dobot import platform as takeover
from unicon_hardware.dobot.codec import DobotFacts, face
from unicon_hardware.dobot.platform import DobotWire, make
from unicon_hardware.wire import Counts

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"

ATOM = load_robot("atom")
TELLS = ("joint_pos", "joint_vel", "joint_effort", "base_quat", "base_ang_vel", "base_lin_acc")
WANTED = 2
# The layouts of the SDK's headers, as CDR has them: an octet in front of the next aligned number.
IMU = "13fB"


def arrays_of() -> dict[str, Any]:
    states = whole_states(ATOM)
    rng = np.random.default_rng(4)
    for name in (*TELLS[:3], *COMMAND_STATES):
        states[name][...] = rng.normal(size=29)
    states["base_quat"][...] = (0.5, -0.5, 0.5, 0.5)
    states["base_ang_vel"][...] = (1.0, -2.0, 3.0)
    states["motor_temperature"][...] = np.arange(29) + 20
    states["battery_charge"][...] = 0.57
    return {name: states[name] for name in states} | zeros(
        "fsm_id u2, upper_control u1, remote u1 40, modes u1 29"
    )


def ends(layout: str = "sdk") -> Ends:
    wire = partial(DobotWire, layout=layout, fsm_id=WANTED)
    return Ends(ATOM, wire, face, states=whole_states, layout=layout)


@pytest.fixture(params=["sdk", "ros2"])
def atom(request: pytest.FixtureRequest) -> Iterator[Ends]:
    made = ends(request.param)
    yield made
    made.close()


def taken_over(pair: Ends) -> list[str]:
    """Go through the takeover; return what was waited for."""
    seen: list[str] = []

    def step() -> bool:
        pair.face.hear()
        pair.face.tell()
        pair.wire.take()
        reason = pair.wire.prepare()
        if reason and reason not in seen:
            seen.append(reason)
        return not reason

    until(step)
    return seen


def test_messages_are_those_of_the_sdk_s_headers() -> None:
    facts, arrays = DobotFacts.of(ATOM, "sdk"), arrays_of()
    arrays["fsm_id"][...] = 301
    arrays["remote"][...] = np.arange(40)
    raw = facts.halves[0].state.encoder(arrays).encode()
    head = struct.Struct("<H2x" + IMU)
    told = head.unpack_from(raw, 4)
    assert told[0] == 301
    assert told[1:5] == (0.5, -0.5, 0.5, 0.5)
    np.testing.assert_allclose(told[5:8], np.rad2deg([1.0, -2.0, 3.0]), rtol=1e-6)
    # The octet of the IMU, and then the motors' own octet without padding: 4 + 4 + 52 + 1 is 61.
    at = 4 + 57
    for joint in range(12):
        assert raw[at] == 0
        at += 1 + -(at + 1 - 4) % 4
        q, dq, _, tau, *_ = struct.unpack_from("<7f", raw, at)
        assert [q, dq, tau] == [float(arrays[name][joint]) for name in TELLS[:3]]
        assert raw[at + 30] == 20 + joint
        at += 32
    at += -(at - 4) % 2
    level = struct.unpack_from("<H", raw, at + 8)[0]
    assert level == 57
    assert bytes(range(40)) in raw
    command = facts.halves[1].command.encoder(arrays).encode()
    element = struct.Struct("<B3x5f")
    assert len(command) == 4 + 17 * element.size
    names = ("joint_pos_target", "joint_vel_target", "joint_effort_ff", "joint_stiffness")
    for slot in range(17):
        mode, *numbers = element.unpack_from(command, 4 + slot * element.size)
        assert mode == 1
        wanted = [float(arrays[name][12 + slot]) for name in (*names, "joint_damping")]
        assert numbers == wanted


@pytest.mark.parametrize("layout", ["sdk", "ros2"])
def test_the_two_layouts_refuse_each_other(layout: str) -> None:
    arrays = arrays_of()
    raw = DobotFacts.of(ATOM, layout).halves[1].state.encoder(arrays).encode()
    other = DobotFacts.of(ATOM, "ros2" if layout == "sdk" else "sdk").halves[1]
    counts = Counts()
    assert not other.state_in(arrays, counts).good(raw)
    assert counts.refused == {"long" if layout == "ros2" else "short": 1}


def test_both_ways_everything_is_equal(atom: Ends) -> None:
    seen = taken_over(atom)
    assert "its own state machine to go to 2" in seen
    assert atom.face.obeys
    rng = np.random.default_rng(3)
    for seed in range(10):
        atom.drawn(("joint_pos", "joint_vel", "joint_effort", "base_ang_vel"), seed)
        quat = rng.normal(size=4)
        atom.theirs["base_quat"][...] = quat / np.linalg.norm(quat)
        for name in COMMAND_STATES:
            atom.ours[name][...] = rng.normal(size=29)
        atom.face.tell()
        until(atom.wire.take)
        for name in TELLS:
            np.testing.assert_allclose(
                atom.ours[name], atom.theirs[name], rtol=1e-5, atol=1e-5, err_msg=name
            )
        atom.wire.put()
        target = atom.ours["joint_pos_target"]
        until(
            lambda target=target: (
                atom.face.hear() and np.array_equal(atom.theirs["joint_pos_target"], target)
            )
        )
        for name in COMMAND_STATES:
            np.testing.assert_array_equal(atom.theirs[name], atom.ours[name])
    assert not atom.wire.counts.refused
    assert atom.wire.commanders() == {"rt/lower/cmd": 0, "rt/upper/cmd": 0}


def test_nothing_acts_before_the_takeover_and_its_loss_is_a_fault() -> None:
    pair = ends()
    try:
        for _ in range(2):
            pair.wire.put()
            until(lambda: pair.face.counts.good >= 2, pair.face.hear)
        assert pair.face.counts.refused["its own controller commands"]
        assert not pair.face.obeys
        taken_over(pair)
        pair.face.own["upper_control"][...] = 0
        pair.face.tell()
        with pytest.raises(Fault, match="the arms were switched back"):
            until(pair.wire.take, pair.face.tell)
        pair.face.own["upper_control"][...] = 1
        pair.face.own["fsm_id"][...] = 301
        with pytest.raises(Fault, match=r"state machine is in 301, and no longer in 2"):
            until(lambda: pair.face.tell() or (pair.wire.take() and False))
    finally:
        pair.close()


def test_a_state_machine_that_does_not_follow_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(takeover.Takeover, "timeout", 0.1)
    pair = ends()
    try:
        with pytest.raises(Fault, match=r"waited 0.1 s for its own state machine to go to 2; it"):
            until(lambda: not pair.wire.prepare())
    finally:
        pair.close()


def test_half_a_robot_is_silent_and_its_remote_is_heard() -> None:
    pair = ends()
    try:
        pair.face.own["remote"][3] = 1
        pair.face.own["remote"][4:8] = np.frombuffer(struct.pack("<f", -0.5), np.uint8)
        before = pair.wire.counts.good
        pair.face.tell()
        until(pair.wire.take)
        assert pair.ours["buttons"][BUTTONS.index("A")] == 1
        assert pair.ours["sticks"][0] == -0.5
        assert pair.wire.counts.good == before + 1
        writer, encode = pair.face._outlets[0]
        for _ in range(3):
            writer.write(encode() + bytes(-len(encode()) % 4))
            assert pair.wire.wait(5.0)
            assert pair.wire.take() == 0  # legs without arms
        bad = bytearray(encode())
        struct.pack_into("<f", bad, 4 + 60, np.nan)
        writer.write(bytes(bad) + bytes(-len(bad) % 4))
        until(lambda: pair.wire.counts.refused["impossible values"], pair.wire.take)
    finally:
        pair.close()


def test_what_is_contradictory_must_be_said() -> None:
    def opened(**options: Any) -> str:
        with pytest.raises(PlatformError) as raised:
            make(whole_states(ATOM), ATOM, 0.02, **{"connect": 0.05, **options})
        return str(raised.value)

    assert "fsm_id is None; give the number (0 to 65535)" in opened(layout="sdk")
    assert "fsm_id is 65536" in opened(layout="sdk", fsm_id=65536)
    told = opened(fsm_id=2)
    assert "layout is ''; the vendor's SDK and its ROS 2 package contradict each other" in told
    with pytest.raises(RobotError, match=r"atom cannot be driven on platform 'dobot'"):
        refuse_incomplete(ATOM, "dobot")
