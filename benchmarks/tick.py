"""`unicon bench tick`: what one tick of the graph costs besides its blocks, ours and the usual way.

Dispatch: 10, 32 and 100 blocks that do nothing, in one zip and in zips of five, compiled and with
the time stamps of `unicon run`, beside closures as the paper of UniCon describes them: a zip is a
function that calls its children in turn and ends with the first that says that it is done (our own
code, by its section on control blocks). Native: 10, 32 and 100 copies of 20 floats in C++
(`unicon run --native`) beside closures of the same, and as many of which each second one stays in
Python, beside all of them in Python. Fused copies: sixteen neighbouring copies of 20 floats, fused
beside the same graph without fusion. All variants take turns in one run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from benchmarks.samples import Samples, Step
from unicon_core.flow import Block, CompiledGraph, LinearMap, Node, Zip, compile_graph, fuse
from unicon_core.native.tick import NativeTick
from unicon_core.runtime import TickStatistics
from unicon_core.runtime.statistics import EVERY, LEARN, Detail
from unicon_core.states import States, StateSpec
from unicon_ros.bench.report import Bench

BLOCKS = (10, 32, 100)
NEST = 5  # blocks of a zip in a zip
COPIES = 16
SIZE = 20  # floats of one copy: one state of a 20-joint robot
REPEATS = 8  # loops in one sample: a clock reading costs as much as two blocks
SAMPLES = 40  # samples of each case in each round


def run(rounds: int = 15) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("tick", rounds)
    cases: dict[str, Step] = {}
    for count in BLOCKS:
        empty = [_nothing(i) for i in range(count)]
        parts = [empty[i : i + NEST] for i in range(0, count, NEST)]
        cases |= {
            f"{count} blocks, flat: closures": loop(closure_zip(*empty)),
            f"{count} blocks, flat: as run": as_run(Zip(*empty)),
            f"{count} blocks, nested: closures": loop(
                closure_zip(*[closure_zip(*p) for p in parts])
            ),
            f"{count} blocks, nested: as run": as_run(Zip(*[Zip(*part) for part in parts])),
        }
        states, maps = _copies(count)
        native = NativeTick(states, print).compile
        blocks = [_copy(each) for each in maps]
        half = [Block(b.name, b.tick, endless=True) if i % 2 else b for i, b in enumerate(blocks)]
        cases |= {
            f"{count} copies: closures": loop(closure_zip(*[block.tick for block in blocks])),
            f"{count} copies: native": as_run(Zip(*blocks), compiles=native),
            f"{count} copies: Python": as_run(Zip(*blocks)),
            f"{count} copies: half native": as_run(Zip(*half), compiles=native),
        }
    states, maps = _copies(COPIES)
    separate = [_copy(each) for each in maps]
    cases |= {
        f"copies: compiled, {how}": loop(compile_graph(root).step)
        for how, root in (("separate", Zip(*separate)), ("fused", fuse(Zip(*separate), states)))
    }
    times = Samples()
    Samples().take(cases, 1, REPEATS)  # warms up
    for _ in range(bench.rounds):
        times.take(cases, SAMPLES, REPEATS)
    for name in cases:
        bench.case(f"{name}, one tick", times.of(name) / EVERY)
    dispatch = [f"{count} blocks, {how}" for count in BLOCKS for how in ("flat", "nested")]
    copies = [f"{count} copies" for count in BLOCKS]
    for name, kinds, one, other, bar in (
        ("dispatch", dispatch, "as run", "closures", 0.7),
        ("native_dispatch", copies, "native", "closures", 0.1),
        ("native_half", copies, "half native", "Python", 1.0),
        ("fused_copy", ["copies"], "compiled, fused", "compiled, separate", 0.15),
    ):
        worst = max(times.ratio(f"{kind}: {one}", f"{kind}: {other}") for kind in kinds)
        bench.ratio(name, worst, bar)
    return bench


DONE = [True]
"""Results that end a zip, as the paper lets its user say them."""


def closure_zip(*parts: Callable[[], Any]) -> Callable[[], Any]:
    """Return a zip as a closure: it calls its children in turn, and ends with one that is done."""

    def step() -> Any:
        result = False
        for part in parts:
            result = part()
            if result in DONE:
                break
        return result

    return step


def loop(step: Callable[[], Any]) -> Step:
    """Return a loop of `EVERY` ticks of a step, which ends with one that is done."""
    ticks = range(EVERY)

    def run() -> None:
        for _ in ticks:
            if step():
                break

    return run


def as_run(root: Node, *, compiles: Callable[..., CompiledGraph] = compile_graph) -> Step:
    """Return a loop of `EVERY` ticks of a tree with the time stamps that a run gives them.

    What keeps them, and what waits for the next tick, is not in it.

    Args:
        root: the tree of a tick.
        compiles: makes the graph.
    """
    graph = compiles(root, trace=True)
    names = [block.name for block in graph.blocks]
    statistics = TickStatistics(names, graph.deferred_blocks, LEARN, graph.groups)
    stamps = memoryview(graph.stamps.data)
    for _ in range(LEARN):
        graph.step()
        graph.deferred()
        statistics.add(0, time.perf_counter_ns(), stamps)
    switch = Detail(graph, statistics)
    switch()

    def run() -> None:
        left = EVERY
        while left:  # as the ticker's: up to the tick before which detail is switched
            ticks = min(left, switch.at - statistics.count)
            step, deferred = graph.step, graph.deferred
            for _ in range(ticks):
                if step() or deferred():
                    break
            left -= ticks
            statistics.count += ticks
            if statistics.count == switch.at:
                switch()

    return run


def _nothing(i: int) -> Step:
    def block() -> bool:
        return False

    block.__name__ = f"nothing{i}"
    return block


def _copy(linear: LinearMap) -> Block:
    """Return a copying block as a user writes it: one slice assignment."""
    source, target = linear.source, linear.target

    def copy() -> None:
        target[...] = source

    return Block("copy", copy, linear=linear, endless=True)


def _copies(count: int) -> tuple[States, list[LinearMap]]:
    names = [f"{side}{i}" for side in ("source", "target") for i in range(count)]
    states = States({name: StateSpec((SIZE,)) for name in names})
    return states, [LinearMap(states[f"source{i}"], states[f"target{i}"]) for i in range(count)]
