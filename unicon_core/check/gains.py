"""Gains and limits of policy, robot and model side by side, and what cannot be right in them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Float32, Float64, Index
from unicon_base.errors import MissingDependencyError, ModelError
from unicon_core.check.model_facts import ModelJoints, model_joints
from unicon_core.check.order import check_mirrored
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import Subject, listed
from unicon_core.models.find import model_of
from unicon_core.models.load import load_model
from unicon_core.platforms.platform import info_of
from unicon_core.robots import Robot, joint_index
from unicon_core.text_table import figure, figures, spans

EFFORT_FACTOR = 3.0
"""Robot file and model may differ by variants of a motor (35 and 50 N·m), not by this."""
SOFTEST_LIMIT = 0.1
"""In [rad]: a servo that is at its effort limit within less is on or off. Published contracts have
0.125 (G1's wrist, 40 N·m/rad and 5 N·m) and more, those of legs 0.4 and more."""
SLOWEST = 0.04
"""Share of a joint's speed limit at which its damping alone may ask for all its effort. Robot files
have 0.048 (X2's head), 0.16 (Go1, Go2: 5 N·m·s/rad, 23.7 N·m, 30.1 rad/s) and more."""
MANY = 0.33
"""Share of joints that hold too hard from which a set of gains is wrong, whatever they turn. The
vendors of Atom and X2 hold heads and wrists of next to no load within less: 8 of 29, 1 of 31."""
SWING = 2.0
"""Natural frequency times tick from which one such joint is wrong: sqrt(kp/I)·T. A mass on a spring
that is stepped once in T is unstable from 2 on (Hairer, Lubich, Wanner, Geometric Numerical
Integration, 2006, I.1.4); joints of robot files have 0.2 to 2.1 at 50 Hz, those that hold within
less than a tenth of a radian none of them that has a model."""
TWICE = 0.5
"""Passive damping as a share of the policy's from which it may be that one, counted twice."""
PASSIVE = 0.01
"""Damping over stiffness in [s] that a model's own joints may stand in for: 0.014 for the Go1 of
mujoco_playground, 0.02 to 0.06 in contracts that give a damping."""


def check_gains(subject: Subject, result: CheckResult) -> None:
    """Add one table of gains for each policy, and its findings."""
    model = model_joints(subject.model)
    passive = np.zeros(subject.robot.num_joints)  # that is simulated
    if model is not None and info_of(subject.program.platform).get("passive") != "replace":
        passive = model.passive
    for policy in subject.policy_results(result):
        contract = policy.contract
        _table(subject.robot, policy, model)
        _plausible(subject.robot, policy, passive)
        _counted_twice(subject, policy, passive)
        for what, values in (("stiffness", contract.stiffness), ("damping", contract.damping)):
            check_mirrored(policy, "gains.symmetry", what, contract.joints, values)


def check_held(subject: Subject, result: CheckResult) -> None:
    """Find gains of the robot file, and of blocks that have their own, which hold too hard.

    A joint does where an error of a tenth of a radian, or a twenty-fifth of its speed limit, asks
    for all its effort: the servo is on or off, and shakes. Many such joints are an error; few are
    one where the model says that they swing faster than the ticks follow.
    """
    robot = subject.robot
    own = robot.joint_stiffness, robot.joint_damping
    sets: list[tuple[str, Any, Any]] = [(f"robot {robot.name}", own, robot.path)]
    for block in subject.blocks:
        gains = getattr(block.tick, "gains", None)
        if gains is not None and len(gains[0]) == robot.num_joints:  # not of a member
            sets.append((f"block {block.name!r}", gains, block.where))
    seen: set[bytes] = set()
    for culprit, gains, where in sets:
        key = gains[0].tobytes() + gains[1].tobytes()
        if key not in seen:
            seen.add(key)
            _held(subject, result, f"{culprit}, gains", gains, where)


def _held(
    subject: Subject,
    result: CheckResult,
    culprit: str,
    gains: tuple[Float32, Float32],
    where: Any,
) -> None:
    robot = subject.robot
    kp, kd, effort, speed = (
        values.astype(np.float64) for values in (*gains, robot.effort_limit, robot.velocity_limit)
    )
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing below compares with an unknown
        error, rate = effort / kp, effort / kd
        excess = np.fmax(SOFTEST_LIMIT / error, SLOWEST * speed / rate)
    hard = np.flatnonzero((excess > 1.0) & ~robot.by_position)  # those have gains of their vendor
    if not hard.size:
        return
    i, swings, fastest = hard[np.argmax(excess[hard])], "", 0.0
    inertia = _inertia(subject)
    if inertia is not None:
        frequency = np.sqrt(kp / inertia)
        ratio = kd[i] / (2.0 * inertia[i] * frequency[i]) if kp[i] > 0.0 else np.inf
        fastest = float(frequency[hard].max())
        swings = (
            f", and swing at {frequency[i]:.3g} rad/s (a tick is {subject.program.period:g} s) "
            f"with damping ratio {ratio:.2g} ({inertia[i]:.3g} kg·m²)"
        )
    if hard.size <= MANY * len(kp) and fastest * subject.program.period <= SWING:
        return
    result.find(
        "gains.stiff",
        culprit,
        f"{robot.joint_names[i]}: {figure(kp[i])} N·m/rad and {figure(kd[i])} N·m·s/rad reach its "
        f"effort limit of {effort[i]:g} N·m within {error[i]:.2g} rad or {rate[i]:.2g} rad/s"
        f"{swings} ({hard.size} joints)",
        where=where,
    )


def _inertia(subject: Subject) -> Float64 | None:
    """Return what joints turn in [kg·m²] by the model, on hardware by the robot file's, if any."""
    try:
        platform, robot = subject.program.platform, subject.robot
        loaded = subject.model or load_model(model_of(platform, robot), robot, quiet=True)
    except (ModelError, MissingDependencyError):
        return None
    model = model_joints(loaded)
    return None if model is None else model.inertia


def _table(robot: Robot, policy: PolicyResult, model: ModelJoints | None) -> None:
    contract = policy.contract
    own = joint_index(contract.joints, robot.joint_names)
    kp, kd = gains = np.array([contract.stiffness, contract.damping], np.float64)
    known = np.array([robot.joint_stiffness[own], robot.joint_damping[own]], np.float64)
    shown = {"kp policy": kp, "kp robot": known[0]}
    if model is not None:
        shown["kp model"] = model.stiffness[own]
    shown |= {"kd policy": kd, "kd robot": known[1]}
    if model is not None:
        shown |= {"kd model": model.damping[own], "passive": model.passive[own]}
    same = np.all(np.isclose(gains, known, rtol=0.02), axis=0) | np.isnan(known).any(axis=0)
    columns: dict[str, Sequence[str]] = {"joint": contract.joints}
    columns |= {name: figures(values, ".4g") for name, values in shown.items()}
    columns[""] = ["" if fits else "≠" for fits in same]
    policy.result.columns(f"Gains of policy {policy.key} [N·m/rad, N·m·s/rad]", columns)
    if not same.all():
        policy.note(
            "gains.differ",
            "",
            f"gains differ from robot {robot.name}'s at {listed(compress(contract.joints, ~same))}"
            "; the policy's are used",
        )


def counted_twice(damping: Array, passive: Float64) -> Index:
    """Return the joints that damp themselves about as much as a policy asks the motors to.

    Args:
        damping: of the policy in [N·m·s/rad], shape (n,).
        passive: of the same joints themselves.

    Returns:
        Places of those joints, the one with the greatest share first.
    """
    twice = np.flatnonzero((damping > 0.0) & (passive >= TWICE * damping))
    return twice[np.argsort(-passive[twice] / damping[twice], kind="stable")]


def _counted_twice(subject: Subject, policy: PolicyResult, passive: Float64) -> None:
    """Note a model whose joints damp themselves about as much as the policy asks the motors to."""
    contract, platform = policy.contract, subject.program.platform
    own = passive[joint_index(contract.joints, subject.robot.joint_names)]
    twice = counted_twice(contract.damping, own)
    if not twice.size:
        return
    i = twice[0]
    name = platform.facts.name
    policy.result.note(
        "gains.passive",
        f"passive damping of model {subject.model.path if subject.model else name}",
        f"{twice.size} of {len(own)} joints damp themselves beside the damping of policy "
        f"{policy.key!r}: {contract.joints[i]} by {own[i]:g} and {contract.damping[i]:g} "
        "N·m·s/rad; in simulation both act, on the robot only the policy's",
        "if the model has the policy's damping as <joint damping>, let the policy's replace it: "
        f"platforms: {{{name}: {{passive: replace}}}}",
        subject.document.where("platform"),
    )


def _plausible(robot: Robot, policy: PolicyResult, passive: Float64) -> None:
    joints, kp, kd = policy.contract.joints, policy.contract.stiffness, policy.contract.damping
    own = joint_index(joints, robot.joint_names)
    bare = np.flatnonzero((kp > 0.0) & (kd <= 0.0))
    if bare.size:
        names = listed(joints[i] for i in bare)
        evidence = f"{names}: stiffness {kp[bare[0]]:g} and damping {figure(kd[bare[0]])}"
        if (passive[own][bare] >= PASSIVE * kp[bare]).all():
            evidence += "; the model's joints damp themselves, a motor has to be told"
            policy.note("gains.damping", "damping", evidence)
        else:
            policy.find("gains.damping", "damping", evidence)
    effort = robot.effort_limit[own]
    hard = np.flatnonzero(kp * SOFTEST_LIMIT > effort)  # false where the effort is not known
    if hard.size:
        i = hard[0]
        policy.find(
            "gains.stiff",
            "stiffness",
            f"{joints[i]}: {kp[i]:g} N·m/rad reaches its effort limit of {effort[i]:g} "
            f"N·m within {effort[i] / kp[i]:.2g} rad ({hard.size} joints)",
        )
    action = policy.contract.action
    turned = dict(zip(action.joints, ~action.of_kind("position")))  # they need no stiffness
    held = (kp > 0.0) & ~np.array([turned.get(name, False) for name in joints])
    stiffer = np.flatnonzero((kd > kp) & held)
    if stiffer.size > len(kp) // 2:
        i = stiffer[0]
        policy.find(
            "gains.swapped",
            "stiffness and damping",
            f"damping is greater than stiffness at {stiffer.size} of {len(kp)} joints "
            f"({joints[i]}: kp {figure(kp[i])}, kd {kd[i]:g})",
        )


def check_limits(subject: Subject, result: CheckResult) -> None:
    """Add the table of limits of robot and model, with differences."""
    robot, model = subject.robot, model_joints(subject.model)
    lower, upper, effort = (
        limit.astype(np.float64) for limit in (robot.lower, robot.upper, robot.effort_limit)
    )
    columns: dict[str, Sequence[str]] = {
        "joint": robot.joint_names,
        "position [rad]": spans(lower, upper, ".4g"),
        "velocity [rad/s]": figures(robot.velocity_limit, ".4g"),
        "effort [N·m]": figures(effort, ".4g"),
    }
    title = f"Limits of robot {robot.name}"
    if model is None:
        result.columns(title, columns)
        return
    # False where one is unknown.
    ranges = (np.abs(model.lower - lower) > 0.02) | (np.abs(model.upper - upper) > 0.02)
    efforts = np.isfinite(model.effort) & (np.abs(model.effort - effort) > 0.02 * effort)
    columns |= {
        "position, model": spans(model.lower, model.upper, ".4g"),
        "effort, model": figures(model.effort, ".4g"),
        "": ["≠" if other else "" for other in ranges | efforts],
    }
    result.columns(title, columns)
    if ranges.any():
        result.note(
            "limits.differ",
            f"model {model.path}",
            f"position limits differ from robot {robot.name}'s at "
            f"{listed(compress(robot.joint_names, ranges))}; targets are kept within the robot's",
        )
    unlike = np.flatnonzero(efforts)
    if unlike.size:
        names = listed(f"{robot.joint_names[j]} {effort[j]:g}/{model.effort[j]:g}" for j in unlike)
        result.note(
            "limits.differ",
            f"model {model.path}",
            f"effort limits robot/model [N·m] differ: {names}; the smaller ones are simulated",
        )
    far = [
        j for j in unlike if not 1.0 / EFFORT_FACTOR < effort[j] / model.effort[j] < EFFORT_FACTOR
    ]
    if far:
        j = far[0]
        result.find(
            "limits.effort",
            f"robot {robot.name}, effort of {robot.joint_names[j]}",
            f"the robot file says {effort[j]:g} N·m and the model {model.effort[j]:g} "
            f"({len(far)} joints differ by more than {EFFORT_FACTOR:g} times)",
            where=robot.path,
        )
