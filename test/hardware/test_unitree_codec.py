"""Unitree's messages against frames of the official SDK, and against struct and a slow CRC."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import RobotError
from unicon_core.robots import Robot, load_robot
from unicon_hardware.unitree.facts import UnitreeFacts
from unicon_hardware.wire import Counts, turned
from unicon_msgs_map.layout.messages import shared_messages

ROBOTS = ("go2", "h1", "g1_29dof", "g1_23dof", "h1_2")
DEFINED = ("go_lowcmd", "go_lowstate", "go_motorcmds", "hg_lowcmd", "hg_lowstate", "hg_handcmd")
DEFINED += ("hg_handstate", "api_request", "api_response", "api_request_checkmode")
DEFINED += ("api_request_releasemode", "api_response_checkmode")

# Offset in the body of `mode` of motor 0, of motor 1, and from there on to the next; of frames of
# the official SDK. Element 0 follows the byte before it without padding.
SPACING = {
    "unitree_go/msg/LowCmd": (22, 56, 36),
    "unitree_go/msg/LowState": (77, 124, 48),
    "unitree_hg/msg/LowCmd": (2, 28, 28),
    "unitree_hg/msg/LowState": (70, 124, 56),
}
# C structs of unitree_sdk2py/utils/crc.py, for the checksum.
STRUCTS = {
    "unitree_go/msg/LowCmd": "<4B4IH2x" + "B3x5f3I" * 20 + "4B55Bx2I",
    "unitree_go/msg/LowState": "<4B4IH2x13fb3x"
    + "B3x7fb3x3I" * 20
    + "4BiH4b15H8hI41B3xf2b2x2f4h2I",
    "unitree_hg/msg/LowCmd": "<2B2x" + "B3x5fI" * 35 + "5I",
    "unitree_hg/msg/LowState": "<2I2B2xI13fh2x" + "B3x4f2hf7I" * 35 + "40B5I",
}


def golden(assets: Path, name: str) -> tuple[bytes, dict[str, Any]]:
    raw = bytes.fromhex("".join((assets / "frames" / f"dds_{name}.hex").read_text().split()))
    described = json.loads((assets / "frames" / "dds.json").read_text())[f"dds_{name}"]
    return raw, described


def type_of(described: dict[str, Any]) -> str:
    package, _, _, name = described["typename"].split(".")
    return f"{package}/msg/{name[:-1]}"


def plain(value: Any) -> Any:
    """Return a message as dds.json writes it."""
    if hasattr(value, "__dataclass_fields__"):
        names = [name for name in value.__dataclass_fields__ if name != "__msgtype__"]
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, (list, np.ndarray)):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def slow_crc(image: bytes) -> int:
    """Return Unitree's checksum bit by bit over all words but the last."""
    crc = 0xFFFFFFFF
    for (word,) in list(struct.iter_unpack("<I", image))[:-1]:
        for bit in range(31, -1, -1):
            top = crc >> 31 ^ word >> bit & 1
            crc = (crc << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if top else 0)
    return crc


@pytest.mark.parametrize("name", DEFINED)
def test_definitions_are_those_of_the_official_sdk(assets: Path, name: str) -> None:
    raw, described = golden(assets, name)
    messages, kind = shared_messages(), type_of(described)
    messages.struct(kind)
    message = messages.store.deserialize_cdr(raw, kind)
    assert plain(message) == described["fields"]
    assert bytes(messages.store.serialize_cdr(message, kind)) == raw
    again = messages.store.deserialize_cdr(raw.ljust(len(raw) + -len(raw) % 4, b"\0"), kind)
    assert plain(again) == described["fields"]


def arrays_of(robot: Robot) -> dict[str, np.ndarray]:
    """Return every array that a map may name, each element another number."""
    n, rng = robot.num_joints, np.random.default_rng(3)
    sizes = {"base_quat": 4, "base_ang_vel": 3, "base_lin_acc": 3, "temperatures": 2 * n}
    names = ("joint_pos", "joint_vel", "joint_effort", "joint_pos_target", "joint_vel_target")
    names += ("joint_effort_ff", "joint_stiffness", "joint_damping")
    made = {name: rng.normal(size=n).astype(np.float32) for name in names}
    made |= {name: rng.normal(size=size).astype(np.float32) for name, size in sizes.items()}
    made["base_quat"] /= np.linalg.norm(made["base_quat"])
    made["temperatures"] = np.arange(20, 20 + 2 * n, dtype=np.int16)
    made["motor_temperature"] = np.arange(30.0, 30 + n, dtype=np.float32)
    made["motor_error"] = np.arange(2**32 - n, 2**32, dtype=np.uint32)
    made["foot_force"] = np.array([11.0, 12, 13, 14], np.float32)
    made["battery_charge"] = np.array(0.57, np.float32)
    made["battery_voltage"] = np.array(29.5, np.float32)
    made["remote"] = np.arange(40, dtype=np.uint8)
    made |= {"tick": np.array(7, np.uint32), "modes": np.zeros(n, np.uint8)}
    made |= {"mode_machine": np.array(5, np.uint8), "mode_pr": np.zeros((), np.uint8)}
    return made


@pytest.mark.parametrize("name", ["go_lowcmd", "go_lowstate", "hg_lowcmd", "hg_lowstate"])
def test_golden_frames_are_good_and_each_wrong_byte_is_not(assets: Path, name: str) -> None:
    raw, described = golden(assets, name)
    facts = UnitreeFacts.of(load_robot("go2" if "go" in name else "g1_29dof"))
    arrays = arrays_of(load_robot("go2" if "go" in name else "g1_29dof"))
    counts = Counts()
    message = facts.command if name.endswith("cmd") else facts.state
    frames = message.frames(arrays, counts)
    assert frames.good(raw)
    assert frames.good(raw + b"\0" * 3)
    assert len(raw) == frames.size
    wrong = [raw[:at] + bytes((raw[at] ^ 0x10,)) + raw[at + 1 :] for at in range(4, len(raw), 7)]
    unseen = sum(map(frames.good, wrong))
    assert unseen < len(wrong) // 4  # padding is not summed up
    for other in (raw[:3], raw[:4], raw[:-1], raw[:-4], raw + b"\0" * 4, raw * 2):
        assert not frames.good(other)
    for header in (b"", b"\0\0", b"\0\7", b"\0\6", b"\0\x0b", b"\1\1"):
        assert not frames.good(header + raw[2:] if header else b"")
    expected = {"wrong CRC": len(wrong) - unseen, "short": 4, "long": 2}
    assert counts.refused == expected | {"not little-endian XCDR1": 6}
    assert type_of(described).startswith(facts.protocol)


def frames_of(kind: str, raw: bytes) -> tuple[list[Any], list[int]]:
    """Read motors by their places, and return modes and the numbers behind each."""
    first, second, step = SPACING[kind]
    count = 20 if "go" in kind else 35
    places = [first, *range(second, second + step * (count - 1), step)]
    modes = [raw[4 + at] for at in places]
    numbers = []
    for at in places:
        at += 1
        at += -at % 4
        numbers.append(struct.unpack_from("<5f", raw, 4 + at))
    return numbers, modes


def image(kind: str, raw: bytes) -> bytes:
    """Return a message as the C struct of the checksum, through rosbags' objects."""
    flat: list[Any] = []

    def walk(value: Any) -> None:
        if isinstance(value, dict):
            for item in value.values():
                walk(item)
        elif isinstance(value, list):
            for item in value:
                walk(item)
        else:
            flat.append(value)

    shared_messages().struct(kind)
    walk(plain(shared_messages().store.deserialize_cdr(raw, kind)))
    return struct.pack(STRUCTS[kind], *flat)


@pytest.mark.parametrize("name", ROBOTS)
def test_commands_stand_in_their_slots(name: str) -> None:
    robot = load_robot(name)
    facts, arrays = UnitreeFacts.of(robot), arrays_of(robot)
    raw = facts.command.encoder(arrays).encode()
    kind = f"{facts.protocol}/msg/LowCmd"
    numbers, modes = frames_of(kind, raw)
    motors = robot.transport.get("motors") or list(range(robot.num_joints))
    said = robot.transport["motor_mode"]
    said = said if isinstance(said, list) else [said] * robot.num_joints
    for joint, slot in enumerate(motors):
        wanted = [arrays[n][joint] for n in ("joint_pos_target", "joint_vel_target")]
        wanted += [
            arrays[n][joint] for n in ("joint_effort_ff", "joint_stiffness", "joint_damping")
        ]
        assert numbers[slot] == tuple(map(float, wanted)), (name, slot)
        assert modes[slot] == said[joint]
    idle = sorted(set(range(len(modes))) - set(motors))
    assert idle
    for slot in idle:
        if facts.go:
            assert numbers[slot] == (np.float32(2.146e9), 16000.0, 0.0, 0.0, 0.0)
            assert modes[slot] == {"go2": 1, "h1": 10}[name]
        else:
            assert numbers[slot] == (0.0,) * 5
            assert modes[slot] == 0
    assert raw[4:7] == b"\xfe\xef\xff" if facts.go else raw[4:6] == bytes((0, 5))
    assert int.from_bytes(raw[-4:], "little") == slow_crc(image(kind, raw))


@pytest.mark.parametrize("name", ROBOTS)
def test_what_one_end_says_the_other_end_reads(name: str) -> None:
    robot = load_robot(name)
    facts, ours = UnitreeFacts.of(robot), arrays_of(robot)
    raw = facts.state.encoder(ours).encode()
    kind = f"{facts.protocol}/msg/LowState"
    assert int.from_bytes(raw[-4:], "little") == slow_crc(image(kind, raw))
    theirs = {key: np.zeros_like(value) for key, value in ours.items()}
    frames = facts.state_in(theirs, Counts())
    assert frames.good(raw)
    assert frames.read(raw)
    told = ["joint_pos", "joint_vel", "joint_effort", "base_quat", "base_ang_vel", "base_lin_acc"]
    told += ["remote", "tick"]
    told += ["motor_temperature", "foot_force"] if facts.go else ["temperatures", "mode_machine"]
    told += [] if facts.go else ["motor_error"]
    told += ["battery_voltage"] if facts.battery else []
    for key in told:
        np.testing.assert_array_equal(theirs[key], ours[key], err_msg=key)
    assert abs(float(theirs["battery_charge"]) - (0.57 if facts.battery else 0.0)) < 1e-6
    command = facts.command.encoder(ours).encode()
    heard = facts.command_in(theirs, Counts())
    assert heard.good(command)
    assert heard.read(command)
    for key in ("joint_pos_target", "joint_vel_target", "joint_effort_ff", "joint_stiffness"):
        np.testing.assert_array_equal(theirs[key], ours[key], err_msg=key)


@settings(max_examples=30)
@given(data=st.data())
def test_garbage_is_refused_and_writes_nothing(data: st.DataObject) -> None:
    robot = load_robot("go2")
    facts, arrays = UnitreeFacts.of(robot), arrays_of(robot)
    raw = bytearray(facts.state.encoder(arrays).encode())
    frames = replace(facts.state, checked=False).frames(arrays, Counts())
    at = data.draw(st.sampled_from([4 + 24, 4 + 28, 4 + 80, 4 + 84, 4 + 128]))  # quaternion, q, dq
    bad = data.draw(st.sampled_from([np.nan, np.inf, -np.inf]))
    struct.pack_into("<f", raw, at, bad)
    before = {key: value.copy() for key, value in arrays.items()}
    assert frames.good(bytes(raw))
    assert not frames.read(bytes(raw))
    for key, value in arrays.items():
        np.testing.assert_array_equal(value, before[key])
    noise = data.draw(st.binary(max_size=1300))
    assert not frames.good(noise) or noise[:2] == b"\0\1"


def test_the_torso_s_imu_is_told_as_if_it_were_in_the_pelvis() -> None:
    rng = np.random.default_rng(5)
    quat = rng.normal(size=4)
    torso = {"base_quat": quat / np.linalg.norm(quat)}
    torso |= {"base_ang_vel": rng.normal(size=3), "base_lin_acc": rng.normal(size=3)}
    angle, rate = 0.7, -1.3
    waist = {"joint_pos": np.array([0.0, angle]), "joint_vel": np.array([0.0, rate])}

    def matrix(q: np.ndarray) -> np.ndarray:
        w, x, y, z = q
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + 2 * w * cross + 2 * cross @ cross

    c, s = np.cos(angle), np.sin(angle)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    pelvis = {key: np.zeros_like(value) for key, value in torso.items()}
    turned(torso, pelvis, waist, 1)
    np.testing.assert_allclose(
        matrix(pelvis["base_quat"]), matrix(torso["base_quat"]) @ about_z.T, atol=1e-12
    )
    expected = about_z @ torso["base_ang_vel"] - (0, 0, rate)
    np.testing.assert_allclose(pelvis["base_ang_vel"], expected, atol=1e-12)
    np.testing.assert_allclose(pelvis["base_lin_acc"], about_z @ torso["base_lin_acc"], atol=1e-12)
    turned(pelvis, pelvis, waist, 1, -1.0)
    for key, value in torso.items():
        np.testing.assert_allclose(pelvis[key], value, atol=1e-12)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("head", [254], "transport.head is [254]; write 2 whole numbers from 0 to 255"),
        ("level_flag", 256, "transport.level_flag is 256; write a whole number from 0 to 255"),
        ("motors", [0] * 12, "write 12 different slots of 0 to 19"),
        ("motors", list(range(9, 21)), "write 12 different slots of 0 to 19"),
        ("motors", [*range(12), 0], "write 12 different slots of 0 to 19"),
        ("motor_mode", [1, 2], "motor_mode is [1, 2]; write 12 whole numbers from 0 to 255"),
        ("motor_mode", "servo", "motor_mode is 'servo'; write a whole number from 0 to 255"),
        ("pos_stop", None, "transport.pos_stop is None; write a number"),
        ("state_topic", 3, "write a text into go2.yaml, with its source"),
        ("release", {"before": ["sport"], "wait": 1}, "before: [service, number]"),
        ("release", None, "{wait: seconds}"),
        ("waist_joint", "neck", "transport.waist_joint is 'neck'; write one of FR_hip_joint, "),
        ("protocol", "unitree_old", "write one of unitree_go, unitree_hg"),
        ("unused_slots", {9: 1000}, "unused_slots is {9: 1000}; write {9: …} of 0 to 255"),
        ("unused_slots", {9: [1]}, "write {9: …} of 0 to 255"),
        ("unused_slots", [9], "write {slot: mode, …}"),
        ("domain", "one", "transport.domain is 'one'; write a whole number from 0 to 230"),
    ],
)
def test_wrong_facts_of_a_robot_file_are_named(key: str, value: Any, told: str) -> None:
    from dataclasses import replace

    go2 = load_robot("go2")
    robot = replace(go2, transport={**go2.transport, key: value})
    with pytest.raises(RobotError) as raised:
        UnitreeFacts.of(robot)
    assert told in str(raised.value)
    assert "go2.yaml" in str(raised.value)
