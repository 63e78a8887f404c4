"""Platform fourier: datagrams byte for byte, enabling, joints that do not answer, a whole run."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from emulated import Emulated, free_ports, moved, states_of

from unicon_base.errors import Fault, PlatformError, RobotError, WorkflowError
from unicon_core.robots import Robot, load_robot
from unicon_hardware.fourier.actuator_wire import TRIES
from unicon_hardware.fourier.platform import COMMAND, Actuators, Fourier, FourierWire, make
from unicon_hardware.wire import Udp

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

FACE = "unicon_hardware.fourier.face:face"
NETWORK = "127.84.1.1"
SCALES = {"stiffness_scale": [0.5] * 23, "damping_scale": [0.25] * 23, "timeout_mode": 3}


@pytest.fixture
def robot() -> Robot:
    """N1 as if somebody had measured its actuators."""
    (port,) = free_ports(1)
    return moved(load_robot("n1"), port_fast=port, **SCALES)


class Pair:
    """Our wire and the emulated actuators, in one process."""

    def __init__(self, robot: Robot) -> None:
        self.robot = moved(robot, rate_hz=1000.0)  # asked in each call
        self.emulated = Emulated(self.robot, FACE, address=NETWORK)
        self.states = states_of(robot)
        self.actuators = Actuators.of(self.robot, NETWORK)
        self.wire = FourierWire(self.states, self.actuators, 0.2)

    def step(self, times: int = 1) -> int:
        good = 0
        for _ in range(times):
            time.sleep(0.002)
            good += self.wire.take()
            self.emulated.step()
        return good

    def prepared(self) -> None:
        for _ in range(200):
            if self.wire.prepare() == "":
                return
            self.step()
        raise AssertionError(self.wire.prepare())

    def close(self) -> None:
        self.wire.close()
        self.emulated.face.close()


@pytest.fixture
def pair(robot: Robot) -> Iterator[Pair]:
    found = Pair(robot)
    yield found
    found.close()


class Bare:
    """One actuator as a plain socket; it says whatever the test gives it."""

    def __init__(self, wire: FourierWire, actuators: Actuators, joint: int) -> None:
        address = (actuators.addresses[joint], actuators.port)
        self.udp, self.wire, self.joint = Udp(address, ("", 0), "bare"), wire, joint
        self.heard = self.listen()

    def listen(self) -> list[bytes]:
        heard: list[bytes] = []
        for _ in range(20):
            self.wire.take()
            time.sleep(0.002)
            heard += [data for data, _ in self.udp.datagrams()]
            if heard:
                break
        return heard


def test_a_robot_whose_gains_have_no_unit_is_refused(robot: Robot) -> None:
    states = states_of(robot)
    for name, why in (
        ("n1", r"write transport\.stiffness_scale, transport\.damping_scale, transport\.timeout_"),
        ("gr1t2", r"transport\.fsa is 1; write 1 \(GR-1\) or 2"),
    ):
        with pytest.raises(RobotError, match=why):
            Actuators.of(load_robot(name))
    for key, value, why in (
        ("stiffness_scale", [0.5] * 22, "write 23 numbers"),
        ("damping_scale", [-1.0] * 23, "write 23 numbers"),
        ("timeout_mode", 1.5, "write a whole number"),
        ("actuator_sign", [0.5] * 23, "write 1 or -1 for each joint"),
        ("actuators", ["127.0.0.1"] * 23, "write an address of its own"),
        ("actuators", ["here"] * 23, "here"),
        ("port_fast", 0, "from 1 to 65535"),
    ):
        with pytest.raises(RobotError, match=why):
            Actuators.of(moved(robot, **{key: value}))
    with pytest.raises(PlatformError, match="address is 'there'"):
        make(states, robot, 0.02, address="there")
    with pytest.raises(WorkflowError, match=r"dead_man is 0\.01"):
        make(states, robot, 0.02, address=NETWORK, dead_man=0.01)
    with pytest.raises(PlatformError, match=r"no frame .* from all 23 motors \(left_hip_pitch_"):
        make(states, robot, 0.02, address=NETWORK, connect=0.05)


def test_what_is_asked_and_commanded_is_as_the_vendor_packs_it(robot: Robot) -> None:
    states = states_of(robot)
    actuators = Actuators.of(moved(robot, rate_hz=1000.0), NETWORK)
    wire = FourierWire(states, actuators, 0.15)
    one = Bare(wire, actuators, 3)  # left knee, whose actuator turns the other way
    try:
        assert one.heard[0] == b"\x21"
        while b"\x22" not in one.heard:
            one.heard += one.listen()
        states["joint_pos_target"][3], states["joint_vel_target"][3] = 0.5, -1.0
        states["joint_stiffness"][3], states["joint_damping"][3] = 100.0, 8.0
        wire.put()
        sent = [data for data in one.listen() if len(data) > 1]
        assert sent[0] == struct.pack(">Bff", 0xA1, 50.0, 2.0)
        assert sent[1] == struct.pack(">Bfff", 0x0E, -np.rad2deg(0.5), np.rad2deg(1.0), 0.0)
        wire.put()  # gains that have not changed are repeated in turn alone
        assert sum(data[0] == 0xA1 for data in one.listen()) <= 1
        for name in ("joint_pos_target", "joint_vel_target", "joint_stiffness", "joint_damping"):
            states[name][3] = 1e38
        wire.put()
        assert wire.counts.clamped == 1
        for data in one.listen():
            assert len(data) == 1 or np.isfinite(np.frombuffer(data, ">f4", offset=1)).all()
        states["joint_effort_ff"][3] = 1.0
        with pytest.raises(Fault, match=r"1 N·m are to be fed forward at left_knee_pitch_joint"):
            wire.put()
        prepared = [wire.prepare()]
        sent = [data for data in one.listen() if len(data) > 1]
        assert sent == [struct.pack(">BIIIIII", 0x64, 1, 0, 150, 3, 0, 0)]
        assert "23 actuators, left_hip_pitch_joint (127.84.1.70) first" in prepared[0]
    finally:
        wire.close()
        one.udp.close()


def test_actuators_are_enabled_limp_and_then_obey(pair: Pair) -> None:
    assert pair.step(10) > 3
    assert pair.step(30) > 10
    assert set(pair.states["motor_temperature"]) == {0.0}  # the emulated ones tell what they have
    np.testing.assert_allclose(
        pair.states["joint_pos"], pair.emulated.states["joint_pos"], atol=1e-5
    )
    assert not pair.emulated.face.obeys
    pair.wire.put()
    pair.step(3)
    assert pair.emulated.heard == 0  # who is not enabled does not obey
    assert pair.emulated.face.dead_man == float("inf")
    pair.prepared()
    assert pair.emulated.face.obeys
    assert not pair.emulated.states["joint_stiffness"].any()
    assert pair.emulated.face.dead_man == 0.2
    states = pair.states
    states["joint_pos_target"][...] = np.linspace(-0.4, 0.4, 23)
    states["joint_vel_target"][...] = np.linspace(1, 2, 23)
    states["joint_stiffness"][...], states["joint_damping"][...] = 80.0, 3.0
    pair.wire.put()
    pair.step(2)
    for name in ("joint_pos_target", "joint_vel_target", "joint_stiffness", "joint_damping"):
        np.testing.assert_allclose(pair.emulated.states[name], states[name], rtol=1e-5, atol=1e-6)
    time.sleep(0.25)  # nothing comes: each lets go by itself
    pair.step(5)
    assert not pair.emulated.face.obeys
    assert not pair.emulated.states["joint_stiffness"].any()
    assert pair.states["motor_error"].all()
    again = FourierWire(pair.states, pair.actuators, 0.2)  # a second run
    pair.wire, first = again, pair.wire
    pair.step(5)
    assert not pair.states["motor_error"].any()  # gates stop at errors, and come before it clears
    pair.prepared()
    assert pair.emulated.face.obeys
    first.close()


def test_gains_that_were_lost_come_again(pair: Pair) -> None:
    pair.step(5)
    pair.prepared()
    pair.states["joint_stiffness"][...] = 60.0
    pair.wire.put()
    pair.step(2)
    for actuator in pair.emulated.face._actuators:  # type: ignore[attr-defined]
        actuator.kp = 1.0
    for _ in range(40):
        pair.wire.put()
        pair.step()
    np.testing.assert_allclose(pair.emulated.states["joint_stiffness"], 60.0)


def test_one_joint_without_a_way_keeps_none_of_the_others_from_damping(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair.step(5)
    pair.prepared()
    pair.states["joint_damping"][...] = 4.0

    def gone(_: object) -> None:
        raise Fault("cannot send to 127.84.1.71: No route to host")

    monkeypatch.setattr(pair.wire._sockets[1], "send", gone)
    with pytest.raises(Fault, match="No route"):
        pair.wire.put()
    pair.emulated.step()
    others = [joint for joint in range(23) if joint != 1]
    np.testing.assert_allclose(pair.emulated.states["joint_damping"][others], 4.0)
    with pytest.raises(Fault, match="No route"):
        pair.wire.close()
    pair.emulated.step()
    enabled = [actuator.enabled for actuator in pair.emulated.face._actuators]  # type: ignore[attr-defined]
    assert [joint for joint in range(23) if enabled[joint]] == [1]


def test_an_error_or_a_refusal_is_told_by_name(pair: Pair) -> None:
    pair.emulated.states["motor_error"][4] = 0x20
    pair.step(10)
    assert pair.states["motor_error"][4] == 0x20
    assert "left_ankle_roll_joint (127.84.1.74) tells an error: 0x20 0x0" in pair.wire.prepare()
    pair.emulated.states["motor_error"][4] = -(2**31)  # ETH time-out, 0x80000000
    pair.step(10)
    assert pair.states["motor_error"][4] == -(2**31)
    pair.emulated.states["motor_error"][4] = 0
    pair.step(10)
    assert set(pair.states["motor_error"]) == {0}
    pair.wire.prepare()
    with pytest.raises(Fault, match=r"left_hip_yaw_joint .* answers 7 to 'disarm the dead man'"):
        pair.wire._sort(2, struct.pack(">BII", 0x64, 1, 7))


def test_who_never_acknowledges_is_a_fault(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_hardware.fourier.actuator_wire.AGAIN", 0.0)
    pair.step(5)
    pair.emulated.face.close()
    for _ in range(TRIES):
        assert "23 actuators" in pair.wire.prepare()
    with pytest.raises(
        Fault, match=r"'disarm the dead man' \(code 0x64\) was not answered by left"
    ):
        pair.wire.prepare()


def test_a_joint_that_does_not_answer_is_a_fault_by_name(pair: Pair) -> None:
    pair.step(5)
    platform = Fourier(pair.states, pair.robot, 0.02, pair.wire, silence=0.05)
    for _ in range(3):
        time.sleep(0.002)
        platform.recv()
        pair.emulated.step()
    face = pair.emulated.face
    face._sockets[9].close()  # type: ignore[attr-defined]
    face._sockets[9] = Udp(("127.0.0.1", 0), ("", 0), "nowhere")  # type: ignore[attr-defined]
    last = time.monotonic()
    with pytest.raises(Fault, match=r"nothing from right_knee_pitch_joint \(127\.84\.1\.53\) for "):  # noqa: PT012
        while time.monotonic() < last + 2.0:
            platform.recv()
            pair.emulated.step()


def test_hostile_answers_are_counted_and_left(pair: Pair) -> None:
    pair.step(10)
    before = pair.states["joint_pos"].copy()
    good = struct.pack(">BffffIIIIIIII", 0x21, 10, 0, 0, 0, *[0] * 8)
    counts = pair.wire.counts
    for data in (b"", b"\x21", good[:-1], good + b"x", b"\x99" * 49, bytes(13), b"\x22" + bytes(7)):
        pair.wire._sort(5, data)
    assert counts.refused["not understood"] == 7
    for value in (np.nan, np.inf, -np.inf):
        pair.wire._sort(5, struct.pack(">BffffIIIIIIII", 0x21, 1, 2, 3, value, *[0] * 8))
        pair.wire._measured()
    pair.wire._sort(5, struct.pack(">Bff", 0x22, np.nan, 30))
    assert counts.refused["not finite"] == 4
    for count, result in ((0, 0), (2**32 - 1, 2**32 - 1)):  # answers that nobody waits for
        for code in range(0x51, 0x67):
            pair.wire._sort(5, struct.pack(">BII", code, count, result))
    np.testing.assert_array_equal(pair.states["joint_pos"], before)
    stranger = Udp(("127.0.0.1", 0), ("127.0.0.1", pair.wire._sockets[5].port), "a stranger")
    stranger.send(good)
    time.sleep(0.01)
    pair.wire.take()
    assert counts.refused["of a stranger"] == 1
    stranger.close()
    rng = np.random.default_rng(0)
    for size in (1, 9, 13, 49):  # noise of the lengths that are understood
        for _ in range(300):
            data = rng.bytes(size)
            if data[0] != 0x21:
                pair.wire._sort(int(rng.integers(23)), data)
    pair.emulated.face._heard(0, b"", print)  # type: ignore[attr-defined]
    for size in (1, 5, 9, 13, 25):
        for _ in range(300):
            pair.emulated.face._heard(0, rng.bytes(size), lambda _: None)  # type: ignore[attr-defined]


def test_the_vendors_package_agrees(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """fi_fsa 0.3.17 from PyPI talks to our actuators as to its own."""
    if find_spec("fi_fsa") is None:
        pytest.skip("fi_fsa is not installed: pip install fi_fsa==0.3.17")
    settings = "hardware: {use_fi_fsa: false}\n"
    (tmp_path / "config.yaml").write_text(settings)  # it reads one where it is imported
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["fi_fsa"])
    from fi_fsa.v2 import fi_fsa_v2 as vendor

    emulated = Emulated(robot, FACE, address=NETWORK)
    vendor.fsa_port_fast, vendor.fsa_flag_debug = robot.transport["port_fast"], False
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            emulated.face.hear()
            emulated.face.tell()
            time.sleep(0.0005)

    server = threading.Thread(target=serve)
    server.start()
    rng = np.random.default_rng(0)
    try:
        ip, states = "127.84.1.73", emulated.states
        # 0.3.17 looks for this one in vain: it forgets to open its socket.
        vendor.fsa_socket = vendor.get_fsa_socket(ip, vendor.fsa_port_fast)
        assert vendor.fast_set_ack_pd_imm(ip, 3, 1.0, 0.5) == (3, 0)
        assert vendor.fast_set_ack_pd_mode(ip, 4) == (4, 0)
        assert vendor.fast_set_ack_enable(ip, 5) == (5, 0)
        assert vendor.fast_set_ack_setpvc_timeout_protect(ip, 6, 1, 5000, 3, 0, 0) == (6, 0)
        assert vendor.fast_set_ack_setpvc_protect_clear(ip, 7, 0) == (7, 0)
        for _ in range(50):
            pos, vel, effort = rng.normal(size=3)
            states["joint_pos"][3], states["joint_vel"][3] = pos, vel
            states["joint_effort"][3] = effort
            told = vendor.fast_get_pvct_error(ip)
            expected = (-np.rad2deg(pos), -np.rad2deg(vel), 0.0, -effort)
            np.testing.assert_allclose(told[:4], expected, rtol=1e-5)
            assert told[4] == [0, 1, 0, 0, 0, 0, 0, 0]
            target = rng.normal(size=2)
            vendor.fast_set_pd_control(ip, *target)
            kp, kd = rng.uniform(1, 2, 2)
            vendor.fast_set_pd_imm(ip, kp, kd)
            assert vendor.fast_get_ntc_temp(ip) == (0.0, 0.0)
            got = [states[f"joint_{which}_target"][3] for which in ("pos", "vel")]
            np.testing.assert_allclose(got, -np.deg2rad(target), rtol=1e-5)
            assert states["joint_stiffness"][3] == pytest.approx(kp / 0.5)
            assert states["joint_damping"][3] == pytest.approx(kd / 0.25)
    finally:
        ended.set()
        server.join()
        emulated.face.close()


def test_a_command_counts_when_every_actuator_has_one(pair: Pair) -> None:
    """Its datagrams come one after the other: half of them is no posture that is commanded."""
    pair.prepared()
    face, actuators = pair.emulated.face, pair.actuators
    command = struct.pack(">Bfff", COMMAND, 0.0, 0.0, 0.0)
    sender = Udp(("127.0.0.1", 0), ("", 0), "sender")
    try:
        for joint, address in enumerate(actuators.addresses):
            sender.peer = (address, actuators.port)
            sender.send(command)
            time.sleep(0.002)
            assert face.hear() == (joint == len(actuators.names) - 1)
        sender.peer = (actuators.addresses[3], actuators.port)
        sender.send(command)
        time.sleep(0.002)
        assert face.hear()
    finally:
        sender.close()
