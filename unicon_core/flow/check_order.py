"""Order in the tick: states read before anything writes them, and what stands behind `send`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from unicon_core.flow.block import Block
from unicon_core.flow.critical_path import is_patient
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
from unicon_core.states.standard import ESTIMATORS

States = frozenset[str]


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


def reads_before_writes(root: Node, given: States) -> list[Finding]:
    """Find blocks whose first run reads or amends a state that nothing can have written by then.

    What is put off is not looked at: an observer may watch states that this robot does not have.
    """
    found = _Reads(root).walk(root, given, given)
    return list({(f.culprit, f.evidence): f for f in found}.values())


class _Reads:
    """Walks in the order of the first runs.

    `before` is what may be written when a node runs in its parent's first tick, `ever` what may be
    written when it runs for the first time in a later one.
    """

    def __init__(self, root: Node) -> None:
        blocks = blocks_of(root)
        # Of several writers the first counts.
        self.writers = {b.claim(name): b for b in reversed(blocks) for name in b.writes}
        self.shared = [(b, b.share) for b in blocks if b.share is not None]

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
        for word in ("reads", "amends"):
            for name in getattr(block, word):
                if name in before or name in block.writes:
                    continue
                missing = next((c for c in self.claims(block, name) if c not in before), None)
                if missing is None:
                    continue
                writer = self.writers.get(missing)
                if writer is None:
                    evidence = f"{word} {missing!r}, which no block writes"
                    remedy = f"put a block before it that writes {missing!r}"
                    if name in ESTIMATORS:
                        ours = ESTIMATORS[name]
                        remedy += f", as {ours} does (estimate: [{ours}])"
                else:
                    evidence = f"{word} {missing!r} before {writer.name!r} has written it"
                    remedy = f"put it behind {writer.name!r}"
                yield Finding.of(block, evidence, remedy)

    def claims(self, block: Block, name: str) -> list[str]:
        """Return what has to be written for a block to read a state: each share of it."""
        own = [(b, s) for b, s in self.shared if name in b.writes and name in s.states]
        if not own or name in self.writers:
            return [block.claim(name)]
        reader = block.share if block.share is not None and name in block.share.states else None
        if reader is not None and block.claim(name) in self.writers:
            return [block.claim(name)]
        share = own[0][1]
        wanted = share.whole if reader is None else reader.joints
        claims = list(dict.fromkeys(b.claim(name) for b, s in own if s.joints & wanted))
        left = wanted.difference(*(s.joints for _, s in own))
        return claims + [f"{name} of {each}" for each in _named(left, share.parts)]


def _named(joints: frozenset[str], parts: Mapping[str, frozenset[str]]) -> list[str]:
    """Return joints by the names of what they are part of, those that are of no whole part last."""
    named = []
    for name, part in parts.items():
        if part and part <= joints:
            named.append(name)
            joints -= part
    return [*named, ", ".join(sorted(joints))] if joints else named


def behind_send(root: Node) -> list[Finding]:
    """Find safety blocks, and writers of what `send` reads, that run behind it in its tick."""
    sends = [block for block in blocks_of(root) if block.stage is Stage.SEND]
    if not sends:
        return []
    send, commands = sends[0].name, {name for block in sends for name in block.reads}
    findings: list[Finding] = []

    def late(block: Block) -> None:
        remedy = f"put it before {send!r}, not into 'deferred'"
        if block.stage is Stage.SAFETY:
            if is_patient(block):
                return
            evidence = f"runs behind {send!r}: the motors have the command by then"
            findings.append(Finding(f"safety block {block.name!r}", evidence, remedy, block.where))
            return
        for name in (*block.writes, *block.amends):
            if name in commands:
                evidence = f"writes {name!r} behind {send!r}: it would leave a tick late"
                findings.append(Finding.of(block, evidence, remedy))

    def walk(node: Node, sent: bool) -> bool:
        """Look at a node that runs when the command is `sent` or not; return what it is then."""
        if isinstance(node, Block):
            if sent:
                late(node)
            return sent or node.stage is Stage.SEND
        if isinstance(node, Deferred):
            walk(node.child, True)  # in the tick that it was put off in, at least
            return sent
        if isinstance(node, (Chain, Switch)):
            if isinstance(node, Switch):
                walk(node.selector, sent)
            after = [walk(child, sent) for child in node.children]
            return all(after)
        before = sent
        for child in children_of(node):
            sent = walk(child, sent)
        return before if isinstance(node, When) else sent

    walk(root, False)
    return list(dict.fromkeys(findings))


def _writes(node: Node) -> States:
    return frozenset(block.claim(name) for block in blocks_of(node) for name in block.writes)
