"""Joint coverage and order: one table of policy, robot and platform."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from operator import attrgetter
from pathlib import Path

import numpy as np

from unicon_base.arrays import Float32, Float64, Index
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import Subject, listed
from unicon_core.models.load import effort_ranges
from unicon_core.models.loaded import LoadedModel, dofs_above, drives, position_gains
from unicon_core.policies.policy import DrivenPolicy
from unicon_core.robots import Robot, joint_index
from unicon_core.text_table import figure


@dataclass(frozen=True)
class ModelJoints:
    """Joints as the model file has them, in the robot's order, NaN where it does not say.

    Attributes:
        path: of the file.
        lower, upper: position range in [rad], shape (n,).
        effort: largest torque in [N·m].
        stiffness, damping: gains of position actuators in [N·m/rad], [N·m·s/rad].
        passive: damping of the joint itself in [N·m·s/rad].
    """

    path: Path
    lower: Float64
    upper: Float64
    effort: Float64
    stiffness: Float64
    damping: Float64
    passive: Float64


def model_joints(loaded: LoadedModel | None) -> ModelJoints | None:
    """Return what a model says, None without a model."""
    if loaded is None:
        return None
    model, ids = loaded.model, loaded.joints
    lower, upper = np.where(model.jnt_limited[ids], model.jnt_range[ids].T, np.nan)
    driven, none = drives(model), (np.nan, np.nan)  # the loader gives each joint an actuator
    kp, kd = np.transpose([position_gains(model, driven[joint][0]) or none for joint in ids])
    effort = np.maximum(*np.abs(effort_ranges(loaded, np.full(len(ids), np.nan))))
    effort[np.isinf(effort)] = np.nan
    passive = model.dof_damping[loaded.dofs]
    return ModelJoints(loaded.path, lower, upper, effort, kp, kd, passive)


def joint_depths(loaded: LoadedModel, robot: Robot, joints: Sequence[str]) -> list[int]:
    """Return how many degrees of freedom each joint's body has in the model, shape (n,)."""
    bodies = dict(zip(robot.joint_names, loaded.model.jnt_bodyid[loaded.joints].tolist()))
    return [len(dofs_above(loaded.model, bodies[name])) for name in joints]


def check_joints(subject: Subject, result: CheckResult) -> None:
    """Add the table of joints; motor slots that do not fit are findings."""
    robot = subject.robot
    names = robot.joint_names
    model = subject.model
    motors = [str(n) for each in _each(robot).values() for n in _slots(each)]
    columns = ["robot", "joint", *(f"policy {name}" for name in subject.policies)]
    columns += [subject.platform.name]
    rows = []
    for i, name in enumerate(names):
        row = [str(i), name]
        for contract in subject.policies.values():
            if name not in contract.joints:
                row.append("held")
            else:
                place = str(contract.joints.index(name))
                row.append(place if name in contract.action.joints else f"{place}, held")
        if model is not None:
            joint = model.joints[i]
            row.append(f"joint {joint} {model.model.joint(joint).name}")
        elif motors[i] and not subject.platform.simulated:
            row.append(f"motor {motors[i]}")
        else:
            row.append(str(i))
        rows.append(row)
    lines = []
    for policy in subject.policy_results(result):
        contract = policy.contract
        moved = len(contract.action.joints)
        same = [name for name in names if name in contract.joints] == list(contract.joints)
        order = "in the robot's order" if same else "in another order, aligned by name"
        lines.append(f"policy {policy.key} moves {moved} of {len(names)} joints, {order}")
        held = [name for name in names if name not in contract.action.joints]
        if held:
            evidence = f"does not move {listed(held)}; they are held at their default"
            policy.note("joints.held", "", evidence)
    if model is not None and model.welded:
        result.note(
            "joints.welded",
            f"model {model.path.name}",
            f"it lacks {listed(model.welded)}, which no policy moves: they are taken as welded",
        )
    _seen(subject, result)
    result.table("Joints", columns, rows, lines)
    if subject.platform.simulated:
        return
    for each in _each(robot).values():
        slots = each.transport.get("motors")
        count = len(each.joint_names)
        if isinstance(slots, list) and not len(set(slots)) == len(slots) == count:
            result.find(
                "joints.motors",
                f"robot {each.name}, transport.motors",
                f"{len(slots)} motor slots, {len(set(slots))} of them different, for "
                f"{count} joints",
                where=each.path,
            )


def _seen(subject: Subject, result: CheckResult) -> None:
    """Find policies that see joints which others move: few were trained so."""
    keys = {id(contract): key for key, contract in subject.program.policies.items()}
    for block in subject.program.blocks:
        tick = block.tick
        if not isinstance(tick, DrivenPolicy) or not {"joint_pos", "joint_vel"} & {*tick.reads}:
            continue
        names = subject.robot.joint_names
        known = {names[place] for place in (*tick.places, *tick.hidden)}
        seen = [name for name in names if name in tick.contract.joints and name not in known]
        if seen:
            result.find(
                "joints.seen",
                f"policy {keys[id(tick.contract)]!r}",
                f"sees {listed(seen)}, which others move: most policies fall by that",
                where=block.where,
            )


def _each(robot: Robot) -> Mapping[str, Robot]:
    return robot.members or {"": robot}


def _slots(robot: Robot) -> list[object]:
    """Return the motor slot of each joint, "" where none is said."""
    slots = robot.transport.get("motors")
    slots = slots if isinstance(slots, list) else []
    return [slots[i] if i < len(slots) else "" for i in range(robot.num_joints)]


ROUNDING = 0.02
"""Relative difference by which mirrored figures may differ (exports round to 3 decimals)."""
POSE_TOLERANCE = 0.02
"""In [rad] or [m]: by how much a pose may differ between sides."""

# Unitree, Fourier, AgiBot, Booster (left_…), quadrupeds (FL_…), short forms (l_…, …_l).
_SIDES = (
    (r"(^|_)left(?=_|$)", r"\g<1>right"),
    (r"(^|_)Left(?=_|$)", r"\g<1>Right"),
    (r"(^|_)LEFT(?=_|$)", r"\g<1>RIGHT"),
    (r"(^|_)([FRHM])L(?=_|$)", r"\g<1>\g<2>R"),
    (r"(^|_)L([FHMR])(?=_|$)", r"\g<1>R\g<2>"),
    (r"(^|_)l(?=_|$)", r"\g<1>r"),
    (r"(^|_)L(?=_|$)", r"\g<1>R"),
)


def mirror_pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs (left, right) of joints, in the order of the left ones.

    Args:
        names: joint names in any order.
    """
    known = set(names)
    pairs = []
    for name in names:
        for pattern, other in _SIDES:
            right = re.sub(pattern, other, name, count=1)
            if right != name and right in known:
                pairs.append((name, right))
                break
    return pairs


def _odd(joints: Sequence[str], figures: Mapping[str, Float32]) -> list[tuple[str, str]]:
    """Return the pairs (left, right) of which a figure, a part of a contract, differs in size."""
    pairs = []
    for what, values in figures.items():
        sides = dict(zip(joints, map(float, values)))
        limits = (0.0, POSE_TOLERANCE) if what == "default_joint_pos" else (ROUNDING, 1e-6)
        pairs += [
            (left, right)
            for left, right in mirror_pairs(joints)
            if not np.isclose(abs(sides[left]), abs(sides[right]), *limits)
        ]
    return pairs


def check_mirrored(policy: PolicyResult, code: str, what: str) -> None:
    """Find values that are not the same size on both sides: they are in another order.

    Args:
        policy: is added to.
        code: of the finding.
        what: the values are in the contract, such as `damping` or `action.scale`.
    """
    contract = policy.contract
    joints = contract.action.joints if what.startswith("action") else contract.joints
    values = attrgetter(what)(contract)
    odd, sides = _odd(joints, {what: values}), dict(zip(joints, map(figure, values)))
    if odd:
        left, right = odd[0]
        more = f" (and {len(odd) - 1} more pairs)" if len(odd) > 1 else ""
        policy.find(
            code,
            what,
            f"{left} has {sides[left]} and {right} has {sides[right]}{more}",
            f"bring {what} into the order of joints: {listed(joints, 3)}",
        )


def other_order(depths: Sequence[int]) -> Index:
    """Return the breadth-first order of joints given depth-first, and the inverse otherwise.

    Isaac Sim lists joints breadth-first (all hips, then all knees), MuJoCo and the vendors
    depth-first (leg by leg).

    Args:
        depths: in the kinematic tree, in the given order, shape (n,).
    """
    order = np.argsort(depths, kind="stable")
    if (np.diff(depths) >= 0).all():  # breadth-first already: back to a limb at a time
        count = max(1, int((np.asarray(depths) == depths[0]).sum()))
        order = np.concatenate([np.arange(limb, len(depths), count) for limb in range(count)])
    return order.astype(np.intp)


def joint_orders(
    joints: Sequence[str], robot: Robot, depths: Sequence[int]
) -> dict[str, list[str]]:
    """Return orders in which the same joints may have been meant, the likeliest first.

    Some may be the given one.

    Args:
        joints: in the given order.
        robot: gives an order.
        depths: of the joints in the kinematic tree, shape (n,).
    """
    limb_by_limb = [name for name in robot.joint_names if name in joints]
    by_depth, other = dict(zip(joints, depths)), other_order(depths)
    return {
        "the joint order of the other kind of simulator": [joints[i] for i in other],
        "that order undone": [joints[i] for i in np.argsort(other)],
        "the robot's joint order": limb_by_limb,
        "a breadth-first joint order": sorted(limb_by_limb, key=by_depth.__getitem__),
        "the reversed joint order": list(joints[::-1]),
    }


def check_order(subject: Subject, result: CheckResult) -> None:
    """Find contracts whose names stand in another order than all their figures.

    Each figure by itself would be told as not symmetric; that one order makes all of them so tells
    what happened.
    """
    model = subject.model
    if model is None:
        return
    for policy in subject.policy_results(result):
        _order(subject.robot, model, policy)


def _order(robot: Robot, model: LoadedModel, policy: PolicyResult) -> None:
    contract = policy.contract
    joints, names = contract.joints, ["default_joint_pos", "stiffness", "damping"]
    names += ["action.scale"] * (contract.action.joints == joints)
    figures = {name: attrgetter(name)(contract) for name in names}
    # Gains may have an order of their own (that of motors): the others tell.
    odd = [name for name in figures if _odd(joints, {name: figures[name]})]
    if "default_joint_pos" not in odd:
        return
    told = {name: figures[name] for name in odd}
    pose, verb = contract.default_joint_pos, "is" if len(odd) == 1 else "are"

    def fits(order: Sequence[str]) -> bool:
        index = joint_index(order, robot.joint_names)
        outside = (pose < robot.lower[index] - 1e-4) | (pose > robot.upper[index] + 1e-4)
        return not outside.any() and not _odd(order, told)

    def find(evidence: str, remedy: str) -> None:
        culprit = f"joints (or {listed(odd)})"
        what = f"{listed(odd)} {verb} not the same on both sides; {evidence}"
        policy.find("joints.order", culprit, what, remedy)

    swaps = [swap for swap in _exchanges(joints, told) if fits(swap)]
    if swaps:  # several may fit: the robot's own pose tells which
        usual = robot.default_joint_pos

        def apart(order: list[str]) -> float:
            return float(np.abs(pose - usual[joint_index(order, robot.joint_names)]).sum())

        best = min(swaps, key=apart)
        both = " and ".join(old for old, new in zip(joints, best) if old != new)
        find(f"with {both} exchanged all of it is", f"exchange {both} in joints, or their figures")
        return
    for name, order in joint_orders(joints, robot, joint_depths(model, robot, joints)).items():
        if fits(order):
            moved = [f"{new} for {old}" for old, new in zip(joints, order) if old != new]
            find(
                f"in {name} ({listed(moved)}) all of it is",
                "write joints in the order of the figures, or the figures in that of joints",
            )
            return


def _exchanges(joints: Sequence[str], figures: Mapping[str, Float32]) -> Iterator[list[str]]:
    """Yield the joints with two exchanged, of those that differ between the sides."""
    odd = [name for pair in _odd(joints, figures) for name in pair]
    for a, b in combinations(dict.fromkeys(odd), 2):
        yield [{a: b, b: a}.get(name, name) for name in joints]


def robot_values(robot: Robot, joints: Sequence[str], *names: str) -> list[Float64]:
    """Return facts of the robot file by name, of some joints, in double precision."""
    own = joint_index(joints, robot.joint_names)
    return [getattr(robot, name)[own].astype(np.float64) for name in names]
