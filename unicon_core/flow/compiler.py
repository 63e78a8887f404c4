"""Compiler: turns a tree of nodes into two flat Python functions, for the runner and for readers.

`step` is what the command depends on, in order, up to the end of the tree; `deferred` is what was
put off until after it. Both are straight-line code over local names (`unicon show --source`). The
meaning of each node is said in `nodes.py`; an interpreter of the tree is the reference in `test/`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from unicon_core.flow.block import Block
from unicon_core.flow.compiled import CompiledGraph, Lines, Scope, indent
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


def compile_graph(root: Node, *, trace: bool = False) -> CompiledGraph:
    """Compile a tree of nodes.

    Args:
        root: the tree; shared blocks may stand in several places.
        trace: write a time stamp after each block, see `CompiledGraph.watch`; 75 to 105 ns each, by
            `unicon bench tick`: `traced` less `as run`.
    """
    return _Compiler(trace).compile(root)


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
            self.groups()
            bodies.append(self.step(root))
        warm_up = self.warm_up(root)
        fresh = self.reset(root)
        after = [f"{name} = 0" for name in scope.state if name.startswith(("due", "ending"))]
        late = self.late_resets(root)
        reset = [*fresh, *after, *late]
        stamps = np.zeros(2 + len(self.blocks) if self.trace else 0, dtype=np.int64)
        begin: dict[str, Lines] = {}
        if self.trace:
            zeros = memoryview(np.zeros_like(stamps).data)
            scope.names |= {"now": time.perf_counter_ns, "T": memoryview(stamps.data), "Z": zeros}
            begin = {"step": ["T[:] = Z", "T[0] = now()"], "deferred": ["T[1] = now()"]}
        ending = ["if ending:", *indent([*reset, "return True"])] if "ending" in scope.state else []
        scope.functions += [("warm_up", warm_up), ("reset", reset)]
        names = ["warm_up", "reset"]
        for way, (body, tail) in zip(("", "_groups"), bodies):
            step = ["done = False", *body, "return done"]
            deferred = [*tail, *ending, *late, "return False"]
            for name, lines in (("step", step), ("deferred", deferred)):
                stamped = [] if way else begin.get(name, [])
                scope.functions.append((name + way, [*stamped, *lines]))
                names.append(name + way)
        source, functions = scope.build(*names)
        (warm, renew), ways = functions[:2], list(functions[2:])
        if self.trace and not (bodies[1][1] or ending or late):
            ways[3] = bool  # nothing is put off: False, without a function of Python's
        later, groups = frozenset(self.deferred_blocks), tuple(self.shared)
        blocks, places = tuple(self.blocks), scope.places("chain", "case")
        return CompiledGraph(
            *(ways[0], ways[1], warm, renew, source, blocks, later, stamps, groups, ways, places)
        )

    def step(self, root: Node) -> tuple[Lines, Lines]:
        """Return the lines of a tick, and those of what is put off in it."""
        self.tail, self.depth = [], 0
        body = self.node(root, ["done = True"], conditional=False, idempotent=True)
        return body, self.tail

    def groups(self) -> None:
        """Let blocks share time stamps from now on: those of the last one of each group.

        The last group of all has none: it ends when the tick does, which its caller knows.
        """
        for later in (False, True):
            own = [i for i in range(len(self.blocks)) if (i in self.deferred_blocks) is later]
            self.shared += [tuple(own[i : i + GROUP]) for i in range(0, len(own), GROUP)]
        self.stamped = {group[-1] for group in self.shared[:-1]}

    def call(self, block: Block) -> str:
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
        if isinstance(node, Zip):
            return self.zip(node, on_done, conditional, idempotent)
        if isinstance(node, Chain):
            return self.chain(node, on_done, conditional, idempotent)
        if isinstance(node, Loop):
            return self.loop(node, on_done, conditional)
        if isinstance(node, Every):
            return self.every(node, on_done)
        if isinstance(node, When):
            return self.when(node, on_done)
        if isinstance(node, Switch):
            return self.switch(node, on_done)
        assert isinstance(node, Deferred)
        return self.defer(node, conditional)

    def block(self, block: Block, on_done: Lines) -> Lines:
        column = self.column(block)
        stamp = []
        if self.trace and (self.stamped is None or column in self.stamped):
            stamp = [f"T[{2 + column}] = now()"]
        if block.endless:
            return [*self.call(block).splitlines(), *stamp]
        after = [*self.reset(block), *on_done]
        call = self.call(block)
        if not after:
            return [call, *stamp]
        asked = [f"r = {call}", *stamp, "if r:"] if stamp else [f"if {call}:"]
        return [*asked, *indent(after)]

    def column(self, block: Block) -> int:
        key = (id(block), self.in_tail)
        if key not in self.columns:
            self.columns[key] = len(self.blocks)
            if self.in_tail:
                self.deferred_blocks.add(len(self.blocks))
            self.blocks.append(block)
        return self.columns[key]

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

    def every(self, node: Every, on_done: Lines) -> Lines:
        wait = self.scope.counter("every", node)
        after = [f"{wait} = 0", *on_done]
        child = self.node(node.child, after, conditional=True, idempotent=False)
        return [
            f"if {wait}:",
            f"    {wait} -= 1",
            "else:",
            f"    {wait} = {node.n - 1}",
            *indent(child),
        ]

    def when(self, node: When, on_done: Lines) -> Lines:
        after = [*self.reset(node.predicate), *on_done]
        child = self.node(node.child, after, conditional=True, idempotent=False)
        return [f"if {self.call(node.predicate)}:", *indent(child)]

    def switch(self, node: Switch, on_done: Lines) -> Lines:
        current = self.scope.counter("case", node, -1)
        blender = node.blender if node.blend else None
        blend = self.scope.counter("blend", node) if node.blend else ""
        index = self.scope.bind("index", node.index)
        new, ended = self.scope.temporary("s"), self.scope.temporary("d")
        capture = []
        if blender:
            capture = [
                f"if {current} >= 0:",
                f"    {self.scope.bind('capture', blender.capture)}()",
                f"    {blend} = {node.blend + 1}",
            ]
        lines = [
            f"{new} = {index}({self.call(node.selector)})",
            f"if {new} != {current}:",
            *indent([*self.reset_case(node, current), *capture, f"{current} = {new}"]),
            f"{ended} = False",
        ]
        if blender:
            lines += [f"if {blend}:", f"    {self.scope.bind('resume', blender.resume)}()"]
        for i, child in enumerate(node.children):
            body = self.node(child, [f"{ended} = True"], conditional=True, idempotent=True)
            lines += [f"{'if' if i == 0 else 'elif'} {new} == {i}:", *indent(body)]
        if blender:
            weight = f"({node.blend + 1} - {blend}) / {node.blend + 1}"
            mix = self.scope.bind("mix", blender.mix)
            lines += [f"if {blend}:", f"    {blend} -= 1"]
            lines += [f"    if {blend}:", f"        {mix}({weight})"]
        fresh = [f"{current} = -1", *([f"{blend} = 0"] if blend else [])]
        after = [*fresh, *self.reset(node.selector), *on_done]
        return [*lines, f"if {ended}:", *indent(after)]

    def reset_case(self, node: Switch, current: str) -> Lines:
        lines: Lines = []
        for i, child in enumerate(node.children):
            reset = self.reset(child)
            if reset:
                lines += [f"if {current} == {i}:", *indent(reset)]
        return lines

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
            lines = self.reset_lines(node)
            if len(lines) > OUTLINE_RESETS:
                lines = [self.scope.outline("fresh", lines)]
            self.resets[id(node)] = lines
        return self.resets[id(node)]

    def reset_lines(self, node: Node) -> Lines:
        if isinstance(node, Block):
            return [f"{self.scope.bind('reset', node.reset, node.name)}()"] if node.reset else []
        if isinstance(node, Deferred) and node.ends:
            return [f"{self.scope.counter('anew', node)} = 1"]
        lines = [line for child in children_of(node) for line in self.reset(child)]
        if isinstance(node, Chain) and len(node.children) > 1:
            lines.append(f"{self.scope.counter('chain', node)} = 0")
        elif isinstance(node, Every):
            lines.append(f"{self.scope.counter('every', node)} = 0")
        elif isinstance(node, Switch):
            lines.append(f"{self.scope.counter('case', node, -1)} = -1")
            if node.blend:
                lines.append(f"{self.scope.counter('blend', node)} = 0")
        return lines

    def late_resets(self, root: Node) -> Lines:
        """Return the lines that make fresh what was put off, after it has run in the last tick."""
        lines = []
        for node in _ending(root):
            if self.scope.has_counter("anew", node):
                flag = self.scope.counter("anew", node)
                lines += [f"if {flag}:", f"    {flag} = 0", *indent(self.reset(node.child))]
        return lines

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
