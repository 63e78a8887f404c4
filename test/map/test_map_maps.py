"""Every ready map: loads, builds, and says to rosbags what the states hold, both ways."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from map_helpers import JAZZY, MAPS, get, serialize, zero_message

from unicon_msgs_map import Decoder, Encoder, MessageMap, PublishSpec, SubscribeSpec, load_map

FILES = sorted(path.stem for path in MAPS.glob("*.yaml"))
COUNTS = {"unitree_go": 12, "unitree_hg": 29, "agibot_x2": 31}


def states(count: int) -> dict[str, np.ndarray]:
    """Return the states of a robot with `count` joints, every element another number."""
    joints = ["joint_pos", "joint_vel", "joint_effort", "joint_pos_target", "joint_vel_target"]
    joints += ["joint_effort_ff", "joint_stiffness", "joint_damping"]
    joints += ["joint_pos_command", "joint_vel_command", "joint_effort_command"]
    joints += ["joint_effort_target"]  # of platform ros alone
    sizes = dict.fromkeys(joints, count) | {"base_quat": 4, "mocap_quat": 4}
    for name in ("base_ang_vel", "base_lin_acc", "base_pos_w", "base_lin_vel", "mocap_pos_w"):
        sizes[name] = 3
    sizes |= {"velocity_command": 3, "wrench": 6, "wrench_command": 6}
    buffer = np.zeros(sum(sizes.values()), np.float32)
    found: dict[str, np.ndarray] = {}
    start = 0
    for name, size in sizes.items():
        found[name] = buffer[start : start + size]
        start += size
    for name in ("voltage", "current", "percentage"):
        found[f"battery_{name}"] = np.zeros((), np.float32)
    for name in ("base_pos_w_variance", "base_lin_vel_variance", "temperature"):
        found[name] = np.zeros((), np.float32)
    found["ambient_temperature"] = np.zeros((), np.float32)
    found["battery_level"] = np.zeros((), np.int32)
    found["driver_level"] = np.zeros((), np.int32)
    found["mode_machine"] = np.zeros((), np.uint8)
    found["motor_mode"] = np.zeros(count, np.uint8)
    found["stamp_ns"] = np.zeros((), np.int64)
    found["odometry_stamp_ns"] = np.zeros((), np.int64)
    return found


def fill(arrays: dict[str, np.ndarray]) -> None:
    """Give every element a number of its own."""
    number = 1
    for state in arrays.values():
        for index in np.ndindex(state.shape):
            state[index] = number if state.dtype.kind != "f" else number / 8
            number = number % 200 + 1
    arrays["battery_level"][...] = 2  # an octet, which rosbags reads as signed
    arrays["stamp_ns"][...] = 1_700_000_000_123_456_789


def variables(count: int) -> dict[str, object]:
    return {
        "joint_names": [f"joint_{k}" for k in range(count)],
        "robot": "go2",
        "base_frame": "base_link",
        "odom_frame": "odom",
        "imu_frame": "imu_link",
    }


def loaded(stem: str) -> tuple[MessageMap, int]:
    return load_map(MAPS / f"{stem}.yaml"), COUNTS.get(stem, 12)


def entries(kind: str) -> list[Any]:
    return [
        pytest.param(stem, spec.topic, id=f"{stem}-{spec.topic}")
        for stem in FILES
        for spec in getattr(load_map(MAPS / f"{stem}.yaml"), kind)
    ]


def spec_of(mapping: MessageMap, kind: str, topic: str) -> Any:
    return next(spec for spec in getattr(mapping, kind) if spec.topic == topic)


@pytest.mark.parametrize("stem", FILES)
def test_every_ready_map_describes_itself(stem: str) -> None:
    assert loaded(stem)[0].description.endswith(".")


@pytest.mark.parametrize(("stem", "topic"), entries("publish"))
def test_rosbags_reads_what_a_ready_map_publishes(stem: str, topic: str) -> None:
    mapping, count = loaded(stem)
    spec: PublishSpec = spec_of(mapping, "publish", topic)
    arrays = states(count)
    encoder = Encoder.build(spec, arrays, {}, variables(count))
    fill(arrays)
    raw = encoder.encode()
    assert len(raw) == encoder.size
    message = mapping.messages.store.deserialize_cdr(raw, spec.type)
    assert serialize(message, mapping.messages) == raw
    assert check_fields(spec, message, arrays, variables(count), count) > 0


@pytest.mark.parametrize(("stem", "topic"), entries("subscribe"))
@pytest.mark.parametrize("little", [True, False])
def test_a_ready_map_reads_what_rosbags_writes(stem: str, topic: str, little: bool) -> None:
    mapping, count = loaded(stem)
    spec: SubscribeSpec = spec_of(mapping, "subscribe", topic)
    message = sample(spec, mapping, count)
    raw = serialize(message, mapping.messages, little=little)
    arrays = states(count)
    decoder = Decoder.build(spec, arrays, {}, variables(count))
    for _ in range(2):
        for state in arrays.values():
            state[...] = 0
        assert decoder.decode(raw), decoder.last_error
        assert check_fields(spec, message, arrays, variables(count), count) > 0
    assert decoder.derived == 1
    decoder.lapse()
    for name in spec.states:
        if not name.endswith("stamp_ns"):
            unset = spec.on_timeout == "unset"
            left = not np.isnan(arrays[name]).all() if unset else arrays[name].any()
            assert not left or name == "velocity_command"


def sample(spec: SubscribeSpec, mapping: MessageMap, count: int) -> Any:
    """Return a message whose every mapped number is another one."""
    store = mapping.messages.store
    message = zero_message(spec.type, mapping.messages)
    names = variables(count)["joint_names"]
    short = spec.type.split("/")[-1]
    if short in ("JointState", "Float64MultiArray"):
        for field in ("position", "velocity", "effort", "data"):
            if hasattr(message, field):
                object.__setattr__(message, field, np.arange(count) / 8 + 1)
        if short == "JointState":
            message.name[:] = names
    elif short == "JointTrajectory":
        point = zero_message("trajectory_msgs/msg/JointTrajectoryPoint")
        object.__setattr__(point, "positions", np.arange(count) / 8 + 1)
        object.__setattr__(point, "velocities", np.arange(count) / 8 + 9)
        message.joint_names[:] = names
        message.points[:] = [point, zero_message("trajectory_msgs/msg/JointTrajectoryPoint")]
    elif short == "TFMessage":
        for child, x in (("camera", 3.0), ("base_link", 5.0), ("imu", 7.0)):
            item = zero_message("geometry_msgs/msg/TransformStamped")
            object.__setattr__(item, "child_frame_id", child)
            object.__setattr__(item.header, "frame_id", "odom")
            object.__setattr__(item.transform.translation, "x", x)
            object.__setattr__(item.transform.rotation, "w", x / 8)
            message.transforms.append(item)
    elif short == "DiagnosticArray":
        for name, level in (("other", 1), ("unicon: driver", 2)):
            item = zero_message("diagnostic_msgs/msg/DiagnosticStatus")
            object.__setattr__(item, "name", name)
            object.__setattr__(item, "level", level)
            message.status.append(item)
    elif short == "JointStateArray":
        names = [f.source.value for f in spec.fields if f.source.kind == "const"]
        for k, name in enumerate(names):
            figures = (1.0 + k / 8, 101.0 + k / 8, 201.0 + k / 8)
            message.joints.append(store.types["aimdk_msgs/msg/JointState"](name, *figures, 0))
    elif short == "Joy":
        object.__setattr__(message, "axes", np.arange(6, dtype=np.float32) / 8)
    number = 3
    for field in spec.fields:  # plain numbers of nested messages
        target = message
        try:
            for name, selector in field.steps[:-1]:
                target = getattr(target, name)
                assert selector is None
        except AssertionError:
            continue
        last, selector = field.steps[-1]
        held = getattr(target, last)
        if selector is None and isinstance(held, (int, float)):
            object.__setattr__(target, last, type(held)(number))
            number += 1
        elif selector is None and hasattr(held, "x"):
            for axis in "xyzw":
                if hasattr(held, axis):
                    object.__setattr__(held, axis, float(number))
                    number += 1
        elif selector is None and hasattr(held, "sec"):
            object.__setattr__(held, "sec", 17)
    if short == "LowState":
        for k, motor in enumerate(message.motor_state):
            object.__setattr__(motor, "q", 1.0 + k)
            object.__setattr__(motor, "dq", 101.0 + k)
            object.__setattr__(motor, "tau_est", 201.0 + k)
        message.imu_state.quaternion[:] = (1, 2, 3, 4)
    assert store.types[spec.type] is type(message)
    return message


def check_fields(
    spec: PublishSpec | SubscribeSpec,
    message: Any,
    arrays: dict[str, np.ndarray],
    texts: dict[str, object],
    count: int,
) -> int:
    """Compare a rosbags message with the states, field by field, the slow way."""
    checked = 0
    for field in spec.fields:
        found = [message]
        for name, selector in field.steps:
            found = [getattr(item, name) for item in found]
            if isinstance(selector, tuple):
                stop = count if selector[1] is None else selector[1]
                found = [part for item in found for part in item[selector[0] : stop]]
            elif isinstance(selector, int):
                found = [item[selector] for item in found]
            elif selector is not None:
                found = [
                    part
                    for item in found
                    for part in item
                    if getattr(part, selector.field) == selector.value
                ]
        checked += 1
        if field.source.kind == "variable":
            assert found[0] == texts[field.source.name]
            continue
        if field.source.kind == "const":
            continue
        state = arrays[field.source.name].reshape(-1)
        index = field.source.index
        if index is not None:
            assert not isinstance(index, str)
            state = state[slice(*index)] if isinstance(index, tuple) else state[index : index + 1]
        assert not isinstance(field.scale, tuple)
        held: Any = found[0] if len(found) == 1 else found
        if isinstance(held, str):
            unit = 100.0 if field.unit == "percent" else 1.0
            assert float(held) == pytest.approx(float(state[0]) * unit, abs=0.05)
            continue
        if hasattr(held, "sec"):
            held = [held.sec * 1_000_000_000 + held.nanosec]
        elif hasattr(held, "w"):
            held = [held.w, held.x, held.y, held.z]  # states are wxyz
        elif hasattr(held, "x"):
            held = [held.x, held.y, held.z]
        np.testing.assert_allclose(
            state, np.atleast_1d(np.asarray(held)) * field.scale, rtol=1e-6, err_msg=field.path
        )
        assert np.any(state) or isinstance(spec, SubscribeSpec)
    return checked


def test_the_default_map_is_what_simulators_need() -> None:
    mapping = load_map(MAPS / "default.yaml")
    assert {spec.topic: spec.type for spec in mapping.publish} == {
        "joint_states": "sensor_msgs/msg/JointState",
        "imu/data": "sensor_msgs/msg/Imu",
        "odom": "nav_msgs/msg/Odometry",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/clock": "rosgraph_msgs/msg/Clock",
    }
    (command,) = mapping.subscribe
    assert (command.topic, command.timeout, command.on_timeout) == ("cmd_vel", 0.5, "zero")
    assert command.states == ("velocity_command",)


def test_a_low_command_leaves_the_slots_without_a_motor_at_zero() -> None:
    mapping, count = loaded("unitree_hg")
    arrays = states(count)
    fill(arrays)
    raw = Encoder.build(mapping.publish[0], arrays).encode()
    message = mapping.messages.store.deserialize_cdr(raw, "unitree_hg/msg/LowCmd")
    np.testing.assert_array_equal([m.q for m in message.motor_cmd[:29]], arrays["joint_pos_target"])
    assert [m.kp for m in message.motor_cmd[29:]] == [0.0] * 6


def test_go_command_copies_all_five_motor_states_at_once() -> None:
    mapping, count = loaded("unitree_go")
    encoder = Encoder.build(mapping.publish[0], states(count))
    assert encoder.source.count("[...] =") == 1, encoder.source


def slow_crc(words: list[int]) -> int:
    """Return Unitree's checksum bit by bit, as its definition says."""
    crc = 0xFFFFFFFF
    for word in words:
        for bit in range(31, -1, -1):
            top = crc >> 31 ^ word >> bit & 1
            crc = (crc << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if top else 0)
    return crc


def c_struct(stem: str, message: Any) -> bytes:
    """Return a LowCmd as C lays it out: `=` has no padding, so it is written out."""
    go = stem == "unitree_go"
    image = b""
    if go:
        image += struct.pack("<2BBB", *message.head, message.level_flag, message.frame_reserve)
        image += struct.pack("<4IH2x", *message.sn, *message.version, message.bandwidth)
    else:
        image += struct.pack("<BB2x", message.mode_pr, message.mode_machine)
    for m in message.motor_cmd:
        reserve = list(m.reserve) if go else [m.reserve]
        numbers = (m.q, m.dq, m.tau, m.kp, m.kd)
        image += struct.pack(f"<B3x5f{len(reserve)}I", m.mode, *numbers, *reserve)
    if go:
        image += struct.pack("<4B", message.bms_cmd.off, *message.bms_cmd.reserve)
        image += bytes(message.wireless_remote) + bytes(message.led) + bytes(message.fan)
        return image + struct.pack("<BxI", message.gpio, message.reserve)
    return image + struct.pack("<4I", *message.reserve)


@pytest.mark.parametrize("stem", ["unitree_go", "unitree_hg"])
def test_low_commands_carry_the_checksum_of_their_c_struct(stem: str) -> None:
    mapping, count = loaded(stem)
    arrays = states(count)
    encoder = Encoder.build(mapping.publish[0], arrays)
    sums = set()
    for scale in (1, -3):
        fill(arrays)
        arrays["joint_pos_target"] *= scale
        message = mapping.messages.store.deserialize_cdr(encoder.encode(), encoder.spec.type)
        image = c_struct(stem, message)
        assert message.crc == slow_crc([w for (w,) in struct.iter_unpack("<I", image)])
        sums.add(message.crc)
    assert len(sums) == 2


def test_unmapped_quaternions_are_the_identity() -> None:
    imu = get(zero_message("nav_msgs/msg/Odometry"), ("pose", "pose", "orientation"))
    assert imu.w == 0.0  # rosbags has no defaults; ROS 2 and we do
    spec = PublishSpec("t", "nav_msgs/msg/Odometry", (), JAZZY)
    message = JAZZY.store.deserialize_cdr(Encoder.build(spec, {}).encode(), spec.type)
    assert message.pose.pose.orientation.w == 1.0


def test_names_used_in_the_maps_are_in_the_vocabulary_or_declared_here() -> None:
    known = set(states(1))
    for stem in FILES:
        mapping, _ = loaded(stem)
        for spec in (*mapping.publish, *mapping.subscribe):
            assert set(spec.states) <= known, (stem, spec.topic)
