"""Hands against pymodbus, which knows nothing of us: it is the hand, or the client of our face."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
import pytest
from hand_peers import free_port, hand_states, pumped, pymodbus_hand, until

pytest.importorskip(
    "pymodbus", reason="pymodbus is the peer: pip install 'pymodbus>=3.13' pyserial"
)
pytest.importorskip("serial", reason="pymodbus needs pyserial for a serial line")

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.framer import FramerType

from unicon_core.robots import load_robot
from unicon_hardware.inspire.platform import face as inspire_face
from unicon_hardware.inspire.platform import make as inspire
from unicon_hardware.modbus.hand import HandWire
from unicon_hardware.modbus.link import ModbusConnection, Rtu
from unicon_hardware.rohand.platform import check_protocol, registers_of
from unicon_hardware.rohand.platform import face as rohand_face

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"

LEFT, ROHAND = load_robot("inspire_rh56_left"), load_robot("rohand")
RNG = np.random.default_rng(0)
INSPIRE = {
    1004: [0],
    1486: [0] * 6,
    1546: [1000, 800, 600, 400, 200, 0],
    1606: [0x0001, 0x0200, 0],
    1612: [0x0202, 0x0202, 0x0202],
    1618: [0x1F20, 0x2122, 0x2324],
}


def test_our_driver_with_their_hand() -> None:
    states = hand_states(LEFT)
    port = free_port()
    with pymodbus_hand(INSPIRE, unit=1, port=port) as written:
        platform = inspire(states, LEFT, 0.01, address="127.0.0.1", port=port)
        share = 1.0 - np.array(INSPIRE[1546]) / 1000.0
        expected = LEFT.lower + share * (LEFT.upper - LEFT.lower)
        np.testing.assert_allclose(states["joint_pos"], expected, atol=1e-5)

        def told() -> bool:
            platform.recv()
            return bool(states["motor_temperature"].all())

        until(told)
        assert states["motor_temperature"].tolist() == [31, 32, 33, 34, 35, 36]
        until(lambda: platform.prepare() == "")
        assert written == [(16, 1004, [1])]
        written.clear()
        wanted = RNG.uniform(LEFT.lower, LEFT.upper, (50, 6)).astype(np.float32)
        for row in wanted:
            states["joint_pos_target"][...] = row
            before = len(written)
            platform.send()
            until(lambda before=before: len(written) > before)
        span = LEFT.upper - LEFT.lower
        sent = np.array([values for _, _, values in written])
        np.testing.assert_array_equal(sent, np.rint(1000.0 * (LEFT.upper - wanted) / span))
        assert {(function, address) for function, address, _ in written} == {(16, 1486)}
        states["joint_stiffness"][...] = 0.0
        platform.close()


def test_our_driver_with_their_hand_over_a_serial_line() -> None:
    master, slave = os.openpty()
    blocks = {
        1000: [0x0105],
        1085: [2] * 6,
        1155: [0] * 6,
        1165: [2000, 12000, 13000, 14000, 15000, 4500],
    }
    states = hand_states(ROHAND)
    with pymodbus_hand(blocks, unit=2, port=os.ttyname(slave)) as written:
        link = ModbusConnection(master, Rtu(), lambda: None)
        check_protocol(link, ROHAND)
        wire = HandWire(states, registers_of(ROHAND), lambda: link, "a pty")
        until(lambda: wire.take() > 0)
        degrees = np.array(blocks[1165]) / 100.0
        np.testing.assert_allclose(states["joint_pos"], np.radians(degrees), atol=1e-5)
        states["joint_pos_target"][...] = np.radians([10.0, 110.0, 111.0, 112.0, 113.0, 45.0])
        wire.put()
        until(lambda: bool(written))
        assert written[0] == (16, 1155, [1000, 11000, 11100, 11200, 11300, 4500])
        wire.close()
    os.close(master)
    os.close(slave)


def test_their_client_with_our_faces() -> None:
    for robot in (LEFT, ROHAND):
        there = hand_states(robot)
        there["joint_pos"][...] = robot.lower
        there["motor_status"][...] = 3
        client: Any
        if robot is LEFT:
            face = inspire_face(there, robot, port=0)
            client = ModbusTcpClient("127.0.0.1", port=face.server.port)  # type: ignore[union-attr]
            unit, target, angle, status = 1, 1486, 1546, (1612, 3)
            raw = [1000] * 6
        else:
            face = rohand_face(there, robot)
            device = face.where
            client = ModbusSerialClient(device, framer=FramerType.RTU, baudrate=115200)
            unit, target, angle, status = 2, 1155, 1165, (1085, 6)
            raw = registers_of(robot).raw(robot.lower)[0].tolist()
        with pumped(face) as pump:
            assert client.connect()
            time.sleep(0.01)
            assert client.read_holding_registers(angle, count=6, device_id=unit).registers == raw
            told = client.read_holding_registers(status[0], count=status[1], device_id=unit)
            assert told.registers == ([0x0303] * 3 if robot is LEFT else [3] * 6)
            middle = registers_of(robot).raw(robot.upper)[0] if robot is ROHAND else np.full(6, 250)
            values = [int(value) for value in middle]
            assert not client.write_registers(target, values, device_id=unit).isError()
            until(lambda pump=pump: pump.heard > 0)
            goal = (
                robot.upper if robot is ROHAND else robot.upper - 0.25 * (LEFT.upper - LEFT.lower)
            )
            np.testing.assert_allclose(there["joint_pos_target"], goal, atol=2e-3)
            refused = client.read_holding_registers(4000, count=1, device_id=unit)
            assert refused.isError()
            assert refused.exception_code == 2
            if robot is LEFT:  # -1 leaves a finger as it is
                client.write_registers(target, [0xFFFF, 1000, *values[2:]], device_id=unit)
                second = there["joint_pos_target"][1:2]
                until(lambda second=second: abs(float(second[0])) < 1e-6)
                assert there["joint_pos_target"][0] == pytest.approx(goal[0], abs=2e-3)
            client.close()
