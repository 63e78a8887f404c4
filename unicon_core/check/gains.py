"""Gains and limits of policy, robot and model side by side, and what cannot be right in them."""

from __future__ import annotations

import numpy as np

from unicon_core.check.mirror import check_mirrored
from unicon_core.check.model_facts import ModelJoints, model_joints
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.policies import PolicyContract
from unicon_core.robots import joint_index

__all__ = ["check_gains", "check_limits", "number"]

EFFORT_FACTOR = 3.0
"""Robot file and model may differ by variants of a motor (35 and 50 N·m), not by this."""


SOFTEST_LIMIT = 0.1
"""In [rad]: a servo that is at its effort limit within less is on or off. Published contracts have
0.125 (G1's wrist, 40 N·m/rad and 5 N·m) and more, those of legs 0.4 and more."""
PASSIVE = 0.01
"""Damping over stiffness in [s] that a model's own joints may stand in for: 0.014 for the Go1 of
mujoco_playground, 0.02 to 0.06 in contracts that give a damping."""


def number(value: float) -> str:
    """Return a figure for a table, `?` where it is not known."""
    return "?" if np.isnan(value) else f"{value:.4g}"


def check_gains(subject: Subject, result: CheckResult) -> None:
    """Add one table of gains for each policy, and its findings."""
    model = model_joints(subject.model)
    for key, contract in subject.policies.items():
        _table(subject, result, key, contract, model)
        _plausible(subject, result, key, contract, model)
        for what, values in (("stiffness", contract.stiffness), ("damping", contract.damping)):
            check_mirrored(result, "gains.symmetry", (key, what), contract, contract.joints, values)


def _table(
    subject: Subject,
    result: CheckResult,
    key: str,
    contract: PolicyContract,
    model: ModelJoints | None,
) -> None:
    robot = subject.robot
    rows = []
    different = []
    passive = []
    policy_from_robot = joint_index(contract.joints, robot.joint_names)
    for i, (name, j) in enumerate(zip(contract.joints, policy_from_robot)):
        kp, kd = float(contract.stiffness[i]), float(contract.damping[i])
        own = float(robot.joint_stiffness[j]), float(robot.joint_damping[j])
        row = [name, number(kp), number(own[0]), number(kd), number(own[1])]
        same = np.isclose([kp, kd], own, rtol=0.02).all() or np.isnan(own).any()
        if model is not None:
            row[3:3] = [number(model.stiffness[j])]
            row += [number(model.damping[j]), number(model.passive[j])]
            if kd > 0.0 and model.passive[j] >= 0.5 * kd:
                passive.append(j)
        if not same:
            different.append(name)
        rows.append([*row, "" if same else "≠"])
    head = ["kp policy", "kp robot", "kd policy", "kd robot"]
    if model is not None:
        head[2:2] = ["kp model"]
        head += ["kd model", "passive"]
    result.table(f"Gains of policy {key} [N·m/rad, N·m·s/rad]", ["joint", *head, ""], rows)
    if different:
        result.note(
            "gains.differ",
            f"policy {key!r}",
            f"gains differ from robot {robot.name}'s at {listed(different)}; the policy's are used",
        )
    if passive and model is not None:
        j = passive[0]
        result.note(
            "gains.damping",
            f"model {model.path}",
            f"joint {robot.joint_names[j]} has a passive damping of {model.passive[j]:g} N·m·s/rad "
            "in the model beside the policy's own: damping may count twice in simulation",
        )


def _plausible(
    subject: Subject,
    result: CheckResult,
    key: str,
    contract: PolicyContract,
    model: ModelJoints | None,
) -> None:
    kp, kd = contract.stiffness, contract.damping
    own = joint_index(contract.joints, subject.robot.joint_names)
    bare = np.flatnonzero((kp > 0.0) & (kd <= 0.0))
    if bare.size:
        names = listed(contract.joints[i] for i in bare)
        evidence = f"{names}: stiffness {kp[bare[0]]:g} and damping {kd[bare[0]]:g}"
        passive = np.zeros(len(own)) if model is None else model.passive[own]
        if (passive[bare] >= PASSIVE * kp[bare]).all():
            result.note(
                "gains.damping",
                f"policy {key!r}, damping",
                f"{evidence}; the model's joints damp themselves, a motor has to be told",
            )
        else:
            result.find(
                "gains.damping",
                f"policy {key!r}, damping",
                evidence,
                "give the damping that it was trained with (some exporters write 0 for built-in "
                "servos)",
                contract.path,
            )
    effort = subject.robot.effort_limit[own]
    hard = np.flatnonzero(kp * SOFTEST_LIMIT > effort)  # false where the effort is not known
    if hard.size:
        i = int(hard[0])
        result.find(
            "gains.stiff",
            f"policy {key!r}, stiffness",
            f"{contract.joints[i]}: {kp[i]:g} N·m/rad reaches its effort limit of {effort[i]:g} "
            f"N·m within {effort[i] / kp[i]:.2g} rad ({hard.size} joints)",
            f"correct stiffness, or joints.effort in {subject.robot.path.name}",
            contract.path,
        )
    stiffer = np.flatnonzero(kd > kp)
    if stiffer.size > len(kp) // 2:
        i = int(stiffer[0])
        result.find(
            "gains.swapped",
            f"policy {key!r}, stiffness and damping",
            f"damping is greater than stiffness at {stiffer.size} of {len(kp)} joints "
            f"({contract.joints[i]}: kp {kp[i]:g}, kd {kd[i]:g})",
            "exchange stiffness and damping",
            contract.path,
        )


def check_limits(subject: Subject, result: CheckResult) -> None:
    """Add the table of limits of robot and model, with differences."""
    robot, model = subject.robot, model_joints(subject.model)
    columns = ["joint", "position [rad]", "velocity [rad/s]", "effort [N·m]"]
    if model is not None:
        columns += ["position, model", "effort, model", ""]
    rows, ranges, efforts = [], [], []
    for j, name in enumerate(robot.joint_names):
        lower, upper = float(robot.lower[j]), float(robot.upper[j])
        effort = float(robot.effort_limit[j])
        row = [name, f"{number(lower)} … {number(upper)}", number(float(robot.velocity_limit[j]))]
        row.append(number(effort))
        if model is not None:
            low, high, torque = model.lower[j], model.upper[j], model.effort[j]
            row += [f"{number(low)} … {number(high)}", number(torque)]
            sides = (
                abs(low - lower) > 0.02 or abs(high - upper) > 0.02
            )  # false where one is unknown
            other = bool(np.isfinite(torque) and abs(torque - effort) > 0.02 * effort)
            ranges += [name] if sides else []
            efforts += [j] if other else []
            row.append("≠" if sides or other else "")
        rows.append(row)
    result.table(f"Limits of robot {robot.name}", columns, rows)
    if model is None:
        return
    if ranges:
        result.note(
            "limits.differ",
            f"model {model.path}",
            f"position limits differ from robot {robot.name}'s at {listed(ranges)}; targets are "
            "kept within the robot's",
        )
    far = [
        j
        for j in efforts
        if not 1.0 / EFFORT_FACTOR < robot.effort_limit[j] / model.effort[j] < EFFORT_FACTOR
    ]
    if efforts:
        names = listed(
            f"{robot.joint_names[j]} {robot.effort_limit[j]:g}/{model.effort[j]:g}" for j in efforts
        )
        result.note(
            "limits.differ",
            f"model {model.path}",
            f"effort limits robot/model [N·m] differ: {names}; the smaller ones are simulated",
        )
    if far:
        j = far[0]
        result.find(
            "limits.effort",
            f"robot {robot.name}, effort of {robot.joint_names[j]}",
            f"the robot file says {robot.effort_limit[j]:g} N·m and the model {model.effort[j]:g} "
            f"({len(far)} joints differ by more than {EFFORT_FACTOR:g} times)",
            "correct joints.effort, or choose the model of this robot",
            robot.path,
        )
