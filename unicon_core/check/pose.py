"""Default pose and action: within limits, the same on both sides, feet on the ground, and sent."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import compress
from typing import Any

import numpy as np

from unicon_base import TextSink
from unicon_base.arrays import Bool
from unicon_core.blocks.safety.limits import EffortLimits, JointLimits, VelocityLimits
from unicon_core.check.graph import has_limits
from unicon_core.check.joints import check_mirrored, mirror_pairs, robot_values
from unicon_core.check.result import CheckResult, PolicyResult, first
from unicon_core.check.subject import Subject, listed
from unicon_core.flow import Stage
from unicon_core.models.loaded import LoadedModel, floors, on_floor
from unicon_core.models.posed import PosedModel, foot_bodies, foot_geoms
from unicon_core.platforms.platform import Resettable
from unicon_core.policies.contract import ActionKind
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
PLAUSIBLE_ACTION = 1.0
"""Action that a trained policy reaches in every walk; used where the contract has no clip."""
UNIT_TORQUE = 2.0
"""Stiffness · scale over the effort limit: 0.25 in BeyondMimic's rule, 0.74 for the Go1 policy.
More is worth a look and may be right: a wrist of 5 N·m has 8 with a scale of 1."""
LARGEST_SCALE = 1.0
"""In [rad] for one unit of action: actions in radians have 1, published ones 0.07 to 1."""
ROUNDING = 1e-4
"""In [rad]: by how much a figure may be beyond a limit, which is often the same one rounded."""


def check_pose(subject: Subject, result: CheckResult) -> None:
    """Add the table of poses for each policy, and findings."""
    policies = subject.policy_results(result)
    for policy in policies:
        _limits(subject.robot, policy)
        check_mirrored(policy, "pose.symmetry", "default_joint_pos")
    model = subject.model
    if model is not None:
        check_collision(model, subject.robot, result, subject.document.where("scene"))
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
    joints, pose = policy.contract.joints, policy.contract.default_joint_pos.astype(np.float64)
    own, lower, upper = robot_values(robot, joints, "default_joint_pos", "lower", "upper")
    outside = (pose < lower - ROUNDING) | (pose > upper + ROUNDING)
    far = np.abs(pose - own) > 0.3
    columns = {
        "joint": joints,
        "policy [rad]": figures(pose),
        "robot [rad]": figures(own),
        "limits [rad]": spans(lower, upper, ".4g"),
        "": ["outside" if out else "≠" if off else "" for out, off in zip(outside, far)],
    }
    policy.result.columns(f"Default pose of policy {policy.key}", columns)
    policy.find(
        "pose.limits",
        "default_joint_pos",
        first(
            outside,
            lambda i: (
                f"{joints[i]} is {figure(pose[i])} rad, its limits are "
                f"[{span(lower[i], upper[i], ', ', '.4g')}]"
            ),
        ),
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
                f"({min(lowest, key=lowest.__getitem__)})"
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
    geom = min(heights, key=heights.__getitem__)
    return model.body(int(model.geom_bodyid[geom])).name, heights[geom]


def _balance(wrong: TextSink, posed: PosedModel, geoms: list[int]) -> None:
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
    result.find("model.collision", f"model {loaded.path}, collision geometry", what, where=where)


def check_action(subject: Subject, result: CheckResult) -> None:
    """Add one table of reachable targets for each policy, and findings."""
    for policy in subject.policy_results(result):
        _action(subject, policy)
        check_mirrored(policy, "action.symmetry", "action.scale")


def _action(subject: Subject, policy: PolicyResult) -> None:
    robot, contract, action = subject.robot, policy.contract, policy.contract.action
    joints, kinds = action.joints, action.kinds
    offset, scale = action.offset.astype(np.float64), action.scale.astype(np.float64)
    bound = np.tile([[-PLAUSIBLE_ACTION], [PLAUSIBLE_ACTION]], (1, len(joints)))
    clip = bound if action.clip is None else action.clip.astype(np.float64)
    wide = np.abs(clip).max(axis=0) > 10.0  # a clip that only guards against blow-ups
    clip = np.where(wide, bound, clip)
    low, high = np.sort(offset + scale * clip, axis=0)
    lower, upper, speed, effort = robot_values(
        robot, joints, "lower", "upper", "velocity_limit", "effort_limit"
    )
    position, velocity = action.of_kind("position"), action.of_kind("velocity")
    most = np.where(velocity, speed, effort)
    lower, upper = np.where(position, (lower, upper), (-most, most))
    at = joint_index(joints, contract.joints)
    stiffness, damping = np.array([contract.stiffness, contract.damping], np.float64)[:, at]
    share = np.abs(scale) * np.where(position, stiffness, np.where(velocity, damping, 1.0)) / effort
    outside = (low < lower - ROUNDING) | (high > upper + ROUNDING)
    unit = "" if kinds else " [rad]"
    columns = {
        "joint": joints,
        **({"target": kinds} if kinds else {}),
        "offset": figures(offset),
        "scale": figures(scale),
        "action": spans(*clip),
        f"reach{unit}": spans(low, high, ".4g"),
        f"limits{unit}": spans(lower, upper, ".4g"),
        "torque/unit": [figure(each, ".2f") if np.isfinite(each) else "?" for each in share],
        "": ["outside" if each else "" for each in outside],
    }
    lines = [f"target = offset + scale · action; last action is the {action.feedback} one"]
    if action.clip is None or wide.any():
        lines.append(f"no clip that binds: shown is an action of ±{PLAUSIBLE_ACTION:g}")
    lines += (
        [
            "position in [rad], velocity in [rad/s], torque in [N·m]",
            "torque/unit: scale · stiffness (velocity: · damping), of the effort limit",
        ]
        if kinds
        else ["torque/unit: stiffness · scale as a share of the effort limit"]
    )
    policy.result.columns(f"Action of policy {policy.key}", columns, lines)
    idle = scale == 0.0
    if idle.all():
        policy.find("action.scale", "action.scale", "it is 0: no joint could move")
    elif idle.any():
        evidence = f"0 at {listed(compress(joints, idle))}: they stay at their offset"
        policy.note("action.scale", "action.scale", evidence)
    policy.find(
        "action.limp",
        "action.kind",
        first(
            position & (stiffness == 0.0) & ~idle,
            lambda i: (
                f"{joints[i]} is given positions and its stiffness is 0: it does not go there"
            ),
        ),
    )
    jumps = position & (np.abs(scale) > upper - lower)
    policy.find(
        "action.scale",
        "action.scale",
        first(
            jumps,
            lambda i: (
                f"one unit of action moves {joints[i]} by {scale[i]:g} rad, and its whole "
                f"range is {upper[i] - lower[i]:.4g}"
            ),
        ),
        # An action in radians (scale 1) may well span more than a narrow joint's range.
        error=bool((np.abs(scale[jumps]) > LARGEST_SCALE + 1e-6).any()),
    )
    policy.note(
        "action.torque",
        "action.scale and stiffness",
        first(
            position & (share > UNIT_TORQUE),
            lambda i: (
                f"one unit of action asks {joints[i]} for {stiffness[i]:g} · {scale[i]:g} = "
                f"{stiffness[i] * scale[i]:.3g} N·m, and its effort limit is {effort[i]:g}"
            ),
        ),
    )
    strange = position & ((offset < lower - ROUNDING) | (offset > upper + ROUNDING))
    if strange.any():
        i = int(strange.argmax())
        policy.find(
            "action.offset",
            "action.offset",
            f"action 0 puts {joints[i]} at {figure(offset[i])} rad, its limits are "
            f"[{span(lower[i], upper[i], ', ', '.4g')}]",
        )
    _reach(subject, policy, outside)


# Of a target: its state, and the block that limits it, NAME_limits.
_KINDS: tuple[tuple[ActionKind, str, str, type], ...] = (
    ("position", "joint_pos_target", "joint", JointLimits),
    ("velocity", "joint_vel_target", "velocity", VelocityLimits),
    ("torque", "joint_effort_ff", "effort", EffortLimits),
)


def _reach(subject: Subject, policy: PolicyResult, outside: Bool) -> None:
    """Find targets that are not sent (a joint would stand still), and those that nothing limits."""
    action, where = policy.contract.action, subject.document.where
    for kind, state, limits, block in _KINDS:
        own = action.of_kind(kind)
        unsent = _unsent(subject, state)
        if action.kinds and own.any() and unsent:
            given = f"it gives {listed(compress(action.joints, own))} a {kind}, and {unsent}"
            policy.find("action.unsent", "", given, where=where("platform"))
        far = outside & own
        if not far.any():
            continue
        text = (
            f"actions within the table reach beyond the {limits} limits of "
            f"{listed(compress(action.joints, far))}"
        )
        if has_limits(subject, block):
            policy.note("action.reach", "", f"{text}; {limits}_limits cuts them off")
            continue
        text += f", and no {limits}_limits is in safety:"
        policy.find("action.reach", "", text, f"add {limits}_limits to safety", where("safety"))


def _unsent(subject: Subject, state: str) -> str:
    """Return that the platform does not send a state; "" where it does, or is elsewhere."""
    facts = subject.program.platform.facts
    sent = not subject.program.has_platform or state in facts.reads
    return "" if sent else f"platform {facts.name!r} does not send {state}"


def check_fed(subject: Subject, result: CheckResult) -> None:
    """Find blocks whose torques a platform leaves out, such as `gravity`: the arms would sag."""
    unsent = _unsent(subject, "joint_effort_ff")
    for block in subject.blocks if unsent else ():
        if block.stage is Stage.FLOW and "joint_effort_ff" in block.amends:
            evidence = f"it adds torques, and {unsent}"
            result.find("action.unsent", f"block {block.name!r}", evidence, where=block.where)
