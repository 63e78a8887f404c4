"""What all pictures of a graph share: a title for each node, and its children with labels."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from unicon_core.flow import (
    Block,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    children_of,
)

LEGEND = "critical path: the command of this tick depends on it"


def title(node: Node) -> str:
    """Return the word for a node, with what stands in its own line: predicates, numbers."""
    if isinstance(node, Block):
        return f"{node.name} (on {node.part})" if node.part else node.name
    if isinstance(node, Zip):
        return "zip"
    if isinstance(node, Chain):
        return "chain"
    if isinstance(node, Loop):
        return "loop" if node.until is None else f"loop until {node.until.name}"
    if isinstance(node, Every):
        return f"every {node.n} ticks"
    if isinstance(node, When):
        return f"when {node.predicate.name}"
    if isinstance(node, Switch):
        blend = f", blended over {node.blend} ticks" if node.blend else ""
        return f"switch on {node.selector.name}{blend}"
    return "deferred, found not to be part of the command" if node.ends else "deferred"


def branches(node: Node) -> list[tuple[str, Node]]:
    """Return the children that hang below a node, each with the label of its branch.

    Those of a fused block are what it was fused of.
    """
    if isinstance(node, Block):
        return [("", part) for part in node.parts]
    if isinstance(node, Chain):
        return [(str(i + 1), child) for i, child in enumerate(node.children)]
    if isinstance(node, Switch):
        return list(zip(node.names, node.children))
    return [("", child) for child in (node.children if isinstance(node, Zip) else (node.child,))]


def is_critical(node: Node, critical: Collection[Block]) -> bool:
    """Return True for a block on the critical path, or fused from one that is."""
    return isinstance(node, Block) and any(part in critical for part in (node, *node.parts))


def shortened(names: Sequence[str], limit: int) -> str:
    """Return names with commas; of more than `limit` the first ones and the number of others."""
    if len(names) <= limit:
        return ", ".join(names)
    return f"{', '.join(names[: limit - 1])}, +{len(names) - limit + 1}"


def data_lines(node: Node, words: Sequence[str], limit: int) -> list[str]:
    """Return what a block reads, writes and amends, each behind its word; none of other nodes."""
    if not isinstance(node, Block):
        return []
    uses = zip(words, (node.reads, node.writes, node.amends))
    return [f"{word} {shortened(names, limit)}" for word, names in uses if names]


def data_flow(root: Node) -> dict[tuple[Block, Block], list[str]]:
    """Return the states that go from a block that writes or amends them to one that reads them.

    A reader gets a state from whichever block may have been the last to write it: of several
    branches that exclude each other from each, without one in this tick from the tick before.
    """
    flow: dict[tuple[Block, Block], list[str]] = {}
    _tick(root, _tick(root, {}, {}), flow)
    return flow


Writers = dict[str, tuple[Block, ...]]


def _tick(root: Node, before: Writers, flow: dict[tuple[Block, Block], list[str]]) -> Writers:
    after = _reach(root, before, flow)
    for child in _put_off(root):
        after = _either([after, _reach(child, after, flow)])
    return after


def _put_off(node: Node) -> list[Node]:
    if isinstance(node, Deferred):
        return [node.child]
    return [found for child in children_of(node) for found in _put_off(child)]


def _reach(node: Node, before: Writers, flow: dict[tuple[Block, Block], list[str]]) -> Writers:
    """Note in `flow` who reads what from whom; return who may have written what after a node."""
    if isinstance(node, Block):
        for name in (*node.reads, *node.amends):
            for source in before.get(name, ()):
                names = flow.setdefault((source, node), [])
                if name not in names:
                    names.append(name)
        return before | dict.fromkeys((*node.writes, *node.amends), (node,))
    if isinstance(node, (Chain, Switch)):
        if isinstance(node, Switch):
            before = _reach(node.selector, before, flow)
        return _either([_reach(child, before, flow) for child in node.children])
    if isinstance(node, When):
        before = _reach(node.predicate, before, flow)
        return _either([before, _reach(node.child, before, flow)])
    after = before
    for child in () if isinstance(node, Deferred) else children_of(node):
        after = _reach(child, after, flow)
    return _either([before, after]) if isinstance(node, Every) else after


def _either(ways: list[Writers]) -> Writers:
    names = dict.fromkeys(name for way in ways for name in way)
    return {
        name: tuple(dict.fromkeys(block for way in ways for block in way.get(name, ())))
        for name in names
    }
