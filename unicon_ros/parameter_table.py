"""The table of unicon_node's parameters, and how they are declared; the table needs no ROS.

For the node, sessions, launch files and documents. Integers are numbers, lists may be empty.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from unicon_base import UniconError
from unicon_ros import compat

Row = tuple[str, Any, str]
"""Name, default and description of a parameter."""

NO_LIMIT = 100.0
"""A command limit from here on does nothing, [m/s] and [rad/s]."""

FRAMES: tuple[Row, ...] = (
    ("publish_link_tf", True, "publish the links' transforms on /tf and /tf_static"),
    ("publish_base_footprint", True, "publish base_footprint, level below the base, on /tf"),
    ("publish_robot_description", True, "publish the URDF on robot_description"),
)
"""Those that `unicon run --ros` has too, after --ros-args."""

INTROSPECTION: tuple[Row, ...] = (
    (
        "debug_states",
        [""],
        "states to publish on ~/debug, such as joint_pos, action[0:3] or joint_*; empty: none",
    ),
    ("debug_rate", 10.0, "how often, in [Hz]"),
)
"""These too."""

AT_CONFIGURE: tuple[Row, ...] = (
    ("workflow", "", "name in config/workflows/ or path of the workflow"),
    ("map", "", "name in config/maps/ or path of the message map; empty: the workflow's"),
    ("robot", "", "robot file in place of the workflow's"),
    ("platform", "", "platform in place of the workflow's"),
    ("part", "", "the one part to run of a workflow that has parts; empty: all of it"),
    ("overrides", [""], "path=value texts as of `unicon run --set`"),
    ("force", [""], "codes of errors of `unicon check` to go on with"),
    ("frame_prefix", "", "stands before the names of all frames, such as robot1/"),
    ("record", "", "file (.mcap) or folder/ to record every state and message to; empty: none"),
    ("record_split", "", "size or length of a file of a recording, such as 1GB or 60s"),
    ("record_frames", "", "all, or names of handles with commas: pictures and clouds to record"),
    ("record_jpeg", 0, "quality of JPEGs that raw pictures are recorded as, 0: as they are"),
    ("speed", "real", "real: by the wall clock; max: as fast as it can"),
    ("rate", 0.0, "ticks per second in [Hz], 0: the workflow's own"),
    *FRAMES,
    *INTROSPECTION,
)
"""Name, default and description of those that take effect when the node is configured."""
AT_ONCE: tuple[Row, ...] = (
    ("autostart", True, "configure and activate at start"),
    ("exit_on_fault", False, "end the process with status 3 after a fault"),
    ("stiffness_scale", 1.0, "factor of all joint stiffnesses, at once"),
    ("damping_scale", 1.0, "factor of all joint dampings, at once; at least 0.5 √stiffness_scale"),
    ("max_vx", NO_LIMIT, "largest |forward command| in [m/s], at once"),
    ("max_vy", NO_LIMIT, "largest |sideward command| in [m/s], at once"),
    ("max_wz", NO_LIMIT, "largest |turning command| in [rad/s], at once"),
)
DECLARED = (
    *(
        (name, value, f"{what}; takes effect when the node is configured or started anew")
        for name, value, what in AT_CONFIGURE
    ),
    *AT_ONCE,
)
"""Name, value and description of each."""

RANGES = {
    "rate": (0.0, 10_000.0),
    "stiffness_scale": (0.0, 2.0),
    "damping_scale": (0.1, 5.0),
    "max_vx": (0.0, NO_LIMIT),
    "max_vy": (0.0, NO_LIMIT),
    "max_wz": (0.0, NO_LIMIT),
}
SCALES = ("stiffness_scale", "damping_scale")
LIMITS = ("max_vx", "max_vy", "max_wz")
WORDS = {"speed": ("real", "max")}

KINDS = {bool: "true or false", float: "a number", str: "a text", list: "a list of texts"}


def declare(node: Any, rows: Sequence[tuple[str, Any, str]]) -> None:
    """Declare parameters on a node, those that it has already excepted.

    Integers are taken where numbers are meant, and an empty list is a list of nothing.

    Args:
        node: rclpy node.
        rows: name, default and description of each.

    Raises:
        UniconError: what was given at start is of another type.
    """
    from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

    for name, default, description in rows:
        if node.has_parameter(name):
            continue
        descriptor = ParameterDescriptor(name=name, description=description)
        if name in WORDS:
            descriptor.additional_constraints = f"one of {', '.join(WORDS[name])}"
        if name in RANGES:
            lowest, highest = RANGES[name]
            span = FloatingPointRange(from_value=lowest, to_value=highest, step=0.0)
            descriptor.floating_point_range = [span]
        given = compat.parameter_given(node, name, default)
        value = fitted(given, default)
        texts = value if isinstance(value, list) else []
        if type(value) is not type(default) or not all(isinstance(t, str) for t in texts):
            raise UniconError(f"parameter {name} is {given!r}; give {KINDS[type(default)]}")
        if value == []:  # has no type for rclpy; a list of an empty text means the same
            value = default
        node.declare_parameter(name, value, descriptor, ignore_override=True)


def fitted(value: Any, default: Any) -> Any:
    """Return a value as the type of a default where it means the same, else as it is."""
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, list) and (value is None or hasattr(value, "__len__")):
        return value if isinstance(value, str) else list(value or [])
    return value
