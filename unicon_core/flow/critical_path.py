"""Critical path: what the command depends on; the rest is put off until after `send`.

From `reads`, `writes` and `amends` alone: a block is on the path when `send` reads, directly or
through others, what it writes. A block off the path is wrapped in `Deferred` where that changes
nothing but its time. Explicit order wins: what stands behind `send` or in a `Deferred` stays there.
The checks of that order stand here as well: states that are read before anything writes them, and
blocks behind `send` that must not be there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from unicon_core.flow.block import FIXED, Block, Stage
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
    with_children,
)
from unicon_core.states.standard import ESTIMATORS


def is_patient(node: Node) -> bool:
    """Return whether a safety block looks for so many ticks that it may look after `send`.

    No command waits for it there: 20 to 30 µs of a tick at 29 joints. It finds in the same tick
    what it would have found before, and one command more has left by then.
    """
    if not isinstance(node, Block) or node.stage is not Stage.SAFETY:
        return False
    return getattr(node.tick, "patient", False)


@dataclass(frozen=True)
class CriticalPath:
    """What was found.

    Attributes:
        root: the tree, with what could be put off in a `Deferred(…, ends=True)`.
        critical: blocks that the command depends on, `send` and blocks of fixed stages included.
    """

    root: Node
    critical: frozenset[Block]


class _Part:
    """One part of the top-level Zip, nested ones unfolded, and what its blocks touch.

    Attributes:
        now, late: states that it touches in `step`, and in what is put off already.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self.blocks = blocks_of(node)
        self.put_off = set(_deferred_blocks(node))
        self.now = _Touched([block for block in self.blocks if block not in self.put_off])
        self.late = _Touched([block for block in self.blocks if block in self.put_off])
        self.explicit = isinstance(node, Deferred)
        self.stages = {block.stage for block in self.blocks} & FIXED


class _Touched:
    """States that blocks read and write; what they amend is both."""

    def __init__(self, blocks: list[Block]) -> None:
        self.reads = {name for block in blocks for name in (*block.reads, *block.amends)}
        self.writes = {name for block in blocks for name in (*block.writes, *block.amends)}

    def conflicts(self, other: _Touched) -> bool:
        """Return whether a state forbids to swap the two."""
        return bool(self.writes & (other.reads | other.writes) | other.writes & self.reads)


def critical_path(root: Node) -> CriticalPath:
    """Find what `send` depends on, and put off what it does not.

    A block is put off when it declares reads, stands in no fixed stage, no state that `send` needs
    depends on it, and no part that it then runs after (or no longer after) writes what it touches
    or reads what it writes. It may still end the graph. Without a `send` in the top-level Zip
    nothing moves.
    """
    parts = [_Part(node) for node in _parts(root)]
    sends = [i for i, part in enumerate(parts) if Stage.SEND in part.stages and not part.explicit]
    if not sends:
        return CriticalPath(root, frozenset())
    needed = _needed(parts[: sends[-1] + 1])
    critical = frozenset(
        block for i in needed for block in parts[i].blocks if block not in parts[i].put_off
    )
    moved: list[_Part] = []
    for i in reversed(range(sends[-1])):  # from the back: those behind are known to move or stay
        if i not in needed and not parts[i].explicit and _may_move(parts, i, moved):
            moved.append(parts[i])
    return CriticalPath(_put_off(root, {id(part.node) for part in moved}), critical)


def _parts(node: Node) -> Iterator[Node]:
    """Yield the parts of Zips inside Zips: a done part ends the graph, wherever it stands."""
    if isinstance(node, Zip):
        for child in node.children:
            yield from _parts(child)
    elif isinstance(node, Loop) and _holds_send(node.child):
        yield from _parts(node.child)
        if node.until is not None:
            yield node.until
    else:
        yield node


def _holds_send(node: Node) -> bool:
    return isinstance(node, (Zip, Loop)) and any(b.stage is Stage.SEND for b in blocks_of(node))


def _needed(parts: list[_Part]) -> set[int]:
    """Return the numbers of the parts up to and including `send` that it depends on.

    What one tick leaves behind is read in the next: a writer may stand behind its reader.
    """
    needed = {i for i, part in enumerate(parts) if part.stages and not part.explicit}
    while True:
        states = {name for i in needed for name in parts[i].now.reads}
        more = {i for i, part in enumerate(parts) if part.now.writes & states} - needed
        if not more:
            return needed
        needed |= more


def _deferred_blocks(node: Node) -> Iterator[Block]:
    if isinstance(node, Deferred):
        yield from blocks_of(node)
    else:
        for child in children_of(node):
            yield from _deferred_blocks(child)


def _may_move(parts: list[_Part], at: int, moved: list[_Part]) -> bool:
    """Return whether a part can be put off, by what `critical_path` says."""
    part = parts[at]
    declared = all(block.reads or block.writes or block.amends for block in part.blocks)
    if not declared or not part.now.reads or part.put_off:
        return False
    for i, other in enumerate(parts):
        if i == at:
            continue
        if set(part.blocks) & set(other.blocks):  # it stands in the graph twice
            return False
        if i > at and other not in moved and part.now.conflicts(other.now):
            return False
        if i < at and part.now.conflicts(other.late):  # in `deferred` the tree's order holds again
            return False
    return True


def _put_off(node: Node, move: set[int]) -> Node:
    if id(node) in move:
        return Deferred(node, ends=True, where=node.where)
    if not isinstance(node, (Zip, Loop)):
        return node
    until = node.until if isinstance(node, Loop) else None
    new = [child if child is until else _put_off(child, move) for child in children_of(node)]
    return with_children(node, new)


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
    A policy's action `holds` that of the tick before, for the policies that run before it.
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
                if writer is not None and name in getattr(writer.tick, "holds", ()):
                    continue
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
