"""Type descriptions and hashes, which peers compare: beside an installed ROS's and rosbags'."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from unicon_msgs_map import Messages
from unicon_ros.compat.made_types import described, rihs01

MESSAGES = Messages()
PREFIXES = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
INSTALLED = sorted(
    path for prefix in PREFIXES if prefix for path in Path(prefix).glob("share/*/msg/*.json")
)


def test_they_are_those_of_an_installed_ros() -> None:
    compared = 0
    for path in INSTALLED:
        name = f"{path.parent.parent.name}/msg/{path.stem}"
        told = json.loads(path.read_text(encoding="utf-8"))
        if name not in MESSAGES._ready:
            continue
        wanted = told["type_description_msg"]
        for one in (wanted["type_description"], *wanted["referenced_type_descriptions"]):
            for field in one["fields"]:
                del field["default_value"]  # the hash goes without
        found = described(MESSAGES.struct(name))
        assert found == wanted
        hashes = {one["type_name"]: one["hash_string"] for one in told["type_hashes"]}
        assert f"RIHS01_{rihs01(found).hex()}" == hashes[name]
        compared += 1
    if not compared:
        pytest.skip("no ROS installation with type descriptions")
    assert compared > 100


TYPES = ("tf2_msgs/msg/TFMessage", "unitree_go/msg/LowState", "diagnostic_msgs/msg/DiagnosticArray")


@pytest.mark.parametrize("name", TYPES)
def test_hashes_are_those_of_rosbags(name: str) -> None:
    definition = MESSAGES.definition(name)
    assert f"RIHS01_{rihs01(described(MESSAGES.struct(name))).hex()}" == definition.rihs


def test_bounds_and_lengths_are_told() -> None:
    messages = Messages()
    messages.register({"a_msgs/msg/B": "string<=5 s\nfloat32[<=3] x\nbyte[4] y\nstring[] z\n"})
    fields = described(messages.struct("a_msgs/B"))["type_description"]["fields"]
    kinds = [tuple(field["type"].values()) for field in fields]
    assert kinds == [(21, 0, 5, ""), (106, 3, 0, ""), (64, 4, 0, ""), (161, 0, 0, "")]
