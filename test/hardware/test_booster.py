"""T1's driver: layouts, both ends on loopback, the takeover, the ankles' law, attacks."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-booster]'")

from dds_ends import DOMAIN, LOOPBACK, Ends, until, whole_states

from unicon_base.errors import Fault, PlatformError
from unicon_core.platforms.kit.base import quat_of_rpy
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.states.standard import BUTTONS, COMMAND_STATES
from unicon_hardware.booster import takeover
from unicon_hardware.booster.codec import REMOTE, BoosterFacts
from unicon_hardware.booster.platform import BoosterWire, make
from unicon_hardware.booster.takeover import BoosterEndpoint, face, number
from unicon_hardware.dds.maps import arrays_of, command_arrays
from unicon_hardware.wire import Counts
from unicon_msgs_map.layout.messages import shared_messages

T1 = load_robot("t1")
FACTS = BoosterFacts.of(T1)
N = T1.num_joints
ANKLES = [15, 16, 21, 22]
OTHERS = [joint for joint in range(N) if joint not in ANKLES]
TELLS = ("joint_pos", "joint_vel", "joint_effort", "base_ang_vel", "base_lin_acc")
TARGETS = ("joint_pos_target", "joint_vel_target", "joint_effort_ff", "joint_stiffness")
TARGETS += ("joint_damping",)
# The headers' layouts, as CDR has them.
IMU, STATE, COMMAND = struct.Struct("<9f"), struct.Struct("<b3x4fb3x3I"), struct.Struct("<B3x6f")
MODES = {"damping": 0, "prepare": 1, "walking": 2, "custom": 3}


def drawn(states: States, names: tuple[str, ...], seed: int = 1) -> None:
    rng = np.random.default_rng(seed)
    for name in names:
        states[name][...] = rng.normal(size=states[name].shape)


def state_bytes(seed: int, cranks: int = N, joints: int = N) -> bytes:
    """Return a LowState, made with struct."""
    rng = np.random.default_rng(seed)
    made = b"\0\1\0\0" + IMU.pack(*rng.normal(size=9) * 0.3)
    for count in (cranks, joints):
        made += struct.pack("<I", count)
        for k in range(count):
            numbers = rng.normal(size=4)
            made += STATE.pack(1, *numbers, 20 + k % 100, k, 7 * (k == 3), 500)
    return made


@pytest.fixture
def pair() -> Iterator[Ends]:
    made = Ends(T1, BoosterWire, face, states=whole_states)
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


@pytest.mark.parametrize("cranks", [N, 0, 5])
def test_states_are_those_of_the_vendor_s_layout(cranks: int) -> None:
    states, rpy, counts = whole_states(T1), np.zeros(3, np.float32), Counts()
    arrays = arrays_of(states) | {"rpy": rpy}
    frames = FACTS.state_in(arrays, counts)
    raw = state_bytes(1, cranks)
    assert frames.good(raw)
    assert frames.read(raw)
    imu = IMU.unpack_from(raw, 4)
    told = np.concatenate((rpy, states["base_ang_vel"], states["base_lin_acc"]))
    np.testing.assert_array_equal(told, np.float32(imu))
    for joint in range(N):
        at = 48 + STATE.size * (cranks + joint)
        _, q, dq, _, tau, temperature, lost, code, rate = STATE.unpack_from(raw, at)
        assert [float(states[name][joint]) for name in TELLS[:3]] == [q, dq, tau]
        assert (states["motor_temperature"][joint], lost) == (temperature, joint)
        assert (states["motor_error"][joint], rate) == (code, 500)


@pytest.mark.parametrize(
    ("raw", "why"),
    [
        (state_bytes(1)[:-1], "short"),
        (state_bytes(1)[:60], "short"),
        (b"", "not little-endian XCDR1"),
        (state_bytes(1)[:44], "short"),
        (state_bytes(1) + bytes(4), "long"),
        (b"\0\0" + state_bytes(1)[2:], "not little-endian XCDR1"),
        (b"\0\7" + state_bytes(1)[2:], "not little-endian XCDR1"),
        (state_bytes(1, 29, 29), "another length of motor_state_serial"),
        (state_bytes(1, 22, 22), "another length of motor_state_serial"),
        (state_bytes(1)[:40] + b"\xff" * 4 + state_bytes(1)[44:], "short"),
    ],
)
def test_states_of_another_robot_are_refused(raw: bytes, why: str) -> None:
    states, counts = whole_states(T1), Counts()
    arrays = arrays_of(states) | {"rpy": np.zeros(3, np.float32)}
    assert not FACTS.state_in(arrays, counts).good(raw)
    assert counts.refused == {why: 1}


def test_commands_are_those_of_the_vendor_s_layout() -> None:
    arrays = command_arrays(N)
    rng = np.random.default_rng(1)
    for values in arrays.values():
        values[...] = rng.normal(size=N)
    raw = FACTS.command.encoder(arrays).encode()
    assert len(raw) == 4 + 8 + N * COMMAND.size
    assert struct.unpack_from("<4s2I", raw) == (b"\0\1\0\0", 1, N)
    for joint in range(N):
        wanted = [float(arrays[name][joint]) for name in TARGETS]
        assert COMMAND.unpack_from(raw, 12 + joint * COMMAND.size) == (0, *wanted, 0.0)


def test_both_ways_everything_is_equal_but_the_ankles_are_torques(pair: Ends) -> None:
    seen = taken_over(pair)
    assert "its own controller to change into custom mode" in seen
    rng = np.random.default_rng(3)
    for seed in range(5):
        drawn(pair.theirs, TELLS, seed)
        pair.theirs["motor_error"][...] = rng.integers(0, 256, N)
        pair.theirs["motor_temperature"][...] = rng.integers(-20, 120, N)
        rpy = rng.uniform(-1.2, 1.2, 3)
        pair.theirs["base_quat"][...] = quat_of_rpy(rpy)
        drawn(pair.ours, COMMAND_STATES, seed + 10)
        pair.ours["joint_stiffness"][...] = 30.0
        pair.face.tell()
        until(pair.wire.take)
        for name in (*TELLS, "motor_error", "motor_temperature"):
            np.testing.assert_array_equal(pair.ours[name], pair.theirs[name], err_msg=name)
        np.testing.assert_allclose(pair.ours["base_quat"], pair.theirs["base_quat"], atol=1e-6)
        target = pair.ours["joint_pos_target"].copy()
        pair.wire.put()
        until(
            lambda target=target: (
                pair.face.hear() and pair.theirs["joint_pos_target"][0] == target[0]
            )
        )
        for name in COMMAND_STATES:
            np.testing.assert_array_equal(pair.theirs[name][OTHERS], pair.ours[name][OTHERS])
        measured = pair.ours["joint_pos"][ANKLES]
        torque = 30.0 * (target[ANKLES] - measured) + pair.ours["joint_effort_ff"][ANKLES]
        limit = T1.effort_limit[ANKLES]
        np.testing.assert_allclose(
            pair.theirs["joint_effort_ff"][ANKLES], np.clip(torque, -limit, limit), rtol=1e-5
        )
        np.testing.assert_array_equal(pair.theirs["joint_pos_target"][ANKLES], measured)
        np.testing.assert_array_equal(pair.theirs["joint_stiffness"][ANKLES], 0.0)
        for name in ("joint_damping", "joint_vel_target"):
            np.testing.assert_array_equal(pair.theirs[name][ANKLES], pair.ours[name][ANKLES])
        np.testing.assert_array_equal(pair.ours["joint_pos_target"], target)  # not ours to change
    assert pair.wire.counts.clamped > 0
    assert not pair.face.counts.refused
    assert pair.wire.commanders() == {"rt/joint_ctrl": 0}


def test_the_robot_is_taken_over_in_the_vendor_s_order_and_given_back(pair: Ends) -> None:
    drawn(pair.theirs, ("joint_pos",))
    pair.face.tell()
    until(pair.wire.take)
    for name in ("damping", "walking"):
        pair.face.mode[...] = MODES[name]
        until(lambda name=name: f"(it is in mode {name})" in pair.wire.prepare(), pair.face.hear)
    assert not pair.face._commanded  # nothing was sent to a robot that does not stand
    pair.face.mode[...] = MODES["prepare"]
    until(lambda: not pair.wire.prepare(), pair.face.hear)
    assert pair.face.obeys
    until(pair.face.hear, pair.wire._hold)
    posture = pair.theirs["joint_pos"]
    np.testing.assert_array_equal(pair.theirs["joint_pos_target"], posture)
    np.testing.assert_allclose(
        pair.theirs["joint_stiffness"][OTHERS], T1.joint_stiffness[OTHERS], rtol=1e-6
    )
    pair.wire.close()  # before a first command
    until(lambda: not pair.face.obeys, pair.face.hear)
    assert int(pair.face.mode) == MODES["damping"]
    assert not pair.theirs["joint_stiffness"].any()
    np.testing.assert_allclose(pair.theirs["joint_damping"], T1.joint_damping, rtol=1e-6)


def test_a_robot_in_custom_mode_is_taken_as_after_a_crash(pair: Ends) -> None:
    pair.face.mode[...] = MODES["custom"]
    assert taken_over(pair)
    assert pair.face.obeys


def test_a_refusal_and_silence_of_the_service_are_faults(
    pair: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BoosterEndpoint, "_changed", lambda *_: 502)
    with pytest.raises(Fault, match=r"refuses request 2000 with status 502: its state machine"):
        until(lambda: not pair.wire.prepare(), pair.face.hear)
    monkeypatch.setattr(takeover.Takeover, "timeout", 0.1)
    again = BoosterWire(pair.ours, T1, DOMAIN, LOOPBACK)
    try:
        with pytest.raises(Fault, match=r"rt/LocoApiTopic does not answer request 2017"):
            until(lambda: not again.prepare())
    finally:
        again.close()


def test_an_answer_that_comes_again_answers_nothing(pair: Ends) -> None:
    client, server = pair.wire._client, pair.face._server
    until(lambda: client.there and server.there)
    client.ask(2017)
    requests: list[Any] = []

    def heard() -> bool:
        requests.extend(server.heard())
        return bool(requests)

    until(heard)
    server.reply(requests[0], 0, mode=1)
    until(lambda: client.answer() == (0, '{"mode": 1}'))
    server.reply(requests[0], 0, mode=1)
    time.sleep(0.2)
    assert client.answer() is None


def test_who_says_done_without_doing_it_is_found_out(
    pair: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BoosterEndpoint, "_changed", lambda *_: 0)
    monkeypatch.setattr(takeover.Takeover, "timeout", 0.3)
    with pytest.raises(Fault, match=r"not in custom mode 0.3 s after it was asked"):
        until(lambda: not pair.wire.prepare(), pair.face.hear)


@pytest.mark.parametrize("body", ["", "{}", "[]", '{"mode": "3"}', '{"mode": true}', "[" * 9999])
def test_an_answer_without_a_mode_names_none(body: str) -> None:
    assert number(body, "mode") is None
    assert number(json.dumps({"mode": 3}), "mode") == 3


def test_a_robot_that_leaves_custom_mode_is_a_fault(pair: Ends) -> None:
    taken_over(pair)
    until(lambda: pair.wire.mode == "custom", lambda: (pair.face.tell(), pair.wire.take()))
    pair.face.mode[...] = MODES["damping"]
    pair.face._told = 0
    with pytest.raises(Fault, match=r"has left custom mode \(it is in damping\)"):
        until(lambda: pair.wire.take() and False, pair.face.tell)


def test_battery_and_gamepad_are_heard_and_are_no_sign_of_life(pair: Ends) -> None:
    pair.theirs["battery_charge"][...] = 0.57
    pair.theirs["battery_voltage"][...] = 47.5
    pair.face._told = 0
    pair.face.tell()
    until(lambda: pair.wire.take() and pair.ours["battery_voltage"] == 47.5, pair.face.tell)
    assert float(pair.ours["battery_charge"]) == pytest.approx(0.57)
    before = pair.wire.counts.good
    message = shared_messages().struct(REMOTE)
    writer = pair.face.participant.writer("rt/remote_controller_state", message)
    raw = b"\0\1\0\0" + struct.pack("<I4f22B", 0x603, -0.5, -1.0, 0, 0, 1, *[0] * 21) + bytes(2)
    until(lambda: writer.matched)
    until(lambda: pair.wire.take() or pair.ours["controls_alive"], lambda: writer.write(raw))
    assert pair.ours["sticks"].tolist() == [-0.5, 1.0, 0.0, 0.0]
    assert pair.ours["buttons"][BUTTONS.index("A")] == 1
    assert pair.wire.counts.good == before


def test_the_emulated_robot_refuses_what_is_not_for_its_joints(pair: Ends) -> None:
    taken_over(pair)
    raw = bytearray(FACTS.command.encoder(command_arrays(N)).encode())
    writer = pair.wire._outlets[0][0]
    struct.pack_into("<I", raw, 4, 0)  # parallel
    until(
        lambda: pair.face.counts.refused["cmd_type"],
        lambda: (writer.write(bytes(raw)), pair.face.hear()),
    )
    struct.pack_into("<2I", raw, 4, 1, 22)
    until(
        lambda: pair.face.counts.refused["another length of motor_cmd"],
        lambda: (writer.write(bytes(raw)), pair.face.hear()),
    )


def test_wrong_options_are_named() -> None:
    states = whole_states(T1)
    with pytest.raises(PlatformError, match="give address, the network interface of this machine"):
        make(states, T1, 0.02)
    with pytest.raises(PlatformError, match="'nowhere' has no IPv4 address"):
        make(states, T1, 0.02, address="nowhere", domain=DOMAIN)
    with pytest.raises(PlatformError, match="mode is 'dance'; give one of custom, damping"):
        face(states, T1, domain=DOMAIN, mode="dance")
