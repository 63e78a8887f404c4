"""What decoders do with names, counts, values and constants that are not as expected."""

from __future__ import annotations

import gc
import weakref
from typing import Any

import numpy as np
import pytest
from map_helpers import JAZZY, NAMES, fields, serialize, subscribe, zero_message

from unicon_msgs_map import Decoder, MapStateError, Messages, SubscribeSpec, parse_map

JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_state(
    names: tuple[str, ...] = NAMES, *, frame: str = "", little: bool = True, **parts: Any
) -> bytes:
    """Return the bytes of a JointState; parts default to 1, 2, 3 … times 1, 10 and 100."""
    message = zero_message(JOINT_STATE)
    message.name[:] = names
    object.__setattr__(message.header, "frame_id", frame)
    for k, part in enumerate(("position", "velocity", "effort")):
        values = parts.get(part, [(1.0 + NAMES.index(n)) * 10**k for n in names if n in NAMES])
        object.__setattr__(message, part, np.asarray(values, np.float64))
    return serialize(message, little=little)


class Joints:
    """A JointState decoder into three states of six joints."""

    def __init__(self, dtype: Any = np.float32, **policies: Any) -> None:
        self.buffer = np.full(18, -1, dtype)
        self.pos, self.vel, self.effort = self.buffer[:6], self.buffer[6:12], self.buffer[12:]
        mapping: dict[str, object] = {"name": "$names", "position": "pos"}
        mapping |= {"velocity": "vel", "effort": "effort"}
        arrays = {"pos": self.pos, "vel": self.vel, "effort": self.effort}
        self.decoder = Decoder.build(
            subscribe(JOINT_STATE, mapping, **policies), arrays, None, {"names": NAMES}
        )

    def refused(self, raw: bytes) -> str:
        """Decode what must be refused; return the reason."""
        before = self.buffer.copy()
        rejected = self.decoder.rejected
        assert not self.decoder.decode(raw)
        assert self.decoder.rejected == rejected + 1
        np.testing.assert_array_equal(self.buffer, before)
        return self.decoder.last_error


def test_joints_are_ordered_by_name_whatever_order_they_come_in() -> None:
    joints = Joints()
    for names in (NAMES, NAMES[::-1], (*NAMES[3:], *NAMES[:3]), NAMES):
        joints.buffer[...] = 0
        assert joints.decoder.decode(joint_state(names))
        np.testing.assert_array_equal(joints.pos, [1, 2, 3, 4, 5, 6])
        np.testing.assert_array_equal(joints.effort, [100, 200, 300, 400, 500, 600])
    assert joints.decoder.derived == 3  # the fourth found the first one's layout again


def test_names_of_equal_length_that_change_places_are_noticed() -> None:
    joints = Joints()
    first, second = list(NAMES), list(NAMES)
    i, j = NAMES.index("calf"), NAMES.index("neck")
    second[i], second[j] = second[j], second[i]  # same bytes in total, other order
    assert joints.decoder.decode(joint_state(tuple(first)))
    assert joints.decoder.decode(joint_state(tuple(second)))
    np.testing.assert_array_equal(joints.pos, [1, 2, 3, 4, 5, 6])


def test_two_publishers_that_alternate_cost_no_new_layouts() -> None:
    joints = Joints()
    one, two = joint_state(), joint_state(NAMES[:3], frame="other")
    for _ in range(5):
        assert joints.decoder.decode(one)
        assert joints.decoder.decode(two)
    assert joints.decoder.derived == 2


def test_a_frame_id_that_changes_every_time_stops_costing_layouts() -> None:
    joints = Joints()
    for k in range(50):
        assert joints.decoder.decode(joint_state(frame=f"frame_{k:04d}"))
    assert joints.decoder.derived == 2


def test_garbage_in_padding_stops_costing_layouts() -> None:
    joints = Joints()
    raw = bytearray(joint_state(frame="a"))
    assert raw[16:18] == b"a\0"
    for k in range(20):
        raw[18:20] = bytes([k, k])
        assert joints.decoder.decode(bytes(raw))
    assert joints.decoder.derived == 2


@pytest.mark.parametrize(
    ("missing", "expected"), [("hold", [1, -1, 3, -1, -1, -1]), ("zero", [1, 0, 3, 0, 0, 0])]
)
def test_missing_joints_are_held_or_zeroed_as_declared(missing: str, expected: list[int]) -> None:
    joints = Joints(missing=missing)
    for _ in range(2):
        joints.buffer[...] = -1
        assert joints.decoder.decode(joint_state((NAMES[0], NAMES[2])))
        np.testing.assert_array_equal(joints.pos, expected)


def test_missing_joints_are_an_error_where_declared() -> None:
    reason = Joints(missing="error").refused(joint_state(NAMES[:4]))
    assert "position lacks 'waist', 'neck', and missing: error is declared" in reason


def test_an_empty_velocity_is_missing() -> None:
    joints = Joints()
    assert joints.decoder.decode(joint_state(velocity=[]))
    np.testing.assert_array_equal(joints.vel, [-1] * 6)
    np.testing.assert_array_equal(joints.pos, [1, 2, 3, 4, 5, 6])
    assert "velocity lacks" in Joints(missing="error").refused(joint_state(velocity=[]))


def test_extra_joints_are_ignored_or_refused_as_declared() -> None:
    names = (*NAMES, "tail")
    raw = joint_state(names, position=[1, 2, 3, 4, 5, 6, 7], velocity=[], effort=[])
    joints = Joints()
    assert joints.decoder.decode(raw)
    np.testing.assert_array_equal(joints.pos, [1, 2, 3, 4, 5, 6])
    reason = Joints(extra="error").refused(raw)
    assert "name holds unknown 'tail', and extra: error is declared" in reason


def test_names_that_are_all_unknown_carry_nothing() -> None:
    raw = joint_state(("a", "b"), position=[1, 2], velocity=[], effort=[])
    assert "carries none of the known names" in Joints().refused(raw)


def test_no_names_are_refused_or_taken_in_order_as_declared() -> None:
    six = {"position": [1, 2, 3, 4, 5, 6], "velocity": [], "effort": []}
    reason = Joints().refused(joint_state((), **six))
    assert "name is empty, and unnamed: error is declared" in reason
    joints = Joints(unnamed="order")
    assert joints.decoder.decode(joint_state((), **six))
    np.testing.assert_array_equal(joints.pos, [1, 2, 3, 4, 5, 6])
    five = six | {"position": [1, 2, 3, 4, 5]}
    assert "position has 5 elements, not 6" in joints.refused(joint_state((), **five))


def test_counts_that_contradict_the_names_are_refused() -> None:
    reason = Joints().refused(joint_state(position=[1, 2, 3]))
    assert "position has 3 elements for 6 in name" in reason


def test_a_name_that_stands_twice_is_refused() -> None:
    reason = Joints().refused(joint_state(("hip", "hip"), position=[1, 2], velocity=[], effort=[]))
    assert "name holds 'hip' twice" in reason


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # of whatever ran before
def test_values_that_are_not_finite_are_refused_or_accepted_as_declared(
    value: float, dtype: Any
) -> None:
    good, bad = joint_state(), joint_state(effort=[1, 2, value, 4, 5, 6])
    joints = Joints(dtype)
    assert joints.decoder.decode(good)  # the layout is known: the fast path must see it too
    assert f"'calf' is {value}, and nonfinite: reject is declared" in joints.refused(bad)
    assert joints.decoder.derived == 1
    joints = Joints(dtype, nonfinite="accept")
    for _ in range(2):
        assert joints.decoder.decode(bad)
        np.testing.assert_array_equal(joints.effort, np.array([1, 2, value, 4, 5, 6], dtype))


@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # of whatever ran before
def test_numbers_beyond_float32_are_refused() -> None:
    joints = Joints()
    largest = float(np.finfo(np.float32).max)
    assert joints.decoder.decode(joint_state(position=[largest, -largest, 0, 0, 0, 0]))
    bad = joint_state(position=[1e39, 0, 0, 0, 0, 0])
    assert "'hip' is 1e+39, which float32 cannot hold" in joints.refused(bad)


def test_somebodys_numpy_error_state_does_not_reach_decode() -> None:
    joints = Joints()
    tiny = joint_state(position=[1e-320, 1e-40, 0, 0, 0, 0])
    with np.errstate(all="raise"):
        for _ in range(3):
            assert joints.decoder.decode(tiny)
            assert not joints.decoder.decode(joint_state(position=[1e39, np.nan, 0, 0, 0, 0]))
    np.testing.assert_array_equal(joints.pos[2:], [0, 0, 0, 0])
    assert joints.pos[1] == np.float32(1e-40)


@pytest.mark.parametrize("little", [True, False])
def test_many_joints_in_any_order_and_byte_order(little: bool) -> None:
    names = tuple(f"joint_{k}" for k in range(64))
    dice = np.random.default_rng(1)
    buffer = np.zeros((3, 64), np.float32)
    arrays = dict(zip(("position", "velocity", "effort"), buffer))
    mapping: dict[str, object] = {"name": "$names"} | {k: k for k in arrays}
    decoder = Decoder.build(subscribe(JOINT_STATE, mapping), arrays, None, {"names": names})
    for _ in range(4):
        order = dice.permutation(64)
        values = dice.standard_normal((3, 64))
        message = zero_message(JOINT_STATE)
        message.name[:] = [names[k] for k in order]
        for part, row in zip(arrays, values):
            object.__setattr__(message, part, row[order])
        for _ in range(2):
            buffer[...] = 0
            assert decoder.decode(serialize(message, little=little))
            np.testing.assert_array_equal(buffer, values.astype(np.float32))


def test_decode_takes_bytes_bytearrays_and_memoryviews() -> None:
    joints = Joints()
    raw = joint_state()
    for _ in range(2):
        for kind in (bytes, bytearray, memoryview):
            assert joints.decoder.decode(kind(raw))  # type: ignore[arg-type]


def test_the_stamp_of_the_last_accepted_message_is_kept() -> None:
    message = zero_message(JOINT_STATE)
    message.name[:] = NAMES
    object.__setattr__(message, "position", np.zeros(6))
    object.__setattr__(message.header.stamp, "sec", 12)
    object.__setattr__(message.header.stamp, "nanosec", 34)
    joints = Joints()
    assert joints.decoder.stamp_ns == 0
    assert joints.decoder.decode(serialize(message))
    assert joints.decoder.stamp_ns == 12_000_000_034
    object.__setattr__(message.header.stamp, "sec", 13)
    assert joints.decoder.decode(serialize(message, little=False))
    assert joints.decoder.stamp_ns == 13_000_000_034
    object.__setattr__(message.header.stamp, "sec", 99)
    assert not joints.decoder.decode(serialize(message)[:-1])
    assert joints.decoder.stamp_ns == 13_000_000_034


def test_zero_clears_what_the_decoder_writes_and_nothing_else() -> None:
    arrays = {"command": np.ones(4, np.float32), "stamp": np.ones((), np.int64)}
    mapping = {"header.stamp": "stamp", "twist.linear.x": "command[1]"}
    decoder = Decoder.build(subscribe("geometry_msgs/msg/TwistStamped", mapping), arrays)
    decoder.lapse()
    np.testing.assert_array_equal(arrays["command"], [1, 0, 1, 1])
    assert arrays["stamp"] == 1


UNSET = """\
subscribe:
  - topic: t
    type: geometry_msgs/msg/TwistStamped
    on_timeout: unset
    fields: {header.stamp: stamp, twist.linear.x: "command[1]"}
"""


def test_unset_makes_what_the_decoder_writes_nan() -> None:
    arrays = {"command": np.ones(3, np.float32), "stamp": np.ones((), np.int64)}
    decoder = Decoder.build(parse_map(UNSET).subscribe[0], arrays)
    decoder.lapse()
    np.testing.assert_array_equal(arrays["command"], [1, np.nan, 1])
    assert arrays["stamp"] == 1


def test_unset_is_for_states_that_can_be_nan() -> None:
    arrays = {"command": np.ones(3, np.int32), "stamp": np.ones((), np.int64)}
    with pytest.raises(MapStateError, match=r"unset makes a state NaN, and 'command' is int32; "):
        Decoder.build(parse_map(UNSET).subscribe[0], arrays)


def test_a_required_text_and_number_must_be_there() -> None:
    arrays = {"pos": np.zeros(3, np.float32)}
    mapping = {"header.frame_id": "=map", "pose.orientation.w": 1, "pose.position": "pos"}
    decoder = Decoder.build(subscribe("geometry_msgs/msg/PoseStamped", mapping), arrays)
    message = zero_message("geometry_msgs/msg/PoseStamped")
    object.__setattr__(message.pose.position, "x", 5.0)
    object.__setattr__(message.pose.orientation, "w", 1.0)
    assert not decoder.decode(serialize(message))
    assert "header.frame_id is '', not the required 'map'" in decoder.last_error
    object.__setattr__(message.header, "frame_id", "map")
    assert decoder.decode(serialize(message))
    object.__setattr__(message.header, "frame_id", "mop")
    assert not decoder.decode(serialize(message))
    object.__setattr__(message.header, "frame_id", "map")
    object.__setattr__(message.pose.orientation, "w", 0.5)
    assert not decoder.decode(serialize(message))
    assert "pose.orientation.w is 0.5, not the required 1.0" in decoder.last_error
    object.__setattr__(message.pose.orientation, "w", 1.0)
    assert decoder.decode(serialize(message))
    assert decoder.rejected == 3


@pytest.mark.parametrize("nonfinite", ["reject", "accept"])
@pytest.mark.parametrize("first", ["good", "bad"])
def test_a_needed_orientation_must_be_one(nonfinite: str, first: str) -> None:
    kind, quat, rate = "sensor_msgs/msg/Imu", np.full(4, 9, np.float32), np.full(3, 9, np.float32)
    mapping: dict[str, object] = {"orientation": "quat", "angular_velocity": "rate"}
    decoder = Decoder.build(
        subscribe(kind, mapping, nonfinite=nonfinite), {"quat": quat, "rate": rate}
    )

    def imu(w: float, x: float = 0.0, covariance: float = 0.0) -> bytes:
        message = zero_message(kind)
        object.__setattr__(message.orientation, "w", w)
        object.__setattr__(message.orientation, "x", x)
        object.__setattr__(message.angular_velocity, "x", w)
        message.orientation_covariance[0] = covariance
        return serialize(message)

    assert decoder.decode(imu(0.0))  # nobody needs it yet
    decoder.need_orientation("quat")
    if first == "good":
        assert decoder.decode(imu(0.8, -0.6))
        np.testing.assert_array_equal(quat, np.float32([0.8, -0.6, 0, 0]))
    before = [*quat, *rate]
    for raw, reason in (
        (imu(0.0), "norm is 0, not 1"),
        (imu(0.9), "norm is 0.9, not 1"),
        (imu(1.0, 1.0), "norm is 1.41421, not 1"),
        (imu(np.nan), "nan"),
        (imu(np.inf), "inf"),
        (imu(1.0, covariance=-1.0), "orientation_covariance[0] is -1: it has no orientation"),
    ):
        assert not decoder.decode(raw)
        assert reason in decoder.last_error
        assert [*quat, *rate] == before
    assert decoder.decode(imu(1.0, covariance=-0.5))
    np.testing.assert_array_equal(quat, [1, 0, 0, 0])
    derived = decoder.derived
    assert decoder.decode(imu(-0.6, 0.8))
    assert decoder.derived == derived  # the fast path looks as well
    assert not decoder.decode(imu(0.5))


def test_a_needed_orientation_that_does_not_come_is_refused() -> None:
    kind = "geometry_msgs/msg/PoseArray"
    quat, message = np.zeros(4, np.float32), zero_message(kind)
    message.poses.extend(zero_message("geometry_msgs/msg/Pose") for _ in range(2))
    decoder = Decoder.build(subscribe(kind, {"poses[1].orientation": "quat"}), {"quat": quat})
    decoder.need_orientation("quat")
    assert not decoder.decode(serialize(message))
    object.__setattr__(message.poses[1].orientation, "z", 1.0)
    assert decoder.decode(serialize(message))
    assert decoder.decode(serialize(message))
    message.poses.pop()
    assert not decoder.decode(serialize(message))


def test_a_first_message_with_a_wrong_number_teaches_nothing_wrong() -> None:
    arrays = {"x": np.zeros((), np.float32)}
    mapping = {"orientation.w": 1, "position.x": "x"}
    decoder = Decoder.build(subscribe("geometry_msgs/msg/Pose", mapping), arrays)
    message = zero_message("geometry_msgs/msg/Pose")
    object.__setattr__(message.position, "x", 5.0)
    for _ in range(3):
        assert not decoder.decode(serialize(message))
    assert arrays["x"] == 0


def numbers() -> Messages:
    """Return a store with a type of integers and floats."""
    store = Messages("jazzy")
    store.register(
        {
            "own_msgs/msg/Numbers": "int64 big\nuint64 huge\nint32[] list\n"
            "float64 real\nbool flag\nbool[12] flags\n"
        }
    )
    return store


@pytest.mark.parametrize(
    ("path", "dtype", "good", "bad"),
    [
        ("big", np.int8, -128, -129),
        ("big", np.uint16, 65535, 65536),
        ("huge", np.int64, 2**63 - 1, 2**63),
        ("real", np.int16, -32768.0, -32769.0),
        ("real", np.int32, 7.4, np.nan),
        ("real", np.uint8, 254.6, np.inf),
    ],
)
def test_integers_that_a_state_cannot_hold_are_refused(
    path: str, dtype: Any, good: float, bad: float
) -> None:
    store = numbers()
    arrays = {"s": np.zeros((), dtype)}
    spec = subscribe("own_msgs/msg/Numbers", {path: "s"}, store, nonfinite="accept")
    decoder = Decoder.build(spec, arrays)
    message = zero_message("own_msgs/msg/Numbers", store)
    for _ in range(2):
        object.__setattr__(message, path, good)
        assert decoder.decode(serialize(message, store)), decoder.last_error
        assert arrays["s"] == round(good)
        object.__setattr__(message, path, bad)
        assert not decoder.decode(serialize(message, store))
        assert "cannot hold" in decoder.last_error
        assert arrays["s"] == round(good)


def test_a_long_list_of_integers_narrows_only_where_it_fits() -> None:
    store = numbers()
    arrays = {"s": np.zeros(20, np.int8)}
    decoder = Decoder.build(subscribe("own_msgs/msg/Numbers", {"list": "s"}, store), arrays)
    message = zero_message("own_msgs/msg/Numbers", store)
    object.__setattr__(message, "list", np.arange(-10, 10, dtype=np.int32))
    for _ in range(2):
        assert decoder.decode(serialize(message, store))
        np.testing.assert_array_equal(arrays["s"], np.arange(-10, 10))
    message.list[7] = 300
    assert not decoder.decode(serialize(message, store))
    np.testing.assert_array_equal(arrays["s"], np.arange(-10, 10))


def test_booleans_of_any_nonzero_byte_are_true() -> None:
    store = numbers()
    arrays = {"flags": np.zeros(12, np.bool_), "count": np.zeros((), np.float32)}
    mapping = {"flags": "flags", "flag": "count"}
    decoder = Decoder.build(subscribe("own_msgs/msg/Numbers", mapping, store), arrays)
    message = zero_message("own_msgs/msg/Numbers", store)
    raw = bytearray(serialize(message, store))
    raw[-1], raw[-3], raw[-13] = 255, 2, 77
    for _ in range(2):
        assert decoder.decode(bytes(raw))
        np.testing.assert_array_equal(arrays["flags"], [False] * 9 + [True, False, True])
        assert arrays["count"] == 1.0


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (b"", "0 bytes are not a CDR payload"),
        (b"\0\1\0", "3 bytes are not a CDR payload"),
        (b"\0\3\0\0" + bytes(60), "encapsulation 0x0003 is not plain CDR"),
        (b"\0\1\0\0" + bytes(47), "float64 at 44 runs past the end (51 bytes)"),
        (b"\0\1\0\0" + bytes(52), "4 bytes are left over behind a whole geometry_msgs/msg/Twist"),
    ],
)
def test_malformed_payloads_are_described(path: bytes, reason: str) -> None:
    mapping = {"linear.x": "v", "angular.z": "w"}
    arrays = {"v": np.zeros(()), "w": np.zeros(())}
    decoder = Decoder.build(subscribe("geometry_msgs/msg/Twist", mapping), arrays)
    assert not decoder.decode(path)
    assert reason in decoder.last_error
    assert decoder.last_error.startswith("topic (geometry_msgs/msg/Twist): ")
    assert decoder.decode(b"\0\1\0\0" + bytes(48))
    assert decoder.decode(b"\0\1\0\0" + bytes(51))  # a writer may pad to a multiple of four


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ((12, b"\xff\xff\xff\xff"), "a string of 4294967295 bytes at 12 runs past the end"),
        ((20, b"\xff\xff\xff\x7f"), "a sequence of 2147483647 at 20 runs past the end"),
        ((24, b"\xff\xff\xff\x0f"), "a string of 268435455 bytes at 24 runs past the end"),
        ((31, b"x"), "the string at 24 does not end in NUL"),
        ((28, b"\xff"), "the string at 24 is not UTF-8"),
    ],
)
def test_lengths_and_texts_that_cannot_be_are_described(
    change: tuple[int, bytes], reason: str
) -> None:
    raw = bytearray(joint_state())
    assert raw[24:32] == b"\4\0\0\0hip\0"
    raw[change[0] : change[0] + len(change[1])] = change[1]
    assert reason in Joints().refused(bytes(raw))


def test_bounds_of_strings_and_sequences_hold() -> None:
    store, loose = Messages("jazzy"), Messages("jazzy")
    name = "own_msgs/msg/Bounded"
    store.register({name: "int32 a\nstring<=3 s\nint32[<=2] l\n"})
    loose.register({name: "int32 a\nstring s\nint32[] l\n"})
    arrays = {"a": np.zeros((), np.int32)}
    decoder = Decoder.build(subscribe(name, {"a": "a"}, store), arrays)
    make = loose.store.types[name]
    assert decoder.decode(serialize(make(1, "abc", np.zeros(2, np.int32)), loose))
    assert not decoder.decode(serialize(make(1, "abcd", np.zeros(2, np.int32)), loose))
    assert "longer than its bound of 3" in decoder.last_error
    assert not decoder.decode(serialize(make(1, "abc", np.zeros(3, np.int32)), loose))
    assert "a sequence of 3 at 16 exceeds its bound of 2" in decoder.last_error


def test_padding_between_many_names_may_be_anything() -> None:
    """Fast CDR leaves padding as it finds it; every structural byte still counts."""
    names = tuple("j" * (1 + k % 4) + f"{k:02d}" for k in range(30))
    state = np.zeros(30, np.float32)
    mapping: dict[str, object] = {"name": "$n", "position": "p"}
    decoder = Decoder.build(subscribe(JOINT_STATE, mapping), {"p": state}, None, {"n": names})
    message = zero_message(JOINT_STATE)
    message.name[:] = names
    object.__setattr__(message, "position", np.arange(30.0))
    raw = bytearray(serialize(message))
    padding = [17, 18, 19]  # behind the empty frame_id
    at = 24
    for name in names:
        end = at + 4 + len(name) + 1
        at = end + -end % 4
        padding += range(end, at)
    dice = np.random.default_rng(0)
    for _ in range(10):
        for k in padding:
            raw[k] = int(dice.integers(256))
        state[...] = 0
        assert decoder.decode(bytes(raw))
        np.testing.assert_array_equal(state, np.arange(30))
    assert decoder.derived == 2
    for k in range(4, at + 4):  # a change anywhere in the structure is seen
        if k in padding or 4 <= k < 12:
            continue
        changed = bytearray(raw)
        changed[k] ^= 1
        derived, rejected = decoder.derived, decoder.rejected
        decoder.decode(bytes(changed))
        assert (decoder.derived, decoder.rejected) != (derived, rejected), k
        assert decoder.decode(bytes(raw))


class Twelve:
    """A decoder of twelve joints, whose numbers come evenly spaced, and messages for it."""

    def __init__(self) -> None:
        self.names = tuple(f"joint_{k:02d}" for k in range(12))
        self.buffer = np.zeros((3, 12), np.float32)
        arrays = dict(zip(("position", "velocity", "effort"), self.buffer))
        mapping: dict[str, object] = {"name": "$names"} | {k: k for k in arrays}
        self.decoder = Decoder.build(
            subscribe(JOINT_STATE, mapping), arrays, None, {"names": self.names}
        )

    def message(self, values: Any, order: list[int]) -> bytearray:
        message = zero_message(JOINT_STATE)
        message.name[:] = [self.names[k] for k in order]
        for part, row in zip(("position", "velocity", "effort"), values):
            object.__setattr__(message, part, row[order])
        return bytearray(serialize(message))


@pytest.mark.parametrize("order", [range(12), range(11, -1, -1), (*range(6, 12), *range(6))])
def test_garbage_between_evenly_spaced_numbers_changes_nothing(order: Any) -> None:
    joints, order = Twelve(), list(order)
    values = np.random.default_rng(0).standard_normal((3, 12))
    raw = joints.message(values, order)
    # Three arrays end the message: 12 doubles each, a length and its padding before each.
    gaps = [len(raw) - k * 96 - (k - 1) * 8 - 4 for k in (1, 2)]
    assert all(raw[gap - 4 : gap + 4] == bytes([12, 0, 0, 0, 0, 0, 0, 0]) for gap in gaps)
    for filled in (0x00, 0x7F, 0xFF):  # of a number these would make one too large
        for gap in gaps:
            raw[gap : gap + 4] = bytes([filled] * 4)
        joints.buffer[...] = 0
        assert joints.decoder.decode(bytes(raw))
        np.testing.assert_array_equal(joints.buffer, values.astype(np.float32))
        assert joints.decoder.fast(bytes(raw))
    assert joints.decoder.derived == 1


@pytest.mark.parametrize("garbage", [False, True])
@pytest.mark.parametrize("wrong", [np.nan, -np.inf, 1e39])
def test_one_wrong_number_among_evenly_spaced_ones_is_found(wrong: float, garbage: bool) -> None:
    joints, order = Twelve(), list(range(12))
    assert joints.decoder.decode(bytes(joints.message(np.ones((3, 12)), order)))
    for place in [(0, 0), (0, 11), (1, 5), (2, 0), (2, 11)]:
        values = np.full((3, 12), 2.0)
        values[place] = wrong
        raw = joints.message(values, order)
        if garbage:
            raw[-100:-96] = bytes([0x7F] * 4)
        rejected = joints.decoder.rejected
        assert not joints.decoder.decode(bytes(raw))
        assert joints.decoder.rejected == rejected + 1
        np.testing.assert_array_equal(joints.buffer, 1.0)


def test_states_outlive_their_names_while_a_decoder_writes_them() -> None:
    arrays = {name: np.zeros(12, np.float32) for name in ("a", "b")}
    mapping: dict[str, object] = {"position": "a", "velocity": "b"}
    decoder = Decoder.build(subscribe(JOINT_STATE, mapping), arrays)
    message = zero_message(JOINT_STATE)
    for part in ("position", "velocity"):
        object.__setattr__(message, part, np.arange(12.0))
    raw = serialize(message)
    assert decoder.decode(raw)
    function = decoder.fast
    alive = [weakref.ref(array) for array in arrays.values()]
    del arrays, decoder
    gc.collect()
    assert function(raw)
    assert all(ref() is not None for ref in alive)


def test_room_that_rclpy_leaves_behind_empty_sequences_is_accepted() -> None:
    joints = Joints()
    raw = joint_state(velocity=[], effort=[])
    for rest in (0, 4, 8, 16):
        assert joints.decoder.decode(raw + bytes(rest)), joints.decoder.last_error
    assert "20 bytes are left over" in joints.refused(raw + bytes(20))
    assert "4 bytes are left over" in joints.refused(joint_state() + bytes(4))


def test_rclpy_reads_and_writes_the_same() -> None:
    messages = pytest.importorskip("sensor_msgs.msg", reason="needs rclpy and its messages")
    from rclpy.serialization import deserialize_message, serialize_message

    for parts in ({}, {"velocity": [], "effort": []}, {"position": []}):
        joints = Joints()
        message = deserialize_message(joint_state(frame="base", **parts), messages.JointState)
        assert list(message.name) == list(NAMES)
        for _ in range(3):
            assert joints.decoder.decode(serialize_message(message)), joints.decoder.last_error
        for state, part in ((joints.pos, "position"), (joints.effort, "effort")):
            expected = getattr(message, part) or [-1] * 6
            np.testing.assert_array_equal(state, expected)


def test_two_elements_of_the_wanted_key_are_refused() -> None:
    arrays = {"pos": np.zeros(3, np.float32)}
    path = "transforms[child_frame_id=base].transform.translation"
    decoder = Decoder.build(subscribe("tf2_msgs/msg/TFMessage", {path: "pos"}), arrays)
    message = zero_message("tf2_msgs/msg/TFMessage")
    item = zero_message("geometry_msgs/msg/TransformStamped")
    object.__setattr__(item, "child_frame_id", "base")
    object.__setattr__(item.transform.translation, "x", 1.0)
    message.transforms[:] = [item]
    assert decoder.decode(serialize(message))
    message.transforms[:] = [item, item]
    assert not decoder.decode(serialize(message))
    assert "two elements have child_frame_id 'base'" in decoder.last_error
    message.transforms[:] = []
    assert not decoder.decode(serialize(message))
    assert "carries none of the mapped elements" in decoder.last_error


def test_unread_arrays_of_messages_are_skipped_at_any_length() -> None:
    """Elements of 24 bytes whose padding depends on where they start."""
    store = Messages("jazzy")
    store.register({"own_msgs/msg/Item": "uint8 a\nfloat64 b\nuint8 c\n"})
    store.register({"own_msgs/msg/Big": "Item[] items\nfloat64 last\n"})
    make, item = store.store.types["own_msgs/msg/Big"], store.store.types["own_msgs/msg/Item"]
    arrays = {"last": np.zeros(())}
    decoder = Decoder.build(subscribe("own_msgs/msg/Big", {"last": "last"}, store), arrays)
    for count in (0, 1, 2, 3, 9, 1000):
        raw = serialize(make([item(1, 2.0, 3)] * count, 7.0 + count), store)
        assert decoder.decode(raw), decoder.last_error
        assert arrays["last"] == 7.0 + count
        assert not decoder.decode(raw[:-9])


def test_layouts_kept_are_few() -> None:
    joints = Joints()
    for k in range(1, 7):
        assert joints.decoder.decode(joint_state(NAMES[:k]))
    assert len(joints.decoder.kept) == 4


def test_specs_without_a_policy_have_the_documented_ones() -> None:
    spec = SubscribeSpec("t", JOINT_STATE, fields({"position": "p"}), JAZZY)
    found = (spec.missing, spec.extra, spec.unnamed, spec.nonfinite, spec.on_timeout)
    assert found == ("hold", "ignore", "error", "reject", "zero")
