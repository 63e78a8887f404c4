"""Platform azureloong: frames byte for byte, the remote's plans, refusals, and a whole run."""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated import Emulated, free_ports, moved, running, states_of
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import Fault, PlatformError, RobotError, WorkflowError
from unicon_core.platforms.kit.base import rpy_of_quat
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime.runner import Runner, RunOptions
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import load_workflow
from unicon_hardware.azureloong.codec import command_type, state_type
from unicon_hardware.azureloong.platform import AzureWire, make

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

FACE = "unicon_hardware.azureloong.codec:face"
COMMAND = (
    "<hhiff155f12f"  # loong_jnt_sdk_datas.py: '2hi', 'ff', five times 31 floats, 6 + 6 fingers
)
STATE = "<id2h16s2h4f9f93f93h93f24f"  # the same file's formats, one after the other


@pytest.fixture
def robot() -> Robot:
    port, keys = free_ports(2)
    return moved(load_robot("azureloong"), port=port, port_keys=keys)


class Bare:
    """The robot's end as a plain socket that says whatever the test gives it."""

    def __init__(self, robot: Robot) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", robot.transport["port"]))
        self.socket.settimeout(1.0)
        self.states = states_of(robot)
        self.wire = AzureWire(self.states, robot, "127.0.0.1", 0.2, 1.0)
        self.wire.take()
        self.asked, self.client = self.socket.recvfrom(4096)

    def say(self, *frames: bytes) -> int:
        for frame in frames:
            self.socket.sendto(frame, self.client)
        assert self.wire.wait(1.0)
        return self.wire.take()

    def commanded(self) -> tuple[Any, ...]:
        """Return the next command; what only asks comes before it."""
        while (sent := struct.unpack(COMMAND, self.socket.recv(4096)))[2] == 0:
            pass
        return sent

    def close(self) -> None:
        self.wire.close()
        self.socket.close()


@pytest.fixture
def bare(robot: Robot) -> Iterator[Bare]:
    found = Bare(robot)
    yield found
    found.close()


def state(stamp: float, key: int = 23, **fields: Any) -> bytes:
    frame = np.zeros(1, state_type(31, 6, 6))
    frame["size"], frame["timestamp"], frame["key"] = 1114, stamp, (0, key)
    for name, value in fields.items():
        frame[name] = value
    return frame.tobytes()


@given(st.binary(min_size=684, max_size=684))
@settings(max_examples=30)
def test_a_command_is_laid_out_as_the_vendors_script_packs_it(packed: bytes) -> None:
    frame = np.frombuffer(packed, command_type(31, 6, 6))[0]
    expected = iter(struct.unpack(COMMAND, packed))
    head = ("checker", "size", "state", "torque_limit_rate", "filter_rate")
    same(frame, (*head, *COMMAND_STATES, "finger_left", "finger_right"), expected)


@given(st.binary(min_size=1114, max_size=1114))
@settings(max_examples=30)
def test_a_state_is_laid_out_as_the_vendors_script_unpacks_it(packed: bytes) -> None:
    frame = np.frombuffer(packed, state_type(31, 6, 6))[0]
    expected = iter(struct.unpack(STATE, packed))
    same(frame, ("size", "timestamp", "key"), expected)
    assert bytes(frame["plan"]) == next(expected).rstrip(b"\0")
    told = ("state", "joy", "rpy", "gyro", "acc", "pos", "vel", "effort")
    drives = ("temperature", "status", "error", "pos_target", "vel_target", "effort_target")
    hands = ("finger_left", "finger_right", "finger_target_left", "finger_target_right")
    same(frame, (*told, *drives, *hands), expected)


def same(frame: Any, fields: tuple[str, ...], expected: Iterator[Any]) -> None:
    for field in fields:
        ours = np.atleast_1d(frame[field])
        np.testing.assert_array_equal(ours, np.array([next(expected) for _ in ours], ours.dtype))
    if "finger_left" in fields:
        assert next(expected, None) is None


def test_the_vendors_own_script_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = os.environ.get("UNICON_LOONG_SDK")
    if folder is None:
        pytest.skip("UNICON_LOONG_SDK does not name the vendor's sdk/loong_jnt_sdk")
    monkeypatch.syspath_prepend(folder)
    import loong_jnt_sdk_datas as vendor

    random = np.random.default_rng(3)
    ctrl = vendor.jntSdkCtrlDataClass(31, 6, 6)
    for name in ("j", "w", "t", "kp", "kd"):
        getattr(ctrl, name)[...] = random.normal(size=31)
    ours = np.frombuffer(ctrl.packData(), command_type(31, 6, 6))[0]
    for name, theirs in zip(COMMAND_STATES, ("j", "w", "t", "kp", "kd")):
        np.testing.assert_array_equal(ours[name], getattr(ctrl, theirs))
    assert (ours["checker"], ours["size"]) == (3480, 684)
    numbers = random.normal(size=31).astype(np.float32)
    sens = vendor.jntSdkSensDataClass(31, 6, 6)
    sens.unpackData(state(12.5, pos=numbers, effort=-numbers, error=7, rpy=(1, 2, 3)))
    np.testing.assert_array_equal(sens.actJ, numbers.astype(float))
    np.testing.assert_array_equal(sens.actT, -numbers.astype(float))
    assert (sens.timestamp[()], set(sens.drvErr), sens.key[1]) == (12.5, {7}, 23)


def test_frames_become_states(bare: Bare) -> None:
    asked = struct.unpack(COMMAND, bare.asked)
    assert asked[:3] == (3480, 684, 0)  # a state of 0 is not carried out
    assert not any(asked[5:])
    pos = np.linspace(-1, 1, 31, dtype=np.float32)
    rpy = (0.1, -0.2, 0.3)
    frame = state(
        5.0, pos=pos, vel=2 * pos, effort=3 * pos, gyro=(1, 2, 3), acc=(4, 5, 6), rpy=rpy,
        temperature=41, error=0x33, finger_target_left=7.0,
    )  # fmt: skip
    assert bare.say(state(4.0), frame) == 2
    states = bare.states
    np.testing.assert_array_equal(states["joint_pos"], pos)
    np.testing.assert_array_equal(states["joint_effort"], 3 * pos)
    np.testing.assert_allclose(rpy_of_quat(states["base_quat"]), rpy, atol=1e-6)
    np.testing.assert_array_equal(states["base_ang_vel"], (1, 2, 3))
    np.testing.assert_array_equal(states["base_lin_acc"], (4, 5, 6))
    assert set(states["motor_temperature"]) == {41.0}
    assert set(states["motor_error"]) == {0x33}
    bare.wire.put()
    sent = bare.commanded()
    assert sent[:3] == (3480, 684, 5)
    assert sent[3:5] == pytest.approx((0.2, 1.0))
    assert sent[-12:] == (7.0,) * 6 + (0.0,) * 6  # fingers keep what the robot wants of them


def test_a_finger_without_a_number_keeps_its_target(bare: Bare) -> None:
    """What the robot says of its fingers goes back to it in each command."""
    assert bare.say(state(4.0, finger_target_left=7.0, finger_target_right=3.0)) == 1
    assert bare.say(state(5.0, finger_target_left=np.nan, finger_target_right=np.inf)) == 1
    bare.wire.put()
    assert bare.commanded()[-12:] == (7.0,) * 6 + (3.0,) * 6


def test_what_the_driver_would_clamp_is_clamped_and_counted(bare: Bare, robot: Robot) -> None:
    bare.say(state(1.0))
    values = [np.arange(31), np.zeros(31), np.full(31, -500.0), np.full(31, 1500), np.full(31, -1)]
    for name, value in zip(COMMAND_STATES, values):
        bare.states[name][...] = value
    bare.wire.put()
    sent = np.array(bare.commanded()[5:160]).reshape(5, 31)
    np.testing.assert_array_equal(sent[0], np.arange(31))
    np.testing.assert_array_equal(sent[2], -np.array(robot.transport["torque_limit"]))
    np.testing.assert_array_equal(sent[3], robot.transport["stiffness_limit"])
    assert set(sent[4]) == {0.0}
    assert bare.wire.counts.clamped == 1


def test_hostile_frames_are_counted_and_left(bare: Bare) -> None:
    assert bare.say(state(10.0, pos=0.5)) == 1
    hostile = {
        "of another length": [b"", b"x", state(11.0)[:-1], state(11.0) + b"x", bytes(807)],
        "not finite": [
            state(11.0, pos=np.nan),
            state(11.0, acc=np.inf),
            state(11.0, rpy=-np.inf),
            state(np.nan),
            state(np.inf),
        ],
        "old": [state(10.0, pos=0.1), state(9.5, pos=0.2), state(-1.0), state(-1e300)],
    }
    for reason, frames in hostile.items():
        before = bare.wire.counts.refused[reason]
        assert bare.say(*frames) == 0
        assert bare.wire.counts.refused[reason] - before == len(frames)
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ours = ("127.0.0.1", bare.client[1])
    stranger.sendto(state(12.0, pos=9.0), ours)
    assert bare.wire.wait(1.0)
    assert bare.wire.take() == 0
    assert bare.wire.counts.refused["of a stranger"] == 1
    stranger.close()
    assert set(bare.states["joint_pos"]) == {0.5}
    for noise in (bytes([i]) * 1114 for i in range(256)):
        bare.socket.sendto(noise, bare.client)  # a flood: some of it is taken in each tick
    for _ in range(10):
        bare.wire.take()
    assert np.isfinite(bare.states["joint_pos"]).all()


def test_the_remote_alone_gives_and_takes_command(bare: Bare) -> None:
    for key, press in ((13, "en, rc, rl, then jntSdk"), (3, "rc, rl, then jntSdk"), (4, "jntSdk")):
        bare.say(state(1.0 + key, key, plan=b"p\n\xff"))
        assert bare.wire.prepare().endswith(f"(key {key}); press {press} on its remote")
        assert "\n" not in bare.wire.prepare()
        bare.wire._stamp = 0.0
    bare.say(state(30.0))
    assert bare.wire.prepare() == ""
    bare.say(state(31.0, 4))  # nothing has been sent yet: it may do what it likes
    bare.say(state(32.0))
    bare.wire.put()
    with pytest.raises(Fault, match=r"left plan jntSdk: .*'damp' \(key 12\); somebody has its rem"):
        bare.say(state(33.0, 12, plan=b"damp"))


def test_wrong_options_and_facts_are_told(robot: Robot) -> None:
    states = states_of(robot)
    with pytest.raises(PlatformError, match="needs the robot's address"):
        make(states, robot, 0.02)
    for address in ("robot", "1.2.3", "::1", 5, None):
        with pytest.raises(PlatformError, match=r"address"):
            make(states, robot, 0.02, address=address)  # type: ignore[arg-type]
    with pytest.raises(WorkflowError, match=r"filter_rate is 1\.5; give a number above 0 to 1"):
        make(states, robot, 0.02, address="127.0.0.1", filter_rate=1.5)
    with pytest.raises(PlatformError, match="silence is nan"):
        make(states, robot, 0.02, address="127.0.0.1", silence=float("nan"))
    with pytest.raises(PlatformError, match=r"no frame that it understands from 127\.0"):
        make(states, robot, 0.02, address="127.0.0.1", connect=0.02)
    for key, value in (
        ("port", 70000),
        ("checker", "3480"),
        ("lost_ms", None),
        ("keys", {"enable": 1}),
        ("stiffness_limit", [1.0] * 30),
        ("torque_limit", [True] * 31),
        ("filter_rate", 2),
    ):
        with pytest.raises(RobotError, match=rf"robot azureloong: transport\.{key} is .*; write "):
            make(states, moved(robot, **{key: value}), 0.02, address="127.0.0.1")


def test_the_face_hears_its_remote_and_good_commands_alone(robot: Robot) -> None:
    emulated = Emulated(robot, FACE, plan="disable")
    port, keys = robot.transport["port"], robot.transport["port_keys"]
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.settimeout(1.0)

    def press(key: int) -> None:
        client.sendto(bytes(84) + bytes([key]) + bytes(11), ("127.0.0.1", keys))
        time.sleep(0.01)
        emulated.step()

    def command(**fields: Any) -> bytes:
        frame = np.zeros(1, command_type(31, 6, 6))
        values = {"checker": 3480, "size": 684, "state": 5, "joint_pos_target": 0.25, **fields}
        for name, value in values.items():
            frame[name] = value
        return frame.tobytes()

    with pytest.raises(PlatformError, match="cannot listen at"):
        Emulated(robot, FACE)
    try:
        good = command()
        for key in (23, 4, 1, 4, 12, 4):  # what is pressed too early does nothing
            press(key)
            client.sendto(good, ("127.0.0.1", port))
            time.sleep(0.01)
            emulated.step()
            assert (emulated.heard, emulated.face.obeys) == (0, False)
        for key in (13, 1, 2, 4, 23):
            press(key)
        assert emulated.face.obeys
        for bad in (good[:-1], good + b"x", command(checker=1), command(size=9), command(state=0)):
            client.sendto(bad, ("127.0.0.1", port))
            time.sleep(0.01)
            emulated.step()
            assert emulated.heard == 0
        client.sendto(good, ("127.0.0.1", port))
        client.sendto(command(state=0), ("127.0.0.1", port))  # who asks takes no command back
        time.sleep(0.01)
        emulated.step()
        assert emulated.heard == 1
        assert set(emulated.states["joint_pos_target"]) == {0.25}
    finally:
        emulated.face.close()
        client.close()


WORKFLOW = """
schema: unicon.workflow/1
name: loong
robot: ./azureloong.yaml
platform: unicon_hardware.azureloong.platform:make
platforms:
  "unicon_hardware.azureloong.platform:make": {address: 127.0.0.1, silence: 2.0}
rate: 50
flow:
  chain:
    - pose: {to: stand, duration: 0.5}
    - hold: {duration: 0.3}
    - damp: {duration: 0.4}
safety: [finite, joint_limits]
"""


def files(folder: Path) -> Path:
    port, keys = free_ports(2)
    text = Path(load_robot("azureloong").path).read_text()
    text = text.replace("port: 8006", f"port: {port}").replace("keys: 8000", f"keys: {keys}")
    text = text.replace("lost_ms: 500", "lost_ms: 1000")  # of a busy machine
    (folder / "azureloong.yaml").write_text(text)
    (folder / "loong.yaml").write_text(WORKFLOW)
    return folder / "loong.yaml"


@pytest.mark.slow
def test_a_run_waits_for_the_remote_then_poses_and_damps(tmp_path: Path) -> None:
    workflow = files(tmp_path)
    told: list[str] = []
    with running(tmp_path / "azureloong.yaml", FACE) as said:
        program = load_workflow(str(workflow))
        keys = program.robot.transport["port_keys"]
        remote = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

        def warn(text: str) -> None:
            told.append(text)
            if "press jntSdk" in text:
                remote.sendto(bytes(84) + bytes([23]) + bytes(11), ("127.0.0.1", keys))

        report = Runner(program, RunOptions(duration=5.0, warn=warn)).run()
        remote.close()
        assert not report.faults, report.faults
        time.sleep(1.1)
    assert any("press jntSdk on its remote" in text for text in told)
    assert [event["event"] for event in said] == ["first", "damping", "silence"]
    assert said[0]["distance"] < 0.05
