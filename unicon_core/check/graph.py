"""The graph of blocks: what the flow's own checks say, as findings."""

from __future__ import annotations

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject
from unicon_core.flow.checks import check_graph
from unicon_core.show.tree import is_critical
from unicon_core.workflow.tick_tree import given_in

__all__ = ["check_blocks"]


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
