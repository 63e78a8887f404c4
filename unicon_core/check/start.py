"""How a run begins, for `unicon check`."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.postures import Pose
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject
from unicon_core.policies import PolicyContract
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import joint_index
from unicon_core.workflow.platform_use import read_platforms

STEP = 0.3
"""In [rad]: a servo that is given a target farther away than this moves with a jerk."""


def check_start(subject: Subject, result: CheckResult) -> None:
    """A policy, or another controller, that takes over a robot which lies."""
    contracts = ((isinstance(b.tick, Pose), controller_contract(b)) for b in subject.blocks)
    posed, contract = next((found for found in contracts if any(found)), (False, None))
    if posed or contract is None:
        return
    robot = subject.robot
    own = joint_index(contract.joints, robot.joint_names)
    way = np.abs(contract.default_joint_pos - robot.rest_joint_pos[own])
    if np.isnan(way).all():
        where = "nobody knows how far from where it is"
    elif np.nanmax(way) > STEP:
        i = int(np.nanargmax(way))
        where = f"{contract.joints[i]} {way[i]:.2g} rad from where it is when the robot lies"
    else:
        return
    result.find(
        "pose.start",
        f"{'policy' if isinstance(contract, PolicyContract) else 'controller'} {contract.name!r}",
        f"it is the first to move the robot, and its default pose is {where}: the motors would "
        "make a step",
        "let `pose: {to: stand}` go there first: flow: {chain: [{pose: …}, {policy: …}]}",
        subject.document.where("flow"),
        # With an approach nothing is a step: a robot is brought there slowly before.
        error=not (subject.platform.simulated or subject.program.start.fade_in),
    )


def check_gates(subject: Subject, result: CheckResult) -> None:
    """A robot that begins to move and nobody has looked at it, or outlives who ticks."""
    if subject.platform.simulated or not subject.program.has_platform:
        return
    for use in {u.path: u for u in read_platforms(subject.document).values()}.values():
        if use.child is not None:
            continue
        result.note(
            "start.watchdog",
            f"{'.'.join(use.path)}: {use.name}",
            "it runs in the process that ticks: where that is killed or hangs for ever, nothing of "
            "ours damps the robot",
            f"{use.path[-1]}: {{child: {use.name}}}",
            subject.document.where(*use.path),
        )
    if subject.program.start.gates:
        return
    result.note(
        "start.gates",
        "start: {gates: false}",
        "nobody asks whether data come, are plausible and of this robot before it is moved",
        "",
        subject.document.where("start", "gates"),
    )
