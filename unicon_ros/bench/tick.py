"""`unicon bench tick`: what one tick of the graph costs besides its blocks, ours and the usual way.

Dispatch: sixteen blocks that do nothing, compiled flat, beside the usual closures: each zip is a
function that calls its children in a loop, nested four by four as a workflow file nests them (one
flat zip of sixteen is measured too). Fused copies: sixteen neighbouring copies of 20 floats, fused
beside the same graph without fusion, and as closures. All variants take turns in one run.
"""

from __future__ import annotations

import numpy as np

from unicon_core.flow import Block, Node, Zip, compile_graph
from unicon_core.flow.fuse import fuse
from unicon_core.flow.linear import LinearMap
from unicon_core.states import States, StateSpec
from unicon_ros.bench.report import Bench
from unicon_ros.bench.samples import Samples, Step

__all__ = ["run"]

BLOCKS = 16
SIZE = 20  # floats of one copy: one state of a 20-joint robot
REPEATS = 500  # ticks in one sample: a clock reading costs as much as two blocks
SAMPLES = 40  # samples of each case in each round


def run(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 15 unless told.
    """
    rounds = rounds or 15
    bench = Bench("tick", seed=0, rounds=rounds)
    empty = [_nothing(i) for i in range(BLOCKS)]
    groups = [closure_zip(*empty[i : i + 4]) for i in range(0, BLOCKS, 4)]
    states, maps = _copies()
    separate = [_copy(each) for each in maps]
    fused = fuse(Zip(*separate), states)
    cases: dict[str, Step] = {
        "dispatch: nested closures": closure_zip(*groups),
        "dispatch: one flat closure": closure_zip(*empty),
        "dispatch: compiled": _flat(Zip(*[Zip(*empty[i : i + 4]) for i in range(0, BLOCKS, 4)])),
        "dispatch: compiled, traced": _flat(Zip(*empty), trace=True),
        "copies: closures": closure_zip(*[block.tick for block in separate]),
        "copies: compiled, separate": _flat(Zip(*separate)),
        "copies: compiled, fused": _flat(fused),
    }
    times = Samples()
    Samples().take(cases, 1, REPEATS)  # warms up
    for _ in range(rounds):
        times.take(cases, SAMPLES, REPEATS)
    for name in cases:
        bench.case(f"{name}, one tick", times.of(name))
    ratio = times.ratio
    bench.ratio("dispatch", ratio("dispatch: compiled", "dispatch: nested closures"), 0.6)
    bench.ratio("fused_copy", ratio("copies: compiled, fused", "copies: compiled, separate"), 0.15)
    flat = ratio("dispatch: compiled", "dispatch: one flat closure")
    bench.facts["compiled / one flat closure"] = f"{flat:.3f}"
    traced = ratio("dispatch: compiled, traced", "dispatch: compiled")
    per_block = np.median(times.of("dispatch: compiled")) / BLOCKS * 1e3
    bench.facts["compiled, per block"] = f"{per_block:.1f} ns, traced {per_block * traced:.1f} ns"
    return bench


def closure_zip(*parts: Step) -> Step:
    """Return the usual zip: a closure that calls its children in turn; done when one is."""

    def step() -> bool:
        done = False
        for part in parts:
            if part():
                done = True
        return done

    return step


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


def _copies() -> tuple[States, list[LinearMap]]:
    names = [f"{side}{i}" for side in ("source", "target") for i in range(BLOCKS)]
    states = States({name: StateSpec((SIZE,)) for name in names})
    return states, [LinearMap(states[f"source{i}"], states[f"target{i}"]) for i in range(BLOCKS)]


def _flat(root: Node, *, trace: bool = False) -> Step:
    return compile_graph(root, trace=trace).step
