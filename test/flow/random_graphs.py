"""Random graphs as plain values, and the worlds that they are built in, for the twin tests.

A description is built as often as a test needs it, each time with states and a log of its own, so
that two executions share nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from unicon_core.flow import (
    Blender,
    Block,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
)
from unicon_core.states import States, StateSpec

NUM_BLOCKS = 5

blocks = st.tuples(st.just("block"), st.integers(0, NUM_BLOCKS - 1))
scripts = st.lists(st.booleans(), min_size=1, max_size=5).map(tuple)


def _composites(children: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    several = st.lists(children, min_size=1, max_size=4).map(tuple)
    maybe = st.none() | blocks | scripts.map(lambda script: ("predicate", script))
    surely = blocks | scripts.map(lambda script: ("predicate", script))
    return st.one_of(
        st.tuples(st.just("zip"), several),
        st.tuples(st.just("chain"), several),
        st.tuples(st.just("loop"), children, maybe),
        st.tuples(st.just("every"), st.integers(1, 4), children),
        st.tuples(st.just("when"), surely, children),
        st.tuples(
            st.just("switch"),
            st.lists(st.integers(0, 3), min_size=1, max_size=8).map(tuple),
            several,
            st.integers(0, 3),
            st.booleans(),
        ),
        st.tuples(st.just("deferred"), children, st.sampled_from([False, False, True])),
        st.tuples(st.just("shared"), st.integers(0, 30)),
    )


trees = st.recursive(blocks, _composites, max_leaves=14)
block_kinds = st.lists(
    st.tuples(scripts, st.booleans(), st.booleans(), st.booleans()),
    min_size=NUM_BLOCKS,
    max_size=NUM_BLOCKS,
)
"""For each block: when it is done, whether it has a reset, a warm-up, an inline form."""


class World:
    """One building of a description: `root`, `states` and the `log` of every call."""

    def __init__(self, tree: Any, kinds: Any) -> None:
        self.log: list[tuple[Any, ...]] = []
        self.states = States(
            {
                "counts": StateSpec((NUM_BLOCKS,), "int64"),
                "command": StateSpec((3,), "float32"),
            }
        )
        self.known: list[Node] = []
        self.blocks = [self.block(i, *kind) for i, kind in enumerate(kinds)]
        self.root = self.build(tree)

    def block(
        self, i: int, script: tuple[bool, ...], resets: bool, warm_up: bool, inline: bool
    ) -> Block:
        counts, command, log = self.states["counts"], self.states["command"], self.log
        turn = 0

        def tick() -> bool:
            nonlocal turn
            log.append(("tick", i))
            turn += 1
            # order matters in both: a swapped pair of calls gives other bytes
            counts[i] = (counts[(i + 1) % NUM_BLOCKS] * 31 + turn + i) % 1_000_003
            command[:] = command * np.float32(0.7) + np.float32(i + 1)
            return script[turn % len(script)]

        def reset() -> None:
            nonlocal turn
            log.append(("reset", i))
            turn = 0

        return Block(
            f"block-{i}",
            tick,
            reset=reset if resets else None,
            warm_up=(lambda: log.append(("warm_up", i))) if warm_up else None,
            endless=not any(script),
            inline="run() is True" if inline else "",
            inline_names={"run": tick} if inline else {},
        )

    def predicate(self, description: Any) -> Block | None:
        if description is None:
            return None
        if description[0] == "block":
            return self.blocks[description[1]]
        script, log, turn = description[1], self.log, 0

        def tick() -> bool:
            nonlocal turn
            log.append(("predicate", turn))
            turn += 1
            return script[turn % len(script)]

        return Block("predicate", tick)

    def selector(self, script: tuple[int, ...], cases: int, named: bool) -> Block:
        log, turn = self.log, 0

        def tick() -> str | int:
            nonlocal turn
            log.append(("select", turn))
            turn += 1
            number = script[turn % len(script)] % cases
            return f"case{number}" if named else number

        def reset() -> None:
            nonlocal turn
            log.append(("reset selector", turn))
            turn = 0

        return Block("selector", tick, reset=reset)

    def build(self, tree: Any) -> Node:
        node = self.node(tree)
        self.known.append(node)
        return node

    def node(self, tree: Any) -> Node:
        kind = tree[0]
        if kind == "block":
            return self.blocks[tree[1]]
        if kind == "shared":
            return self.known[tree[1] % len(self.known)] if self.known else self.blocks[0]
        if kind == "zip":
            return Zip(*[self.build(child) for child in tree[1]])
        if kind == "chain":
            return Chain(*[self.build(child) for child in tree[1]])
        if kind == "loop":
            return Loop(self.build(tree[1]), self.predicate(tree[2]))
        if kind == "every":
            return Every(tree[1], self.build(tree[2]))
        if kind == "when":
            predicate = self.predicate(tree[1])
            assert predicate is not None
            return When(predicate, self.build(tree[2]))
        if kind == "deferred":
            return Deferred(self.build(tree[1]), ends=tree[2])
        _, script, children, blend, named = tree
        cases = {f"case{i}": self.build(child) for i, child in enumerate(children)}
        blender = Blender({"command": self.states["command"]}) if blend else None
        selector = self.selector(script, len(children), named)
        return Switch(selector, cases, blend=blend, blender=blender)
