"""An arm of six joints on a turned base, with a model of its own, and what moves it, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from reference_capsules import nearest

from unicon_core.models.find import pick_model
from unicon_core.robots import Robot
from unicon_manipulation.ik.chain import Chain, load_apart
from unicon_manipulation.ik.differential import DifferentialIk
from unicon_manipulation.ik.tasks import Settings, Weights

__all__ = ["Solved", "write_arm"]

JOINTS = ("yaw", "lift", "elbow", "roll", "pitch", "twist")

ROBOT = """
schema: unicon.robot/1
name: welder
description: An arm to test with
manufacturer: Nobody
kind: arm
models: {mjcf: welder.xml}
base_frame: plate
joints:
{joints}
imu: null
groups: {arm: [yaw, lift, elbow, roll, pitch, twist], hand: [roll, pitch, twist]}
end_effectors:
  elbow: {body: forearm, position: [0.3, 0.0, 0.0]}
  tool: {body: flange, position: [0.0, 0.0, 0.1], quat: [0.5, 0.5, 0.5, 0.5]}
capsules:
  pillar: {body: plate, from: [0, 0, 0], to: [0, 0, 0.1], radius: 0.06}
  upper_arm: {body: upper_arm, from: [0.05, 0, 0], to: [0.3, 0, 0], radius: 0.04}
  forearm: {body: forearm, from: [0.05, 0, 0], to: [0.25, 0, 0], radius: 0.035}
  hand: {body: flange, from: [0, 0, 0.06], radius: 0.05}
transport: {protocol: fake, rate_hz: 500}
sources:
  joints: "made up"
  gains: "made up"
  default: "made up"
  rest: "made up"
  transport: "made up"
  end_effectors: "made up"
  capsules: "made up"
unknown: []
"""

LINKS = (
    ("post", "pos='0 0 0.1'", "yaw", "0 0 1"),
    ("upper_arm", "pos='0 0 0.1'", "lift", "0 1 0"),
    ("forearm", "pos='0.35 0 0'", "elbow", "0 1 0"),
    ("wrist", "pos='0.3 0 0'", "roll", "1 0 0"),
    ("knuckle", "", "pitch", "0 1 0"),
    ("flange", "pos='0.05 0 0' euler='0 90 0'", "twist", "0 0 1"),
)
MODEL = "".join(
    (
        "<mujoco><worldbody><body name='plate' pos='0.4 -0.1 0.6' euler='0 30 90'>",
        *(
            f"<body name='{body}' {place}><joint name='{joint}' axis='{axis}'/>"
            "<geom size='0.03' mass='1'/>"
            for body, place, joint, axis in LINKS
        ),
        "</body>" * (1 + len(LINKS)),
        "</worldbody></mujoco>",
    )
)
DEFAULT = (0.3, -0.9, 1.4, 0.2, 0.6, 0.1)


def write_arm(folder: Path, **changes: str) -> Path:
    """Write the robot file beside its model; return it.

    Args:
        folder: for both.
        changes: text to what stands for it in the robot file.
    """
    facts = "velocity: 8.0, effort: 40.0, rest: 0.0, stiffness: 60.0, damping: 3.0"
    joints = "\n".join(
        f"  - {{name: {name}, lower: -2.5, upper: 2.5, default: {default}, {facts}}}"
        for name, default in zip(JOINTS, DEFAULT)
    )
    text = ROBOT.replace("{joints}", joints)
    for old, new in changes.items():
        text = text.replace(old, new)
    (folder / "welder.xml").write_text(MODEL)
    path = folder / "welder.yaml"
    path.write_text(text)
    return path


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
        self.chain.put(self.pose, self.ik.pos)
        return nearest(self.robot, self.chain, self.reaching.pairs)
