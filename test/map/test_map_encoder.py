"""What encoders do with constants, conversions, quaternions, times and numbers that do not fit."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from map_helpers import JAZZY, NAMES, publish, serialize, subscribe, zero_message

from unicon_msgs_map import Decoder, Encoder, Messages

JOINT_STATE = "sensor_msgs/msg/JointState"


def message_of(
    kind: str,
    mapping: dict[str, object],
    arrays: dict[str, np.ndarray],
    messages: Messages = JAZZY,
    **more: Any,
) -> Any:
    """Return what rosbags reads from an encoder's bytes."""
    raw = Encoder.build(publish(kind, mapping, messages), arrays, **more).encode()
    message = messages.store.deserialize_cdr(raw, kind)
    assert serialize(message, messages) == raw
    return message


def own(text: str) -> tuple[str, Messages]:
    """Return a type of one's own in a fresh store."""
    store = Messages("jazzy")
    store.register({"own_msgs/msg/Own": text})
    return "own_msgs/msg/Own", store


def joints(count: int, names: list[str] | None = None) -> tuple[Encoder, np.ndarray]:
    """Return a JointState encoder and the buffer that its states share."""
    buffer = np.arange(3 * count, dtype=np.float32)
    arrays = {k: buffer[i * count : (i + 1) * count] for i, k in enumerate("pve")}
    arrays["stamp"] = np.array(1, np.int64)
    mapping: dict[str, object] = {"header.stamp": "stamp", "name": "$names"}
    mapping |= {"position": "p", "velocity": "v", "effort": "e"}
    names = names or [f"j{k}" for k in range(count)]
    spec = publish(JOINT_STATE, mapping)
    return Encoder.build(spec, arrays, None, {"names": names}), buffer


def test_states_in_one_buffer_leave_in_one_copy() -> None:
    encoder, buffer = joints(20)
    assert encoder.source.count("[...] =") == 1, encoder.source
    buffer *= 2
    message = JAZZY.store.deserialize_cdr(encoder.encode(), JOINT_STATE)
    np.testing.assert_array_equal(message.velocity, buffer[20:40])


FAR_APART = """
import numpy as np
from map_helpers import JAZZY, publish, subscribe
from unicon_msgs_map import Decoder, Encoder

many = sorted((np.arange(150.0) for _ in range(60_000)), key=lambda array: array.ctypes.data)
arrays = {"p": many[0], "v": many[-1]}  # 72 MB that are free lie between the two
del many
mapping = {"position": "p", "velocity": "v"}
encoder = Encoder.build(publish("sensor_msgs/msg/JointState", mapping), arrays)
raw = encoder.encode()
assert encoder.source.count("[...] =") == 2, encoder.source
for array in arrays.values():
    array[:] = 0.0
Decoder.build(subscribe("sensor_msgs/msg/JointState", mapping), arrays).decode(raw)
for array in arrays.values():
    np.testing.assert_array_equal(array, np.arange(150.0))
"""


def test_arrays_that_lie_far_apart_are_not_read_across_what_lies_between() -> None:
    """NumPy runs out of stack where one copy spans memory that it takes its own copies from."""
    done = subprocess.run(
        [sys.executable, "-c", FAR_APART],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr


def test_the_work_per_message_does_not_depend_on_the_number_of_joints() -> None:
    lines = [joints(count)[0].source.splitlines()[2:] for count in (12, 20, 64)]
    assert lines[0] == lines[1] == lines[2]


def test_states_at_uneven_distances_are_copied_one_by_one() -> None:
    buffer = np.arange(100, dtype=np.float32)
    arrays = {"p": buffer[:12], "v": buffer[20:32], "e": buffer[50:62]}
    mapping: dict[str, object] = {"position": "p", "velocity": "v", "effort": "e"}
    encoder = Encoder.build(publish(JOINT_STATE, mapping), arrays)
    message = JAZZY.store.deserialize_cdr(encoder.encode(), JOINT_STATE)
    for part, name in mapping.items():
        np.testing.assert_array_equal(getattr(message, part), arrays[str(name)])


def test_strided_and_batched_states_are_read_in_place() -> None:
    batch = np.arange(48, dtype=np.float32).reshape(2, 24)
    arrays = {"p": batch[1:, :], "v": batch[0, ::2]}
    message = message_of(JOINT_STATE, {"position": "p", "velocity": "v[:9]"}, arrays)
    np.testing.assert_array_equal(message.position, batch[1])
    np.testing.assert_array_equal(message.velocity, batch[0, ::2][:9])


def test_bytes_of_an_earlier_message_do_not_change() -> None:
    encoder, buffer = joints(12)
    raw = encoder.encode()
    kept = bytearray(raw)
    buffer += 1
    assert encoder.encode() != kept
    assert raw == kept


@pytest.mark.parametrize(
    "stamp", [0, 1, 999_999_999, 10**9, 1_700_000_000_123_456_789, -1, (1 << 62)]
)
def test_times_become_seconds_and_nanoseconds(stamp: int) -> None:
    message = message_of("rosgraph_msgs/msg/Clock", {"clock": "t"}, {"t": np.array(stamp)})
    sec = stamp // 10**9
    assert message.clock.nanosec == stamp % 10**9
    assert message.clock.sec == (sec + 2**31) % 2**32 - 2**31  # wraps, and never raises


def test_constants_of_every_kind_are_written() -> None:
    mapping: dict[str, object] = {
        "header.frame_id": "=base_link",
        "header.stamp": 1_500_000_000,
        "voltage": 24.5,
        "charge": math.nan,
        "power_supply_status": "=POWER_SUPPLY_STATUS_FULL",
        "power_supply_health": "=0x03",
        "present": True,
        "cell_voltage": [3.5, 3.6],
        "serial_number": "=007",
        "location": "",
    }
    mapping["location"] = "="
    message = message_of("sensor_msgs/msg/BatteryState", mapping, {})
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    assert (message.header.frame_id, message.serial_number, message.location) == (
        "base_link",
        "007",
        "",
    )
    assert (message.power_supply_status, message.power_supply_health) == (4, 3)
    assert message.present is True
    assert math.isnan(message.charge)
    np.testing.assert_array_equal(message.cell_voltage, np.array([3.5, 3.6], np.float32))


def test_constants_fill_arrays_and_nested_messages() -> None:
    mapping: dict[str, object] = {
        "pose.covariance": 0.5,
        "pose.covariance_dummy": 0,
        "twist.covariance[0]": 0.25,
        "twist.covariance[7]": "=0.125",
        "pose.pose.orientation": [0, 0, 1, 0],
        "twist.twist.linear": [1, 2, 3],
    }
    del mapping["pose.covariance_dummy"]
    message = message_of("nav_msgs/msg/Odometry", mapping, {})
    np.testing.assert_array_equal(message.pose.covariance, [0.5] * 36)
    assert (message.twist.covariance[0], message.twist.covariance[7]) == (0.25, 0.125)
    assert (message.pose.pose.orientation.z, message.pose.pose.orientation.w) == (1, 0)
    assert (message.twist.twist.linear.x, message.twist.twist.linear.z) == (1, 3)


def test_variables_give_texts_numbers_and_lists() -> None:
    mapping: dict[str, object] = {"name": "$names", "header.frame_id": "$frame", "effort": "$e"}
    given = {"names": NAMES, "frame": "base", "e": [1, 2.5]}
    message = message_of(JOINT_STATE, mapping, {}, variables=given)
    assert message.name == list(NAMES)
    assert message.header.frame_id == "base"
    np.testing.assert_array_equal(message.effort, [1, 2.5])


def test_elements_are_named_counted_and_sliced() -> None:
    arrays = {"p": np.arange(6, dtype=np.float32)}
    mapping: dict[str, object] = {"linear.x": "p[calf]", "linear.y": "p[4]", "angular": "p[1:4]"}
    message = message_of("geometry_msgs/msg/Twist", mapping, arrays, names={"p": NAMES})
    assert (message.linear.x, message.linear.y) == (2, 4)
    assert (message.angular.x, message.angular.y, message.angular.z) == (1, 2, 3)


WXYZ = np.array([0.1, 0.2, 0.3, 0.4])


def test_quaternion_messages_are_converted_by_themselves() -> None:
    message = message_of("sensor_msgs/msg/Imu", {"orientation": "q"}, {"q": WXYZ})
    q = message.orientation
    assert [q.w, q.x, q.y, q.z] == list(WXYZ)


def test_the_automatic_conversion_can_be_switched_off() -> None:
    mapping: dict[str, object] = {"orientation": {"state": "q", "quat": "none"}}
    q = message_of("sensor_msgs/msg/Imu", mapping, {"q": WXYZ}).orientation
    assert [q.x, q.y, q.z, q.w] == list(WXYZ)


def test_quaternions_in_plain_arrays_are_converted_where_asked() -> None:
    kind, store = own("float64[4] q\nfloat64[] many\ngeometry_msgs/Pose[2] poses\n")
    two = np.stack([WXYZ, WXYZ + 1])
    convert = "xyzw_from_wxyz"
    mapping: dict[str, object] = {
        "q": {"state": "one", "quat": convert},
        "many": {"state": "two", "quat": "none"},
        "poses[:].orientation": "two",
    }
    message = message_of(kind, mapping, {"one": WXYZ, "two": two}, store)
    assert list(message.q) == [0.2, 0.3, 0.4, 0.1]
    np.testing.assert_array_equal(message.many, two.reshape(-1))
    assert [message.poses[1].orientation.w, message.poses[1].orientation.x] == [1.1, 1.2]
    mapping = {"many": {"state": "two", "quat": convert}}
    message = message_of(kind, mapping, {"two": two}, store)
    assert list(message.many) == [0.2, 0.3, 0.4, 0.1, 1.2, 1.3, 1.4, 1.1]


@pytest.mark.parametrize("count", [3, 12])
@pytest.mark.parametrize("wire", ["float64", "float32"])
def test_conversions_out_and_back_are_inverse(count: int, wire: str) -> None:
    kind, store = own(f"{wire}[] data\n")
    state = np.linspace(-1, 1, count).astype(np.float32)
    signs = tuple(-1.0 if k % 2 else 1.0 for k in range(count))
    out: dict[str, object] = {"state": "s", "unit": "deg", "scale": signs, "offset": 10.0}
    message = message_of(kind, {"data": out}, {"s": state}, store)
    expected = np.rad2deg(state.astype(np.float64)) * signs + 10
    np.testing.assert_allclose(message.data, expected, rtol=1e-6)
    back: dict[str, object] = {"state": "s", "unit": "deg", "scale": signs}
    back["offset"] = tuple(-np.deg2rad(10) * s for s in signs)
    got = np.zeros(count, np.float32)
    decoder = Decoder.build(subscribe(kind, {"data": back}, store), {"s": got})
    for _ in range(2):
        got[...] = 0
        assert decoder.decode(serialize(message, store))
        np.testing.assert_allclose(got, state, atol=1e-6)


@pytest.mark.parametrize(
    ("unit", "si", "on_the_wire"),
    [("deg", math.pi, 180.0), ("mm", 1.5, 1500.0), ("rpm", 2 * math.pi, 60.0), ("g", 9.80665, 1.0)],
)
def test_units_are_those_of_the_message(unit: str, si: float, on_the_wire: float) -> None:
    mapping: dict[str, object] = {"data": {"state": "s", "unit": unit}}
    message = message_of("std_msgs/msg/Float64", mapping, {"s": np.array(si)})
    assert message.data == pytest.approx(on_the_wire)


@pytest.mark.parametrize("count", [1, 20])
@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # of whatever ran before
def test_integers_round_and_saturate(count: int) -> None:
    kind, store = own("int8[] a\nuint16[] b\nint64[] c\n")
    values = np.resize([1.5, 2.5, -0.6, 300.0, -300.0, np.nan, np.inf, -np.inf], 20)[:count]
    arrays = {"f": values, "i": np.full(count, 70000), "h": np.full(count, 2**64 - 1, np.uint64)}
    with np.errstate(all="raise"):
        message = message_of(kind, {"a": "f", "b": "i", "c": "h"}, arrays, store)
    expected = np.resize([2, 2, -1, 127, -128, 0, 127, -128], 20)[:count]
    np.testing.assert_array_equal(message.a, expected)
    np.testing.assert_array_equal(message.b, [65535] * count)
    np.testing.assert_array_equal(message.c, [2**63 - 1] * count)


@pytest.mark.parametrize("count", [1, 20])
@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # of whatever ran before
def test_no_error_state_of_numpy_reaches_encode(count: int) -> None:
    kind, store = own("float32[] a\nfloat32[] b\nfloat64[] c\n")
    arrays = {"d": np.full(count, 1e300), "t": np.full(count, 1e-320)}
    mapping: dict[str, object] = {"a": "d", "b": "t", "c": {"state": "d", "scale": 1e300}}
    with np.errstate(all="raise"):
        message = message_of(kind, mapping, arrays, store)
    assert np.isinf(message.a).all()
    assert not message.b.any()
    assert np.isinf(message.c).all()


def test_booleans_come_from_any_number() -> None:
    kind, store = own("bool a\nbool[3] b\nfloat32 c\n")
    arrays = {"a": np.array(2.0), "b": np.array([0, 5, -1]), "c": np.array(True)}
    message = message_of(kind, {"a": "a", "b": "b", "c": "c"}, arrays, store)
    assert message.a
    assert list(message.b) == [False, True, True]
    assert message.c == 1.0


def test_numbers_as_text_keep_their_width() -> None:
    arrays = {"v": np.array(12.345, np.float32)}
    path = "status[0].values[0].value"
    mapping: dict[str, object] = {path: {"state": "v", "text": "8.2f"}}
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    encoder = Encoder.build(publish(kind, mapping), arrays)
    for value, text in ((12.345, "   12.35"), (-1e5, "-100000.00"), (np.nan, "     nan")):
        arrays["v"][...] = value
        message = JAZZY.store.deserialize_cdr(encoder.encode(), kind)
        expected = text if len(text) == 8 else "********"
        assert message.status[0].values[0].value == expected


def test_sequences_of_messages_are_as_long_as_the_highest_index() -> None:
    mapping: dict[str, object] = {"status[2].name": "=third", "status[0].level": "level"}
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    message = message_of(kind, mapping, {"level": np.array(1, np.uint8)})
    assert [(s.name, s.level) for s in message.status] == [("", 1), ("", 0), ("third", 0)]


def test_one_state_may_fill_several_fields() -> None:
    mapping: dict[str, object] = {"linear": "v", "angular": "v", "linear_": 0}
    del mapping["linear_"]
    arrays = {"v": np.array([1, 2, 3], np.float32)}
    message = message_of("geometry_msgs/msg/Twist", mapping, arrays)
    assert (message.linear.y, message.angular.z) == (2, 3)


def test_an_encoder_without_states_returns_its_constant_bytes() -> None:
    raw = Encoder.build(publish("std_msgs/msg/String", {"data": "=hello"}), {}).encode()
    message = zero_message("std_msgs/msg/String")
    object.__setattr__(message, "data", "hello")
    assert raw == serialize(message)


def test_an_empty_message_has_one_byte() -> None:
    assert Encoder.build(publish("std_msgs/msg/Empty", {}), {}).encode() == b"\0\1\0\0\0"


def test_what_goes_out_comes_in_again() -> None:
    encoder, buffer = joints(20)
    got = np.zeros_like(buffer)
    arrays = {k: got[i * 20 : (i + 1) * 20] for i, k in enumerate("pve")}
    shuffled = [f"j{k}" for k in np.random.default_rng(0).permutation(20)]
    mapping: dict[str, object] = {"name": "$n", "position": "p", "velocity": "v", "effort": "e"}
    decoder = Decoder.build(subscribe(JOINT_STATE, mapping), arrays, None, {"n": shuffled})
    assert decoder.decode(encoder.encode())
    order = [int(name[1:]) for name in shuffled]
    np.testing.assert_array_equal(got.reshape(3, 20), buffer.reshape(3, 20)[:, order])
