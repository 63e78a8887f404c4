"""A bench for blocks: built as a program builds them, on the states of one robot; for tests.

bench = Bench("go2")
block = bench.block("pose", to="rest")
assert bench.ticks(block) == 100
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unicon_base import WorkflowError
from unicon_core.flow import Block
from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.workflow.autowire import BuildContext, autowire
from unicon_core.workflow.registry import find_factory


class Bench:
    """A robot's states and what builds blocks on them.

    Args:
        robot: name or path of a robot file, or a robot.
        num_robots: batch axis of the states; None for one robot without it.
        period: of a tick in [s].
        states: further states by name.
    """

    def __init__(
        self,
        robot: str | Robot = "go2",
        num_robots: int | None = None,
        *,
        period: float = 0.02,
        states: dict[str, StateSpec] | None = None,
    ) -> None:
        self.robot = load_robot(robot) if isinstance(robot, str) else robot
        self.period = period
        self.states = States(standard_states(self.robot.joint_names) | (states or {}), num_robots)

    def block(self, what: str | Callable[..., Any], **options: Any) -> Block:
        """Build a block by its registered name, or with a factory of your own."""
        context = BuildContext(self.states, self.robot, self.period)
        if not isinstance(what, str):
            return autowire(what, getattr(what, "__name__", "block"), context, options)
        return autowire(find_factory("blocks", what, WorkflowError), what, context, options)

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
