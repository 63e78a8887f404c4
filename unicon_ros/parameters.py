"""Parameters of unicon_node: declared, checked when they are set, and read; see parameter_table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from rcl_interfaces.msg import ParameterType, SetParametersResult

from unicon_base.errors import UniconError, alternatives
from unicon_base.packages import loaded
from unicon_base.resources import find_config
from unicon_core.check.rules import CODES
from unicon_core.workflow.document import split_setting
from unicon_core.workflow.registry import known
from unicon_ros import compat
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.bridge.declare import declare, fitted
from unicon_ros.bridge.tuning import Tuning
from unicon_ros.parameter_table import DECLARED, RANGES, WORDS

DEFAULTS = {name: value for name, value, _ in DECLARED}
FOREIGN = ("qos_overrides.", "start_type_description_service", "use_sim_time", "bond")
"""Parameters that rclpy itself declares, or looks at."""


def _beside(kind: str) -> Callable[[str], object]:
    """Look for a name or a path, but not for one that may be relative to the workflow's folder."""

    def find(name: str) -> None:
        relative = "/" in name or name.endswith(".yaml")
        if name.startswith(("/", "~")) or not relative:
            find_config(kind, name)

    return find


def _platform(name: str) -> None:
    if ":" not in name and name not in known("platforms"):
        raise UniconError(f"unknown platform {name!r}; {alternatives(name, known('platforms'))}")


def _code(code: str) -> None:
    if code not in CODES:
        raise UniconError(f"no finding has the code {code!r}; {alternatives(code, CODES)}")


CHECKS: dict[str, Callable[[str], object]] = {
    "workflow": lambda name: find_config("workflows", name),
    "map": _beside("maps"),
    "robot": _beside("robots"),
    "platform": _platform,
    "overrides": split_setting,
    "force": _code,
    "frame_prefix": checked_prefix,
    **{word: check for each in loaded("run").values() for word, check in each.CHECKS.items()},
}
"""What can be known of a text when it is set; the rest shows when the node is configured."""


def unsuitable(values: Mapping[str, Any]) -> str:
    """Return why a parameter cannot have the value that it is set to, or ""."""
    for name, value in values.items():
        words = WORDS.get(name)
        if words and value not in words:
            return f"{name} is one of {', '.join(words)}, not {value!r}"
        texts = value if isinstance(value, (list, tuple)) else [value]
        for text in texts if name in CHECKS else []:
            try:
                if text:
                    CHECKS[name](text)
            except UniconError as error:
                return f"{name}: {error}"
    return ""


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
        declare(node, DECLARED)
        given = {name: self[name] for name in RANGES}
        refusal = self._refusal(given)
        if refusal:
            raise UniconError(refusal)
        self._tuning.apply(given)
        compat.convert_parameters(node, self._fitted)
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

    @property
    def unknown(self) -> list[str]:
        """What was given at start and is not a parameter of the node, a line for each."""
        given = compat.parameters_given(self._node)
        names = [name for name in given if not self._node.has_parameter(name)]
        strange = [name for name in names if not name.startswith(FOREIGN)]
        return [f"no parameter {n!r}; {alternatives(n, sorted(DEFAULTS))}" for n in strange]

    def _fitted(self, name: str, value: Any) -> tuple[Any, Any]:
        """Return a value as it is meant, and a type of rclpy where the value does not tell it."""
        default = DEFAULTS.get(name)
        value = fitted(value, default)
        array = isinstance(default, list) and isinstance(value, list)
        return value, ParameterType.PARAMETER_STRING_ARRAY if array and not value else None

    def _set(self, parameters: Sequence[Any]) -> SetParametersResult:
        values = {parameter.name: parameter.value for parameter in parameters}
        refusal = unsuitable(values) or self._refusal(values)
        if refusal:
            return SetParametersResult(successful=False, reason=refusal)
        self._tuning.apply(values)
        return SetParametersResult(successful=True)

    def _refusal(self, values: dict[str, Any]) -> str:
        """Return why these numbers cannot be set together with the present ones, or ""."""
        for name in RANGES:
            if not math.isfinite(values.get(name, 0.0)):
                return f"{name} is {values[name]}; give a finite number"
        return self._tuning.refusal(values)
