"""Gains, limits and action of a policy beside robot and model: what cannot be right in them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from typing import Any

import numpy as np

from unicon_base import MissingDependencyError, ModelError
from unicon_base.arrays import Array, Float64
from unicon_core.check.joints import ModelJoints, check_mirrored, model_joints, robot_values
from unicon_core.check.result import CheckResult, PolicyResult, first
from unicon_core.check.subject import Subject, listed
from unicon_core.models.find import model_of
from unicon_core.models.load import load_model
from unicon_core.platforms.platform import info_of
from unicon_core.policies import PolicyContract
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
    robot, platform, model = subject.robot, subject.program.platform, model_joints(subject.model)
    passive = np.zeros(robot.num_joints)  # that is simulated
    if model is not None and info_of(platform).get("passive") != "replace":
        passive = model.passive
    for policy in subject.policy_results(result):
        contract = policy.contract
        own = joint_index(contract.joints, robot.joint_names)
        _table(robot, policy, model)
        _plausible(robot, policy, passive[own])
        if twice := counted_twice(contract, passive[own]):
            name = platform.facts.name
            result.note(
                "gains.passive",
                f"passive damping of model {subject.model.path if subject.model else name}",
                f"policy {policy.key!r}: {twice}; in simulation both act, on the robot only the "
                "policy's",
                "if the model has the policy's damping as <joint damping>, let the policy's "
                f"replace it: platforms: {{{name}: {{passive: replace}}}}",
                subject.document.where("platform"),
            )
        for what in ("stiffness", "damping"):
            check_mirrored(policy, "gains.symmetry", what)


def check_held(subject: Subject, result: CheckResult) -> None:
    """Find gains of the robot file, and of blocks that have their own, which hold too hard.

    A joint does where an error of a tenth of a radian, or a twenty-fifth of its speed limit, asks
    for all its effort: the servo is on or off, and shakes. Many such joints are an error; few are
    one where the model says that they swing faster than the ticks follow.
    """
    robot, seen = subject.robot, set[bytes]()
    own: Any = robot.joint_stiffness, robot.joint_damping
    for culprit, gains, where in (
        (f"robot {robot.name}", own, robot.path),
        *((f"block {b.name!r}", getattr(b.tick, "gains", None), b.where) for b in subject.blocks),
    ):
        if gains is None or len(gains[0]) != robot.num_joints:  # of a member
            continue
        if (numbers := np.concatenate(gains).tobytes()) not in seen:
            seen.add(numbers)
            result.find("gains.stiff", f"{culprit}, gains", _too_hard(subject, *gains), where=where)


def _too_hard(subject: Subject, stiffness: Array, damping: Array) -> str:
    """Return which joints hold too hard, "" for none or few."""
    robot, period, names = subject.robot, subject.program.period, subject.robot.joint_names
    kp, kd = stiffness.astype(np.float64), damping.astype(np.float64)
    effort, speed = robot_values(robot, names, "effort_limit", "velocity_limit")
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing below compares with an unknown
        error, rate = effort / kp, effort / kd
        excess = np.fmax(SOFTEST_LIMIT / error, SLOWEST * speed / rate)
    hard = np.flatnonzero((excess > 1.0) & ~robot.by_position)  # those have gains of their vendor
    if not hard.size:
        return ""
    i, swings, fastest = hard[np.argmax(excess[hard])], "", 0.0
    inertia = _inertia(subject)
    if inertia is not None:
        frequency = np.sqrt(kp / inertia)
        ratio = kd[i] / (2.0 * inertia[i] * frequency[i]) if kp[i] > 0.0 else np.inf
        fastest = float(frequency[hard].max())
        swings = (
            f", and swing at {frequency[i]:.3g} rad/s (a tick is {period:g} s) "
            f"with damping ratio {ratio:.2g} ({inertia[i]:.3g} kg·m²)"
        )
    if hard.size <= MANY * len(kp) and fastest * period <= SWING:
        return ""
    return (
        f"{names[i]}: {figure(kp[i])} N·m/rad and {figure(kd[i])} N·m·s/rad reach its "
        f"effort limit of {effort[i]:g} N·m within {error[i]:.2g} rad or {rate[i]:.2g} rad/s"
        f"{swings} ({hard.size} joints)"
    )


def _inertia(subject: Subject) -> Float64 | None:
    """Return what joints turn in [kg·m²] by the model, on hardware by the robot file's, if any.

    It is that of the model's zero pose, armature included: the diagonal of the mass matrix.
    """
    robot = subject.robot
    try:
        path = model_of(subject.program.platform, robot)
        loaded = subject.model or load_model(path, robot, quiet=True)
    except (ModelError, MissingDependencyError):
        return None
    inertia: Float64 = loaded.model.dof_M0[loaded.dofs]
    return inertia


def _table(robot: Robot, policy: PolicyResult, model: ModelJoints | None) -> None:
    contract, joints = policy.contract, policy.contract.joints
    own = joint_index(joints, robot.joint_names)
    gains = np.array([contract.stiffness, contract.damping], np.float64)
    known = np.array(robot_values(robot, joints, "joint_stiffness", "joint_damping"))
    shown: dict[str, Float64] = {}
    for what, name, value, other in zip(("kp", "kd"), ("stiffness", "damping"), gains, known):
        shown |= {f"{what} policy": value, f"{what} robot": other}
        if model is not None:
            shown[f"{what} model"] = getattr(model, name)[own]
    if model is not None:
        shown["passive"] = model.passive[own]
    same = np.all(np.isclose(gains, known, rtol=0.02), axis=0) | np.isnan(known).any(axis=0)
    columns: dict[str, Sequence[str]] = {"joint": joints}
    columns |= {name: figures(values, ".4g") for name, values in shown.items()}
    columns[""] = ["" if fits else "≠" for fits in same]
    policy.result.columns(f"Gains of policy {policy.key} [N·m/rad, N·m·s/rad]", columns)
    if not same.all():
        policy.note(
            "gains.differ",
            "",
            f"gains differ from robot {robot.name}'s at {listed(compress(joints, ~same))}; the "
            "policy's are used",
        )


def counted_twice(contract: PolicyContract, passive: Float64) -> str:
    """Return which joints damp themselves about as much as a policy asks the motors to.

    Args:
        contract: of the policy.
        passive: damping of its joints themselves in [N·m·s/rad], shape (n,).

    Returns:
        How many, and the one with the greatest share; "" for none.
    """
    damping = contract.damping
    twice = np.flatnonzero((damping > 0.0) & (passive >= TWICE * damping))
    if not twice.size:
        return ""
    i = twice[np.argmax(passive[twice] / damping[twice])]
    return (
        f"{twice.size} of {len(damping)} joints damp themselves beside the policy's damping, "
        f"{contract.joints[i]} by {passive[i]:g} and {damping[i]:g} N·m·s/rad"
    )


def _plausible(robot: Robot, policy: PolicyResult, passive: Float64) -> None:
    contract = policy.contract
    joints, kp, kd, action = contract.joints, contract.stiffness, contract.damping, contract.action
    bare = (kp > 0.0) & (kd <= 0.0)
    if bare.any():
        i = int(bare.argmax())
        evidence = (
            f"{listed(compress(joints, bare))}: stiffness {kp[i]:g} and damping {figure(kd[i])}"
        )
        if (passive[bare] >= PASSIVE * kp[bare]).all():
            evidence += "; the model's joints damp themselves, a motor has to be told"
            policy.note("gains.damping", "damping", evidence)
        else:
            policy.find("gains.damping", "damping", evidence)
    (effort,) = robot_values(robot, joints, "effort_limit")
    policy.find(
        "gains.stiff",
        "stiffness",
        first(
            kp * SOFTEST_LIMIT > effort,  # false where the effort is not known
            lambda i: (
                f"{joints[i]}: {kp[i]:g} N·m/rad reaches its effort limit of {effort[i]:g} "
                f"N·m within {effort[i] / kp[i]:.2g} rad"
            ),
        ),
    )
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
    robot, model, names = subject.robot, model_joints(subject.model), subject.robot.joint_names
    lower, upper, effort = robot_values(robot, names, "lower", "upper", "effort_limit")
    columns: dict[str, Sequence[str]] = {
        "joint": names,
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
    unlike = [f"{names[j]} {effort[j]:g}/{model.effort[j]:g}" for j in np.flatnonzero(efforts)]
    for differ, evidence in (
        (
            ranges,
            f"position limits differ from robot {robot.name}'s at "
            f"{listed(compress(names, ranges))}; targets are kept within the robot's",
        ),
        (
            efforts,
            f"effort limits robot/model [N·m] differ: {listed(unlike)}; the smaller ones are "
            "simulated",
        ),
    ):
        if differ.any():
            result.note("limits.differ", f"model {model.path}", evidence)
    ratio = effort / model.effort
    far = np.flatnonzero(efforts & ~((ratio > 1.0 / EFFORT_FACTOR) & (ratio < EFFORT_FACTOR)))
    if far.size:
        j = far[0]
        result.find(
            "limits.effort",
            f"robot {robot.name}, effort of {names[j]}",
            f"the robot file says {effort[j]:g} N·m and the model {model.effort[j]:g} "
            f"({far.size} joints differ by more than {EFFORT_FACTOR:g} times)",
            where=robot.path,
        )
