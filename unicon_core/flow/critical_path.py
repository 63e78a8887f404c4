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

__all__ = ["CriticalPath", "critical_path"]


@dataclass(frozen=True)
class CriticalPath:
    """What was found.

    Attributes:
        root: the tree, with what could be put off in a `Deferred(…, ends=True)`.
        critical: blocks that the command depends on, `send` and blocks of fixed stages included.
        deferred: blocks that were put off.
        kept: blocks off the path that stay before `send`, each with the reason.
    """

    root: Node
    critical: frozenset[Block]
    deferred: tuple[Block, ...]
    kept: dict[Block, str]


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

    def conflict(self, other: _Touched) -> str:
        """Return a state that forbids to swap the two, or nothing."""
        shared = self.writes & (other.reads | other.writes) | other.writes & self.reads
        return min(shared, default="")


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
        return CriticalPath(root, frozenset(), (), {})
    needed = _needed(parts[: sends[-1] + 1])
    critical = {block for i in needed for block in _critical_blocks(parts[i])}
    moved: list[_Part] = []
    kept: dict[Block, str] = {}
    for i in reversed(range(sends[-1])):  # from the back: those behind are known to move or stay
        part = parts[i]
        if i in needed or part.explicit:
            continue
        reason = _reason(part, parts, i, moved)
        if reason:
            kept |= dict.fromkeys(part.blocks, reason)
        else:
            moved.insert(0, part)
    move = {id(part.node) for part in moved}
    blocks = tuple(block for part in moved for block in part.blocks)
    return CriticalPath(_put_off(root, move), frozenset(critical), blocks, kept)


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


def _critical_blocks(part: _Part) -> list[Block]:
    return [block for block in part.blocks if block not in part.put_off]


def _deferred_blocks(node: Node) -> Iterator[Block]:
    if isinstance(node, Deferred):
        yield from blocks_of(node)
    else:
        for child in children_of(node):
            yield from _deferred_blocks(child)


def _reason(part: _Part, parts: list[_Part], at: int, moved: list[_Part]) -> str:
    """Return why a part cannot be put off, or nothing."""
    for block in part.blocks:
        if not (block.reads or block.writes or block.amends):
            return f"{block.name} declares no states"
    if not part.now.reads:
        return "it reads no state"
    if part.put_off:
        return "a part of it is put off already"
    for i, other in enumerate(parts):
        if i == at:
            continue
        if set(part.blocks) & set(other.blocks):
            return "it stands in the graph twice"
        state = ""
        if i > at and other not in moved:
            state = part.now.conflict(other.now)
        elif i < at:  # in `deferred` the order of the tree holds again
            state = part.now.conflict(other.late)
        if state:
            return f"{other.blocks[0].name} shares {state} with it"
    return ""


def _put_off(node: Node, move: set[int]) -> Node:
    if id(node) in move:
        return Deferred(node, ends=True, where=node.where)
    if isinstance(node, (Zip, Loop)):
        old = children_of(node)
        until = node.until if isinstance(node, Loop) else None
        new = tuple(child if child is until else _put_off(child, move) for child in old)
        if any(a is not b for a, b in zip(old, new)):
            return with_children(node, new)
    return node
