"""The graph of blocks: what the flow's own checks say, as findings."""

from __future__ import annotations

from collections.abc import Iterator

from unicon_core.check.memory_proof import prove
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject
from unicon_core.flow import Block, Stage
from unicon_core.flow.checks import check_graph
from unicon_core.flow.nodes import unfused
from unicon_core.memory import Memory, holder_of
from unicon_core.show.tree import is_critical
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
