"""How a run begins, what stands between flow and motors, and whether it sees every command."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from unicon_core.blocks.postures import Pose
from unicon_core.blocks.safety.stops import Finite, RemoteStop
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.flow import Block, Chain, Every, Loop, Node, Switch, When, blocks_of
from unicon_core.flow.block import Stage
from unicon_core.flow.nodes import children_of, chooser_of
from unicon_core.policies import PolicyContract
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import joint_index
from unicon_core.workflow.members import read_platforms

TARGET = "joint_pos_target"
"""What limits are for."""
GIVEN = ("tick", "velocity_command")
"""What the runner and people write, beside platform and blocks."""


def has_limits(subject: Subject, limits: type) -> bool:
    """Whether a safety block of this class amends what is sent.

    A part without the platform sends nothing: the first part's blocks do.
    """
    return not subject.program.has_platform or any(
        isinstance(block.tick, limits) and set(block.amends) & _sent(subject)
        for block in _safety(subject)
    )


def check_safety(subject: Subject, result: CheckResult) -> None:
    """A workflow without safety blocks, and blocks that are there and see nothing, or seldom."""
    where, sent = subject.document.where("safety"), _sent(subject)
    blocks = _safety(subject)
    if sent and not any(sent & {*block.reads, *block.amends} for block in blocks):
        what = "safety: none" if not blocks else f"safety: {listed([b.name for b in blocks])}"
        result.note(
            "safety.none",
            what,
            "no block looks at commands before they are sent: what is not finite or beyond the "
            "limits of a joint leaves as it is",
            "",
            where,
        )
    elif less := subject.program.safety_left_out:
        reasons = {why: [n for n in less if less[n] == why] for why in less.values()}
        parts = [f"{', '.join(names)} ({why})" for why, names in reasons.items()]
        evidence = f"this robot does not have {'; '.join(parts)}"
        result.note("safety.less", "safety", evidence, "", where)
    for node in subject.program.stages[Stage.SAFETY]:
        for block, under in _conditional(node, ""):
            result.find(
                "safety.partial",
                f"safety block {block.name!r}",
                f"it stands under {under!r}, so it does not run in every tick",
                where=block.where or where,
            )
    _check_remote(subject, result, blocks)
    told = {*subject.program.platform.facts.writes, *GIVEN, *subject.written}
    for block in blocks:
        blind = _blind(block, sent, told)
        if blind:
            result.find(
                "safety.partial",
                f"safety block {block.name!r}",
                blind,
                where=block.where or where,
            )


def _check_remote(subject: Subject, result: CheckResult, blocks: list[Block]) -> None:
    """Which buttons of the remote stop the robot, and that no other block gives them a meaning."""
    used = {
        name: block.name
        for block in subject.program.blocks
        for name in getattr(block.tick, "buttons_used", ())
    }
    for block in blocks:
        if not isinstance(block.tick, RemoteStop):
            continue
        names, where = "+".join(block.tick.names), block.where or subject.document.where("safety")
        if used.keys() >= {*block.tick.names}:
            using = listed(dict.fromkeys(used[name] for name in block.tick.names))
            result.find(
                "safety.remote",
                f"safety block {block.name!r}",
                f"{names} on the remote stops the robot, and means something else to {using}",
                f"give {using} other buttons, or list {{remote_stop: {{on: [BUTTON, BUTTON]}}}}",
                where,
            )
        else:
            result.note("safety.remote", names, "held on the remote, stops the robot", "", where)


def _safety(subject: Subject) -> list[Block]:
    return [block for node in subject.program.stages[Stage.SAFETY] for block in blocks_of(node)]


def _sent(subject: Subject) -> set[str]:
    return set(subject.program.platform.facts.reads)


def _conditional(node: Node, under: str) -> Iterator[tuple[Block, str]]:
    """Blocks that do not run in every tick, with the word that says so."""
    if isinstance(node, Block):
        if under:
            yield node, under
        return
    chooses = (
        isinstance(node, (Switch, When))
        or (isinstance(node, Chain) and len(node.children) > 1)
        or (isinstance(node, Every) and node.n > 1)
        or (isinstance(node, Loop) and node.until is not None)
    )
    chosen = type(node).__name__.lower() if chooses and not under else under
    chooser = chooser_of(node)
    for child in children_of(node):
        if child is not chooser:
            yield from _conditional(child, chosen)


def _blind(block: Block, sent: set[str], told: set[str]) -> str:
    """Return why a block sees nothing of what it is there for; empty where it does."""
    if isinstance(block.tick, Finite):
        missed = [name for name in sorted(sent) if name not in block.reads]
        return f"it does not look at {listed(missed)}, which is sent" if missed else ""
    clamps = getattr(block.tick, "clamps", False)
    if block.amends and not sent & set(block.amends):
        return f"it changes {listed(block.amends)}, which is not sent"
    target = getattr(block.tick, "limits", TARGET)
    if clamps and target not in block.amends:
        return f"it changes {listed(block.amends)}, not {target}"
    silent = [name for name in block.reads if name not in told]
    if silent and (clamps or len(silent) == len(block.reads)):
        return f"nothing writes {listed(silent)}, which it reads"
    return ""


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
        where=subject.document.where("flow"),
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
