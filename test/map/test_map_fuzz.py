"""Random, cut and mutated payloads: never an exception, never a wrong value, never a partial write.

The judge is slow and separate: rosbags parses the payload, and a few lines per message type say
what the states must then hold.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from map_helpers import JAZZY, MAPS, NAMES, serialize, subscribe, zero_message

from unicon_msgs_map import Decoder, Messages, load_map

F32_MAX = float(np.finfo(np.float32).max)
Judge = Callable[[Any, dict[str, np.ndarray]], bool]


class No(Exception):
    """The message must be refused."""


@dataclass
class Case:
    """A decoder, payloads that it accepts, and the judge of what it must do with any other."""

    decoder: Decoder
    arrays: dict[str, np.ndarray]
    payloads: list[bytes]
    judge: Callable[[Any], dict[str, Any]]
    messages: Messages = JAZZY


def assign(message: Any, path: str, value: Any) -> None:
    *owners, last = path.split(".")
    for owner in owners:
        message = getattr(message, owner)
    object.__setattr__(message, last, value)


def finite(values: Any) -> np.ndarray:
    """Return values that float32 states take, or refuse."""
    values = np.atleast_1d(np.asarray(values, np.float64))
    if not np.isfinite(values).all() or (np.abs(values) > F32_MAX).any():
        raise No
    return values.astype(np.float32)


def by_name(
    arrays: dict[str, np.ndarray], names: list[str], parts: dict[str, Any]
) -> dict[str, Any]:
    """Order arrays by name; what is missing stays as it is (the default policies)."""
    found, carried = {}, 0
    for state, values in parts.items():
        new = arrays[state].copy()
        if len(values):
            if len(names) != len(values) or len(set(names)) != len(names):
                raise No
            for name, value in zip(names, values):
                if name in NAMES:
                    new[NAMES.index(name)] = finite(value)[0]
                    carried += 1
        found[state] = new
    if not carried:
        raise No
    return found


def joint_state() -> Case:
    arrays = {name: np.zeros(6, np.float32) for name in ("pos", "vel", "effort")}
    fields = {"name": "$names", "position": "pos", "velocity": "vel", "effort": "effort"}
    spec = subscribe("sensor_msgs/msg/JointState", fields)
    payloads = []
    for names, little in ((NAMES, True), (NAMES[::-1], True), (NAMES[1:4], False)):
        message = zero_message(spec.type)
        message.name[:] = names
        assign(message, "header.frame_id", "base")
        for k, part in enumerate(("position", "velocity", "effort")):
            assign(message, part, np.arange(len(names)) + 10.0 * k + 1)
        payloads.append(serialize(message, little=little))
    return Case(
        Decoder.build(spec, arrays, None, {"names": NAMES}),
        arrays,
        payloads,
        lambda m: by_name(
            arrays, m.name, {"pos": m.position, "vel": m.velocity, "effort": m.effort}
        ),
    )


def trajectory() -> Case:
    arrays = {"pos": np.zeros(6, np.float32)}
    fields = {"joint_names": "$names", "points[0].positions": "pos"}
    spec = subscribe("trajectory_msgs/msg/JointTrajectory", fields)
    message = zero_message(spec.type)
    message.joint_names[:] = NAMES
    for k in range(3):
        point = zero_message("trajectory_msgs/msg/JointTrajectoryPoint")
        assign(point, "positions", np.arange(6.0) + k)
        message.points.append(point)
    return Case(
        Decoder.build(spec, arrays, None, {"names": NAMES}),
        arrays,
        [serialize(message), serialize(message, little=False)],
        lambda m: by_name(
            arrays, m.joint_names, {"pos": m.points[0].positions if m.points else []}
        ),
    )


def twist() -> Case:
    arrays = {"command": np.zeros(3, np.float32)}
    fields = {
        f"{part}": f"command[{k}]" for k, part in enumerate(("linear.x", "linear.y", "angular.z"))
    }
    spec = subscribe("geometry_msgs/msg/Twist", fields)
    message = zero_message(spec.type)
    assign(message, "linear.x", 0.5)
    assign(message, "angular.z", -0.25)
    return Case(
        Decoder.build(spec, arrays),
        arrays,
        [serialize(message), serialize(message, little=False)],
        lambda m: {"command": finite([m.linear.x, m.linear.y, m.angular.z])},
    )


def odometry() -> Case:
    arrays = {"quat": np.zeros(4, np.float32), "stamp": np.zeros((), np.int64)}
    arrays["pos"] = np.zeros(3, np.float64)
    fields = {"header.stamp": "stamp", "child_frame_id": "=base_link"}
    fields |= {"pose.pose.orientation": "quat", "pose.pose.position": "pos"}
    spec = subscribe("nav_msgs/msg/Odometry", fields)
    message = zero_message(spec.type)
    assign(message, "child_frame_id", "base_link")
    assign(message, "header.frame_id", "odom")
    assign(message, "pose.pose.orientation.w", 1.0)

    def judge(m: Any) -> dict[str, Any]:
        if m.child_frame_id != "base_link":
            raise No
        q, p = m.pose.pose.orientation, np.array([getattr(m.pose.pose.position, a) for a in "xyz"])
        if not np.isfinite(p).all():
            raise No
        stamp = m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
        return {"quat": finite([q.w, q.x, q.y, q.z]), "pos": p, "stamp": np.array(stamp)}

    payloads = [serialize(message), serialize(message, little=False)]
    return Case(Decoder.build(spec, arrays), arrays, payloads, judge)


def transforms() -> Case:
    arrays = {"pos": np.zeros(3, np.float32)}
    path = "transforms[child_frame_id=base].transform.translation"
    spec = subscribe("tf2_msgs/msg/TFMessage", {path: "pos"})
    message = zero_message(spec.type)
    for child in ("arm", "base", "leg"):
        item = zero_message("geometry_msgs/msg/TransformStamped")
        assign(item, "child_frame_id", child)
        assign(item, "transform.translation.x", float(len(message.transforms)))
        message.transforms.append(item)

    def judge(m: Any) -> dict[str, Any]:
        found = [t.transform.translation for t in m.transforms if t.child_frame_id == "base"]
        if len(found) != 1:
            raise No
        return {"pos": finite([found[0].x, found[0].y, found[0].z])}

    return Case(Decoder.build(spec, arrays), arrays, [serialize(message)], judge)


def low_state() -> Case:
    mapping = load_map(MAPS / "unitree_go.yaml")
    spec = mapping.subscribe[0]
    sizes = {"base_quat": 4, "base_ang_vel": 3, "base_lin_acc": 3}
    arrays = {name: np.zeros(sizes.get(name, 12), np.float32) for name in spec.states}
    message = zero_message(spec.type, mapping.messages)
    for k, motor in enumerate(message.motor_state):
        assign(motor, "q", float(k))

    def judge(m: Any) -> dict[str, Any]:
        motors = m.motor_state[:12]
        return {
            "base_quat": finite(m.imu_state.quaternion),
            "base_ang_vel": finite(m.imu_state.gyroscope),
            "base_lin_acc": finite(m.imu_state.accelerometer),
            "joint_pos": finite([motor.q for motor in motors]),
            "joint_vel": finite([motor.dq for motor in motors]),
            "joint_effort": finite([motor.tau_est for motor in motors]),
        }

    store = mapping.messages
    payloads = [serialize(message, store), serialize(message, store, little=False)]
    return Case(Decoder.build(spec, arrays), arrays, payloads, judge, store)


def multi_array() -> Case:
    arrays = {"data": np.zeros(12, np.float32)}
    spec = subscribe(
        "std_msgs/msg/Float64MultiArray", {"data": "data"}, missing="error", extra="error"
    )
    message = zero_message(spec.type)
    dimension = zero_message("std_msgs/msg/MultiArrayDimension")
    assign(dimension, "label", "joints")
    message.layout.dim.append(dimension)
    assign(message, "data", np.arange(12.0))

    def judge(m: Any) -> dict[str, Any]:
        if len(m.data) != 12:
            raise No
        return {"data": finite(m.data)}

    return Case(Decoder.build(spec, arrays), arrays, [serialize(message)], judge)


CASES = (joint_state, trajectory, twist, odometry, transforms, low_state, multi_array)
SPECIAL = (math.nan, math.inf, 1e300, -1e39, 3.5e38, 0.0, 1.0)


def mutate(raw: bytes, dice: random.Random) -> bytes:
    """Return a payload that was cut, stretched, or had bits, words or numbers changed."""
    data = bytearray(raw)
    for _ in range(dice.choice((1, 1, 1, 2, 4))):
        kind = dice.randrange(9)
        at = dice.randrange(len(data)) if data else 0
        if kind == 0:
            del data[at:]
        elif kind == 1:
            data += dice.randbytes(dice.randrange(1, 9))
        elif kind == 2 and data:
            data[at] ^= 1 << dice.randrange(8)
        elif kind == 3 and data:
            data[at] = dice.randrange(256)
        elif kind == 4:
            del data[at : at + dice.randrange(1, 9)]
        elif kind == 5:
            data[at:at] = dice.randbytes(dice.randrange(1, 9))
        elif kind == 6 and len(data) > 8:  # a length word, most likely
            word = 4 * dice.randrange(1, len(data) // 4)
            value = dice.choice((0, 1, 2, 3, 5, 7, 255, 1 << 16, 1 << 31, (1 << 32) - 1))
            data[word : word + 4] = struct.pack("<I", value)
        elif kind == 7 and len(data) > 16:
            word = 4 + 4 * dice.randrange((len(data) - 12) // 4)
            data[word : word + 8] = struct.pack(dice.choice("<>") + "d", dice.choice(SPECIAL))
        elif data:
            data = bytearray(dice.randbytes(dice.randrange(len(raw) + 8)))
    return bytes(data)


def check(case: Case, raw: bytes) -> str:
    """Decode a payload and compare with the judge; return what happened."""
    kind = case.decoder.spec.type
    before = {name: state.copy() for name, state in case.arrays.items()}
    counts = case.decoder.received, case.decoder.rejected
    accepted = case.decoder.decode(raw)
    assert (case.decoder.received, case.decoder.rejected) == (
        counts[0] + accepted,
        counts[1] + (not accepted),
    )
    after = {name: state.copy() for name, state in case.arrays.items()}
    if not accepted:
        assert case.decoder.last_error
        for name, state in after.items():
            np.testing.assert_array_equal(state, before[name], err_msg=name)
    try:
        message = case.messages.store.deserialize_cdr(raw, kind)
    except Exception as error:
        reason = str(error)
    else:
        reason = ""
    if "mismatch" in reason and accepted:
        message, reason = without_rest(case, raw), ""
    if reason:
        # Texts that nobody reads may be anything; FastCDR reads length 0 as an empty one.
        assert not accepted or "decode byte" in reason or "length 0" in reason, reason
        return "unread text" if accepted else "malformed"
    if raw[:2] not in (b"\x00\x00", b"\x00\x01"):  # rosbags looks at the second byte only
        assert not accepted
        return "encapsulation"
    for name, state in before.items():  # the judge keeps what a message lacks
        case.arrays[name][...] = state
    try:
        with np.errstate(all="ignore"):
            expected = case.judge(message)
    except No:
        assert not accepted, (kind, raw)
        return "refused"
    assert accepted, (case.decoder.last_error, raw)
    for name, state in after.items():
        np.testing.assert_array_equal(state, expected[name], err_msg=name)
        case.arrays[name][...] = state
    return "accepted"


def without_rest(case: Case, raw: bytes) -> Any:
    """Return the message in front of bytes that rclpy's serialize_message() leaves behind it."""
    for rest in range(4, 60):
        try:
            return case.messages.store.deserialize_cdr(raw[:-rest], case.decoder.spec.type)
        except Exception:
            continue
    raise AssertionError("accepted what is not a message at all")


def fuzz(make: Callable[[], Case], count: int, seed: int) -> dict[str, int]:
    case, dice = make(), random.Random(seed)
    seen: dict[str, int] = {}
    with np.errstate(all="raise"):
        for _ in range(count):
            raw = dice.choice(case.payloads)
            if dice.random() < 0.9:
                raw = mutate(raw, dice)
            verdict = check(case, raw)
            seen[verdict] = seen.get(verdict, 0) + 1
    return seen


@pytest.mark.parametrize("make", CASES)
@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # of whatever ran before
def test_mutated_payloads_are_read_right_or_refused(make: Callable[[], Case]) -> None:
    seen = fuzz(make, 750, seed=7)
    assert seen["malformed"] > 50, seen
    assert seen["accepted"] > 100, seen


@pytest.mark.slow
@pytest.mark.parametrize("make", CASES)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # of whatever ran before
def test_a_hundred_thousand_mutated_payloads(make: Callable[[], Case], seed: int) -> None:
    seen = fuzz(make, 100_000 // (4 * len(CASES)) + 1, seed=100 + seed)
    assert seen["malformed"] > 100, seen
    assert seen["accepted"] > 100, seen


@pytest.mark.parametrize("make", CASES)
def test_every_cut_of_a_payload_is_refused(make: Callable[[], Case]) -> None:
    case = make()
    for raw in case.payloads:
        for length in range(len(raw)):
            verdict = check(case, raw[:length])
            # Up to three bytes behind the last number may be padding that a writer left out.
            assert verdict in ("malformed", "refused"), (length, len(raw))
    assert case.decoder.received == 0


def test_random_bytes_as_any_type_never_raise() -> None:
    dice = random.Random(3)
    for make in CASES:
        case = make()
        for _ in range(200):
            check(case, b"\0" + dice.randbytes(1 + dice.randrange(200)))
