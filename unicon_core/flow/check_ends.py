"""Ends: blocks that can never be reached, because what stands before them can never be done."""

from __future__ import annotations

from collections.abc import Iterator

from unicon_core.flow.block import Block
from unicon_core.flow.finding import Finding
from unicon_core.flow.nodes import (
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    blocks_of,
    children_of,
)


def never_done(node: Node) -> bool:
    """Return True where it is proven that a node is never done.

    A block is proven so by `endless`, which a function that is annotated to return None has too.
    """
    if isinstance(node, Block):
        return node.endless
    if isinstance(node, (Zip, Switch)):
        return all(never_done(child) for child in node.children)
    if isinstance(node, Chain):
        return any(never_done(child) for child in node.children)
    if isinstance(node, Loop):
        return (node.until is None or node.until.endless) and never_done(node.child)
    if isinstance(node, (Every, When)):
        return never_done(node.child)
    return isinstance(node, Deferred)


def never_reached(root: Node) -> list[Finding]:
    """Find children of chains behind one that is never done, each chain's first."""
    return list(dict.fromkeys(_walk(root)))


def _walk(node: Node) -> Iterator[Finding]:
    if isinstance(node, Chain):
        for before, behind in zip(node.children, node.children[1:]):
            if not never_done(before):
                continue
            blocks = blocks_of(behind)
            loop = _loop(before)
            if loop is None:
                name = blocks_of(before)[0].name
                yield Finding(
                    f"block {blocks[0].name!r}",
                    f"can never be reached: {name!r} before it in the chain is never done",
                    f"run both in a zip, or give {name!r} an end: loop: {{do: …, until: …}}",
                    blocks[0].where or behind.where,
                )
            else:
                name = blocks_of(loop)[0].name
                yield Finding(
                    "loop",
                    f"of {name!r} can never end, and {blocks[0].name!r} stands behind it in the "
                    "chain",
                    "give it an until:, or put it last",
                    loop.where or blocks_of(loop)[0].where,
                )
            break
    for child in children_of(node):
        yield from _walk(child)


def _loop(node: Node) -> Loop | None:
    """Return the loop that a node is, through nodes with one child."""
    while not isinstance(node, Loop):
        if isinstance(node, (Every, When)):
            node = node.child
        elif isinstance(node, (Zip, Chain)) and len(node.children) == 1:
            node = node.children[0]
        else:
            return None
    return node
