"""The flow primitives, for workflow authors: how blocks follow each other from tick to tick.

Every node is stepped once per tick and says whether it is done. A node that ends is reset at once,
with its parts that were still running (`Block.reset`, counters to zero), so a node that is entered
again starts from its beginning. Equations: UniCon paper, section 3.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from operator import index as index_of
from typing import TypeAlias

import numpy as np

from unicon_base.errors import WorkflowError
from unicon_core.flow.block import Block, Tick, as_block


class _Several:
    def __init__(self, *children: Node | Tick, where: str = "") -> None:
        if not children:
            word = type(self).__name__.lower()
            raise WorkflowError(f"{word}: no blocks; give at least one", where)
        self.children: tuple[Node, ...] = tuple(as_node(child, where=where) for child in children)
        self.where = where


class Zip(_Several):
    """Each tick steps all children in order; done when one of them is done.

    zip(T_g, T_h) = ((g_1, h_1), …, (g_n, h_n)).
    """


class Chain(_Several):
    """Steps the first child until it is done, from the next tick on the second, and so on.

    chain(T_g, T_h) = (g_1, …, g_m, h_1, …, h_n). Done with its last child.
    """


class Loop:
    """Steps a child each tick until the predicate holds after it, or the child is done.

    loop(T_g, p) = (g_1, …, g_k), p(k) = 1.

    Args:
        block: what is stepped.
        until: function without parameters; asked after each step; None: the child alone decides.
    """

    def __init__(
        self, block: Node | Tick, until: Tick | Block | None = None, *, where: str = ""
    ) -> None:
        self.child = as_node(block, where=where)
        self.until = None if until is None else as_block(until, where=where)
        self.where = where


class Every:
    """Steps a child in the first of every n ticks; done when the child is done."""

    def __init__(self, n: int, block: Node | Tick, *, where: str = "") -> None:
        if not isinstance(n, int) or isinstance(n, bool) or n < 1:
            raise WorkflowError(f"every: n is {n!r}; give a whole number of ticks >= 1", where)
        self.n = n
        self.child = as_node(block, where=where)
        self.where = where


class When:
    """Steps a child in those ticks in which the predicate holds; done when the child is done."""

    def __init__(self, predicate: Tick | Block, block: Node | Tick, *, where: str = "") -> None:
        self.predicate = as_block(predicate, where=where)
        self.child = as_node(block, where=where)
        self.where = where


class Switch:
    """Steps the one case that the selector names; done when that case is done.

    On a change of case the outgoing one is reset. With `blend`, the command states then go from the
    last outgoing command to the incoming ones: with w = k / (K + 1), tick k = 1 … K sends
    (1 - w) · held + w · incoming.

    Args:
        selector: function without parameters that returns a case's name or its number.
        cases: name to block.
        blend: ticks K that a change of case is blended over; 0 for none. A float is a time in [s],
            which the program makes into ticks when it is built.
        blender: built by the program for the command states: see `Blender`.
    """

    def __init__(
        self,
        selector: Tick | Block,
        cases: Mapping[str, Node | Tick],
        *,
        blend: int | float = 0,
        blender: Blender | None = None,
        where: str = "",
    ) -> None:
        if not cases:
            raise WorkflowError("switch: no cases; give at least one, as name: block", where)
        if isinstance(blend, bool) or not isinstance(blend, (int, float)) or not blend >= 0:
            raise WorkflowError(
                f"switch: blend is {blend!r}; give a whole number of ticks >= 0", where
            )
        if blend and blender is None and not isinstance(blend, float):
            raise WorkflowError("switch: blend needs a blender (Blender(states))", where)
        self.selector = as_block(selector, name="selector", where=where)
        self.names = tuple(cases)
        self.children = tuple(as_node(case, where=where) for case in cases.values())
        self.blend = blend
        self.blender = blender
        self.where = where

    def index(self, key: object) -> int:
        """Return the number of the case that a selector's value means.

        Raises:
            WorkflowError: no such case.
        """
        if isinstance(key, str):
            if key in self.names:
                return self.names.index(key)
        elif isinstance(key, np.bool_) or hasattr(key, "__index__"):
            # a comparison of states is a np.bool_, which is not an index to NumPy
            number = int(key) if isinstance(key, np.bool_) else index_of(key)
            if 0 <= number < len(self.names):
                return number
        raise WorkflowError(f"switch: no case {key!r}; cases: {', '.join(self.names)}", self.where)


class Deferred:
    """Steps a child after `send`, in the slack of the tick; never makes its parent done.

    A child that became due is stepped even if its parent has ended in the same tick. Several of
    them run in their order in the tree.

    Args:
        block: what is stepped.
        ends: the whole graph is done when the child is done, and where the parent ends the child
            is made fresh only after it has run. `critical_path` sets it on what it puts off, so
            that a block that may end the graph can move behind `send` and nothing else changes.
    """

    def __init__(self, block: Node | Tick, *, ends: bool = False, where: str = "") -> None:
        self.child = as_node(block, where=where)
        self.ends = ends
        self.where = where


class Blender:
    """Mixes held and incoming commands in place: what `Switch` needs for blending.

    Args:
        arrays: the command states' views, float32.
    """

    memory = ("_held", "_own")

    def __init__(self, arrays: Mapping[str, object]) -> None:
        self._live = [np.asarray(array) for array in arrays.values()]
        self._held = [array.copy() for array in self._live]
        self._own = [array.copy() for array in self._live]
        self._scratch = [array.copy() for array in self._live]

    def capture(self) -> None:
        """Hold the present commands as the outgoing ones."""
        for held, own, live in zip(self._held, self._own, self._live):
            held[...] = own[...] = live

    def resume(self) -> None:
        """Take the last mixing back: what steps next may leave its commands as they are.

        A policy that runs in every tenth tick does: its targets would be mixed ten times.
        """
        for own, live in zip(self._own, self._live):
            live[...] = own

    def mix(self, weight: float) -> None:
        """Replace the commands by (1 - weight) · held + weight · present."""
        for held, own, live, scratch in zip(self._held, self._own, self._live, self._scratch):
            own[...] = live
            live *= weight
            scratch[...] = held
            scratch *= 1.0 - weight
            live += scratch


Node: TypeAlias = Block | Zip | Chain | Loop | Every | When | Switch | Deferred


def as_node(candidate: object, *, where: str = "") -> Node:
    """Return a flow node as it is, anything callable as a Block."""
    if isinstance(candidate, Node):
        return candidate
    return as_block(candidate, where=where)


def children_of(node: Node) -> tuple[Node, ...]:
    """Return the nodes right below, predicates and selectors included, in order of calling."""
    if isinstance(node, (Zip, Chain)):
        return node.children
    if isinstance(node, Switch):
        return (node.selector, *node.children)
    if isinstance(node, Loop):
        return (node.child,) if node.until is None else (node.child, node.until)
    if isinstance(node, When):
        return (node.predicate, node.child)
    if isinstance(node, (Every, Deferred)):
        return (node.child,)
    return ()


def unfused(node: Node) -> Iterator[Block]:
    """Yield a block, or the blocks that were fused into it; nothing of other nodes."""
    if isinstance(node, Block):
        if not node.parts:
            yield node
        for part in node.parts:
            yield from unfused(part)


def with_children(node: Node, children: Sequence[Node]) -> Node:
    """Return a node of the same kind and options with other children, in `children_of` order.

    Where they are the same objects the node itself is returned.
    """
    if children_of(node) == tuple(children):
        return node
    new: Node = copy(node)
    if isinstance(new, (Zip, Chain)):
        new.children = tuple(children)
    elif isinstance(new, Switch):
        selector, *cases = children
        new.selector, new.children = _predicate(selector), tuple(cases)
    elif isinstance(new, Loop):
        new.child = children[0]
        new.until = _predicate(children[1]) if len(children) > 1 else None
    elif isinstance(new, When):
        new.predicate, new.child = _predicate(children[0]), children[1]
    elif isinstance(new, (Every, Deferred)):
        (new.child,) = children
    return new


def chooser_of(node: Node) -> Block | None:
    """Return the predicate or selector that says which way a node goes, if it has one."""
    if isinstance(node, When):
        return node.predicate
    if isinstance(node, Loop):
        return node.until
    return node.selector if isinstance(node, Switch) else None


def _predicate(node: Node) -> Block:
    assert isinstance(node, Block)
    return node


def blocks_of(node: Node) -> list[Block]:
    """Return all blocks of a tree in order of calling, each once."""
    if isinstance(node, Block):
        return [node]
    return list(dict.fromkeys(block for child in children_of(node) for block in blocks_of(child)))


def never_done(node: Node) -> bool:
    """Return True where it is proven that a node is never done.

    A block is proven so by `endless`, which a function that is annotated to return None has too.
    """
    if isinstance(node, Block):
        return node.endless
    if isinstance(node, (Zip, Switch)):
        return all(map(never_done, node.children))
    if isinstance(node, Chain):
        return any(map(never_done, node.children))
    if isinstance(node, Loop):
        return (node.until is None or node.until.endless) and never_done(node.child)
    if isinstance(node, (Every, When)):
        return never_done(node.child)
    return isinstance(node, Deferred)
