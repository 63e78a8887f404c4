"""Messages without generated code go as bytes: /tf from the wheels, a `.msg` that is all there is.

What another's generated code makes of them: `test_ros_tf.py` (slow).
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from unicon_msgs_map import Messages
from unicon_ros import compat
from unicon_ros.compat import made_types
from unicon_ros.compat.made_types import described, rihs01

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

TF = "tf2_msgs/msg/TFMessage"
NOTED = "own_msgs/msg/Noted"  # installed nowhere
TEXTS = {NOTED: "std_msgs/Header header\nMark[] marks\n", "own_msgs/msg/Mark": "float64[3] at\n"}


@pytest.fixture
def messages() -> Messages:
    known = Messages()
    known.register(TEXTS)
    return known


@pytest.fixture
def node() -> Iterator[Any]:
    rclpy = compat.import_rclpy()
    context = rclpy.Context()
    rclpy.init(context=context)
    made = rclpy.create_node("made_types", context=context)
    yield made
    made.destroy_node()
    context.shutdown()


def test_an_installed_class_is_taken_as_it_is(messages: Messages) -> None:
    from sensor_msgs.msg import JointState

    assert compat.bytes_class("sensor_msgs/msg/JointState", messages) is JointState


def test_an_unknown_type_has_no_class(messages: Messages) -> None:
    assert compat.bytes_class("own_msgs/msg/Other", messages) is None


def test_one_definition_makes_one_class_and_another_one_another(messages: Messages) -> None:
    made = compat.bytes_class(NOTED, messages)
    again, other = Messages(), Messages()
    again.register(TEXTS)
    other.register({NOTED: "bool done\n"})
    assert compat.bytes_class(NOTED, again) is made
    assert compat.bytes_class(NOTED, other) is not made


@pytest.mark.parametrize("middleware", ["rmw_cyclonedds_cpp", "rmw_fastrtps_dynamic_cpp"])
def test_other_middlewares_need_generated_code(
    middleware: str, messages: Messages, monkeypatch: pytest.MonkeyPatch
) -> None:
    import rclpy.utilities

    monkeypatch.setattr(rclpy.utilities, "get_rmw_implementation_identifier", lambda: middleware)
    monkeypatch.setattr(made_types, "_made", {})
    made_types._template.cache_clear()
    try:
        assert compat.bytes_class(NOTED, messages) is None
    finally:
        made_types._template.cache_clear()


def test_bytes_pass_as_they_are(messages: Messages, node: Any) -> None:
    made = compat.bytes_class(NOTED, messages)
    publisher = node.create_publisher(made, "noted", 10)
    subscription = node.create_subscription(made, "noted", print, 10, raw=True)
    take, leave = compat.raw_take(subscription)
    assert take is not None
    publish, release = compat.raw_publish(publisher)
    heard: list[bytes] = []
    arrived = threading.Event()
    for size in (0, 3, 100_000):  # grows beyond what was reserved
        sent = b"\0\1\0\0" + bytes(range(12)) + size.to_bytes(4, "little") + bytes(24 * size)
        for _ in range(500):
            publish(sent)
            raw = take()
            if raw is not None and bytes(raw) == sent:
                heard.append(sent)
                break
            arrived.wait(0.01)
    release()
    leave()
    assert [len(raw) for raw in heard] == [20, 92, 2_400_020]


def test_what_is_no_bytes_is_refused_and_harms_nothing(messages: Messages, node: Any) -> None:
    made = compat.bytes_class(NOTED, messages)
    with pytest.raises(TypeError, match="own_msgs/msg/Noted goes as bytes only: the ROS package"):
        made()
    publisher = node.create_publisher(made, "noted", 10)
    with pytest.raises(TypeError):
        publisher.publish(object.__new__(made))
    publisher.publish(b"\0\1\0\0" + bytes(16))


def test_the_graph_tells_type_hash_and_description(messages: Messages, node: Any) -> None:
    from type_description_interfaces.srv import GetTypeDescription

    made = compat.bytes_class(NOTED, messages)
    wanted = described(messages.struct(NOTED))
    publisher = node.create_publisher(made, "noted", 10)
    (info,) = node.get_publishers_info_by_topic("/noted")
    assert info.topic_type == NOTED
    told = f"RIHS01_{rihs01(wanted).hex()}"
    assert str(info.topic_type_hash) == told == messages.definition(NOTED).rihs
    client = node.create_client(GetTypeDescription, "made_types/get_type_description")
    assert client.wait_for_service(10.0)
    request = GetTypeDescription.Request(type_name=NOTED, type_hash=told)
    executor = compat.import_rclpy().executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    future = client.call_async(request)
    executor.spin_until_future_complete(future, 10.0)
    executor.remove_node(node)
    answer = future.result()
    assert answer is not None
    assert answer.successful, answer.failure_reason
    found = answer.type_description

    def plain(one: Any) -> dict[str, Any]:
        keys = ("type_id", "capacity", "string_capacity", "nested_type_name")
        fields = [
            {"name": f.name, "type": {key: getattr(f.type, key) for key in keys}}
            for f in one.fields
        ]
        return {"type_name": one.type_name, "fields": fields}

    assert plain(found.type_description) == wanted["type_description"]
    referenced = [plain(one) for one in found.referenced_type_descriptions]
    assert referenced == wanted["referenced_type_descriptions"]
    node.destroy_publisher(publisher)


def test_a_run_tells_its_frames_without_tf2_msgs(
    peers: Callable[..., Any], processes: Callable[..., Any], sway: Path
) -> None:
    """Here the wheels' user has them; in an installation tf2_msgs's own classes are used."""
    command = (sys.executable, "-m", "unicon_ros", "run", str(sway), "--ros", "--duration", "30")
    run = processes(*command)
    moving, fixed = peers("raw_listener", "/tf", TF), peers("raw_listener", "/tf_static", TF, "l")
    moving.wait_for(lambda: len(moving.of("/tf")) > 20, "/tf", 60.0)
    fixed.wait_for(lambda: bool(fixed.of("/tf_static")), "/tf_static", 60.0)
    store = Messages().store
    children = set()
    for line in (*moving.of("/tf"), *fixed.of("/tf_static")):
        message = store.deserialize_cdr(bytes.fromhex(line["raw"]), TF)
        children |= {one.child_frame_id for one in message.transforms}
    assert {"base_link", "FR_calf", "FR_foot", "imu_link"} <= children
    hashes = {each for line in moving.of("/tf") for each in line["hashes"]}
    assert hashes == {Messages().definition(TF).rihs}
    assert "is left out" not in run.errors
