"""The graph of blocks: the flow's own checks, who writes a state, and what stands before motors.

In a divided workflow each state has one part that writes it, and has to reach its readers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from unicon_core.blocks.postures import Pose
from unicon_core.blocks.safety.stops import Finite, RemoteStop
from unicon_core.check.memory_proof import prove
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.flow import Block, Chain, Every, Loop, Node, Stage, Switch, When, blocks_of
from unicon_core.flow.checks import check_graph
from unicon_core.flow.nodes import children_of, chooser_of, unfused
from unicon_core.memory import Memory, holder_of
from unicon_core.policies import PolicyContract
from unicon_core.policies.chunks import RemoteSpec
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import joint_index
from unicon_core.show.text import is_critical
from unicon_core.states.backends.zmq_socket import WITHOUT_KEYS, is_exposed
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.division import is_divided, owner_of
from unicon_core.workflow.members import read_platforms
from unicon_core.workflow.parts import Parts, read_store
from unicon_core.workflow.tick_tree import given_in


def check_blocks(subject: Subject, result: CheckResult) -> None:
    """Add the table of blocks with what they read and write, and what is wrong with the graph.

    The build stops at the first such mistake; here all of a built graph are listed.
    """
    program = subject.program
    rows = [
        [
            block.name,
            block.stage.value if block.stage else "-",
            "before send" if is_critical(block, program.critical) else "after send",
            " ".join(block.reads) or "-",
            " ".join([*block.writes, *(f"{name}*" for name in block.amends)]) or "-",
        ]
        for block in subject.blocks
    ]
    columns = ["block", "stage", "runs", "reads", "writes (* amends)"]
    result.table("Blocks", columns, rows)
    for found in check_graph(program.root, program.states, given=given_in(program.states)):
        result.find("graph", found.culprit, found.evidence, found.remedy, found.where)


REMEDY = "write memory = (NAME, …) in its class, or () where no tick depends on the last one"


def check_memory(subject: Subject, result: CheckResult) -> None:
    """Note blocks of the user's own whose memory is not known: no record holds it."""
    blocks = {block.name: block.tick for block in _own_blocks(subject)}
    for name, why in Memory(blocks, subject.program.states.buffer).unproven.items():
        evidence = f"{why}: records lack its memory, and --twin finds out what it changes"
        result.note("blocks.memory", f"block {name!r}", evidence, REMEDY)


def prove_memory(subject: Subject, result: CheckResult) -> None:
    """Tick blocks of the user's own on random inputs; note what they hide. For simulators.

    It ticks them, so that it stands beside what simulates the workflow.
    """
    for block in _own_blocks(subject):
        proof = prove(block, subject.program.states)
        names = ", ".join(proof.hidden or proof.undeclared)
        if proof.hidden:
            evidence = (
                f"its next tick depends on {names}, which it does not declare: a replay differs"
            )
        elif proof.undeclared:
            evidence = f"it changes {names}, which it does not declare, though to no effect here"
        elif proof.trouble:
            evidence = f"its memory could not be proven: {proof.trouble}"
        else:
            continue
        result.note("blocks.memory", f"block {block.name!r}", evidence, REMEDY, block.where)


def _own_blocks(subject: Subject) -> Iterator[Block]:
    """Yield blocks that the user wrote, but devices: those that a snapshot holds."""
    for block in (part for each in subject.blocks for part in unfused(each)):
        outside = getattr(block.tick, "outside", False) or block.stage in (Stage.RECV, Stage.SEND)
        holder = holder_of(block.tick)
        module = getattr(holder, "__module__", None) or type(holder).__module__
        if not outside and not module.startswith("unicon_"):
            yield block


Writers = Mapping[str, Mapping[str, str]]
"""State to the parts that write it, each with the block that does."""


def check_parts(subject: Subject, result: CheckResult) -> None:
    """Find states that two parts write, that do not cross the border, or that nobody writes."""
    parts = subject.program.parts
    if parts is None:
        return
    if not subject.program.part and not is_divided(subject.program.blocks, parts):
        return  # all of it is in one process, until a block says `on:`
    given = {s: part.name for part in parts.parts.values() for s in part.publishes}
    _check_silence(subject, result, parts, given)
    if subject.program.part:  # the others' blocks are not here
        return
    writers, where = _writers(subject, parts), subject.document.where
    for state, who in writers.items():
        if len(who) > 1:
            said = " and ".join(f"{block!r} of part {part!r}" for part, block in who.items())
            evidence = f"{said} write it, and a part does not write another's states"
            result.find("parts.writers", f"state {state!r}", evidence, where=where("parts"))
    for part in parts.parts.values():
        for state in part.publishes:
            if part.name in writers.get(state, {}):
                continue
            theirs = next(iter(writers.get(state, {})), "")
            result.find(
                "parts.published",
                f"part {part.name!r}",
                f"it publishes {state!r}, which "
                + (f"part {theirs!r} writes" if theirs else "nothing writes"),
                f"move it to part {theirs!r}" if theirs else "take it out of publishes",
                where("parts", part.name, "publishes"),
            )
    _check_read(subject, result, parts, given, writers)


def check_keys(subject: Subject, result: CheckResult) -> None:
    """Find what other machines reach, and everybody there may write, for want of keys.

    Parts of a live workflow without `--part` are in one process.
    """
    program, document = subject.program, subject.document
    store, party = read_store(document), program.start.together
    found = []
    if store is not None and store.keys is None and (program.part or not subject.live):
        found.append(("store", [store.address], "store: {zmq: {address: …, keys: …}}"))
    if party is not None and party.keys is None:
        remedy = "start: {together: {…, keys: FOLDER}}"
        found.append(("start.together", [*party.robots.values()], remedy))
    for name, contract in program.policies.items():
        if isinstance(contract.child, RemoteSpec) and contract.child.keys is None:
            where = f"policies.{name}.remote"
            found.append((where, [contract.child.address], "remote: {…, keys: FOLDER}"))
    for where, addresses, remedy in found:
        if exposed := [*filter(is_exposed, addresses)]:
            result.find(
                "zmq.keys",
                where,
                f"{listed(exposed)} can be reached from other machines, without keys: "
                f"{WITHOUT_KEYS}",
                f"make keys (docs/howto/zmq.md) and write {remedy}, or use addresses of 127.0.0.1",
                document.where(*where.split(".")),
            )


def _writers(subject: Subject, parts: Parts) -> Writers:
    writers = {
        state: {parts.first: f"platform {subject.platform.name!r}"}
        for state in subject.program.platform.facts.writes
    }
    for block in subject.program.blocks:
        for state in block.writes:
            writers.setdefault(state, {}).setdefault(owner_of(block, parts), block.name)
    return writers


def _check_read(
    subject: Subject, result: CheckResult, parts: Parts, given: Mapping[str, str], writers: Writers
) -> None:
    missing: dict[tuple[str, str], set[str]] = {}
    for block in subject.program.blocks:
        here = owner_of(block, parts)
        for state in (*block.reads, *block.amends):
            owners = writers.get(state, {})
            if not owners or here in owners:
                continue
            theirs = next(iter(owners))
            if given.get(state) not in owners:
                missing.setdefault((theirs, here), set()).add(state)
            if parts.store.backend == "zmq" and parts.first not in (here, theirs):
                result.find(
                    "parts.published",
                    f"block {block.name!r} of part {here!r}",
                    f"it reads {state!r} of part {theirs!r}; over zmq parts talk with "
                    f"{parts.first!r} alone",
                    f"move one of them to part {parts.first!r}, or use store: shm",
                    block.where,
                )
    for (owner, here), states in missing.items():
        result.find(
            "parts.published",
            f"part {here!r}",
            f"it reads {', '.join(sorted(states))}, which part {owner!r} writes and does not "
            "publish",
            f"add to parts.{owner}.publishes: [{', '.join(sorted(states))}]",
            subject.document.where("parts", owner),
        )


def _check_silence(
    subject: Subject, result: CheckResult, parts: Parts, given: Mapping[str, str]
) -> None:
    part = parts.parts[parts.first]
    commands = [s for s in COMMAND_STATES if given.get(s, part.name) != part.name]
    unknown = [s for s in commands if s not in part.silent.values]
    if unknown and part.silent.then == "neutral":
        result.find(
            "parts.silent",
            f"part {part.name!r}",
            f"its commands {', '.join(unknown)} come from another part, and nobody says what is "
            "sent when that is silent",
            where=subject.document.where("parts", part.name),
        )


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
        evidence = (
            "no block looks at commands before they are sent: what is not finite or beyond the "
            "limits of a joint leaves as it is"
        )
        result.note("safety.none", what, evidence, "", where)
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
        name, blind = f"safety block {block.name!r}", _blind(block, sent, told)
        result.find("safety.partial", name, blind, where=block.where or where)


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
        isinstance(node, Switch | When)
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
