"""Blocks are built as a workflow builds them: by name, from options, against states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from unicon_core.errors import WorkflowError
from unicon_core.flow.block import Block
from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, standard_states
from unicon_core.workflow.autowire import BuildContext, autowire
from unicon_core.workflow.registry import find_factory

PERIOD = 0.02


@dataclass
class Bench:
    """A robot's states and what builds blocks on them."""

    robot: Robot
    states: States

    def block(self, name: str, **options: Any) -> Block:
        """Build a block by its registered name."""
        context = BuildContext(self.states, self.robot, PERIOD)
        return autowire(find_factory("blocks", name, WorkflowError), name, context, options)

    def ticks(self, block: Block, limit: int = 10_000) -> int:
        """Run a block until it is done; return the number of ticks."""
        for tick in range(1, limit + 1):
            if block.tick():
                if block.reset is not None:
                    block.reset()
                return tick
        raise AssertionError(f"{block.name} is not done after {limit} ticks")

    def stand(self) -> None:
        """Hold the standing pose: measured, commanded, with the robot's gains."""
        self.states.joint_pos = self.robot.default_joint_pos
        self.states.joint_pos_target = self.robot.default_joint_pos
        self.states.joint_stiffness = self.robot.joint_stiffness
        self.states.joint_damping = self.robot.joint_damping

    def randomize(self, rng: np.random.Generator) -> None:
        """Fill every float state with random values, the orientation with a unit quaternion."""
        for name in self.states:
            view = self.states[name]
            if view.dtype == np.float32:
                view[...] = rng.uniform(-2, 2, view.shape)
        self.states.base_quat /= np.linalg.norm(self.states.base_quat, axis=-1, keepdims=True)
        self.states.joint_stiffness = np.abs(self.states.joint_stiffness) * 20
        self.states.joint_damping = np.abs(self.states.joint_damping)


@pytest.fixture
def bench() -> Callable[..., Bench]:
    """Builds a Bench of a robot, with a batch axis where asked."""

    def build(robot: str = "go2", num_robots: int | None = None) -> Bench:
        loaded = load_robot(robot)
        return Bench(loaded, States(standard_states(loaded.joint_names), num_robots))

    return build
