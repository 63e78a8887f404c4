"""The compiler against its slow reference: same calls, order, results and state bytes."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

from hypothesis import given, settings
from hypothesis import strategies as st
from interpreter import Interpreter
from random_graphs import World, block_kinds, trees

from unicon_core.flow import Block, Chain, CompiledGraph, Loop, Node, Zip, compile_graph, compiler

TICKS = 25


def run(world: World, graph: CompiledGraph | Interpreter, resets: frozenset[int]) -> list[Any]:
    """Run ticks with a warm-up before each; return everything that can be observed."""
    seen = []
    for tick in range(TICKS):
        graph.warm_up()
        seen.append(("done", graph.step()))
        if tick in resets and tick % 2:
            graph.reset()  # as after a fault: what was due is dropped
        else:
            world.log.append(("deferred",))
            seen.append(("done deferred", graph.deferred()))
            if tick in resets:
                graph.reset()
        seen.append(world.states.buffer.tobytes())
    return [*world.log, *seen]


@settings(max_examples=500)
@given(
    trees,
    block_kinds,
    st.booleans(),
    st.frozensets(st.integers(0, TICKS), max_size=2),
    st.sampled_from([(1, 0), (2, 1), (12, 6)]),
)
def test_compiled_graph_equals_interpreter(
    tree: Any, kinds: Any, trace: bool, resets: frozenset[int], outline: tuple[int, int]
) -> None:
    fast, slow = World(tree, kinds), World(tree, kinds)
    with patch.multiple(compiler, OUTLINE_DEPTH=outline[0], OUTLINE_RESETS=outline[1]):
        compiled = compile_graph(fast.root, trace=trace)
    assert run(fast, compiled, resets) == run(slow, Interpreter(slow.root), resets)


def test_two_hundred_levels_of_nesting_compile_and_run() -> None:
    calls = []
    resets = []
    node: Node = Block("leaf", lambda: calls.append(1), reset=lambda: resets.append(1))
    for level in range(200):
        if level % 4 == 0:
            node = Chain(node, lambda: True)
        elif level % 4 == 1:
            node = Zip(node, lambda: False)
        else:
            node = Loop(node, until=lambda: False)
    graph = compile_graph(node, trace=True)
    assert not graph.step()
    assert len(calls) == 1
    graph.warm_up()
    graph.reset()
    assert len(resets) == 1
