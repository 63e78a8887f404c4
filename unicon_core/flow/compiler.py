"""Compiler: turns a tree of nodes into two flat Python functions, for the runner and for readers.

`step` is what the command depends on, in order, up to the end of the tree; `deferred` is what was
put off until after it. Both are straight-line code over local names (`unicon show --source`). The
meaning of each node is said in `nodes.py`; an interpreter of the tree is the reference in `test/`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from unicon_base.arrays import Int64
from unicon_core.flow.block import Block
from unicon_core.flow.compiled import PLACED, CompiledGraph, Lines, Scope, indent
from unicon_core.flow.nodes import (
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


class NativeCode(Protocol):
    """What has blocks run as native code; see `unicon_core/native/tick.py`.

    Attributes:
        cells: variables that lie in memory of native code, by name.
    """

    cells: dict[str, Any]

    def call(self, block: Block, scope: Scope) -> str:
        """Return the lines that call a block, "" where Python runs it."""
        ...

    def rewrite(self, scope: Scope, functions: dict[str, Lines], stamps: Int64) -> dict[str, Lines]:
        """Return the functions' lines with calls of native code, and change the scope's own."""
        ...


def compile_graph(
    root: Node, *, trace: bool = False, native: NativeCode | None = None
) -> CompiledGraph:
    """Compile a tree of nodes.

    Args:
        root: the tree; shared blocks may stand in several places.
        trace: write a time stamp after each block, see `CompiledGraph.watch`; 75 to 105 ns each.
        native: takes the blocks that it can run; None leaves all to Python.
    """
    return _Compiler(trace, native).compile(root)


OUTLINE_DEPTH = 12
"""Every so many levels of nesting the code goes on in a function of its own: Python refuses more
than 100 levels of indentation, and a level of nodes takes up to two."""

GROUP = 32
"""So many blocks at most share a time stamp where not each has its own."""

OUTLINE_RESETS = 6
"""A subtree with more lines of reset than this gets a function for them, so that the source grows
linearly with the tree and not with its square."""


@dataclass
class _Compiler:
    trace: bool
    native: NativeCode | None = None
    scope: Scope = field(default_factory=Scope)
    blocks: list[Block] = field(default_factory=list)
    columns: dict[tuple[int, bool], int] = field(default_factory=dict)
    resets: dict[int, Lines] = field(default_factory=dict)
    tail: Lines = field(default_factory=list)
    deferred_blocks: set[int] = field(default_factory=set)
    in_tail: bool = False
    depth: int = 0
    stamped: set[int] | None = None
    shared: list[tuple[int, ...]] = field(default_factory=list)

    def compile(self, root: Node) -> CompiledGraph:
        scope = self.scope
        bodies = [self.step(root)]
        if self.trace:
            # Blocks share time stamps from here on: those of the last one of each group. The last
            # group of all has none: it ends when the tick does, which its caller knows.
            for later in (False, True):
                own = [i for i in range(len(self.blocks)) if (i in self.deferred_blocks) is later]
                self.shared += [tuple(own[i : i + GROUP]) for i in range(0, len(own), GROUP)]
            self.stamped = {group[-1] for group in self.shared[:-1]}
            bodies.append(self.step(root))
        warm_up, fresh = self.warm_up(root), self.reset(root)
        after = [f"{name} = 0" for name in scope.state if name.startswith(("due", "ending"))]
        late: Lines = []  # makes fresh what was put off, after it has run in the last tick
        for node in _ending(root):
            if ("anew", id(node)) in scope.counters:
                flag = scope.counter("anew", node)
                late += [f"if {flag}:", f"    {flag} = 0", *indent(self.reset(node.child))]
        reset = [*fresh, *after, *late]
        stamps = np.zeros(2 + len(self.blocks) if self.trace else 0, dtype=np.int64)
        begin, begin_deferred = Lines(), Lines()
        if self.trace:
            zeros = memoryview(np.zeros_like(stamps).data)
            scope.names |= {"now": time.perf_counter_ns, "T": memoryview(stamps.data), "Z": zeros}
            begin, begin_deferred = ["T[:] = Z", "T[0] = now()"], ["T[1] = now()"]
        ending = ["if ending:", *indent([*reset, "return True"])] if "ending" in scope.state else []
        made = {"warm_up": warm_up, "reset": reset}
        for way, (body, tail) in zip(("", "_groups"), bodies):
            made[f"step{way}"] = [*begin, "done = False", *body, "return done"]
            made[f"deferred{way}"] = [*begin_deferred, *tail, *ending, *late, "return False"]
            begin, begin_deferred = [], []
        if self.native is not None:
            made = self.native.rewrite(scope, made, stamps)
        scope.functions += made.items()
        source, (warm, renew, *ways) = scope.build(*made)
        if self.trace and not (bodies[1][1] or ending or late):
            ways[3] = bool  # nothing is put off: False, without a function of Python's
        return CompiledGraph(
            *(ways[0], ways[1], warm, renew, source, tuple(self.blocks)),
            *(frozenset(self.deferred_blocks), stamps, tuple(self.shared), ways),
            {owner: name for (kind, owner), name in scope.counters.items() if kind in PLACED},
            shared={} if self.native is None else self.native.cells,
        )

    def step(self, root: Node) -> tuple[Lines, Lines]:
        """Return the lines of a tick, and those of what is put off in it."""
        self.tail, self.depth = [], 0
        body = self.node(root, ["done = True"], conditional=False, idempotent=True)
        return body, self.tail

    def call(self, block: Block) -> str:
        if self.native is not None and (lines := self.native.call(block, self.scope)):
            return lines
        if not block.inline:
            return f"{self.scope.bind('b', block.tick, block.name)}()"
        text = self.scope.renamed(block.inline, block.inline_names)
        return text if block.endless else f"({text})"

    # -- one tick -----------------------------------------------------------------------------

    def node(self, node: Node, on_done: Lines, *, conditional: bool, idempotent: bool) -> Lines:
        """Return the lines that step a node and run `on_done` when it ends.

        `idempotent` says that `on_done` may run twice in one tick (it only sets a flag).
        """
        if isinstance(node, Block):
            return self.block(node, on_done)
        self.depth += 1
        if self.depth % OUTLINE_DEPTH:
            lines = self.composite(node, on_done, conditional=conditional, idempotent=idempotent)
        else:
            body = self.composite(node, ["end = True"], conditional=conditional, idempotent=True)
            call = self.scope.outline("part", ["end = False", *body, "return end"])
            lines = [f"if {call}:", *indent(on_done)] if on_done else [call]
        self.depth -= 1
        return lines

    def composite(
        self, node: Node, on_done: Lines, *, conditional: bool, idempotent: bool
    ) -> Lines:
        match node:
            case Zip():
                return self.zip(node, on_done, conditional, idempotent)
            case Chain():
                return self.chain(node, on_done, conditional, idempotent)
            case Loop():
                return self.loop(node, on_done, conditional)
            case Switch():
                return self.switch(node, on_done)
            case Every():
                wait = self.scope.counter("every", node)
                after = [f"{wait} = 0", *on_done]
                child = self.node(node.child, after, conditional=True, idempotent=False)
                fresh = [f"    {wait} -= 1", "else:", f"    {wait} = {node.n - 1}"]
                return [f"if {wait}:", *fresh, *indent(child)]
            case When():
                after = [*self.reset(node.predicate), *on_done]
                child = self.node(node.child, after, conditional=True, idempotent=False)
                return [f"if {self.call(node.predicate)}:", *indent(child)]
        assert isinstance(node, Deferred)
        return self.defer(node, conditional)

    def block(self, block: Block, on_done: Lines) -> Lines:
        key = id(block), self.in_tail
        if key not in self.columns:
            self.columns[key] = len(self.blocks)
            if self.in_tail:
                self.deferred_blocks.add(len(self.blocks))
            self.blocks.append(block)
        column, stamp = self.columns[key], Lines()
        if self.trace and (self.stamped is None or column in self.stamped):
            stamp = [f"T[{2 + column}] = now()"]
        if block.endless:
            return [*self.call(block).splitlines(), *stamp]
        after = [*self.reset(block), *on_done]
        call = self.call(block)
        if not after:
            return [call, *stamp]
        if not stamp:
            return [f"if {call}:", *indent(after)]
        result = self.scope.temporary("r")
        return [f"{result} = {call}", *stamp, f"if {result}:", *indent(after)]

    def zip(self, node: Zip, on_done: Lines, conditional: bool, idempotent: bool) -> Lines:
        resets = [self.reset(child) for child in node.children]
        if not any(resets) and (idempotent or not on_done):
            return [
                line
                for child in node.children
                for line in self.node(child, on_done, conditional=conditional, idempotent=True)
            ]
        mask = self.scope.temporary("m")
        lines = [f"{mask} = 0"]
        for i, child in enumerate(node.children):
            mark = [f"{mask} |= {1 << i}"]
            lines += self.node(child, mark, conditional=conditional, idempotent=True)
        lines.append(f"if {mask}:")
        for i, reset in enumerate(resets):
            if reset:
                lines += [f"    if not {mask} & {1 << i}:", *indent(reset, 2)]
        return [*lines, *indent(on_done)]

    def chain(self, node: Chain, on_done: Lines, conditional: bool, idempotent: bool) -> Lines:
        last = len(node.children) - 1
        if not last:
            child = node.children[0]
            return self.node(child, on_done, conditional=conditional, idempotent=idempotent)
        index = self.scope.counter("chain", node)
        lines: Lines = []
        for i, child in enumerate(node.children):
            after = [f"{index} = {i + 1}"] if i < last else [f"{index} = 0", *on_done]
            safe_twice = i < last or idempotent
            body = self.node(child, after, conditional=True, idempotent=safe_twice)
            branch = "else:" if i == last else f"{'elif' if i else 'if'} {index} == {i}:"
            lines += [branch, *indent(body)]
        return lines

    def loop(self, node: Loop, on_done: Lines, conditional: bool) -> Lines:
        if node.until is None:
            return self.node(node.child, on_done, conditional=conditional, idempotent=False)
        ended = self.scope.temporary("d")
        child = self.node(node.child, [f"{ended} = True"], conditional=conditional, idempotent=True)
        until, reset = self.call(node.until), self.reset(node.until)
        on_until = [*self.reset(node.child), *reset, *on_done]
        return [
            f"{ended} = False",
            *child,
            f"if {ended}:",
            *indent([*reset, *on_done] or ["pass"]),
            f"elif {until}:",
            *indent(on_until or ["pass"]),
        ]

    def switch(self, node: Switch, on_done: Lines) -> Lines:
        bind = self.scope.bind
        current = self.scope.counter("case", node, -1)
        blender = node.blender if node.blend else None
        blend = self.scope.counter("blend", node) if node.blend else ""
        index = bind("index", node.index)
        new, ended = self.scope.temporary("s"), self.scope.temporary("d")
        capture: Lines = []
        if blender:
            capture = [f"if {current} >= 0:", f"    {bind('capture', blender.capture)}()"]
            capture.append(f"    {blend} = {node.blend + 1}")
        chosen, leave = self.call(node.selector), Lines()
        for i, child in enumerate(node.children):
            if reset := self.reset(child):
                leave += [f"if {current} == {i}:", *indent(reset)]
        lines = [
            f"{new} = {index}({chosen})",
            f"if {new} != {current}:",
            *indent([*leave, *capture, f"{current} = {new}"]),
            f"{ended} = False",
        ]
        if blender:
            lines += [f"if {blend}:", f"    {bind('resume', blender.resume)}()"]
        for i, child in enumerate(node.children):
            body = self.node(child, [f"{ended} = True"], conditional=True, idempotent=True)
            lines += [f"{'elif' if i else 'if'} {new} == {i}:", *indent(body)]
        if blender:
            weight = f"({node.blend + 1} - {blend}) / {node.blend + 1}"
            mix = f"        {bind('mix', blender.mix)}({weight})"
            lines += [f"if {blend}:", f"    {blend} -= 1", f"    if {blend}:", mix]
        fresh = [f"{current} = -1", *([f"{blend} = 0"] if blend else [])]
        after = [*fresh, *self.reset(node.selector), *on_done]
        return [*lines, f"if {ended}:", *indent(after)]

    def defer(self, node: Deferred, conditional: bool) -> Lines:
        ends = []
        if node.ends:
            self.scope.state["ending"] = 0
            ends = ["ending = 1"]
        if self.in_tail:
            return self.node(node.child, ends, conditional=conditional, idempotent=True)
        depth, self.depth, self.in_tail = self.depth, 0, True
        body = self.node(node.child, ends, conditional=True, idempotent=True)
        self.depth, self.in_tail = depth, False
        if not conditional:
            self.tail += body
            return []
        flag = self.scope.variable("due")  # one for each place, even of a shared node
        self.tail += [f"if {flag}:", f"    {flag} = 0", *indent(body)]
        return [f"{flag} = 1"]

    # -- making fresh, warming up -------------------------------------------------------------

    def reset(self, node: Node) -> Lines:
        """Return the lines that make a node and all below it fresh."""
        if id(node) not in self.resets:
            counter = self.scope.counter
            if isinstance(node, Block):
                call = self.scope.bind("reset", node.reset, node.name) if node.reset else ""
                lines = [f"{call}()"] if call else []
            elif isinstance(node, Deferred) and node.ends:
                lines = [f"{counter('anew', node)} = 1"]
            else:
                lines = [line for child in children_of(node) for line in self.reset(child)]
            if isinstance(node, Chain) and len(node.children) > 1:
                lines.append(f"{counter('chain', node)} = 0")
            elif isinstance(node, Every):
                lines.append(f"{counter('every', node)} = 0")
            elif isinstance(node, Switch):
                lines.append(f"{counter('case', node, -1)} = -1")
                lines += [f"{counter('blend', node)} = 0"] if node.blend else []
            if len(lines) > OUTLINE_RESETS:
                lines = [self.scope.outline("fresh", lines)]
            self.resets[id(node)] = lines
        return self.resets[id(node)]

    def warm_up(self, node: Node, depth: int = 0) -> Lines:
        """Return the lines that call `warm_up` of the blocks that are up next; no predicates."""
        if isinstance(node, Deferred):
            return []
        if isinstance(node, Block):
            warm_up = node.warm_up
            return [f"{self.scope.bind('warm_up', warm_up, node.name)}()"] if warm_up else []
        if isinstance(node, Switch) or (isinstance(node, Chain) and len(node.children) > 1):
            kind, initial = ("chain", 0) if isinstance(node, Chain) else ("case", -1)
            index = self.scope.counter(kind, node, initial)
            lines = [
                line
                for i, child in enumerate(node.children)
                if (body := self.warm_up(child, depth + 1))
                for line in (f"if {index} == {i}:", *indent(body))
            ]
        else:
            lines = [line for child in children_of(node) for line in self.warm_up(child, depth + 1)]
            if isinstance(node, Every) and lines:
                lines = [f"if not {self.scope.counter('every', node)}:", *indent(lines)]
        outlined = lines and depth and depth % OUTLINE_DEPTH == 0
        return [self.scope.outline("warm_up", lines)] if outlined else lines


def _ending(root: Node) -> list[Deferred]:
    """Return the `Deferred(…, ends=True)` of a tree in order, each once."""
    own = [root] if isinstance(root, Deferred) and root.ends else []
    return list(dict.fromkeys([*own, *(n for c in children_of(root) for n in _ending(c))]))
