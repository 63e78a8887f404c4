"""The graph of blocks: what the flow's own checks say, as findings."""

from __future__ import annotations

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject

__all__ = ["check_blocks"]


def check_blocks(subject: Subject, result: CheckResult) -> None:
    """Add the table of blocks with what they read and write."""
    rows = [
        [block.name, block.role or "-", " ".join(block.reads) or "-", " ".join(_out(block)) or "-"]
        for block in subject.blocks
    ]
    result.table("Blocks", ["block", "role", "reads", "writes"], rows)


def _out(block: object) -> list[str]:
    writes = getattr(block, "writes", ())
    amends = getattr(block, "amends", ())
    return [*writes, *(f"{name}*" for name in amends)]
