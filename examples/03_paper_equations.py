"""Equations 1 to 3 of the UniCon paper: zip, chain and loop over the simplest blocks.

A block T is a sequence of steps t_1 … t_n; calling it runs the next step and returns whether it
was the last, the paper's r.
"""

from __future__ import annotations

from collections.abc import Callable

from unicon_core import Chain, Loop, Zip
from unicon_core.flow import compile_graph


def steps(name: str, count: int, log: list[str]) -> Callable[[], bool]:
    """Return a block of `count` steps that notes each of them."""
    done = 0

    def step() -> bool:
        nonlocal done
        done = done % count + 1
        log.append(f"{name}{done}")
        return done == count

    return step


def ticks(root: object, log: list[str]) -> str:
    """Run a graph to its end; return what each tick did."""
    graph, told = compile_graph(root), []  # type: ignore[arg-type]
    done = False
    while not done:
        log.clear()
        done = graph.step()
        told.append("(" + ", ".join(log) + ")")
    return " ".join(told)


if __name__ == "__main__":
    log: list[str] = []
    g, h = steps("g", 3, log), steps("h", 3, log)
    print("zip(g, h)      =", ticks(Zip(g, h), log))  # eq. 1: both in each tick
    print("chain(g, h)    =", ticks(Chain(g, h), log))  # eq. 2: one behind the other
    until = steps("p", 2, [])
    print("loop(f, p)     =", ticks(Loop(steps("f", 9, log), until), log))  # eq. 3: until p
