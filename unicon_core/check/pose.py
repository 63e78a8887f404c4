"""The default pose: within limits, the same on both sides, feet on the ground, which they touch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import compress
from typing import Any

import numpy as np

from unicon_core.check.order import check_mirrored, mirror_pairs
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import Subject, listed
from unicon_core.models.loaded import LoadedModel, floors, on_floor
from unicon_core.models.posed import PosedModel, foot_bodies, foot_geoms
from unicon_core.platforms.platform import Resettable
from unicon_core.robots import Robot, joint_index
from unicon_core.text_table import figure, figures, span, spans

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
    policies = subject.policy_results(result)
    for policy in policies:
        joints, pose = policy.contract.joints, policy.contract.default_joint_pos
        _limits(subject.robot, policy)
        check_mirrored(policy, "pose.symmetry", "default_joint_pos", joints, pose, 0.02)
    model = subject.model
    if model is not None:
        where = subject.document.where("scene")
        check_collision(model, subject.robot, result, where)
    if not subject.robot.walks:
        return
    if model is None:
        what = "it simulates no model, so feet and height above the floor are not checked"
        result.note("pose.feet", f"platform {subject.platform.name!r}", what)
        return
    posed = PosedModel(model)
    for policy in policies:
        _feet(subject.robot, policy, posed)
    _start(subject, result, posed)


def _limits(robot: Robot, policy: PolicyResult) -> None:
    joints = policy.contract.joints
    index = joint_index(joints, robot.joint_names)
    pose = policy.contract.default_joint_pos.astype(np.float64)
    own, lower, upper = (
        values[index].astype(np.float64)
        for values in (robot.default_joint_pos, robot.lower, robot.upper)
    )
    outside = (pose < lower - 1e-4) | (pose > upper + 1e-4)
    far = np.abs(pose - own) > 0.3
    columns = {
        "joint": joints,
        "policy [rad]": figures(pose),
        "robot [rad]": figures(own),
        "limits [rad]": spans(lower, upper, ".4g"),
        "": ["outside" if out else "≠" if off else "" for out, off in zip(outside, far)],
    }
    policy.result.columns(f"Default pose of policy {policy.key}", columns)
    wrong = np.flatnonzero(outside)
    if wrong.size:
        i = wrong[0]
        policy.find(
            "pose.limits",
            "default_joint_pos",
            f"{joints[i]} is {figure(pose[i])} rad, its limits are "
            f"[{span(lower[i], upper[i], ', ', '.4g')}] ({wrong.size} joints)",
        )
    if far.any():
        policy.note(
            "pose.differ",
            "",
            f"its default pose is more than 0.3 rad from robot {robot.name}'s at "
            f"{listed(compress(joints, far))}",
        )


def _feet(robot: Robot, policy: PolicyResult, posed: PosedModel) -> None:
    """Put the default pose into the model, base upright, and look what is lowest."""
    model, contract, result = posed.loaded.model, policy.contract, policy.result
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

    def wrong(what: str) -> None:
        policy.find("pose.feet", "default_joint_pos", what)

    geoms = [geom for group in feet.values() for geom in group]
    parts = {foot: [heights[g] for g in group if g in heights] for foot, group in feet.items()}
    lowest = {foot: min(own) for foot, own in parts.items() if own}
    if not lowest:
        return
    ground = min(lowest.values())
    rows = [[foot, figure(1e3 * (height - ground), ".0f")] for foot, height in lowest.items()]
    title = f"Feet in the default pose of policy {policy.key}"
    result.table(title, ["foot", "height [mm]"], rows)
    others = {geom: height for geom, height in heights.items() if geom not in geoms}
    if others:
        body, height = _lowest(model, others)
        if height < ground - BELOW_FEET:
            wrong(
                f"{body} is {1e2 * (ground - height):.1f} cm below the lowest foot "
                f"({min(lowest, key=lambda foot: lowest[foot])})"
            )
    for foot, height in lowest.items():
        across = max(parts[foot]) - height
        if across > TILTED_FOOT:
            wrong(
                f"{foot} is not flat on the ground: its parts differ in height by "
                f"{1e2 * across:.1f} cm"
            )
    _balance(wrong, posed, geoms)
    for left, right in mirror_pairs(list(lowest)):
        apart = abs(lowest[left] - lowest[right])
        if apart > 0.03:
            wrong(f"{left} and {right} are {1e2 * apart:.1f} cm apart in height")


def _lowest(model: Any, heights: Mapping[int, float]) -> tuple[str, float]:
    """Return the body of the lowest geom, and how high that is."""
    geom = min(heights, key=lambda geom: heights[geom])
    return model.body(int(model.geom_bodyid[geom])).name, heights[geom]


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
    body, lowest = _lowest(posed.loaded.model, heights)
    if lowest < -INSIDE_FLOOR:
        what, change = f"{body} is {-1e2 * lowest:.1f} cm inside the floor", "raise"
    elif lowest > ABOVE_FLOOR:
        what, change = f"the lowest part, {body}, is {lowest:.2f} m above the floor", "lower"
    else:
        return
    result.find(
        "pose.floor",
        "initial state of the simulation",
        what,
        f"{change} initial_height, or leave it out and give initial_pose",
        subject.document.where("scene"),
    )


def check_collision(loaded: LoadedModel, robot: Robot, result: CheckResult, where: Any) -> None:
    """Find a robot that would fall through the floor; note meshes that are absent.

    Args:
        loaded: the model that is simulated.
        robot: the robot.
        result: is added to.
        where: `file:line` of what chose the model.
    """
    for path, line in loaded.absent.items():
        result.note("model.meshes", f"model {path}", line, "add the files", where)
    if loaded.base is None or not floors(loaded.model):
        return
    touching, model = on_floor(loaded), loaded.model
    geoms = foot_geoms(model, robot.feet) if robot.walks else {}
    bodies = foot_bodies(model, robot.feet) if robot.walks else {}
    lost = {foot: loaded.absent_shapes.get(model.body(i).name, []) for foot, i in bodies.items()}
    feet = [foot for foot in bodies if foot in geoms or lost[foot]]  # else its shape may be another
    blind = [foot for foot in feet if not {*geoms.get(foot, ())} & {*touching}]
    if not touching:
        what = "nothing of the robot collides with the floor: it falls through"
    elif feet and len(blind) == len(feet):
        what = f"its feet ({listed(blind)}) do not collide with the floor: it sinks to its shins"
    else:
        return
    files = dict.fromkeys(file for foot in blind for file in lost[foot])
    what += f"; mesh files that are their shapes are absent: {listed(files)}" if files else ""
    result.find(
        "model.collision",
        f"model {loaded.path}, collision geometry",
        what,
        where=where,
    )
