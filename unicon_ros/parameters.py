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
from unicon_core.workflow.document import WorkflowDocument, load_document
from unicon_ros.bridge.tuning import NO_LIMIT, Tuning, too_little_damping

__all__ = ["Parameters"]

AT_CONFIGURE = "takes effect when the node is configured or started anew"

DECLARED: tuple[tuple[str, Any, str], ...] = (
    ("workflow", "", f"name in config/workflows/ or path of the workflow; {AT_CONFIGURE}"),
    (
        "map",
        "",
        f"name in config/maps/ or path of the message map; empty: the workflow's; {AT_CONFIGURE}",
    ),
    ("robot", "", f"robot file in place of the workflow's; {AT_CONFIGURE}"),
    ("platform", "", f"platform in place of the workflow's; {AT_CONFIGURE}"),
    ("overrides", [""], f"path=value texts as of `unicon run --set`; {AT_CONFIGURE}"),
    ("force", [""], f"codes of errors of `unicon check` to go on with; {AT_CONFIGURE}"),
    (
        "frame_prefix",
        "",
        f"stands before the names of all frames, such as robot1/; {AT_CONFIGURE}",
    ),
    ("record", "", f"file (.mcap) to record to; empty: no recording; {AT_CONFIGURE}"),
    ("speed", "real", f"real: by the wall clock; max: as fast as it can; {AT_CONFIGURE}"),
    ("autostart", True, "configure and activate at start"),
    ("exit_on_fault", False, "end the process with status 3 after a fault"),
)
RANGED: tuple[tuple[str, float, tuple[float, float], str], ...] = (
    (
        "rate",
        0.0,
        (0.0, 10_000.0),
        f"ticks per second in [Hz], 0: the workflow's own; {AT_CONFIGURE}",
    ),
    ("stiffness_scale", 1.0, (0.0, 2.0), "factor of all joint stiffnesses, at once"),
    (
        "damping_scale",
        1.0,
        (0.1, 5.0),
        "factor of all joint dampings, at once; at least 0.5 √stiffness_scale",
    ),
    ("max_vx", NO_LIMIT, (0.0, NO_LIMIT), "largest |forward command| in [m/s], at once"),
    ("max_vy", NO_LIMIT, (0.0, NO_LIMIT), "largest |sideward command| in [m/s], at once"),
    ("max_wz", NO_LIMIT, (0.0, NO_LIMIT), "largest |turning command| in [rad/s], at once"),
)
SCALES = ("stiffness_scale", "damping_scale")
LIMITS = ("max_vx", "max_vy", "max_wz")
WORDS = {"speed": ("real", "max")}


class Parameters:
    """Declares the parameters on a node and reads them.

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
            node.declare_parameter(name, value, descriptor)
        for name, number, (lowest, highest), description in RANGED:
            span = FloatingPointRange(from_value=lowest, to_value=highest, step=0.0)
            descriptor = ParameterDescriptor(
                name=name, description=description, floating_point_range=[span]
            )
            node.declare_parameter(name, number, descriptor)
        given = {name: self._value(name) for name, *_ in RANGED}
        refusal = self._refusal(given)
        if refusal:
            raise UniconError(refusal)
        self._apply(given)
        node.add_on_set_parameters_callback(self._set)

    def _value(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    @property
    def workflow(self) -> str:
        """Name or path of the workflow."""
        return str(self._value("workflow"))

    @property
    def map(self) -> str:
        """Name or path of the message map; empty: the workflow's own."""
        return str(self._value("map"))

    @property
    def force(self) -> list[str]:
        """Codes of the check's errors to go on with."""
        return [code for code in self._value("force") if code]

    @property
    def frame_prefix(self) -> str:
        """What stands before the names of all frames."""
        return str(self._value("frame_prefix"))

    @property
    def record(self) -> str:
        """File to record to, or empty."""
        return str(self._value("record"))

    @property
    def speed(self) -> Literal["real", "max"]:
        """How ticks are paced."""
        return "max" if self._value("speed") == "max" else "real"

    @property
    def autostart(self) -> bool:
        """Whether to configure and activate at start."""
        return bool(self._value("autostart"))

    @property
    def exit_on_fault(self) -> bool:
        """Whether a fault ends the process."""
        return bool(self._value("exit_on_fault"))

    @property
    def overrides(self) -> list[str]:
        """What differs from the workflow file, as `path=value`."""
        found = [f"{name}={self._value(name)}" for name in ("robot", "platform")]
        found = [text for text in found if not text.endswith("=")]
        if self._value("rate") > 0.0:
            found.append(f"rate={self._value('rate')}")
        return found + [text for text in self._value("overrides") if text]

    def document(self) -> WorkflowDocument:
        """Read the workflow's file with the overrides.

        Raises:
            UniconError: it is unknown or wrong.
        """
        return load_document(self.workflow, self.overrides)

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
        for name, *_ in RANGED:
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
