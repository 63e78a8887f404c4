"""Any datagram with a right checksum: the driver and the face take it or refuse it, and raise not.

The states are held against a twin that reads them with struct.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from legged_peer import LENGTHS, free_port, robot_of, sealed, servo_link, slow_state, states_of

from unicon_core.states import States, StateSpec
from unicon_hardware.unitree_legged.codec import LAYOUTS, CommandFrame, Frame, link_of
from unicon_hardware.unitree_legged.platform import face
from unicon_hardware.unitree_legged.wire import StateReader
from unicon_hardware.wire import Counts, Udp

FLOAT = st.floats(width=32)
PLAIN = st.floats(-1e6, 1e6, width=32)
MOTOR = st.tuples(
    st.integers(0, 255), PLAIN, PLAIN, st.integers(-32768, 32767), st.integers(-128, 127)
)
HEADS = {"a1": b"\xff" + bytes(9), "go1": b"\xfe\xef\xff" + bytes(19)}


def reader_of(name: str) -> tuple[StateReader, States, Counts]:
    robot = robot_of(name)
    specs = dict(states_of(robot).layout.specs) | {"foot_force": StateSpec((4,))}
    states, counts = States(specs), Counts()
    return StateReader(states, robot, link_of(robot), counts, False), states, counts


@pytest.mark.parametrize("name", ["a1", "go1"])
@settings(max_examples=15)
@given(
    motors=st.lists(MOTOR, min_size=20, max_size=20),
    imu=st.lists(PLAIN, min_size=10, max_size=10),
    tick=st.integers(0, 2**32 - 1),
    soc=st.integers(0, 255),
)
def test_any_state_is_read_as_the_slow_twin_wrote_it(
    name: str, motors: list[tuple[Any, ...]], imu: list[float], tick: int, soc: int
) -> None:
    reader, states, counts = reader_of(name)
    remote = bytearray(40)
    assert reader.good(slow_state(name, motors, (*imu,), tick, soc=soc)), counts
    reader.tell(remote)
    ours = motors[:12]
    f32 = np.float32
    assert list(reader.modes) == [mode for mode, *_ in ours]
    np.testing.assert_array_equal(states["joint_pos"], [f32(q) for _, q, *_ in ours])
    np.testing.assert_array_equal(states["joint_vel"], [f32(dq) for _, _, dq, *_ in ours])
    np.testing.assert_array_equal(states["joint_effort"], [tau / 256.0 for *_, tau, _ in ours])
    np.testing.assert_array_equal(states["motor_temperature"], [each[-1] for each in ours])
    errors = [0 if mode in (0, 10) else mode for mode, *_ in ours]
    np.testing.assert_array_equal(states["motor_error"], errors)
    for state, part in (
        ("base_quat", imu[:4]),
        ("base_ang_vel", imu[4:7]),
        ("base_lin_acc", imu[7:]),
    ):
        np.testing.assert_array_equal(states[state], np.array(part, f32))
    assert list(states["foot_force"]) == [11.0, 12.0, 13.0, 14.0]
    assert remote == bytes(range(40))
    if name == "go1":
        assert states["battery_charge"] == f32(soc / 100.0)


def test_modes_are_those_of_the_newest_good_datagram() -> None:
    """`prepare` looks at them: what was refused must not say that motors are ready, or are not."""
    reader, _, _ = reader_of("a1")
    servo = [(10, 0.0, 0.0, 0, 0)] * 20
    assert reader.good(slow_state("a1", servo, (1.0, *[0.0] * 9), 1))
    reader.tell(bytearray(40))
    damaged = bytearray(slow_state("a1", [(0, 0.0, 0.0, 0, 0)] * 20, (1.0, *[0.0] * 9), 2))
    damaged[-1] ^= 1
    assert not reader.good(bytes(damaged))
    assert set(reader.modes) == {10}


@pytest.mark.parametrize("name", ["a1", "go1"])
@settings(max_examples=20)
@given(data=st.data())
def test_any_bytes_under_a_right_checksum_are_taken_or_refused(name: str, data: Any) -> None:
    reader, states, counts = reader_of(name)
    head, length = HEADS[name], LENGTHS[name][1]
    rest = length - len(head)
    body = data.draw(st.binary(min_size=rest, max_size=rest))
    if reader.good(sealed(head + body)):
        reader.tell(bytearray(40))
    else:
        assert list(counts.refused) == ["not finite"]
        floats = struct.unpack("<10f", body[:40])
        motors = [struct.unpack_from("<ff", body, 53 + 32 * i + 1) for i in range(12)]
        assert not all(map(math.isfinite, (*floats, *sum(motors, ()))))
    for state in states:
        assert np.isfinite(states[state]).all(), state


@pytest.mark.parametrize("name", ["a1", "go1"])
def test_a_face_takes_or_refuses_any_bytes_under_a_right_checksum(name: str) -> None:
    robot, port = robot_of(name), free_port()
    states = states_of(robot)
    board = face(states, robot, port=port)
    us = Udp(("127.0.0.1", 0), ("127.0.0.1", port), "us")

    @settings(max_examples=20)
    @given(data=st.data())
    def hostile(data: Any) -> None:
        head = HEADS[name]
        rest = LENGTHS[name][0] - len(head)
        body = bytearray(data.draw(st.binary(min_size=rest, max_size=rest)))
        if data.draw(st.booleans()):
            for i in range(20):
                body[27 * i] = 10
        us.send(sealed(head + bytes(body)))
        before = board.good + board.refused
        while board.good + board.refused == before:
            board.hear()
        board.tell()
        for state in states:
            assert np.isfinite(states[state]).all(), state

    try:
        hostile()
    finally:
        us.close()
        board.close()


@settings(max_examples=50)
@given(values=st.lists(FLOAT, min_size=3, max_size=3))
def test_a_clamped_figure_is_the_nearest_that_the_wire_has(values: list[float]) -> None:
    """Whatever is asked for, nothing on the wire has another sign, or is beyond its range."""

    if not all(map(math.isfinite, values)):
        return
    frame = CommandFrame(servo_link("a1", 1))
    one = [np.array([value], np.float32) for value in (0.0, 0.0, *values)]
    sent = Frame(LAYOUTS[LENGTHS["a1"]].command)
    sent.fill(frame.write(*one))
    motor = sent["motors"][0]
    for asked, told, low, high in (
        (values[0] * 256.0, motor["tau"], -32768, 32767),
        (values[1] * 32.0, motor["kp"], 0, 65535),
        (values[2] * 16.0, motor["kd"], 0, 65535),
    ):
        assert int(told) == int(min(max(asked, low), high))
