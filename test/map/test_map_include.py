"""Maps that include maps: what is changed, replaced, removed, and each mistake with its line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from unicon_base.resources import find_config
from unicon_msgs_map import MapFileError, MessageMap, load_map, parse_map
from unicon_msgs_map.spec import TopicSpec

Compose = Callable[[str], MessageMap]

BASE = """\
description: Of the base.
publish:
  - topic: odom
    type: nav_msgs/msg/Odometry
    rate: 50
    qos: latest
    fields: {header.stamp: stamp_ns, pose.pose.position: base_pos_w}
  - topic: /clock
    type: rosgraph_msgs/msg/Clock
    fields: {clock: stamp_ns}
subscribe:
  - topic: cmd_vel
    type: geometry_msgs/msg/Twist
    timeout: 0.5
    fields: {linear.x: "velocity_command[0]", angular.z: "velocity_command[2]"}
"""


@pytest.fixture
def compose(tmp_path: Path) -> Compose:
    (tmp_path / "base.yaml").write_text(BASE)

    def composed(text: str) -> MessageMap:
        path = tmp_path / "m.yaml"
        path.write_text(text)
        return load_map(path)

    return composed


def fields(spec: TopicSpec) -> dict[str, str | None]:
    return {field.path: field.source.name for field in spec.fields}


def test_a_map_begins_with_what_it_includes(compose: Compose) -> None:
    mapping = compose("include: base.yaml\n")
    assert [spec.topic for spec in mapping.publish] == ["odom", "/clock"]
    assert [spec.topic for spec in mapping.subscribe] == ["cmd_vel"]
    assert mapping.description == ""  # its own words


def test_keys_that_are_given_change_the_included_entry_and_the_rest_stays(compose: Compose) -> None:
    mapping = compose(
        "include: [base.yaml]\npublish:\n  - {topic: odom, rate: 20}\n"
        "subscribe:\n  - {topic: cmd_vel, timeout: 0.2, "
        "fields: {linear.y: 'velocity_command[1]'}}\n"
    )
    odom, _ = mapping.publish
    assert (odom.rate, odom.qos.reliability, odom.type) == (
        20,
        "best_effort",
        "nav_msgs/msg/Odometry",
    )
    assert fields(odom) == {"header.stamp": "stamp_ns", "pose.pose.position": "base_pos_w"}
    (cmd_vel,) = mapping.subscribe
    assert cmd_vel.timeout == 0.2
    assert set(fields(cmd_vel)) == {"linear.x", "linear.y", "angular.z"}


def test_an_empty_field_removes_it_and_remove_the_entry(compose: Compose) -> None:
    mapping = compose(
        "include: base.yaml\npublish:\n  - topic: odom\n    fields: {header.stamp: }\n"
        "  - {topic: /clock, remove: true}\n"
    )
    (odom,) = mapping.publish
    assert fields(odom) == {"pose.pose.position": "base_pos_w"}


def test_another_type_replaces_the_entry_whole(compose: Compose) -> None:
    mapping = compose(
        "include: base.yaml\nsubscribe:\n  - topic: cmd_vel\n"
        "    type: geometry_msgs/msg/TwistStamped\n"
        "    fields: {twist.linear.x: 'velocity_command[0]'}\n"
    )
    (cmd_vel,) = mapping.subscribe
    assert cmd_vel.timeout is None
    assert list(fields(cmd_vel)) == ["twist.linear.x"]


def test_a_type_without_its_middle_is_the_same_type(compose: Compose) -> None:
    mapping = compose(
        "include: base.yaml\nsubscribe:\n"
        "  - {topic: cmd_vel, type: geometry_msgs/Twist, timeout: 1}\n"
    )
    assert len(mapping.subscribe[0].fields) == 2


def test_new_topics_stand_behind_the_included_ones(compose: Compose) -> None:
    mapping = compose(
        "include: base.yaml\npublish:\n  - topic: joint_states\n"
        "    type: sensor_msgs/msg/JointState\n"
        "    fields: {position: joint_pos}\n"
    )
    assert [spec.topic for spec in mapping.publish] == ["odom", "/clock", "joint_states"]


def test_of_several_maps_the_later_one_counts_and_names_are_found_as_everywhere() -> None:
    mapping = load_map(find_config("maps", "default_stamped"))
    plain = load_map(find_config("maps", "default"))
    assert mapping.publish == plain.publish
    (cmd_vel,) = mapping.subscribe
    assert (cmd_vel.topic, cmd_vel.type) == ("cmd_vel", "geometry_msgs/msg/TwistStamped")


def test_messages_of_an_included_map_are_found_beside_it(compose: Compose, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "Own.msg").write_text("float64 height\n")
    (tmp_path / "there" / "own.yaml").write_text(
        "messages: [Own.msg]\npublish:\n"
        "  - {topic: own, type: there/Own, fields: {height: height}}\n"
    )
    assert compose("include: there/own.yaml\n").publish[0].type == "there/msg/Own"


def test_an_error_in_an_included_map_names_that_file(compose: Compose, tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text(BASE.replace("rate: 50", "rate: fast"))
    with pytest.raises(
        MapFileError, match=r"base\.yaml:5: publish\.odom\.rate is 'fast'; write a number"
    ):
        compose("include: base.yaml\n")


def test_maps_may_come_to_the_same_map_twice(compose: Compose, tmp_path: Path) -> None:
    for name in ("left", "right"):
        (tmp_path / f"{name}.yaml").write_text("include: base.yaml\n")
    assert len(compose("include: [left.yaml, right.yaml]\n").publish) == 2


PLAYED = "trajectory: {topic: joint_trajectory, action: follow, start_tolerance: 0.2}\n"


def test_a_trajectory_is_read_and_changed_key_by_key(compose: Compose, tmp_path: Path) -> None:
    (tmp_path / "played.yaml").write_text(PLAYED)
    mapping = compose("include: played.yaml\ntrajectory: {missing: hold, topic: }\n")
    spec = mapping.trajectory
    assert spec is not None
    assert (spec.topic, spec.action, spec.missing) == (None, "follow", "hold")
    assert (spec.start_tolerance, spec.goal_time) == (0.2, 0.0)
    assert compose("include: [base.yaml, played.yaml]\ntrajectory: \n").trajectory is None


ENTRY = "include: base.yaml\npublish:\n"
WRONG = [
    ("include: 3\n", "m.yaml:1: include is 3; write a text or a list, each a text"),
    ("include: [3]\n", "m.yaml:1: include.0 is 3; write a text"),
    ("include: m.yaml\n", "m.yaml:1: include 'm.yaml' leads back to "),
    ("include: gone.yaml\n", "m.yaml:1: include: no file gone.yaml; give an existing path"),
    ("include: defalt\n", "m.yaml:1: include: unknown map 'defalt'; did you mean 'default'?"),
    (
        ENTRY + "  - {topic: odm, remove: true}\n",
        "m.yaml:3: publish has no topic 'odm' of an included map to remove; did you mean 'odom'?",
    ),
    (
        "publish:\n  - {topic: odom, remove: true}\n",
        "m.yaml:2: publish has no topic 'odom' of an included map to remove; include: NAME brings",
    ),
    (
        ENTRY + "  - {topic: odom, remove: true, rate: 5}\n",
        "m.yaml:3: remove must be true, and stand beside the topic alone",
    ),
    (
        ENTRY + "  - {topic: odom, fields: {header.stmp: }}\n",
        "m.yaml:3: there is no field 'header.stmp' to remove; did you mean 'header.stamp'?",
    ),
    (
        ENTRY + "  - {topic: odom, rte: 5}\n",
        "m.yaml:3: publish.odom: unknown key 'rte'; did you mean 'rate'?",
    ),
    (
        ENTRY + "  - {topic: odom, rate: 5}\n  - {topic: odom, rate: 6}\n",
        "m.yaml:4: publish.odom: missing key 'type'; an entry needs topic, type and fields",
    ),
    (
        ENTRY + "  - {topic: /clock, remove: true}\n"
        "subscribe:\n  - {topic: cmd_vel, remove: true}\n  - {topic: cmd_vel, timeout: 1}\n",
        "m.yaml:6: subscribe.cmd_vel: missing key 'type'; an entry needs topic, type and fields",
    ),
    ("include: hop.yaml\n", "hop.yaml:1: include 'm.yaml' leads back to "),
    ("include: [old.yaml, new.yaml]\n", "m.yaml:1: included maps have the typestores 'humble'"),
    ("trajectory: {}\n", "m.yaml:1: trajectory: give topic or action, or both"),
    (
        "trajectory: {topic: a b}\n",
        "m.yaml:1: trajectory.topic is 'a b'; write a ROS name: words of",
    ),
    ("trajectory: {tpic: a}\n", "m.yaml:1: trajectory: unknown key 'tpic'; did you mean 'topic'?"),
    (
        "trajectory: {topic: a, missing: zero}\n",
        "m.yaml:1: trajectory.missing 'zero' is not known; did you mean 'error'?",
    ),
    (
        "trajectory: {topic: a, goal_time: -1}\n",
        "m.yaml:1: trajectory.goal_time is -1; write a number from 0 to 60 [s]",
    ),
    ("include: wide1.yaml\n", "more than 32 maps are included; name fewer"),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_each_mistake_is_one_line(
    compose: Compose, tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "hop.yaml").write_text("include: m.yaml\n")
    (tmp_path / "old.yaml").write_text("typestore: humble\n")
    (tmp_path / "new.yaml").write_text("typestore: jazzy\n")
    for k in range(1, 40):
        (tmp_path / f"wide{k}.yaml").write_text(f"include: [wide{k + 1}.yaml, wide{k + 1}.yaml]\n")
    with pytest.raises(MapFileError) as caught:
        compose(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_its_own_typestore_outranks_those_of_included_maps(
    compose: Compose, tmp_path: Path
) -> None:
    (tmp_path / "old.yaml").write_text("typestore: humble\n")
    (tmp_path / "base.yaml").write_text("typestore: jazzy\n" + BASE)
    compose("include: [old.yaml, base.yaml]\ntypestore: kilted\n")


def test_a_text_without_a_file_includes_by_name() -> None:
    assert parse_map("include: joy\n").subscribe[0].topic == "joy"
