"""Tuning: gain scales and command limits that a host may change while ticks run.

The host's thread writes numbers between ticks; the blocks read them. At the neutral values a tick
costs a comparison or two for each block, in the place of its call.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from unicon_core.flow import Block, Stage, Tick
from unicon_core.states.standard import GAIN_SCALE, GAIN_SCALE_SPEC
from unicon_core.workflow import Program, WorkflowDocument
from unicon_ros.parameter_table import LIMITS, NO_LIMIT, SCALES

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

    def __init__(self) -> None:
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

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
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
        own = tuple(array.copy() for array in live)
        told = program.states[GAIN_SCALE] if _declared(program) else np.ones(2)
        changed = memoryview(np.zeros(2, np.int8).data)

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
