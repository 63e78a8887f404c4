"""The graph of blocks: what the flow's own checks say, and, of one in parts, who writes a state.

In a divided workflow each state has one part that writes it, and has to reach its readers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from unicon_core.check.memory_proof import prove
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.flow import Block, Stage
from unicon_core.flow.checks import check_graph
from unicon_core.flow.nodes import unfused
from unicon_core.memory import Memory, holder_of
from unicon_core.show.tree import is_critical
from unicon_core.states.backends.zmq_socket import WITHOUT_KEYS, is_exposed
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.division import is_divided, owner_of
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
    """Find what other machines reach, and everybody there may write, for want of keys."""
    program, document = subject.program, subject.document
    store, party = read_store(document), program.start.together
    found: list[tuple[str, tuple[str, ...], Path | None, str]] = []
    if store is not None and (program.part or not subject.live):  # else all is in one process
        found.append(("store", (store.address,), store.keys, "store: {zmq: {address: …, keys: …}}"))
    if party is not None:
        remedy = "start: {together: {…, keys: FOLDER}}"
        found.append(("start.together", tuple(party.robots.values()), party.keys, remedy))
    for where, addresses, keys, remedy in found:
        exposed = [address for address in addresses if is_exposed(address)]
        if exposed and keys is None:
            result.find(
                "zmq.keys",
                where,
                f"{listed(exposed)} can be reached from other machines, without keys: "
                f"{WITHOUT_KEYS}",
                f"make keys (docs/howto/zmq.md) and write {remedy}, or use addresses of 127.0.0.1",
                document.where(*where.split(".")),
            )


def _writers(subject: Subject, parts: Parts) -> Writers:
    writers: dict[str, dict[str, str]] = {
        state: {parts.first: f"platform {subject.platform.name!r}"}
        for state in subject.program.platform.facts.writes
    }
    for block in subject.program.blocks:
        for state in block.writes:
            writers.setdefault(state, {}).setdefault(owner_of(block, parts), block.name)
    return writers


def _check_read(
    subject: Subject,
    result: CheckResult,
    parts: Parts,
    given: Mapping[str, str],
    writers: Writers,
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
