"""The message types of Jazzy as plain data, for `Messages`, which needs no more for a layout."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

FILE = "jazzy.json"
"""In the folder `msg`. Names, types, bounds and constants of ROS's common interfaces, as rosbags
0.11 tells them; `UNICON_WRITE_GOLDEN=1 pytest test/map/test_map_ready_made.py` writes it anew."""


@cache
def ready_made() -> Mapping[str, Any]:
    """Return name to (constants, fields), laid out as rosbags' `fielddefs`; read in 2 ms."""
    file = resources.files("unicon_msgs_map").joinpath("msg").joinpath(FILE)
    types: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return types
