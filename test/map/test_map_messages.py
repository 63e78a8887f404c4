"""Message definitions: known, registered, shipped, and what recorders and viewers ask of them."""

from __future__ import annotations

import json
import os
import sys
from importlib import resources
from pathlib import Path

import pytest

import unicon_msgs_map
from unicon_msgs_map import Messages, MessageTypeError, message_definition
from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct


def test_exported_names_exist_and_are_sorted() -> None:
    assert unicon_msgs_map.__all__ == sorted(unicon_msgs_map.__all__)
    for name in unicon_msgs_map.__all__:
        assert hasattr(unicon_msgs_map, name)


def test_fields_come_in_wire_order_with_their_kinds() -> None:
    joint_state = Messages().struct("sensor_msgs/JointState")
    assert joint_state.name == "sensor_msgs/msg/JointState"
    assert list(joint_state.fields) == ["header", "name", "position", "velocity", "effort"]
    header, name, position, *_ = joint_state.fields.values()
    assert isinstance(header, Struct)
    assert isinstance(name, Array)
    assert name.item == String()
    assert isinstance(position, Array)
    assert isinstance(position.item, Primitive)
    assert position.length is None
    covariance = Messages().struct("sensor_msgs/msg/Imu").fields["orientation_covariance"]
    assert isinstance(covariance, Array)
    assert covariance.length == 9


@pytest.mark.parametrize(
    "distro", ["foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical", "ros2_jazzy"]
)
def test_every_distribution_has_its_interfaces(distro: str) -> None:
    assert Messages(distro).knows("sensor_msgs/msg/JointState")


def test_a_rosbags_typestore_is_taken_as_it_is() -> None:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    assert Messages(store).store is store


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry", "std_msgs/msg/Empty"]
)
def test_type_hashes_are_those_of_an_installed_ros(name: str) -> None:
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    files = [Path(prefix) / "share" / f"{name}.json" for prefix in prefixes if prefix]
    described = next((file for file in files if file.is_file()), None)
    if described is None:
        pytest.skip("no ROS installation with type descriptions")
    hashes = json.loads(described.read_text(encoding="utf-8"))["type_hashes"]
    known = {entry["type_name"]: entry["hash_string"] for entry in hashes}
    assert message_definition(name).rihs == known[name]


def test_definitions_name_their_parts() -> None:
    found = message_definition("nav_msgs/msg/Odometry")
    assert found.encoding == "ros2msg"
    assert len(found.md5) == 32
    lines = found.text.splitlines()
    for part in ("std_msgs/Header", "geometry_msgs/Pose", "builtin_interfaces/Time"):
        assert f"MSG: {part}" in lines
    again = Messages("foxy")
    again.register({"copy_msgs/msg/Twist": message_definition("geometry_msgs/msg/Twist").text})
    assert list(again.struct("copy_msgs/Twist").fields) == ["linear", "angular"]


SHIPPED = ("unitree_go", "unitree_hg")


@pytest.mark.parametrize("package", SHIPPED)
def test_shipped_definitions_are_found_as_package_data(package: str) -> None:
    folder = resources.files("unicon_msgs_map") / "msg" / package
    names = sorted(entry.name[:-4] for entry in folder.iterdir() if entry.name.endswith(".msg"))
    assert {"LowCmd", "LowState", "MotorCmd", "MotorState", "IMUState"} <= set(names)
    for name in names:
        assert Messages().struct(f"{package}/msg/{name}").fields


# Sizes of the CDR bodies, summed by hand from the field lists with CDR alignment.
@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("unitree_go/msg/MotorCmd", 36),
        ("unitree_go/msg/MotorState", 48),
        ("unitree_hg/msg/MotorCmd", 28),
        ("unitree_hg/msg/MotorState", 56),
        ("unitree_hg/msg/LowCmd", 35 * 28 + 4 * 4 + 4),
    ],
)
def test_shipped_layouts_have_their_sizes(name: str, size: int) -> None:
    from unicon_msgs_map.layout.walker import static_size

    messages = Messages()
    assert static_size(messages.struct(name), 0) == size


def test_text_file_and_folder_register_alike(tmp_path: Path) -> None:
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Foot.msg").write_text("float32[3] force\nbool contact\n", encoding="utf-8")
    (folder / "Feet.msg").write_text("std_msgs/Header header\nFoot[4] feet\n", encoding="utf-8")
    by_folder, by_file, by_text = Messages(), Messages(), Messages()
    by_folder.register_path(folder)
    by_file.register_path(folder / "Foot.msg")
    by_file.register_path(folder / "Feet.msg")
    by_text.register({"my_msgs/msg/Foot": "float32[3] force\nbool contact\n"})
    by_text.register({"my_msgs/msg/Feet": "std_msgs/Header header\nFoot[4] feet\n"})
    texts = {m.definition("my_msgs/msg/Feet").rihs for m in (by_folder, by_file, by_text)}
    assert len(texts) == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda m: m.struct("sensor_msgs/msg/JointStat"),
            "message type 'sensor_msgs/msg/JointStat' is unknown; "
            "did you mean 'sensor_msgs/msg/JointState'?",
        ),
        (
            lambda m: m.struct("JointState"),
            "message type 'JointState' is not a type name; write pkg/msg/Name, "
            "such as sensor_msgs/msg/JointState",
        ),
        (
            lambda m: m.register({"a/msg/B": "float65 x\n"}) or m.struct("a/msg/B"),
            "message type 'a/msg/float65' is unknown; ",
        ),
        (
            lambda m: m.register({"a/msg/B": "float64 = = 3\n"}),
            "definition of 'a/msg/B' cannot be parsed: ",
        ),
        (
            lambda m: m.register({"std_msgs/msg/Bool": "int32 data\n"}),
            "Type 'std_msgs/msg/Bool' is already present with different definition. "
            "Rename the type, or drop one of the two definitions.",
        ),
        (
            lambda m: m.register_path("/"),
            "folder '/' holds no .msg file; give the folder that holds them",
        ),
        (
            lambda m: m.register_path("nowhere/msg/X.msg"),
            "cannot read message file 'nowhere/msg/X.msg': No such file or directory",
        ),
        (
            lambda m: m.register({"a/msg/W": "wstring w\n"}) or m.struct("a/msg/W"),
            "a/msg/W.w: wstring is not laid out; use string or one of bool, byte, ",
        ),
        (
            lambda m: Messages("jazy"),
            "typestore 'jazy' is unknown; did you mean 'jazzy'? known: dashing, ",
        ),
    ],
)
def test_every_message_of_the_type_store(call: object, message: str) -> None:
    assert callable(call)
    with pytest.raises(MessageTypeError) as caught:
        call(Messages())
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)
