"""The default pose: within limits, the same on both sides, feet on the ground."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from unicon_core.check.mirror import check_mirrored, mirror_pairs
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.models.posed import PosedModel, foot_geoms
from unicon_core.platforms.platform import Resettable
from unicon_core.policies import PolicyContract
from unicon_core.robots import joint_index

__all__ = ["check_pose"]

BELOW_FEET = 0.01
"""How far another part may be below the feet in [m]."""
TILTED_FOOT = 0.03
"""How far the parts of one foot may differ in height in [m] (10° on the G1's sole)."""
OFF_BALANCE = 0.1
"""How far the centre of mass may be outside the feet in [m]; inside them for all poses tried."""
INSIDE_FLOOR = 0.02
"""How far a simulation may begin inside the floor in [m]."""
ABOVE_FLOOR = 0.3
"""How far above it."""


def check_pose(subject: Subject, result: CheckResult) -> None:
    """Add the table of poses for each policy, and findings."""
    for key, contract in subject.policies.items():
        _limits(subject, result, key, contract)
        culprit, pose = (key, "default_joint_pos"), contract.default_joint_pos
        check_mirrored(result, "pose.symmetry", culprit, contract, contract.joints, pose, 0.02)
    model = subject.model
    if not subject.robot.walks:
        return
    if model is None:
        what = "it simulates no model, so feet and height above the floor are not checked"
        result.note("pose.feet", f"platform {subject.platform.name!r}", what)
        return
    for key, contract in subject.policies.items():
        _feet(subject, result, key, contract, PosedModel(model))
    _start(subject, result, PosedModel(model))


def _limits(subject: Subject, result: CheckResult, key: str, contract: PolicyContract) -> None:
    robot = subject.robot
    rows, outside, far = [], [], []
    policy_from_robot = joint_index(contract.joints, robot.joint_names)
    for i, (name, j) in enumerate(zip(contract.joints, policy_from_robot)):
        value, own = float(contract.default_joint_pos[i]), float(robot.default_joint_pos[j])
        lower, upper = float(robot.lower[j]), float(robot.upper[j])
        wrong = value < lower - 1e-4 or value > upper + 1e-4
        rows.append(
            [
                name,
                f"{value:g}",
                "?" if np.isnan(own) else f"{own:g}",
                f"{lower:.4g} … {upper:.4g}",
                "outside" if wrong else "≠" if abs(value - own) > 0.3 else "",
            ]
        )
        outside += [(name, value, lower, upper)] if wrong else []
        far += [name] if abs(value - own) > 0.3 else []
    columns = ["joint", "policy [rad]", "robot [rad]", "limits [rad]", ""]
    result.table(f"Default pose of policy {key}", columns, rows)
    if outside:
        name, value, lower, upper = outside[0]
        result.find(
            "pose.limits",
            f"policy {key!r}, default_joint_pos",
            f"{name} is {value:g} rad, its limits are [{lower:.4g}, {upper:.4g}] "
            f"({len(outside)} joints)",
            "correct the pose, its order or its unit (degrees?)",
            contract.path,
        )
    if far:
        result.note(
            "pose.differ",
            f"policy {key!r}",
            f"its default pose is more than 0.3 rad from robot {robot.name}'s at {listed(far)}",
        )


def _feet(
    subject: Subject, result: CheckResult, key: str, contract: PolicyContract, posed: PosedModel
) -> None:
    """Put the default pose into the model, base upright, and look what is lowest."""
    model, robot = posed.loaded.model, subject.robot
    feet = foot_geoms(model, robot.feet)
    if not feet:
        result.note(
            "pose.feet",
            f"model {posed.loaded.path}",
            f"none of the robot's feet ({listed(robot.feet) or 'none named'}) is in the model, so "
            "their height is not checked",
        )
        return
    pose = np.nan_to_num(robot.default_joint_pos.astype(np.float64))
    pose[joint_index(contract.joints, robot.joint_names)] = contract.default_joint_pos
    posed.put(pose)
    heights = posed.heights()
    if not heights:
        return

    def wrong(what: str) -> None:
        remedy = "correct the pose, its order, signs or unit"
        culprit = f"policy {key!r}, default_joint_pos"
        result.find("pose.feet", culprit, what, remedy, contract.path)

    geoms = {geom for group in feet.values() for geom in group}
    lowest_foot = {
        foot: min(heights[geom] for geom in group if geom in heights)
        for foot, group in feet.items()
        if any(geom in heights for geom in group)
    }
    others = {geom: height for geom, height in heights.items() if geom not in geoms}
    if not lowest_foot:
        return
    ground = min(lowest_foot.values())
    rows = [[foot, f"{1e3 * (height - ground):.0f}"] for foot, height in lowest_foot.items()]
    result.table(f"Feet in the default pose of policy {key}", ["foot", "height [mm]"], rows)
    if others:
        geom = min(others, key=lambda g: others[g])
        if others[geom] < ground - BELOW_FEET:
            body = model.body(int(model.geom_bodyid[geom])).name
            wrong(
                f"{body} is {1e2 * (ground - others[geom]):.1f} cm below the lowest foot "
                f"({min(lowest_foot, key=lambda f: lowest_foot[f])})"
            )
    for foot, group in feet.items():
        across = [heights[geom] for geom in group if geom in heights]
        if across and max(across) - min(across) > TILTED_FOOT:
            wrong(
                f"{foot} is not flat on the ground: its parts differ in height by "
                f"{1e2 * (max(across) - min(across)):.1f} cm"
            )
    _balance(wrong, posed, [g for group in feet.values() for g in group])
    for left, right in mirror_pairs(list(lowest_foot)):
        apart = abs(lowest_foot[left] - lowest_foot[right])
        if apart > 0.03:
            wrong(f"{left} and {right} are {1e2 * apart:.1f} cm apart in height")


def _balance(wrong: Callable[[str], None], posed: PosedModel, geoms: list[int]) -> None:
    """The centre of mass over the feet: a pose that is far off it is none to stand in."""
    model, data = posed.loaded.model, posed.data
    root = int(model.body_rootid[model.geom_bodyid[geoms[0]]])
    centre, places = data.subtree_com[root][:2], data.geom_xpos[geoms][:, :2]
    outside = np.maximum(places.min(axis=0) - centre, centre - places.max(axis=0))
    far = float(outside.max())
    if far > OFF_BALANCE:
        axis = int(outside.argmax())
        side = ("in front of", "behind") if axis == 0 else ("to the left of", "to the right of")
        wrong(
            f"the centre of mass is {1e2 * far:.0f} cm "
            f"{side[int(centre[axis] < places[:, axis].mean())]} the feet"
        )


def _start(subject: Subject, result: CheckResult, posed: PosedModel) -> None:
    """How far the simulation begins above the floor or in it."""
    platform, states = subject.program.platform, subject.program.states
    told = ("joint_pos", "base_pos_w", "base_quat")
    if not {*told} <= {*platform.facts.writes}:
        return
    before = states.snapshot()
    platform.recv()
    first = slice(None) if states.num_robots is None else 0
    joint_pos, *base = (states[name][first] for name in told)
    posed.put(joint_pos, np.concatenate(base))
    states.restore(before)
    if isinstance(platform, Resettable):
        platform.reset()
    heights = posed.heights()
    if not heights:
        return
    geom = min(heights, key=lambda g: heights[g])
    model = posed.loaded.model
    lowest, body = heights[geom], model.body(int(model.geom_bodyid[geom])).name
    where = subject.document.where("scene")
    if lowest < -INSIDE_FLOOR:
        result.find(
            "pose.floor",
            "initial state of the simulation",
            f"{body} is {-1e2 * lowest:.1f} cm inside the floor",
            "raise initial_height, or leave it out and give initial_pose",
            where,
        )
    elif lowest > ABOVE_FLOOR:
        result.find(
            "pose.floor",
            "initial state of the simulation",
            f"the lowest part, {body}, is {lowest:.2f} m above the floor",
            "lower initial_height, or leave it out and give initial_pose",
            where,
        )
