"""Parameters of unicon_node: declared, checked when they are set, and read; see parameter_table.

`Tuning` holds the gain scales and command limits that change while ticks run: the host's thread
writes numbers between ticks, and blocks read them. At the neutral values a tick costs a comparison
or two for each block, in the place of its call.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from rcl_interfaces.msg import ParameterType, SetParametersResult

from unicon_base import AnyDict, AnyMapping, UniconError, alternatives
from unicon_base.packages import loaded
from unicon_base.resources import find_config
from unicon_core.check.rules import CODES
from unicon_core.flow import Block, Stage, Tick
from unicon_core.states.standard import GAIN_SCALE, GAIN_SCALE_SPEC
from unicon_core.workflow import HookBlocks, Program, WorkflowDocument
from unicon_core.workflow.document import split_setting
from unicon_core.workflow.registry import known
from unicon_ros import compat
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.parameter_table import (
    DECLARED,
    LIMITS,
    NO_LIMIT,
    RANGES,
    SCALES,
    WORDS,
    declare,
    fitted,
)

UNSCALED = (1.0, 1.0)

LEAST_DAMPING_RATIO = 0.5
"""The damping ratio, as a part of that which the gains were made for, may not fall below this."""


def too_little_damping(stiffness_scale: float, damping_scale: float) -> str:
    """Return why two gain scales go together badly, or "".

    A joint's damping ratio kd / (2 √(kp · inertia)) goes with damping_scale / √stiffness_scale.
    """
    least = LEAST_DAMPING_RATIO * math.sqrt(stiffness_scale)
    if damping_scale >= least:
        return ""
    return (
        f"damping_scale {damping_scale:g} is too little for stiffness_scale {stiffness_scale:g}: "
        f"joints would ring; give at least {math.ceil(1e3 * least) / 1e3:g} "
        f"({LEAST_DAMPING_RATIO:g} · √stiffness_scale), or less stiffness"
    )


class Tuning:
    """Numbers that are applied in every tick.

    Attributes:
        scales: factors of `joint_stiffness` and `joint_damping`, shape (2,).
        command_limit: largest magnitude of vx, vy [m/s] and wz [rad/s], shape (3,).
    """

    memory = ("_own", "_changed")  # the numbers are those of today, whatever moment a run repeats

    def __init__(self) -> None:
        self._own: tuple[Any, ...] = ()
        self._changed = np.zeros(2, np.int8)
        self.scales: Any = memoryview(np.ones(2).data)
        self.command_limit = np.full(3, NO_LIMIT)

    def values(self) -> dict[str, float]:
        """Return what the parameters are at present, by their names on `unicon_node`."""
        limits = zip(LIMITS, map(float, self.command_limit))
        return {**dict(zip(SCALES, map(float, self.scales))), **dict(limits)}

    def refusal(self, values: Mapping[str, float]) -> str:
        """Return why parameters cannot be set together with the present ones, or ""."""
        if values.keys().isdisjoint(SCALES):
            return ""
        meant = {**self.values(), **values}
        return too_little_damping(*(meant[name] for name in SCALES))

    def apply(self, values: Mapping[str, float]) -> None:
        """Set those of some parameters that are here."""
        for i, name in enumerate(SCALES):
            self.scales[i] = values.get(name, self.scales[i])
        for i, name in enumerate(LIMITS):
            self.command_limit[i] = values.get(name, self.command_limit[i])

    def declare(self, document: WorkflowDocument) -> None:
        """Let a workflow have the state `gain_scale`, before it is built: records tell it then.

        A state of that name that it has already is its own, and stays.
        """
        states = document.get("states", {})
        if GAIN_SCALE not in states:
            document.values["states"] = {**states, GAIN_SCALE: GAIN_SCALE_SPEC.to_dict()}

    def hook(self, program: Program) -> HookBlocks:
        """Return the blocks that limit the velocity command and scale the gains.

        Place it after the hook that receives commands.
        """
        command = program.states["velocity_command"]
        limit = self.command_limit
        each = memoryview(limit.data)  # a reduction would cost more than the rest of the block

        def limited() -> None:
            np.clip(command, -limit, limit, out=command)

        limits = {"each": each, "no": NO_LIMIT, "limited": limited}
        unscaled, scaled, changed = self._gain_scale(program)
        scaling = {"scales": self.scales, "changed": changed, "scaled": scaled}
        gains = ("joint_stiffness", "joint_damping")
        told = (GAIN_SCALE,) if _declared(program) else ()
        return {
            Stage.INPUT: [
                Block(
                    "command limits",
                    limited,
                    amends=("velocity_command",),
                    endless=True,
                    inline="(each[0] < no or each[1] < no or each[2] < no) and limited()",
                    inline_names=limits,
                ),
                # Declares nothing: it takes back what `gain scale` did, and no more.
                Block(
                    "gains unscaled",
                    unscaled,
                    endless=True,
                    inline="changed[0] and unscaled()",
                    inline_names={"changed": changed, "unscaled": unscaled},
                ),
            ],
            Stage.TUNE: [
                Block(
                    "gain scale",
                    scaled,
                    writes=told,
                    amends=gains,
                    endless=True,
                    inline="(scales[0] != 1.0 or scales[1] != 1.0 or changed[1]) and scaled()",
                    inline_names=scaling,
                )
            ],
        }

    def _gain_scale(self, program: Program) -> tuple[Tick, Tick, memoryview]:
        """Return what takes the scales out of the gains before the flow, and puts them in after.

        The third are two flags: the gains are scaled at present, and were in the last tick.

        A flow need not write its gains in every tick (a policy that runs every fourth does not), so
        without the former the factors would add up.
        """
        live = (program.states["joint_stiffness"], program.states["joint_damping"])
        own = self._own = tuple(array.copy() for array in live)
        told = program.states[GAIN_SCALE] if _declared(program) else np.ones(2)
        changed = memoryview(self._changed.data)

        def unscaled() -> None:
            if changed[0]:
                changed[0] = 0
                for array, kept in zip(live, own):
                    array[...] = kept

        def scaled() -> None:
            scales = tuple(self.scales)
            told[...] = scales
            changed[0] = changed[1] = scales != UNSCALED
            if changed[0]:
                for array, kept, scale in zip(live, own, scales):
                    kept[...] = array
                    np.multiply(array, scale, out=array, casting="unsafe")

        return unscaled, scaled, changed


def _declared(program: Program) -> bool:
    return program.states.layout.specs.get(GAIN_SCALE) == GAIN_SCALE_SPEC


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


def unsuitable(values: AnyMapping) -> str:
    """Return why a parameter cannot have the value that it is set to, or ""."""
    for name, value in values.items():
        words = WORDS.get(name)
        if words and value not in words:
            return f"{name} is one of {', '.join(words)}, not {value!r}"
        texts = value if isinstance(value, list | tuple) else [value]
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

    def _refusal(self, values: AnyDict) -> str:
        """Return why these numbers cannot be set together with the present ones, or ""."""
        for name in RANGES:
            if not math.isfinite(values.get(name, 0.0)):
                return f"{name} is {values[name]}; give a finite number"
        return self._tuning.refusal(values)
