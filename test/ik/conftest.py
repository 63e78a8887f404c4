"""An arm of six joints on a turned base, with a model of its own, and both arms of a G1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from welder import write_arm

from unicon_core.ik import DifferentialIk, Settings, Weights
from unicon_core.ik.chain import Chain
from unicon_core.ik.pairs import load_apart
from unicon_core.models.find import pick_model
from unicon_core.robots import Robot, load_robot


@pytest.fixture
def arm_file(tmp_path: Path) -> Path:
    return write_arm(tmp_path)


@pytest.fixture
def arm(arm_file: Path) -> Robot:
    return load_robot(arm_file)


@pytest.fixture
def g1(assets: Path) -> Robot:
    """A G1 with 29 joints, whose model is one of the assets."""
    return load_robot("g1_29dof")


class Solved:
    """Inverse kinematics of a robot that stands at its default pose.

    Attributes:
        robot, ik, chain: of it.
        pose: of all joints in [rad], shape (n,).
        moved: places of the moved ones.
    """

    def __init__(
        self,
        robot: Robot,
        effectors: Sequence[str] = ("tool",),
        moves: Sequence[str] = ("arm",),
        rate: float = 6.0,
        period: float = 0.02,
        weights: Weights | None = None,
        **settings: Any,
    ) -> None:
        self.robot, self.rate, self.period = robot, rate, period
        chosen = Settings(**settings)
        self.moved = robot.group(list(moves))
        reaching = load_apart(pick_model(robot), robot, effectors, self.moved, chosen.apart)
        self.reaching, self.chain = reaching, Chain(reaching.loaded, robot, effectors, self.moved)
        k = len(self.moved)
        each = [weights or Weights()] * len(effectors)
        self.ik = DifferentialIk(self.chain, robot, each, np.full(k, rate), period, chosen)
        self.pose = robot.default_joint_pos.astype(np.float64)
        self.ik.begin(self.pose[self.moved], np.ones(k, np.bool_))

    def at(self, own: Any, effector: int = 0) -> tuple[list[float], list[float]]:
        """Return where an end effector is with the moved joints somewhere."""
        self.chain.put(self.pose, np.asarray(own, np.float64))
        return self.chain.frame(effector)

    def random_pose(self, rng: np.random.Generator, share: float = 0.8) -> Any:
        """Return the moved joints somewhere within a share of their limits."""
        lower, upper = (a[self.moved].astype(float) for a in (self.robot.lower, self.robot.upper))
        return rng.uniform(share * lower, share * upper)

    def tick(self, *targets: Any) -> Any:
        """Make a step; return the moved joints."""
        self.ik(self.pose, targets)
        return self.ik.pos.copy()

    def distance(self) -> float:
        """Return how near the nearest of all pairs is now in [m]."""
        from reference_capsules import nearest

        self.chain.put(self.pose, self.ik.pos)
        return nearest(self.robot, self.chain, self.reaching.pairs)


@pytest.fixture
def solved() -> Callable[..., Solved]:
    """Builds inverse kinematics of a robot."""
    return Solved
