"""Finding: one thing that is wrong with a graph, in the order in which a reader needs it."""

from __future__ import annotations

from dataclasses import dataclass

from unicon_core.flow.block import Block


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes:
        culprit: what is wrong (`block 'policy'`, `loop`).
        evidence: what shows it.
        remedy: what to do.
        where: `file:line` of the culprit, or "".
    """

    culprit: str
    evidence: str
    remedy: str
    where: str = ""

    @classmethod
    def of(cls, block: Block, evidence: str, remedy: str) -> Finding:
        """Return what is wrong with a block."""
        return cls(f"block {block.name!r}", evidence, remedy, block.where)

    @property
    def text(self) -> str:
        """The line to print, without the place."""
        return f"{self.culprit} {self.evidence}; {self.remedy}"

    def __str__(self) -> str:
        return f"{self.where}: {self.text}" if self.where else self.text
