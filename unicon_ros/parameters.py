"""Parameters of unicon_node: names, descriptions, ranges, and what changes while it runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)

from unicon_core.errors import UniconError
from unicon_ros.bridge.introspection import PARAMETERS as INTROSPECTION
from unicon_ros.bridge.tuning import NO_LIMIT, Tuning, too_little_damping

__all__ = ["Parameters"]

AT_CONFIGURE: tuple[tuple[str, Any, str], ...] = (
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
    *((name, value, what) for name, (value, what) in INTROSPECTION.items()),
    ("speed", "real", "real: by the wall clock; max: as fast as it can"),
    ("rate", 0.0, "ticks per second in [Hz], 0: the workflow's own"),
)
AT_ONCE: tuple[tuple[str, Any, str], ...] = (
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


class Parameters:
    """Declares the parameters on a node and reads them: `parameters["record"]`.

    Args:
        node: rclpy node.
        tuning: gets the numbers that may change while ticks run.

    Raises:
        UniconError: numbers that were given at start do not go together.
    """

    def __init__(self, node: Any, tuning: Tuning) -> None:
        self._node, self._tuning = node, tuning
        for name, value, description in DECLARED:
            descriptor = ParameterDescriptor(name=name, description=description)
            if isinstance(value, list):
                descriptor.type = ParameterType.PARAMETER_STRING_ARRAY
            if name in WORDS:
                descriptor.additional_constraints = f"one of {', '.join(WORDS[name])}"
            if name in RANGES:
                lowest, highest = RANGES[name]
                span = FloatingPointRange(from_value=lowest, to_value=highest, step=0.0)
                descriptor.floating_point_range = [span]
            node.declare_parameter(name, value, descriptor)
        given = {name: self[name] for name in RANGES}
        refusal = self._refusal(given)
        if refusal:
            raise UniconError(refusal)
        self._apply(given)
        node.add_on_set_parameters_callback(self._set)

    def __getitem__(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    @property
    def speed(self) -> Literal["real", "max"]:
        """How ticks are paced."""
        return "max" if self["speed"] == "max" else "real"

    @property
    def force(self) -> list[str]:
        """Codes of the check's errors to go on with."""
        return [code for code in self["force"] if code]

    @property
    def overrides(self) -> list[str]:
        """What differs from the workflow file, as `path=value`."""
        found = [f"{name}={self[name]}" for name in ("robot", "platform") if self[name]]
        if self["rate"] > 0.0:
            found.append(f"rate={self['rate']}")
        return found + [text for text in self["overrides"] if text]

    def _set(self, parameters: Sequence[Any]) -> SetParametersResult:
        for parameter in parameters:
            words = WORDS.get(parameter.name)
            if words and parameter.value not in words:
                reason = f"{parameter.name} is one of {', '.join(words)}, not {parameter.value!r}"
                return SetParametersResult(successful=False, reason=reason)
        values = {parameter.name: parameter.value for parameter in parameters}
        refusal = self._refusal(values)
        if refusal:
            return SetParametersResult(successful=False, reason=refusal)
        self._apply(values)
        return SetParametersResult(successful=True)

    def _refusal(self, values: dict[str, Any]) -> str:
        """Return why these numbers cannot be set together with the present ones, or ""."""
        for name in RANGES:
            if not math.isfinite(values.get(name, 0.0)):
                return f"{name} is {values[name]}; give a finite number"
        if values.keys().isdisjoint(SCALES):
            return ""
        return too_little_damping(
            *(values.get(name, getattr(self._tuning, name)) for name in SCALES)
        )

    def _apply(self, values: dict[str, Any]) -> None:
        tuning = self._tuning
        tuning.stiffness_scale = values.get("stiffness_scale", tuning.stiffness_scale)
        tuning.damping_scale = values.get("damping_scale", tuning.damping_scale)
        for i, name in enumerate(LIMITS):
            if name in values:
                tuning.command_limit[i] = values[name]
