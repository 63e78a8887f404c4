"""Injected faults: what is made wrong, where and how much, for `unicon bench diagnose`.

A fault is in the plant, where joints, masses, sensors or gains are not what the simulator of the
robot has, or in the contract with which the policy ran. `injected.yaml` lists the kinds, and five
sizes of each for each robot, which `injected_records.ladder` finds. Where a policy would fall at
once, the robot hangs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.located_yaml import read_yaml
from unicon_core.check.joints import mirror_pairs
from unicon_core.check.twin.perturb import (
    exchanged,
    gains_of,
    permuted,
    renamed,
    with_action,
    with_gains,
    with_scales,
    with_terms,
)
from unicon_core.policies import PolicyContract
from unicon_core.policies.contract import FilterSpec
from unicon_lab.diagnose.plant import KINDS, Place

HEALTHY = "healthy"
HEALTHY_RECORDS = 60
ROBOTS = ("go2", "go1", "g1")
PLANTS = {"mujoco": ROBOTS, "pybullet": ROBOTS, "emulated": ("go2", "g1")}
SIGNS = ("projected_gravity", "base_ang_vel", "joint_pos", "joint_vel", "action")
OF_JOINT = " of a joint"
LOWERED = ("strength", "ground friction", "stiffness", "damping")
"""Kinds of which a fault takes something away."""
EDITED = ("payload", "centre", "inertia", "ground", "viscous")
"""Kinds that are in the model, and, all but the last, not in the motion of a robot that hangs."""
MEASURED = ("encoder", "stiffness", "damping", "gyro", "attitude")
"""Kinds that an emulated robot cannot have."""


@cache
def sizes() -> dict[str, dict[str, list[float]]]:
    """Return the kinds, and five sizes of each for each robot."""
    found: dict[str, dict[str, list[float]]]
    found = read_yaml(Path(__file__).with_name("injected.yaml")).value
    return found


@dataclass(frozen=True)
class Case:
    """One record that is made and diagnosed.

    Attributes:
        robot, plant: of `PLANTS`.
        kind: of `sizes`, or `HEALTHY`.
        size: which of the five; of a healthy record how many were before it.
        seed: of latency, and of what masses a plant has.
        amount: of the change.
        hung: whether the robot hangs.
    """

    robot: str
    plant: str
    kind: str
    size: int
    seed: int
    amount: float = 0.0
    hung: bool = False

    @property
    def name(self) -> str:
        """What tells it from all others."""
        return f"{self.robot}/{self.plant}/{self.kind}/{self.size}/{self.seed}"

    @property
    def joint(self) -> int:
        """Number of the joint, of a kind that concerns one."""
        return (5 * self.size + 7 * self.seed) % 12

    @property
    def change(self) -> dict[Place, float]:
        """What differs in the plant."""
        kind = self.kind.removesuffix(OF_JOINT)
        if kind not in KINDS:
            return {}
        amount = -self.amount if kind in LOWERED else self.amount
        return {(kind, -1 if kind == self.kind else self.joint): amount}


def cases() -> list[Case]:
    """Return all: 15 of each kind, which meets every robot and plant that has it, and healthy."""
    found = []
    for kind, known in (*sizes().items(), (HEALTHY, {})):
        cells = [(r, p) for p, robots in PLANTS.items() for r in robots if _has(kind, r, p)]
        turns = [*product(range(3), range(1, 6))]
        if kind == HEALTHY:
            turns = [(i // len(cells) % 3, i + 1) for i in range(HEALTHY_RECORDS)]
        for (seed, size), (robot, plant) in zip(turns, cycle(cells)):
            five = known.get(robot) or known.get("all")
            amount = five[size - 1] if five else 0.0
            hung = "all" in known and plant != "pybullet"  # which has no gantry
            hung |= (robot, plant) == ("g1", "emulated")
            found.append(Case(robot, plant, kind, size, seed, amount, hung))
    return found


def _has(kind: str, robot: str, plant: str) -> bool:
    """Return whether a fault can be made there."""
    if plant == "pybullet":  # it has no rotors
        return not kind.startswith("armature")
    hangs = robot == "g1" and kind.startswith(EDITED[:-1])
    return plant == "mujoco" or not (hangs or kind.startswith(MEASURED))


def mistake(c: PolicyContract, case: Case, joint: str) -> tuple[PolicyContract, str]:
    """Return a changed contract, and what a diagnosis has to call the change."""
    s, k, action = case.amount, int(case.amount), c.action
    here, moved = (np.array(names) == joint for names in (c.joints, action.joints))
    ordered = renamed if k % 2 else permuted  # names alone, or each figure with its joint
    of_joint = f"{case.kind.removesuffix(OF_JOINT)} of {joint}"

    def scaled(factor: Any, *states: str) -> PolicyContract:
        return with_scales(c, lambda t: t.scale * np.float32(factor if t.state in states else 1))

    def term(state: str) -> str:
        return next(term.name for term in c.terms if term.state == state)

    match case.kind:
        case "joint order":
            return ordered(c, sorted(c.joints) if k > 2 else c.joints[::-1]), case.kind
        case "joint exchange":
            a, b = c.joints[2 * k : 2 * k + 2]
            return renamed(c, exchanged(c.joints, [(a, b)])), f"{case.kind} of {a} and {b}"
        case "left right":
            return ordered(c, exchanged(c.joints, mirror_pairs(c.joints))), case.kind
        case "joint sign":
            turned = scaled(1 - 2 * here, "joint_pos", "joint_vel")
            return with_action(turned, scale=action.scale * (1 - 2 * moved)), of_joint
        case "default pose" | "action offset":
            shifted = with_action(c, offset=action.offset + np.float32(s * moved))
            if case.kind == "default pose":
                pose = c.default_joint_pos + np.float32(s * here)
                shifted = replace(shifted, default_joint_pos=pose)
            return shifted, of_joint
        case "action scale":
            return with_action(c, scale=action.scale * np.float32(1 + s)), case.kind
        case "action scale of a joint":
            return with_action(c, scale=action.scale * np.float32(1 + s * moved)), of_joint
        case "action clip":
            bound = np.outer((-1, 1), np.full(len(moved), 1 / s))
            return with_action(c, clip=np.float32(bound)), case.kind
        case "action filter":
            return with_action(c, filter=FilterSpec(alpha=1 / (1 + s))), case.kind
        case "scale of joint_vel" | "scale of base_ang_vel":
            state = case.kind.removeprefix("scale of ")
            return scaled(1 + s, state), f"observation scale of {term(state)}"
        case "observation sign":
            state = SIGNS[k - 1]
            return scaled(-1, state), f"{case.kind} of {term(state) if k > 1 else state}"
        case "term order":
            first, then = c.terms[k - 1 : k + 1]
            terms = (*c.terms[: k - 1], then, first, *c.terms[k + 1 :])
            return with_terms(c, terms), f"{case.kind} of {first.name} and {then.name}"
        case "sent stiffness":
            return replace(c, stiffness=c.stiffness * np.float32(1 + s)), "stiffness"
        case "sent damping":
            return replace(c, damping=c.damping * np.float32(1 + s)), "damping"
        case "gain order":
            gains = gains_of(c)
            backwards = gains[:, ::-1]
            alike = k % 2 or np.allclose(backwards, gains)
            return with_gains(c, gains[::-1] if alike else backwards), case.kind
    return c, "delay"
