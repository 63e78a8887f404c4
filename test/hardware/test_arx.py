"""Platform arx: frames of the vendor's library, motors without answers, strangers, a whole run."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated import Emulated, moved, states_of
from hypothesis import given
from hypothesis import strategies as st

from unicon_base.errors import Fault, MissingDependencyError, PlatformError, RobotError
from unicon_core.robots import Robot, load_robot
from unicon_hardware.arx.codec import (
    DM,
    EC,
    Motors,
    Packing,
    Reply,
    answer,
    command_of,
    reply_of,
)

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "frames"

FACE = "unicon_hardware.arx.platform:face"
# What libhardware.so of real-stanford/arx5-sdk (lib/x86_64) wrote to the bus and read from it, its
# socket being ours: four of 4,000 each, all of which are equal.
# q*, qd*, tau, kp, kd and the frame; the third and the last are beyond the ranges.
EC_COMMANDS = """
0 0 0 0 0 0000007fff7ff7ff
-4.79968119 1.38585281 0.0672264099 227.79245 4.88994741 0e93f34ed989d804
-5.78902531 -17.427227 1.66588783 36.0255661 2.09686089 024ed644b8041871
-6.34352779 -6.42918015 -39.0657272 650.289124 5.92991209 1fffff3f0a524000
"""
DM_COMMANDS = """
0 0 0 0 0 7fff7ff0000007ff
8.23227692 44.824173 7.75020409 499.758423 4.97218418 d44bff7ffdfe8b71
-9.07670212 2.68402863 19.877594 713.015442 2.81921411 230d879fff904fff
-6.34352779 -14.4527893 9.41384125 650.289124 5.92991209 3f0a56dffffffc2e
"""
# number, frame; motor, position, speed, torque, temperature, error
REPLIES = """
1 3dc3cda9da416c9e 1 6.62146187 5.88571358 8.46154022 29 29
3 28d6834e84b9850d 3 8.44873047 -6.95824146 -12.2857151 41.5 8
0 31c3cda9da416c9e 1 6.62146187 14.7142868 5.07692337 nan 0
0 23d6834e84b9850d 3 8.44873047 -17.3956051 -7.37142849 nan 0
"""


def numbers(table: str) -> list[list[str]]:
    return [line.split() for line in table.split("\n") if line]


@pytest.fixture
def robot() -> Robot:
    return load_robot("arx_x5")


def packing(robot: Robot, layout: Any) -> tuple[Packing, int]:
    motors = Motors.of(robot)
    return Packing(motors), motors.layouts.index(layout)


@pytest.mark.parametrize(("layout", "table"), [(EC, EC_COMMANDS), (DM, DM_COMMANDS)])
def test_commands_are_packed_as_the_vendors_library_does(
    robot: Robot, layout: Any, table: str
) -> None:
    pack, joint = packing(robot, layout)
    for i, (*figures, frame) in enumerate(numbers(table)):
        rows = np.zeros((5, 6), np.float32)
        rows[:, joint] = [float(figure) for figure in figures]
        fits = pack(rows)
        assert pack.frames[joint].tobytes().hex() == frame
        beyond = any(bound in frame for bound in ("ffff3f", "904fff", "fffffc"))
        assert fits != beyond, i


@pytest.mark.slow
def test_the_vendors_library_agrees(robot: Robot, tmp_path: Path) -> None:
    """2,000 random commands and answers of each kind, a third of the commands beyond the ranges."""
    library = os.environ.get("UNICON_ARX_LIBRARY")
    if library is None or shutil.which("g++") is None:
        pytest.skip("UNICON_ARX_LIBRARY does not name a libhardware.so of arx5-sdk, or g++ lacks")
    (tmp_path / "none.c").write_text("")
    soem, program = tmp_path / "libsoem.so", tmp_path / "vendor"
    source = Path(__file__).with_name("arx_vendor.cpp")
    for command in (
        ["g++", "-shared", "-o", soem, tmp_path / "none.c"],
        ["g++", "-rdynamic", "-o", program, source, library, f"-Wl,-rpath-link,{tmp_path}"],
    ):
        subprocess.run(command, check=True)
    random, asked = np.random.default_rng(5), []
    for i in range(2000):
        for word, layout in (("E", EC), ("D", DM)):
            most = np.array([500.0, 5.0, 12.5, layout.velocity, layout.torque])
            figures = random.uniform(-1, 1, 5) * most * (1.5 if i % 3 == 0 else 1.0)
            asked.append((word, layout, np.float32(figures)))
        motor = int(random.integers(1, 8))
        data = bytearray(random.bytes(8))
        data[0] = 0x20 | data[0] & 0x1F
        asked.append(("R", motor, bytes(data)))
        data[0] = data[0] & 0xF0 | motor
        asked.append(("M", motor, bytes(data)))
    lines = [
        f"{word} {what} {data.hex()}"
        if isinstance(data, bytes)
        else " ".join([word, *(f"{figure:.9g}" for figure in data)])
        for word, what, data in asked
    ]
    ran = subprocess.run(
        [program],
        input="\n".join(lines),
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        check=True,
        env={"LD_LIBRARY_PATH": f"{tmp_path}:{Path(library).parent}"},
    )
    answers = ran.stderr.splitlines()
    assert len(answers) == len(asked)
    for (word, what, data), theirs in zip(asked, answers):
        if isinstance(data, bytes):
            told = reply_of(what if word == "R" else 0, data)
            motor, *figures = theirs.split()
            assert told is not None
            assert told.motor == int(motor)
            np.testing.assert_allclose(told[1:4], [float(f) for f in figures[:3]], atol=1e-4)
            assert told.error == int(figures[4])
            if told.temperature is not None:
                assert int(told.temperature) % 256 == int(figures[3])
        else:
            pack, joint = packing(robot, what)
            rows = np.zeros((5, 6), np.float32)
            rows[:, joint] = data[[2, 3, 4, 0, 1]]
            pack(rows)
            assert pack.frames[joint].tobytes().hex() == theirs.split()[1]


def test_answers_are_read_as_the_vendors_library_does() -> None:
    for number, frame, motor, *figures in numbers(REPLIES):
        told = reply_of(int(number), bytes.fromhex(frame))
        assert told is not None
        assert told.motor == int(motor)
        pos, vel, torque, temperature, error = map(float, figures)
        np.testing.assert_allclose(told[1:4], (pos, vel, torque), atol=1e-5)
        assert (told.temperature is None) == np.isnan(temperature)
        assert told.temperature in (None, temperature)
        assert told.error == error


@given(
    data=st.lists(st.floats(-1, 1, width=32), min_size=5, max_size=5),
    layout=st.sampled_from([EC, DM]),
)
def test_what_is_packed_is_heard_to_a_bit_of_each_figure(data: list[float], layout: Any) -> None:
    most = np.array([12.5, layout.velocity, layout.torque, 500.0, 5.0])
    figures = np.array(data) * most
    figures[3:] = np.abs(figures[3:])
    pack, joint = packing(load_robot("arx_x5"), layout)
    rows = np.zeros((5, 6), np.float32)
    rows[:, joint] = figures
    assert pack(rows)
    heard = command_of(layout, pack.frames[joint].tobytes())
    bits = np.array([16, 12, 12, 12, layout.kd_bits])
    span = most * np.array([2, 2, 2, 1, 1])
    assert (np.abs(heard - figures) <= span / (2.0**bits - 1) + 1e-5 * most).all()
    told = Reply(3, figures[0], figures[1], figures[2], None if layout is DM else 40.5, 0)
    back = reply_of(*answer(3, layout, told))
    assert back is not None
    assert (back.motor, back.temperature, back.error) == (3, told.temperature, 0)
    np.testing.assert_allclose(back[1:4], told[1:4], atol=0.03)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_any_frame_is_read_or_left(number: int, data: bytes) -> None:
    told = reply_of(number, data)
    if told is not None:
        assert np.isfinite(told[1:4]).all()
        assert abs(told.pos) <= 12.5 + 1e-9


def test_wrong_facts_and_options_are_told(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    from unicon_hardware.arx.platform import make

    states = states_of(robot)
    with pytest.raises(PlatformError, match=r"write platforms: \{arx: \{unverified: true\}\}"):
        make(states, robot, 0.02)
    for key, value, why in (
        ("motor_id", [1, 2, 4, 5, 6, 6], "write a whole number of its own"),
        ("motor_id", [1, 2, 4, 5, 6, 7.5], "write a whole number of its own"),
        ("motor_id", [0] * 6, "write 6 numbers from 1 to 15"),
        ("motor_type", ["XX_1"] * 6, "write texts that begin with EC_ or DM_"),
        ("torque_state", None, "write 6 numbers"),
        ("interface", "", "write a text"),
    ):
        with pytest.raises(RobotError, match=why):
            make(states, moved(robot, **{key: value}), 0.02)
    monkeypatch.setitem(__import__("sys").modules, "can", None)
    with pytest.raises(MissingDependencyError, match=r"needs python-can: .*unicon_ros\[hw-arx\]"):
        make(states, robot, 0.02, unverified=True)


def test_a_bus_that_is_not_there_is_told(robot: Robot) -> None:
    pytest.importorskip(
        "can", reason="python-can is not installed: pip install 'unicon_ros[hw-arx]'"
    )
    from unicon_hardware.arx.platform import make

    states = states_of(robot)
    for interface in ("socketcan", "nonsense"):
        with pytest.raises(PlatformError, match=r"cannot open CAN bus 'can77' .*ip link set can77"):
            make(states, robot, 0.02, channel="can77", interface=interface, unverified=True)
    with pytest.raises(PlatformError, match=r"no frame .* from all 6 motors \(joint1 \(motor 1\)"):
        make(
            states,
            robot,
            0.02,
            channel="arx_none",
            interface="virtual",
            unverified=True,
            connect=0.02,
        )


class Pair:
    """Our wire and the emulated motors, on a bus of this process."""

    def __init__(self, robot: Robot, channel: str) -> None:
        from unicon_hardware.arx.platform import ArxWire, open_bus

        self.emulated = Emulated(robot, FACE, channel=channel)
        self.states = states_of(robot)
        self.wire = ArxWire(self.states, Motors.of(robot), open_bus(channel, "virtual"), 1e4)

    def step(self, times: int = 1) -> int:
        good = 0
        for _ in range(times):
            time.sleep(0.001)
            good += self.wire.take()
            self.emulated.step()
        return good

    def close(self) -> None:
        self.wire.close()
        self.emulated.face.close()


@pytest.fixture
def pair(robot: Robot, request: pytest.FixtureRequest) -> Iterator[Pair]:
    pytest.importorskip(
        "can", reason="python-can is not installed: pip install 'unicon_ros[hw-arx]'"
    )
    found = Pair(robot, request.node.name)
    yield found
    found.close()


def test_motors_are_asked_limp_and_then_obey(pair: Pair) -> None:
    assert pair.step(10) >= 8
    pos = pair.emulated.states["joint_pos"]
    np.testing.assert_allclose(pair.states["joint_pos"], pos, atol=25 / 65535)
    assert pair.emulated.heard == 0
    assert pair.emulated.face.obeys
    assert not pair.emulated.states["joint_stiffness"].any()
    states = pair.states
    states["joint_pos_target"][...] = np.linspace(-1, 1, 6)
    states["joint_stiffness"][...], states["joint_damping"][...] = 50.0, 2.0
    states["joint_effort_ff"][...] = 3.0
    pair.wire.put()
    pair.step()
    told = pair.emulated.states
    np.testing.assert_allclose(told["joint_pos_target"], np.linspace(-1, 1, 6), atol=1e-3)
    np.testing.assert_allclose(told["joint_stiffness"], 50.0, atol=0.2)
    np.testing.assert_allclose(told["joint_damping"], 2.0, atol=0.02)
    np.testing.assert_allclose(told["joint_effort_ff"], 3.0, atol=0.03)
    states["joint_stiffness"][...] = 2000.0
    pair.wire.put()
    assert pair.wire.counts.clamped == 1
    pair.step(3)
    np.testing.assert_allclose(told["joint_stiffness"], 500.0)
    pair.emulated.states["motor_error"][1] = 9
    pair.wire.put()
    pair.step(2)
    assert pair.states["motor_error"].tolist() == [0, 9, 0, 0, 0, 0]


def test_a_motor_that_does_not_answer_is_a_fault_by_name(pair: Pair, robot: Robot) -> None:
    from unicon_hardware.arx.platform import Arx

    pair.step(5)
    platform = Arx(pair.states, robot, 0.02, pair.wire, silence=0.05)
    del pair.emulated.face._joints[4]  # type: ignore[attr-defined]
    end = time.monotonic() + 5.0
    with pytest.raises(Fault, match=r"nothing from joint3 \(motor 4\) on .* is silent"):  # noqa: PT012
        while time.monotonic() < end:
            time.sleep(0.001)
            platform.recv()
            pair.emulated.step()


def test_strangers_and_garbage_on_the_bus_are_counted(pair: Pair) -> None:
    import can

    pair.step(5)
    before = pair.states["joint_pos"].copy()
    stranger = can.Bus(channel=pair.wire._bus.channel_id, interface="virtual")
    assert set(pair.wire.commanders().values()) == {0}

    def say(number: int, data: bytes, **kind: bool) -> None:
        options = {"is_extended_id": False, **kind}
        stranger.send(can.Message(arbitration_id=number, data=data, **options))

    say(2, bytes.fromhex("0e93f34ed989d804"))  # somebody else's commands
    say(5, bytes.fromhex("d44bff7ffdfe8b71"))
    say(0, b"\x08" + bytes(7))  # the gripper's answer
    say(0x123, bytes(8))
    say(1, b"")
    say(0, b"\x05\x00")
    say(1, bytes.fromhex("3dc3cda9da416c9e"), is_extended_id=True)
    stranger.send(can.Message(arbitration_id=1, is_remote_frame=True, is_extended_id=False))
    stranger.send(can.Message(is_error_frame=True))
    pair.wire.take()
    refused = pair.wire.counts.refused
    assert refused["somebody else's command"] == 3
    assert refused["not understood"] == 3
    assert refused["not a data frame"] == 3
    np.testing.assert_allclose(pair.states["joint_pos"], before, atol=25 / 65535)
    assert set(pair.wire.commanders().values()) == {1}
    for _ in range(600):  # a flood: some of it is taken in each tick
        say(0x77, bytes(8))
    pair.wire.take()
    assert 250 <= refused["not understood"] < 265
    for _ in range(600):
        say(2, bytes(8))
    pair.emulated.face.hear()
    assert len(pair.emulated.face._asked) <= 256  # type: ignore[attr-defined]
    stranger.shutdown()


def test_a_bus_that_goes_is_a_fault(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    import can

    def full(*_: Any) -> None:
        raise can.CanOperationError("Transmit buffer full")

    monkeypatch.setattr(pair.wire._bus, "send", full)
    with pytest.raises(Fault, match=r"does not take a frame for motor 1: Transmit buffer full; is"):
        pair.wire.put()
    send, motors = can.interfaces.virtual.VirtualBus.send, []

    def full_for_one(message: Any, *_: Any) -> None:
        motors.append(message.arbitration_id)
        if message.arbitration_id == 1:
            full()
        send(pair.wire._bus, message)

    monkeypatch.setattr(pair.wire._bus, "send", full_for_one)
    with pytest.raises(Fault, match="for motor 1: Transmit buffer full"):
        pair.wire.put()
    assert motors == [1, 2, 4, 5, 6, 7]
    monkeypatch.setattr(pair.wire._bus, "recv", full)
    with pytest.raises(Fault, match=r"arx: CAN bus .*: Transmit buffer full"):
        pair.wire.take()
