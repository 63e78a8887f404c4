"""The datagrams of unitree_legged_sdk against golden frames and against a slow twin with struct."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from legged_peer import LENGTHS, sealed, servo_link, slow_command, slow_crc

from unicon_core.robots import load_robot
from unicon_hardware.unitree_legged.codec import (
    LAYOUTS,
    CommandFrame,
    Frame,
    encrypted_crc,
    link_of,
)

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "frames"

POS_STOP, VEL_STOP = 2.146e9, 16000.0
COLUMNS = st.tuples(
    st.floats(-12.0, 12.0, width=32),
    st.floats(-200.0, 200.0, width=32),
    st.floats(-1e6, 1e6, width=32),
    st.floats(-10.0, 1e6, width=32),
    st.floats(-10.0, 1e6, width=32),
)


def golden(assets: Path, name: str) -> bytes:
    return bytes.fromhex((assets / "frames" / f"{name}.hex").read_text("ascii"))


def command(name: str, motors: int = 12, **options: bool) -> CommandFrame:
    return CommandFrame(servo_link(name, motors), **options)


def rows(*motors: tuple[float, ...]) -> list[np.typing.NDArray[np.float32]]:
    return list(np.array(motors, np.float32).T.copy())


@pytest.mark.parametrize("name", ["a1", "go1"])
def test_commands_are_the_bytes_of_the_vendors_library(assets: Path, name: str) -> None:
    out = command(name, 3)
    motors = (
        (0.5, 1.5, 2.25, 20.5, 1.5),
        (-1.25, -2.0, -0.65, 5.0, 2.0),
        (2.146e9, 16000.0, 33.5, 80.0, 7.1),
    )
    assert out.write(*rows(*motors)) == golden(assets, f"{name}_lowcmd")
    assert out.clamped == 0


@pytest.mark.parametrize("name", ["a1", "go1"])
def test_what_the_vendors_encoder_wraps_is_clamped(assets: Path, name: str) -> None:
    out = command(name, 3)
    motors = (
        (0.5, 1.5, 200.0, 2047.9, 4095.0),
        (-1.25, -2.0, -200.0, 3000.0, 5000.0),
        (0.0, 0.0, 127.9, -1.0, -1.0),
    )
    ours, theirs = Frame(LAYOUTS[LENGTHS[name]].command), Frame(LAYOUTS[LENGTHS[name]].command)
    ours.fill(out.write(*rows(*motors)))
    theirs.fill(golden(assets, f"{name}_lowcmd_wrap"))
    assert theirs.sound()
    assert list(theirs["motors"]["tau"][:3]) == [-14336, 14336, 32742]
    assert list(ours["motors"]["tau"][:3]) == [32767, -32768, 32742]
    assert list(theirs["motors"]["kp"][:3]) == [65532, 30464, 65504]
    assert list(ours["motors"]["kp"][:3]) == [65532, 65535, 0]
    assert list(theirs["motors"]["kd"][:3]) == [65520, 14464, 65520]
    assert list(ours["motors"]["kd"][:3]) == [65520, 65535, 0]
    assert out.clamped == 1
    assert ours.buffer[-4 - 4 - 40 :] != theirs.buffer[-4 - 4 - 40 :]  # the checksum alone differs
    assert ours.buffer[-48:-4] == theirs.buffer[-48:-4]


@pytest.mark.parametrize("name", ["a1", "go1"])
def test_states_are_those_that_the_vendors_library_decodes(assets: Path, name: str) -> None:
    frame = Frame(LAYOUTS[LENGTHS[name]].state)
    frame.fill(golden(assets, f"{name}_lowstate"))
    assert frame.sound()
    motors = frame["motors"]
    i = np.arange(20, dtype=np.float32)
    np.testing.assert_array_equal(motors["mode"], 10)
    np.testing.assert_allclose(motors["q"], 0.1 * i, rtol=1e-6)
    np.testing.assert_allclose(motors["dq"], 0.2 * i, rtol=1e-6)
    np.testing.assert_array_equal(motors["ddq"], 2 * i)
    np.testing.assert_array_equal(motors["tau"] / 256.0, 1.5 * i)
    np.testing.assert_array_equal(motors["temperature"], 30 + i)
    np.testing.assert_allclose(frame["quat"], (1.0, 0.1, 0.2, 0.3), rtol=1e-6)
    np.testing.assert_allclose(frame["gyro"], (0.4, 0.5, 0.6), rtol=1e-6)
    np.testing.assert_allclose(frame["acc"], (0.7, 0.8, 9.8), rtol=1e-6)
    np.testing.assert_allclose(frame["rpy"], (0.01, 0.02, 0.03), rtol=1e-6)
    assert int(frame["imu_temperature"]) == 40
    assert list(frame["foot_force"]) == [11, 12, 13, 14]
    assert int(frame["tick"]) == 123456
    assert frame["remote"].tobytes() == bytes(range(40))
    assert ("bms" in frame) == (name == "go1")
    if name == "go1":
        bms = frame["bms"]
        assert (list(bms["version"]), bms["status"], bms["soc"]) == ([1, 2], 1, 77)
        assert (bms["current"], bms["cycle"]) == (-1234, 55)
        assert [*bms["bq_ntc"], *bms["mcu_ntc"]] == [20, 21, 22, 23]
        assert list(bms["cells"]) == [100] * 10


@pytest.mark.parametrize("name", ["a1", "go1"])
@settings(max_examples=15)
@given(motors=st.lists(COLUMNS, min_size=12, max_size=12))
def test_any_command_is_that_of_the_slow_twin(name: str, motors: list[tuple[float, ...]]) -> None:
    out = command(name)
    first = out.write(*rows(*motors))
    assert first == slow_command(name, motors)
    back = Frame(LAYOUTS[LENGTHS[name]].command)
    back.fill(first)
    assert back.sound()
    assert out.write(*rows(*motors)) == first  # nothing of the one before is left


@settings(max_examples=20)
@given(datagram=st.binary(min_size=807, max_size=807), flip=st.integers(0, 8 * 803 - 1))
def test_any_flipped_bit_is_found(datagram: bytes, flip: int) -> None:
    frame = Frame(LAYOUTS[LENGTHS["go1"]].state)
    good = sealed(datagram)
    frame.fill(good)
    assert frame.sound()
    bad = bytearray(good)
    bad[flip >> 3] ^= 1 << (flip & 7)
    frame.fill(bytes(bad))
    covered = flip >> 3 < 800 or flip >> 3 >= 803
    assert frame.sound() is not covered


def test_the_other_checksum_is_free_dogs() -> None:
    """`ucl/common.py: encryptCrc`, with its steps on bytes."""
    for crc in (0, 1, 0xFFFFFFFF, 0x12345678):
        data = struct.pack("<I", crc ^ 0xEDCAB9DE)
        expected = int.from_bytes(bytes([data[1], data[2], data[3], data[0]]), "little")
        assert encrypted_crc(crc) == expected
    plain, other = command("go1"), command("go1", encrypted=True)
    limp = rows(*[(0.0,) * 5] * 12)
    plain.write(*limp)
    sent = other.write(*limp)
    assert sent[20:22] == b"\x3a\xc0"
    assert other["crc"] == encrypted_crc(slow_crc(sent[:608]))
    assert other.sound(encrypted=True)
    assert not other.sound()
    assert plain.sound()


def test_an_idle_command_is_the_vendors_initial_one(assets: Path) -> None:
    """Motors 3 to 19 of the golden frame; and the byte that switches a Go1 off stays zero."""
    idle, theirs = command("go1"), golden(assets, "go1_lowcmd")
    step = 27
    assert idle.buffer[22 : 22 + step] == theirs[22 + 3 * step : 22 + 4 * step]
    assert idle.buffer[562] == 0
    assert idle.buffer[:22] == theirs[:22]
    assert idle.sound()


@pytest.mark.parametrize(
    ("name", "generation", "local_port"),
    [
        ("a1", "legged_sdk_3.3.1", 8080),  # include/unitree_legged_sdk/udp.h: UDP_CLIENT_PORT
        ("aliengo", "legged_sdk_3.3.1", 8080),
        ("aliengo", "legged_sdk_3.8.4", 8082),  # branch Aliengo, example_position_aliengo.cpp
        ("go1", "legged_sdk_3.8.6", 8090),  # branch go1, example/example_position.cpp
    ],
)
def test_robot_files_have_the_sdks_figures(name: str, generation: str, local_port: int) -> None:
    link = link_of(load_robot(name), generation=generation)
    assert (link.address, link.port, link.local_port) == ("192.168.123.10", 8007, local_port)
    assert link.layout is LAYOUTS[LENGTHS[name]]
    assert (link.motors, link.level_flag) == (slice(0, 12), 0xFF)
    assert (link.servo, link.damping) == (0x0A, 0x00)
    assert (link.pos_stop, link.vel_stop, link.rate) == (POS_STOP, VEL_STOP, 500.0)
