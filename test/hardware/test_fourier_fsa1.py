"""Platform fourier with FSA v1 (GR-1): bytes of the vendor, zero, gains, hostile JSON, a run."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated import Emulated, free_ports, moved, running, states_of
from hypothesis import given
from hypothesis import strategies as st

from unicon_base.errors import Fault, PlatformError, RobotError
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime.runner import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_hardware.fourier import fsa1_codec as codec
from unicon_hardware.fourier.face import Fsa1Endpoint
from unicon_hardware.fourier.fsa1_codec import Servos
from unicon_hardware.fourier.fsa1_wire import SAMPLES, Fsa1Wire, Zero
from unicon_hardware.fourier.platform import Fourier, make
from unicon_hardware.wire import Udp

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

FACE = "unicon_hardware.fourier.face:face"
NETWORK = "127.85.1.1"
FIGURES = {  # as somebody might have measured them
    "reduction_ratio": [31.0] * 16 + [51.0] * 16,
    "pole_pairs": [21] * 16 + [10] * 16,
    "torque_constant": [0.1] * 32,
    "encoder_zero": [float(20 * i) for i in range(15)],
}


@pytest.fixture
def robot() -> Robot:
    """GR-1 as if somebody had measured its actuators."""
    fast, control = free_ports(2)
    return moved(load_robot("gr1t2"), port_fast=fast, port_control=control, **FIGURES)


class Pair:
    """Our wire and the emulated actuators, in one process."""

    def __init__(self, robot: Robot) -> None:
        self.robot = moved(robot, rate_hz=1000.0)  # asked in each call
        self.emulated = Emulated(self.robot, FACE, address=NETWORK)
        self.states = states_of(robot)
        self.servos = Servos.of(self.robot, NETWORK)
        self.wire = Fsa1Wire(self.states, self.servos)

    @property
    def face(self) -> Fsa1Endpoint:
        assert isinstance(self.emulated.face, Fsa1Endpoint)
        return self.emulated.face

    def step(self, times: int = 1) -> int:
        good = 0
        for _ in range(times):
            time.sleep(0.002)
            good += self.wire.take()
            self.emulated.step()
        return good

    def prepared(self) -> None:
        self.step(SAMPLES + 5)
        for _ in range(200):
            if self.wire.prepare() == "":
                return
            self.step()
        raise AssertionError(self.wire.prepare())

    def close(self) -> None:
        self.wire.close()
        self.face.close()


@pytest.fixture
def pair(robot: Robot) -> Iterator[Pair]:
    found = Pair(robot)
    yield found
    found.close()


def test_a_robot_whose_actuators_are_not_known_is_refused_with_what_is_missing(
    robot: Robot,
) -> None:
    states = states_of(robot)
    with pytest.raises(
        RobotError,
        match=r"write transport\.reduction_ratio, transport\.pole_pairs, "
        r"transport\.torque_constant, transport\.encoder_zero into gr1t2\.yaml with its source",
    ):
        make(states, load_robot("gr1t2"), 0.02)
    for key, value, why in (
        ("reduction_ratio", [31.0] * 31, "write 32 numbers"),
        ("pole_pairs", [0] * 32, "write 32 numbers"),
        ("torque_constant", None, r"write transport\.torque_constant into"),
        ("encoder_zero", [0.0] * 14, "write 15 numbers"),
        ("encoder_zero", [float("nan")] * 15, "write 15 numbers"),
        ("encoder_sign", [2] * 15, "write 15 numbers"),
        ("encoder_sign", [0.5] * 15, "is not 1 or -1"),
        ("encoders", ["127.0.0.1"] * 15, "an address of its own for each"),
        ("encoders", "192.168.137.170", "is not a list"),
        ("encoders", ["192.168.137.70"], "names an address of transport.actuators"),
        ("port_control", "2333", "from 1 to 65535"),
        ("fsa", 3, r"write 1 \(GR-1\) or 2 \(N1\)"),
    ):
        with pytest.raises(RobotError, match=why):
            make(states, moved(robot, **{key: value}), 0.02)
    with pytest.raises(PlatformError, match="dead_man is given, and actuators of FSA v1 have none"):
        make(states, robot, 0.02, address=NETWORK, dead_man=0.2)
    with pytest.raises(PlatformError, match=r"from all 32 motors \(left_hip_roll_joint"):
        make(states, robot, 0.02, address=NETWORK, connect=0.05)
    assert not Servos.of(moved(robot, encoders=[])).encoders


def test_gains_are_those_of_the_vendors_equation(robot: Robot) -> None:
    """The current of a position error and of a speed, one joint after the other, step by step."""
    servos = Servos.of(robot)
    rng = np.random.default_rng(0)
    stiffness, damping = rng.uniform(1, 300, 32), rng.uniform(0.1, 15, 32)
    position, speed = servos.gains(stiffness, damping)
    for joint in range(32):
        i, poles, k_t = (FIGURES[key][joint] for key in list(FIGURES)[:3])
        k_p, k_v = position[joint], speed[joint]
        off, vel = np.rad2deg(0.02), np.rad2deg(0.7)
        current = k_v * (k_p * off * i - vel * i * poles / 360)
        expected = stiffness[joint] * 0.02 - damping[joint] * 0.7
        assert current * i * k_t == pytest.approx(expected)
        assert servos.joint_gains(joint, k_p, k_v) == pytest.approx(
            (stiffness[joint], damping[joint])
        )
    # The ratio of these two is public for a hip roll: 0.997 (CreeperLin/unicon FSA_POSITION_KP).
    position, _ = servos.gains(np.full(32, 251.625), np.full(32, 14.72))
    assert position[0] == pytest.approx(0.997, abs=1e-3)
    limp = servos.gains(np.zeros(32), np.zeros(32))
    assert not np.any(limp)


def test_joints_are_counted_from_the_encoders(pair: Pair) -> None:
    assert pair.step(SAMPLES) == 0
    assert pair.wire.where == "encoder 127.85.1.170 and 14 more" or pair.step(1) == 0
    assert pair.step(20) > 5
    np.testing.assert_allclose(
        pair.states["joint_pos"], pair.emulated.states["joint_pos"], atol=1e-4
    )
    assert set(pair.states["motor_temperature"][:5]) == {0.0}


def test_a_zero_that_moves_is_a_fault_and_angles_wrap(robot: Robot) -> None:
    servos = Servos.of(robot)
    zero = Zero(servos)
    for angle in [359.5, 0.5] * (SAMPLES // 2):
        zero.told(0, angle, 2.0 * (angle % 360 if angle < 180 else angle - 360))
    assert 0 not in zero.missing
    assert zero.offset[0] == pytest.approx(0.0)
    for sample in range(SAMPLES - 1):
        zero.told(1, 30.0, float(sample))
    with pytest.raises(Fault, match=r"encoder 192.168.137.171 of left_hip_yaw_joint .* disagree"):
        zero.told(1, 30.0, 0.0)


def test_actuators_are_enabled_limp_where_they_are_and_then_obey(pair: Pair) -> None:
    pair.prepared()
    face, states = pair.face, pair.states
    assert face.obeys
    pair.step(2)
    emulated = pair.emulated.states
    assert not emulated["joint_stiffness"].any()
    np.testing.assert_allclose(emulated["joint_pos_target"], emulated["joint_pos"], atol=1e-3)
    states["joint_pos_target"][...] = np.linspace(-0.4, 0.4, 32)
    states["joint_effort_ff"][...] = np.linspace(-2, 2, 32)
    states["joint_stiffness"][...], states["joint_damping"][...] = 80.0, 3.0
    pair.wire.put()
    pair.step(2)
    for name in ("joint_pos_target", "joint_effort_ff", "joint_stiffness", "joint_damping"):
        np.testing.assert_allclose(emulated[name], states[name], rtol=1e-4, atol=1e-4)
    face.gains[...] = 0.0  # as if they had been lost
    for _ in range(60):
        pair.wire.put()
        pair.step()
    np.testing.assert_allclose(emulated["joint_stiffness"], 80.0, rtol=1e-4)
    assert pair.wire.counts.clamped == 0
    states["joint_vel_target"][3] = 1.0
    pair.wire.put()
    assert pair.wire.counts.clamped == 1
    states["joint_damping"][3] = 0.0
    with pytest.raises(Fault, match="left_knee_pitch_joint shall have stiffness without damping"):
        pair.wire.put()
    states["joint_damping"][3], states["joint_stiffness"][3] = 3.0, 0.0
    with pytest.raises(Fault, match="left_knee_pitch_joint shall turn at a velocity without stif"):
        pair.wire.put()
    for name in ("joint_pos_target", "joint_effort_ff", "joint_stiffness", "joint_damping"):
        states[name][...] = 1e38
    pair.wire.put()
    pair.step(2)
    assert np.isfinite(emulated["joint_pos_target"]).all()
    assert pair.wire.counts.clamped == 2
    pair.wire.close()
    pair.emulated.step()
    assert not face.enabled.any()


def test_one_joint_without_a_way_keeps_none_of_the_others_from_damping(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair.prepared()

    def gone(_: object) -> None:
        raise Fault("No route to host")

    monkeypatch.setattr(pair.wire._sockets[1], "send", gone)
    monkeypatch.setattr(pair.wire._controls[1], "send", gone)
    pair.states["joint_damping"][...] = 4.0
    with pytest.raises(Fault, match="No route"):
        pair.wire.put()
    pair.emulated.step()
    others = [joint for joint in range(32) if joint != 1]
    np.testing.assert_allclose(pair.emulated.states["joint_damping"][others], 4.0, rtol=1e-5)
    with pytest.raises(Fault, match="No route"):
        pair.wire.close()
    pair.emulated.step()
    assert np.flatnonzero(pair.face.enabled).tolist() == [1]


def test_an_error_or_a_refusal_is_told_by_name(pair: Pair) -> None:
    pair.step(SAMPLES + 5)
    pair.emulated.states["motor_error"][4] = 0x20
    pair.step(5)
    assert pair.states["motor_error"][4] == 0x20
    assert "left_ankle_pitch_joint (127.85.1.74) tells an error: 0x20" in pair.wire.prepare()
    pair.emulated.states["motor_error"][4] = 0
    pair.emulated.states["motor_error"][4] = -(2**31)
    pair.step(5)
    assert pair.states["motor_error"][4] == -(2**31)
    assert "tells an error: 0x80000000" in pair.wire.prepare()
    pair.emulated.states["motor_error"][4] = 0
    pair.step(5)
    assert "'servo off' (control word 0x6): 32 actuators" in pair.wire.prepare()
    with pytest.raises(Fault, match=r"left_hip_pitch_joint .* answers 'ERROR' to 'servo off'"):
        pair.wire._told(2, b'{"status": "ERROR"}')


def test_hostile_answers_are_counted_and_left(pair: Pair) -> None:
    pair.prepared()
    pair.step(10)
    before = pair.states["joint_pos"].copy()
    counts = pair.wire.counts
    good = struct.pack(">Bfff", 0x1A, 10, 0, 0)
    bad: tuple[bytes, ...] = (b"", b"\x1a", good[:-1], good + b"x", bytes(13), b"\x1b" + bytes(5))
    for data in bad:
        pair.wire._sort(5, data)
    assert counts.refused["not understood"] == len(bad)
    for value in (np.nan, np.inf, -np.inf):
        pair.wire._sort(5, struct.pack(">Bfff", 0x1A, 1, 2, value))
    assert counts.refused["not finite"] == 3
    texts = (b"", b"{", b"[" * 1024, b"[]", b"null", b"\xff" * 20, b'{"a": 1}', b" " * 60000)
    for data in texts:
        pair.wire._told(5, data)
        pair.wire._encoder(5, data)
    for angle in ("1e999", "NaN", "true", '"3"', "9" * 400, "null", "[1]"):
        pair.wire._encoder(5, b'{"angle": %s}' % angle.encode())
        text = b'{"status": "OK", "mos_temperature": %s, "armature_temperature": 20}'
        pair.wire._told(5, text % angle.encode())
    assert counts.refused["not understood"] == len(bad) + 2 * len(texts) + 7
    assert counts.refused["not finite"] == 3 + 7
    pair.wire._told(5, b'{"status": ["OK"]}')
    assert counts.refused["not carried out"] == 1
    pair.wire._measured()
    np.testing.assert_array_equal(pair.states["joint_pos"], before)
    rng = np.random.default_rng(0)
    for size in (0, 1, 13, 200):
        for _ in range(200):
            data = rng.bytes(size)
            pair.face._heard(3, data, pair.face._fast[3])
            pair.face._set(3, codec.understood(data) or {}, lambda _: None)
    for target in ("/pid_param_imm", "/control_word", "/mode_of_operation", [], {}, None):
        for value in (None, [], {}, "x", 1e400, True):
            asked: dict[str, Any] = {"method": "SET", "reqTarget": target}
            asked |= dict.fromkeys(("control_word", "mode_of_operation", *codec_keys()), value)
            pair.face._set(3, asked, lambda _: None)


def codec_keys() -> list[str]:
    return [key for key in json.loads(codec.loop_gains(0, 0)) if key.endswith("_imm")]


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_gains_come_through_json_to_the_bit(position: float, speed: float) -> None:
    found = codec.understood(codec.loop_gains(position, speed)) or {}
    assert [found[key] for key in codec_keys()] == [position, speed, 0.0]


def test_a_late_answer_is_not_taken_for_that_of_the_next_step(pair: Pair) -> None:
    pair.step(SAMPLES + 5)
    pair.wire.prepare()
    pair.wire._enabling._sent = -1.0  # half of the answers are late: all is sent again
    for joint in range(31):
        pair.wire._told(joint, b'{"status": "OK"}')
    pair.wire.prepare()
    pair.wire._told(31, b'{"status": "OK"}')
    assert pair.wire.prepare() == "late answers before 'no gains' (pid_param_imm)"
    for joint in range(32):
        pair.wire._told(joint, b'{"status": "OK"}')
    assert pair.wire._enabling.count == 1
    time.sleep(0.06)
    assert pair.wire.prepare().startswith("'no gains' (pid_param_imm): 32 actuators")


def test_a_joint_that_does_not_answer_is_a_fault_by_name(pair: Pair) -> None:
    pair.step(SAMPLES + 5)
    platform = Fourier(pair.states, pair.robot, 0.02, pair.wire, silence=0.05)
    face = pair.face
    face._fast[9].close()
    face._fast[9] = Udp(("127.0.0.1", 0), ("", 0), "nowhere")
    last = time.monotonic()
    with pytest.raises(Fault, match=r"nothing from right_knee_pitch_joint \(127\.85\.1\.53\) for "):  # noqa: PT012
        while time.monotonic() < last + 2.0:
            platform.recv()
            pair.emulated.step()
    face._sockets.append(face._fast[9])


def test_the_vendors_package_agrees(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """fi_fsa 0.3.17 from PyPI, v1: its bytes are ours, and our actuators answer as its own."""
    if find_spec("fi_fsa") is None:
        pytest.skip("fi_fsa is not installed: pip install fi_fsa==0.3.17")
    settings = "hardware: {use_fi_fsa: false}\n"
    (tmp_path / "config.yaml").write_text(settings)  # it reads one where it is imported
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["fi_fsa"])
    from fi_fsa.v1 import fi_fsa_v1 as vendor

    emulated = Emulated(robot, FACE, address=NETWORK)
    face = emulated.face
    assert isinstance(face, Fsa1Endpoint)
    vendor.fsa_port_fast, vendor.fsa_flag_debug = robot.transport["port_fast"], False
    vendor.fsa_port_ctrl = robot.transport["port_control"]
    heard: list[bytes] = []
    for socket in (face._controls[3], face._fast[3]):
        datagrams = socket.datagrams

        def kept(datagrams: Any = datagrams) -> list[tuple[bytes, tuple[str, int]]]:
            found: list[tuple[bytes, tuple[str, int]]] = datagrams()
            heard.extend(data for data, _ in found)
            return found

        monkeypatch.setattr(socket, "datagrams", kept)
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            face.hear()
            face.tell()
            time.sleep(0.0005)

    server = threading.Thread(target=serve)
    server.start()
    rng = np.random.default_rng(0)
    try:
        ip, states = "127.85.1.73", emulated.states
        assert vendor.set_disable(ip) == vendor.FSAFunctionResult.SUCCESS
        keys = ("control_position_kp_imm", "control_velocity_kp_imm", "control_velocity_ki_imm")
        values = dict(zip(keys, (1.061, 0.263, 0.0)))
        assert vendor.set_pid_param_imm(ip, values) == vendor.FSAFunctionResult.SUCCESS
        assert vendor.set_mode_of_operation(ip, 1) == vendor.FSAFunctionResult.SUCCESS
        assert vendor.set_enable(ip) == vendor.FSAFunctionResult.SUCCESS
        assert vendor.get_ntc_temperature(ip) == (0.0, 0.0)
        assert heard == [
            codec.control_word(codec.SERVO_OFF),
            codec.loop_gains(1.061, 0.263),
            codec.mode_of_operation(codec.POSITION_MODE),
            codec.control_word(codec.SERVO_ON),
            codec.TEMPERATURE,
        ]
        begun = float(face._begun[3])
        for _ in range(30):
            pos, vel, effort = rng.normal(size=3)
            states["joint_pos"][3], states["joint_vel"][3] = pos, vel
            states["joint_effort"][3], states["motor_error"][3] = effort, rng.integers(2**31)
            told = vendor.fast_get_pvc(ip)
            current = effort / (-31.0 * 0.1)
            expected = (-np.rad2deg(pos) - begun, -np.rad2deg(vel), current)
            np.testing.assert_allclose(told, expected, rtol=1e-4)
            assert vendor.fast_get_error(ip) == states["motor_error"][3]
            target = rng.normal(size=3)
            heard.clear()
            vendor.fast_set_position_control(ip, *target)
            vendor.fast_get_error(ip)
            assert heard[0] == struct.pack(">Bfff", codec.POSITION, *target)
            expected_target = -np.deg2rad(target[0] + begun)
            assert states["joint_pos_target"][3] == pytest.approx(expected_target, rel=1e-4)
        stiffness, damping = states["joint_stiffness"][3], states["joint_damping"][3]
        assert Servos.of(robot).gains(*np.full((2, 32), ((stiffness,), (damping,))))[0][
            3
        ] == pytest.approx(1.061, rel=1e-5)
    finally:
        ended.set()
        server.join()
        face.close()


WORKFLOW = f"""
schema: unicon.workflow/1
name: fourier1
robot: ./gr1t2.yaml
platform: unicon_hardware.fourier.platform:make
platforms:
  "unicon_hardware.fourier.platform:make": {{address: {NETWORK}, silence: 2.0}}
rate: 50
flow:
  chain:
    - pose: {{to: stand, duration: 0.5}}
    - damp: {{duration: 0.4}}
safety: [finite, joint_limits]
"""


@pytest.mark.slow
@pytest.mark.alone
def test_a_file_of_the_user_with_the_missing_facts_runs(tmp_path: Path) -> None:
    fast, control = free_ports(2)
    text = Path(load_robot("gr1t2").path).read_text()
    text = text.replace("port_fast: 2335", f"port_fast: {fast}")
    text = text.replace("port_control: 2333", f"port_control: {control}")
    for key, value in FIGURES.items():
        text = text.replace(f"{key}: null", f"{key}: {value}")
        text = text.replace(f", transport.{key}", "")
    text = text.replace(", joint_order]", "]")
    assert "null" not in text.replace("rest: null", "")
    (tmp_path / "gr1t2.yaml").write_text(text)
    (tmp_path / "fourier1.yaml").write_text(WORKFLOW)
    with running(tmp_path / "gr1t2.yaml", FACE, f"address={NETWORK}") as said:
        program = load_workflow(str(tmp_path / "fourier1.yaml"))
        report = Runner(program, RunOptions(duration=5.0, warn=lambda _: None)).run()
        assert not report.faults, report.faults
        time.sleep(0.3)
    assert [event["event"] for event in said] == ["first", "damping"]
    assert said[0]["distance"] < 0.05
