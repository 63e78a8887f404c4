"""The types of Jazzy that lie ready-made: what rosbags has, without what rosbags costs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import resources
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from unicon_msgs_map.errors import MapDependencyError, MessageTypeError
from unicon_msgs_map.layout.installed import FILE, ready_made
from unicon_msgs_map.layout.messages import Messages

THEIRS = get_typestore(Stores.ROS2_JAZZY)


def plain(value: Any) -> Any:
    return json.loads(json.dumps(value))


def test_they_are_what_rosbags_has() -> None:
    theirs = {name: plain(THEIRS.fielddefs[name]) for name in sorted(THEIRS.fielddefs)}
    if os.environ.get("UNICON_WRITE_GOLDEN"):
        lines = ",\n".join(
            f"{json.dumps(name)}:{json.dumps(each, separators=(',', ':'))}"
            for name, each in theirs.items()
        )
        with resources.as_file(resources.files("unicon_msgs_map") / "msg" / FILE) as path:
            path.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
        ready_made.cache_clear()
    assert ready_made() == theirs


def test_layouts_are_those_of_the_typestore() -> None:
    ready, wrapped = Messages(), Messages(THEIRS)
    for name in THEIRS.fielddefs:
        assert repr(ready.struct(name)) == repr(wrapped.struct(name))


def test_a_layout_loads_no_rosbags_and_a_text_does() -> None:
    code = (
        "import sys; from unicon_msgs_map.layout.messages import Messages\n"
        "messages = Messages(); messages.struct('sensor_msgs/msg/JointState')\n"
        "assert messages.knows('tf2_msgs/TFMessage')\n"
        "assert 'rosbags' not in sys.modules\n"
        "assert 'float64[] effort' in messages.definition('sensor_msgs/JointState').text"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_without_rosbags_layouts_are_there_and_the_rest_tells_how(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    messages = Messages()
    assert list(messages.struct("geometry_msgs/msg/Vector3").fields) == ["x", "y", "z"]
    with pytest.raises(MapDependencyError, match="pip install rosbags"):
        messages.definition("geometry_msgs/msg/Vector3")
    with pytest.raises(MapDependencyError, match="pip install rosbags"):
        Messages("humble")


@pytest.mark.parametrize("first", [True, False], ids=["laid out before", "not laid out before"])
def test_a_type_that_contradicts_a_ready_made_one_is_refused(first: bool) -> None:
    messages = Messages()
    if first:
        messages.struct("geometry_msgs/msg/Vector3")
    with pytest.raises(MessageTypeError, match="already present with different definition"):
        messages.register({"geometry_msgs/msg/Vector3": "float32 x"})
    assert list(messages.struct("geometry_msgs/msg/Vector3").fields) == ["x", "y", "z"]
