"""Modbus frames: known ones byte for byte, a slow twin, and everything that is not a frame."""

from __future__ import annotations

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unicon_core.robots import load_robot
from unicon_hardware.inspire.platform import registers_of as inspire
from unicon_hardware.modbus.hand import Told
from unicon_hardware.modbus.link import (
    Frame,
    Framing,
    Refused,
    Rtu,
    Tcp,
    crc16,
    read_answer,
    read_request,
    write_answer,
    write_request,
)
from unicon_hardware.rohand.platform import registers_of as rohand

WORDS = st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=120)
ANGLES = st.lists(st.floats(-100.0, 100.0), min_size=6, max_size=6)


def crc_bit_by_bit(data: bytes) -> int:
    """The specification's own loop (Modbus over Serial Line V1.02, section 6.2.2)."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def test_the_specifications_examples() -> None:
    # Application Protocol V1.1b3, section 6.3: registers 108 to 110 are 555, 0, 100.
    assert read_request(0x6B, 3) == bytes.fromhex("03006b0003")
    told = read_answer(bytes.fromhex("0306022b00000064"), 3)
    assert told.tolist() == [555, 0, 100]
    # Section 6.12: registers 2 and 3 become 10 and 258.
    wanted = write_request(1, np.array([10, 258], np.uint16))
    assert wanted == bytes.fromhex("1000010002" + "04000a0102")
    write_answer(bytes.fromhex("1000010002"), 1, 2)
    # Over Serial Line V1.02, section 6.2.2: function 07 of device 2.
    assert Rtu().pack(Frame(0, 2, b"\x07")) == bytes.fromhex("02074112")
    assert Tcp().pack(Frame(1, 255, read_request(4, 1))) == bytes.fromhex(
        "000100000006ff0300040001"
    )


@given(st.binary(max_size=300))
def test_crc_is_that_of_the_slow_loop(data: bytes) -> None:
    assert crc16(data) == crc_bit_by_bit(data)


@pytest.mark.parametrize("framing", [Tcp(), Rtu()])
@given(unit=st.integers(0, 255), start=st.integers(0, 0xFFFF), values=WORDS)
def test_frames_come_back(framing: Framing, unit: int, start: int, values: list[int]) -> None:
    words = np.array(values, np.uint16)
    count = len(words)
    answer = bytes((3, 2 * count)) + struct.pack(f">{count}H", *values)
    for pdu, answers in ((write_request(start, words), False), (answer, True)):
        data = framing.pack(Frame(7, unit, pdu))
        assert framing.size(data, answer=answers) == len(data)
        assert framing.size(data + b"more", answer=answers) == len(data)
        frame = framing.unpack(data)
        assert (frame.unit, frame.pdu) == (unit, pdu)
    np.testing.assert_array_equal(read_answer(answer, count), words)


@pytest.mark.parametrize("framing", [Tcp(), Rtu()])
@given(data=st.binary(max_size=300), answer=st.booleans())
def test_garbage_is_refused_or_waited_for(framing: Framing, data: bytes, answer: bool) -> None:
    with suppress(Refused):
        size = framing.size(data, answer=answer)
        assert size >= 0
        if size and len(data) >= size:
            read_answer(framing.unpack(data[:size]).pdu, 6)


def test_each_bit_of_a_serial_frame_counts() -> None:
    good = Rtu().pack(Frame(0, 1, read_request(1546, 6)))
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        with pytest.raises(Refused, match="wrong CRC"):
            Rtu().unpack(bytes(bad))


@pytest.mark.parametrize(
    ("pdu", "reason"),
    [
        ("8302", "exception 2"),
        ("8304", "exception 4"),
        ("0402000a", "wrong function"),
        ("", "wrong function"),
        ("0302000a", "wrong length"),
        ("030c000a", "wrong length"),
        ("030c" + "00" * 11, "wrong length"),
        ("030c" + "00" * 13, "wrong length"),
    ],
)
def test_another_answer_is_refused(pdu: str, reason: str) -> None:
    with pytest.raises(Refused) as raised:
        read_answer(bytes.fromhex(pdu), 6)
    assert raised.value.reason == reason


@pytest.mark.parametrize("pdu", ["1005ce0005", "1005cf0006", "10", "9003"])
def test_another_write_is_refused(pdu: str) -> None:
    with pytest.raises(Refused):
        write_answer(bytes.fromhex(pdu), 1486, 6)


# -- what registers mean ---------------------------------------------------------------------------


def test_inspire_is_1000_open_and_0_closed() -> None:
    robot = load_robot("inspire_rh56_left")
    registers = inspire(robot)
    assert registers.raw(robot.lower)[0].tolist() == [1000] * 6
    assert registers.raw(robot.upper)[0].tolist() == [0] * 6
    half = registers.raw(0.5 * (robot.lower + robot.upper))[0]
    assert half.tolist() == [500] * 6
    # xr_teleoperate, normalize: (max - v) / (max - min) of 1000.
    pose = np.array([0.3, 0.6, 0.9, 1.2, 0.2, 0.5], np.float32)
    expected = np.rint(1000 * (robot.upper - pose) / (robot.upper - robot.lower))
    np.testing.assert_array_equal(registers.raw(pose)[0], expected)


def test_rohand_is_hundredths_of_a_degree() -> None:
    robot = load_robot("rohand")
    registers = rohand(robot)
    degrees = np.array([20.0, 120.5, 130.25, 140.0, 150.0, 45.0])
    raw, clamped = registers.raw(np.radians(degrees).astype(np.float32))
    assert raw.tolist() == [2000, 12050, 13025, 14000, 15000, 4500]
    assert not clamped
    np.testing.assert_allclose(registers.angles(raw), np.radians(degrees), atol=1e-6)


@pytest.mark.parametrize(("name", "of"), [("inspire_rh56_left", inspire), ("rohand", rohand)])
@given(angles=ANGLES)
def test_angles_are_clamped_and_come_back(name: str, of: object, angles: list[float]) -> None:
    robot = load_robot(name)
    registers = of(robot)  # type: ignore[operator]
    wanted = np.array(angles, np.float32)
    raw, clamped = registers.raw(wanted)
    step = float(np.abs(1.0 / registers.per_rad).max())
    held = np.clip(wanted, robot.lower, robot.upper)
    np.testing.assert_allclose(registers.angles(raw), held, atol=1.01 * step)
    beyond = (wanted < robot.lower - 2 * step) | (wanted > robot.upper + 2 * step)
    assert clamped or not beyond.any()


@pytest.mark.parametrize("raw", [0x7FFF, 0x8000, 0xFFFF - 200, 1200])
def test_an_impossible_angle_is_refused(raw: int) -> None:
    registers = inspire(load_robot("inspire_rh56_left"))
    with pytest.raises(Refused, match="of joint 3"):
        registers.angles(np.array([500, 500, 500, raw, 500, 500], np.uint16))


def test_bytes_stand_two_to_a_register_high_one_first() -> None:
    block = Told(1618, bytes=True)
    told = block.values(np.array([0x2A2B, 0x2C2D, 0x2E2F], np.uint16), 6)
    assert told.tolist() == [0x2A, 0x2B, 0x2C, 0x2D, 0x2E, 0x2F]
    assert block.registers(told).tolist() == [0x2A2B, 0x2C2D, 0x2E2F]
    assert block.count(6) == 3
