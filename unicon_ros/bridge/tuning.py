"""Tuning: gain scales and command limits that a host may change while ticks run.

The host's thread writes numbers between ticks; the blocks read them. At the neutral values a tick
costs one comparison each.
"""

from __future__ import annotations

import numpy as np

from unicon_core.flow import Block, Zip
from unicon_core.workflow import Workflow

__all__ = ["NO_LIMIT", "Tuning"]

NO_LIMIT = 100.0
"""A command limit from here on does nothing, [m/s] and [rad/s]."""


class Tuning:
    """Numbers that are applied in every tick.

    Attributes:
        stiffness_scale, damping_scale: factors of `joint_stiffness` and `joint_damping`.
        command_limit: largest magnitude of vx, vy [m/s] and wz [rad/s], float32, shape (3,).
    """

    def __init__(self) -> None:
        self.stiffness_scale = 1.0
        self.damping_scale = 1.0
        self.command_limit = np.full(3, NO_LIMIT, np.float32)

    def inputs(self, workflow: Workflow) -> list[Block]:
        """Return the block that limits the velocity command; a hook of `load_workflow`.

        Place it after the hook that receives commands.
        """
        command = workflow.states["velocity_command"]
        limit = self.command_limit

        def limited() -> None:
            if limit.min() < NO_LIMIT:
                np.clip(command, -limit, limit, out=command)

        return [Block("command limits", limited, amends=("velocity_command",))]

    def insert(self, workflow: Workflow) -> None:
        """Put the block that scales the gains before the safety blocks, the last word."""
        stiffness = workflow.states["joint_stiffness"]
        damping = workflow.states["joint_damping"]

        def scaled() -> None:
            if self.stiffness_scale != 1.0:
                np.multiply(stiffness, self.stiffness_scale, out=stiffness, casting="unsafe")
            if self.damping_scale != 1.0:
                np.multiply(damping, self.damping_scale, out=damping, casting="unsafe")

        block = Block("gain scale", scaled, amends=("joint_stiffness", "joint_damping"))
        root = workflow.root
        assert isinstance(root, Zip)
        children = list(root.children)
        roles = [child.role if isinstance(child, Block) else "" for child in children]
        at = next(i for i, role in enumerate(roles) if role in ("safety", "send"))
        children.insert(at, block)
        workflow.root = Zip(*children)
