"""Critical path: what the command depends on; the rest is put off until after `send`.

From `reads`, `writes` and `amends` alone: a block is on the path when `send` reads, directly or
through others, what it writes. A block off the path is wrapped in `Deferred` where that changes
nothing but its time. Explicit order wins: what stands behind `send` or in a `Deferred` stays there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from unicon_core.flow.block import Block
from unicon_core.flow.nodes import Deferred, Loop, Node, Zip, blocks_of, children_of, with_children
from unicon_core.flow.stage import FIXED, Stage


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
