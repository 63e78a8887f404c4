"""Several robots share /tf and readers of frames: with a prefix each their names do not collide."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import UniconError
from unicon_core.workflow import load_workflow
from unicon_msgs_map import Messages
from unicon_ros import compat
from unicon_ros.bridge import RosSession
from unicon_ros.bridge.bindings import robot_variables

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

PLAIN = {"odom", "base_link", "imu_link"}


def test_all_frames_of_a_session_have_the_prefix(
    sway: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What would be published, by a node that only notes it."""
    found = {prefix: frames_of(sway, prefix, monkeypatch) for prefix in ("", "robot1/")}
    assert PLAIN | {"FR_calf", "FR_foot"} <= found[""].keys() | set(found[""].values())
    assert found["robot1/"] == {
        f"robot1/{child}": f"robot1/{parent}" for child, parent in found[""].items()
    }


def frames_of(path: Path, prefix: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Return the parent of each frame that the session tells on /tf and /tf_static."""
    heard: list[tuple[str, bytes]] = []
    kind = "tf2_msgs/msg/TFMessage"
    real = compat.bytes_class

    class Noted:
        def __init__(self, topic: str) -> None:
            self.topic_name = topic

        def publish(self, data: Any) -> None:
            if isinstance(data, bytes):
                heard.append((self.topic_name, data))

    session = RosSession(frame_prefix=prefix, warn=lambda text: None)
    create, destroy = session.node.create_publisher, session.node.destroy_publisher

    def noting(message: Any, topic: str, *rest: Any, **options: Any) -> Any:
        if message is Noted:
            return Noted(topic)
        return create(message, topic, *rest, **options)

    monkeypatch.setattr(session.node, "create_publisher", noting)
    monkeypatch.setattr(
        session.node, "destroy_publisher", lambda p: isinstance(p, Noted) or destroy(p)
    )
    monkeypatch.setattr(compat, "bytes_class", lambda n, m: Noted if n == kind else real(n, m))
    try:
        workflow = load_workflow(path, hooks=[session.hook])
        for out in session.outgoing:
            out.flush(0.0)
        workflow.close()
    finally:
        session.close()
        monkeypatch.undo()
    store = Messages().store
    found = {}
    for _, raw in heard:
        for one in store.deserialize_cdr(raw, kind).transforms:
            found[one.child_frame_id] = one.header.frame_id
    assert {topic for topic, _ in heard} == {"/tf", "/tf_static"}
    return found


@pytest.mark.slow
def test_two_nodes_in_two_namespaces_have_no_frame_in_common(
    nodes: Callable[..., Any], peers: Callable[..., Any], sway: Path
) -> None:
    for name in ("robot1", "robot2"):
        parameters = (f"workflow:={sway}", f"frame_prefix:={name}/")
        given = [part for text in parameters for part in ("-p", text)]
        nodes("--ros-args", "-r", f"__ns:=/{name}", *given)
    watchers = {name: peers("frame_watcher", f"/{name}") for name in ("robot1", "robot2")}
    for name, watcher in watchers.items():
        watcher.wait_for(lambda w=watcher: w.of("odom") and w.of("imu"), f"the frames of {name}")
        frames = {frame for line in watcher.lines for frame in line["frames"]}
        assert frames == {f"{name}/{frame}" for frame in PLAIN}


def test_variables_are_prefixed_where_they_are_frames(sway: Path) -> None:
    workflow = load_workflow(sway)
    plain, prefixed = robot_variables(workflow.robot), robot_variables(workflow.robot, "r1_")
    workflow.close()
    changed = {name for name in plain if plain[name] != prefixed[name]}
    assert changed == {"base_frame", "odom_frame", "imu_frame"}
    assert all(prefixed[name] == f"r1_{plain[name]}" for name in changed)


@pytest.mark.parametrize(("wrong", "right"), [("/robot1/", "robot1/"), ("a b/", "ab/")])
def test_a_prefix_that_tf2_refuses_is_refused_with_a_right_one(wrong: str, right: str) -> None:
    with pytest.raises(UniconError, match=f"write '{right}'"):
        RosSession(frame_prefix=wrong)
