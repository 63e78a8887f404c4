"""Order in the tick: states read before anything writes them, and what stands behind `send`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from unicon_core.flow.block import Block
from unicon_core.flow.finding import Finding
from unicon_core.flow.nodes import (
    Chain,
    Deferred,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    blocks_of,
    children_of,
)
from unicon_core.flow.stage import Stage

__all__ = ["behind_send", "reads_before_writes"]

States = frozenset[str]


def reads_before_writes(root: Node, given: States) -> list[Finding]:
    """Find blocks whose first run reads or amends a state that nothing can have written by then.

    What is put off is not looked at: an observer may watch states that this robot does not have.
    """
    return list(
        {(f.culprit, f.evidence): f for f in _Reads(root).walk(root, given, given)}.values()
    )


class _Reads:
    """Walks in the order of the first runs.

    `before` is what may be written when a node runs in its parent's first tick, `ever` what may be
    written when it runs for the first time in a later one.
    """

    def __init__(self, root: Node) -> None:
        self.writers: dict[str, Block] = {}
        for block in blocks_of(root):
            for name in block.writes:
                self.writers.setdefault(name, block)

    def walk(self, node: Node, before: States, ever: States) -> Iterator[Finding]:
        if isinstance(node, Block):
            yield from self.block(node, before)
        elif isinstance(node, Zip):
            ever = ever | _writes(node)
            for child in node.children:
                yield from self.walk(child, before, ever)
                before = before | _writes(child)
        elif isinstance(node, Chain):
            for i, child in enumerate(node.children):
                yield from self.walk(child, before if i == 0 else before | ever, ever)
                before, ever = before | _writes(child), ever | _writes(child)
        elif isinstance(node, Loop):
            yield from self.walk(node.child, before, ever)
            if node.until is not None:
                yield from self.block(node.until, before | _writes(node.child))
        elif isinstance(node, When):
            yield from self.block(node.predicate, before)
            yield from self.walk(node.child, before | ever | _writes(node.predicate), ever)
        elif isinstance(node, Switch):
            yield from self.block(node.selector, before)
            every = before | ever | _writes(node)  # nobody knows which case comes first
            for child in node.children:
                yield from self.walk(child, every, every)
        elif not isinstance(node, Deferred):
            for child in children_of(node):
                yield from self.walk(child, before, ever)

    def block(self, block: Block, before: States) -> Iterator[Finding]:
        for word, names in (("reads", block.reads), ("amends", block.amends)):
            for name in names:
                if name in before or name in block.writes:
                    continue
                writer = self.writers.get(name)
                if writer is None:
                    evidence = f"{word} {name!r}, which no block writes"
                    remedy = f"put a block before it that writes {name!r}"
                else:
                    evidence = f"{word} {name!r} before {writer.name!r} has written it"
                    remedy = f"put it behind {writer.name!r}"
                yield Finding(f"block {block.name!r}", evidence, remedy, block.where)


def behind_send(root: Node) -> list[Finding]:
    """Find safety blocks, and writers of what `send` reads, that run behind it in its tick."""
    sends = [block for block in blocks_of(root) if block.stage is Stage.SEND]
    if not sends:
        return []
    sent = _Sent(sends[0].name, frozenset(name for block in sends for name in block.reads))
    sent.walk(root, False)
    return list(dict.fromkeys(sent.findings))


@dataclass
class _Sent:
    send: str
    commands: States
    findings: list[Finding] = field(default_factory=list)

    def walk(self, node: Node, sent: bool) -> bool:
        """Look at a node that runs when the command is `sent` or not; return what it is then."""
        if isinstance(node, Block):
            if sent:
                self.late(node)
            return sent or node.stage is Stage.SEND
        if isinstance(node, Deferred):
            self.walk(node.child, True)  # in the tick that it was put off in, at least
            return sent
        if isinstance(node, (Chain, Switch)):
            if isinstance(node, Switch):
                self.walk(node.selector, sent)
            after = [self.walk(child, sent) for child in node.children]
            return all(after)
        before = sent
        for child in children_of(node):
            sent = self.walk(child, sent)
        return before if isinstance(node, When) else sent

    def late(self, block: Block) -> None:
        if block.stage is Stage.SAFETY:
            self.findings.append(
                Finding(
                    f"safety block {block.name!r}",
                    f"runs behind {self.send!r}: the motors have the command by then",
                    f"put it before {self.send!r}, not into 'deferred'",
                    block.where,
                )
            )
        for name in (*block.writes, *block.amends):
            if name in self.commands and block.stage is not Stage.SAFETY:
                self.findings.append(
                    Finding(
                        f"block {block.name!r}",
                        f"writes {name!r} behind {self.send!r}: it would leave a tick late",
                        f"put it before {self.send!r}, not into 'deferred'",
                        block.where,
                    )
                )


def _writes(node: Node) -> States:
    return frozenset(name for block in blocks_of(node) for name in block.writes)
