"""The map of the AgiBot X2: it says what the robot file says, and refuses another robot's messages.

The definitions are the vendor's. Two facts are made here: until 0.9.7 a joint's state ended with
temperatures and a voltage (their types are not public, float32 is taken), and some releases may
leave names empty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from map_helpers import MAPS, get, serialize, zero_message

pytest.importorskip("unicon_ros", reason="the map is installed alone")

from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_msgs_map import Decoder, Messages, load_map
from unicon_ros.bridge.map_fit import robot_codecs

ROBOT = load_robot("x2")
MAP = load_map(MAPS / "agibot_x2.yaml")
GROUPS: dict[str, slice] = {}
for _group, _size in ROBOT.transport["groups"].items():
    _first = sum(part.stop - part.start for part in GROUPS.values())
    GROUPS[_group] = slice(_first, _first + _size)


def state_of(
    group: str, names: tuple[str, ...] | None = None, messages: Messages = MAP.messages
) -> Any:
    """Return a message of a group, each joint's figures its own."""
    joint = messages.store.types["aimdk_msgs/msg/JointState"]
    message = zero_message("aimdk_msgs/msg/JointStateArray", messages)
    more = [0.0] * (len(messages.struct("aimdk_msgs/msg/JointState").fields) - 4)
    more = [0] if len(more) == 1 else more
    for k, name in enumerate(ROBOT.joint_names[GROUPS[group]] if names is None else names):
        message.joints.append(joint(name, 0.1 + k, 0.2 + k, 0.3 + k, *more))
    return message


def decoder(group: str, states: States) -> Decoder:
    topic = ROBOT.transport["state_topics"][group]
    return next(d for d in robot_codecs(MAP, states, ROBOT)[0] if d.spec.topic == topic)


@pytest.fixture
def states() -> States:
    return States(standard_states(ROBOT.joint_names))


def test_topics_types_and_groups_are_the_robot_files() -> None:
    transport = ROBOT.transport
    assert transport["map"] == "agibot_x2"
    heard = {spec.topic: spec for spec in MAP.subscribe}
    said = {spec.topic: spec for spec in MAP.publish}
    assert set(heard) == {*transport["state_topics"].values(), transport["imu_topic"]}
    assert set(said) == set(transport["command_topics"].values())
    for group, topic in transport["state_topics"].items():
        assert heard[topic].type == transport["state_message"]
        assert heard[topic].qos.reliability == transport["state_qos"]
        command = said[transport["command_topics"][group]]
        assert command.type == transport["message"]
        assert command.qos.reliability == transport["command_qos"]


@pytest.mark.parametrize("group", GROUPS)
def test_states_of_each_group_come_in_by_joint(group: str, states: States) -> None:
    where = GROUPS[group]
    assert decoder(group, states).decode(serialize(state_of(group), MAP.messages))
    steps = np.arange(where.stop - where.start, dtype=np.float32)
    for name, first in (("joint_pos", 0.1), ("joint_vel", 0.2), ("joint_effort", 0.3)):
        np.testing.assert_allclose(states[name][where], first + steps, rtol=1e-6)
        states[name][where] = 0.0
        assert not states[name].any()  # of no other joint


@pytest.mark.parametrize("group", GROUPS)
def test_commands_carry_every_joint_of_the_group_and_the_head_does_not_nod(
    group: str, states: States
) -> None:
    fields = {
        "position": "joint_pos_target",
        "velocity": "joint_vel_target",
        "effort": "joint_effort_ff",
        "stiffness": "joint_stiffness",
        "damping": "joint_damping",
    }
    for number, state in enumerate(fields.values()):
        states[state][...] = 100 * number + 1 + np.arange(ROBOT.num_joints)
    topic = ROBOT.transport["command_topics"][group]
    encoder = next(e for e in robot_codecs(MAP, states, ROBOT)[1] if e.spec.topic == topic)
    message = MAP.messages.store.deserialize_cdr(encoder.encode(), encoder.spec.type)
    assert tuple(joint.name for joint in message.joints) == ROBOT.joint_names[GROUPS[group]]
    assert (message.header.stamp.sec, message.header.frame_id) == (0, "")
    for joint in message.joints:
        index = ROBOT.joint_names.index(joint.name)
        commanded = joint.name not in ROBOT.transport["not_commanded"]
        for field, state in fields.items():
            assert get(joint, [field]) == (states[state][index] if commanded else 0.0)


def other_order(names: tuple[str, ...]) -> tuple[str, ...]:
    return (names[1], names[0], *names[2:])


HOSTILE: list[tuple[str, Callable[[tuple[str, ...]], tuple[str, ...]], str]] = [
    ("another order", other_order, "joints[0].name"),
    ("no names", lambda names: ("",) * len(names), "joints[0].name"),
    ("a joint less", lambda names: names[:-1], "joints"),
    ("a joint more", lambda names: (*names, "tail_joint"), "13"),
    ("no joints", lambda names: (), "joints"),
    ("another group's", lambda names: ROBOT.joint_names[GROUPS["arm"]], "joints[0].name"),
]


@pytest.mark.parametrize(("what", "change", "told"), HOSTILE, ids=[each[0] for each in HOSTILE])
def test_a_message_of_another_robot_changes_nothing_and_says_why(
    what: str, change: Callable[[tuple[str, ...]], tuple[str, ...]], told: str, states: States
) -> None:
    legs = decoder("leg", states)
    names = change(ROBOT.joint_names[GROUPS["leg"]])
    assert not legs.decode(serialize(state_of("leg", names), MAP.messages)), what
    assert told in legs.last_error
    assert not states.joint_pos.any()


def test_figures_that_are_not_finite_are_refused(states: States) -> None:
    message = state_of("leg")
    object.__setattr__(message.joints[3], "position", float("nan"))
    legs = decoder("leg", states)
    assert not legs.decode(serialize(message, MAP.messages))
    assert "'left_knee_joint' is nan" in legs.last_error
    assert not states.joint_pos.any()


@pytest.mark.parametrize("group", GROUPS)
def test_joint_states_of_an_older_release_are_refused(group: str, states: States) -> None:
    older = Messages()
    folder = MAPS.parents[1] / "unicon_msgs_map" / "msg" / "aimdk_msgs"
    texts = {f"aimdk_msgs/msg/{each.stem}": each.read_text() for each in folder.glob("*.msg")}
    state = texts["aimdk_msgs/msg/JointState"]
    texts["aimdk_msgs/msg/JointState"] = state.replace(
        "uint16 error_code", "float32 coil_temp\nfloat32 motor_temp\nfloat32 motor_vol"
    )
    older.register(texts)
    raw = serialize(state_of(group, messages=older), older)
    there = decoder(group, states)
    assert not there.decode(raw)
    assert there.last_error
    assert not states.joint_pos.any()


def test_cut_and_garbled_messages_change_nothing(states: States) -> None:
    raw = serialize(state_of("leg"), MAP.messages)
    legs = decoder("leg", states)
    random = np.random.default_rng(1)
    for length in range(
        0, len(raw) - 2, 7
    ):  # the last two bytes are an error code, which is not read
        assert not legs.decode(raw[:length])
    for _ in range(300):
        legs.decode(random.bytes(int(random.integers(0, 2 * len(raw)))))
    assert legs.received == 0
    assert not states.joint_pos.any()
