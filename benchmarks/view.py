"""`unicon bench view`: what a viewer adds to a tick at 500 Hz, nobody looking and three looking.

go2_teleop in MuJoCo ticks at 500 Hz, its policy at every tenth tick, and walks; runs take turns:
without a viewer, with the live page and nobody at it, and with two clients that read what the page
sends and one that has stalled. Timed are the way from recv to the end of send, the whole tick, the
block that copies the tick, and those that hear what comes back.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from benchmarks.runs import RATE, SETTLED, walk
from benchmarks.samples import TICK, Samples, tick_times, unsaid
from unicon_base.arrays import Float64
from unicon_base.resources import same_modules
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_lab.view import PORT
from unicon_lab.view.view import View
from unicon_ros.bench.report import Bench

SECONDS = 10.0  # of each run
NONE, ALONE, LOOKED_AT = "no viewer", "viewer", "viewer, 3 clients"
COPY, EARS = "the copy", "what hears it"
OURS = {COPY: ("view",), EARS: ("viewer", "viewer e-stop", "viewer is heard")}
CLIENTS = ("reads", "reads", "stalled")


def run_view(rounds: int | None = None, seconds: float = SECONDS, sink: str = "page") -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 5 unless told.
        seconds: of each run, in [s].
        sink: word of `--view`.

    Raises:
        MissingDependencyError: the sink's package or MuJoCo is not installed.
    """
    bench = Bench("view", rounds or 5)
    times = Samples()
    received: list[int] = []
    for number in range(bench.rounds):
        turns = [NONE, ALONE, LOOKED_AT]
        for name in turns[number % 3 :] + turns[: number % 3]:
            samples, counts = _run(name, seconds, sink)
            received += counts
            for part, values in samples.items():
                times.add(f"{part}, {name}", values)
    times.add_to(bench)
    bench.facts = {
        "rate": f"{RATE:g} Hz, {seconds:g} s a run, sink {sink}",
        "messages a client got": f"{min(received):,} to {max(received):,}" if received else "none",
    }
    for percent, bar in ((50, 1.1), (99, 1.1)):
        found = times.ratio(f"{TICK}, {LOOKED_AT}", f"{TICK}, {NONE}", percent=percent)
        bench.ratio(f"view_p{percent}", found, bar)
    for percent, bar in ((50, 10.0), (99, 50.0)):
        spent = float(np.percentile(times.of(f"{COPY}, {LOOKED_AT}"), percent))
        bench.facts[f"{COPY}, p{percent}"] = f"{spent:.1f} µs, at most {bar:g} are meant"
    return bench


def _run(name: str, seconds: float, sink: str) -> tuple[dict[str, Float64], list[int]]:
    """Return the times of a run's ticks in [µs], and how many messages each client has read."""
    options = {"sink": sink, "host": "127.0.0.1", "port": PORT, "token": "", "fps": 30.0}
    view = None if name == NONE else View(options, warn=unsaid)
    hooks = [walk, *([view.hook] if view else [])]
    program = load_workflow("go2_teleop", {"rate": RATE, "ros": False}, hooks=hooks)
    runner = Runner(program, RunOptions(duration=seconds, warn=unsaid, detail=True))
    counts: list[int] = []
    try:
        if view is not None:
            view.attach(runner)
        address = "" if view is None or name != LOOKED_AT else view.address
        with _clients(address, sink, counts):
            report = runner.run()
    finally:
        if view is not None:
            view.close()
    if report.faults:
        raise RuntimeError(f"bench view: {report.faults[0]}")
    statistics, first = runner.statistics, round(SETTLED * RATE)
    found = tick_times(statistics, first)
    for part, blocks in OURS.items() if view is not None else ():
        found[part] = np.sum([statistics.spans_us(block)[first:] for block in blocks], axis=0)
    return found, counts


@contextmanager
def _clients(address: str, sink: str, counts: list[int]) -> Iterator[None]:
    """Let clients look while a run ticks, each a process of its own."""
    if not address:
        yield
        return
    command = [sys.executable, "-m", "benchmarks.view_client", sink, address]
    started = [
        subprocess.Popen(
            [*command, kind], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=same_modules()
        )
        for kind in CLIENTS
    ]
    try:
        for process in started:
            assert process.stdout is not None
            if process.stdout.readline() != b"connected\n":
                raise RuntimeError("bench view: a client could not connect; see above")
        yield
    finally:
        for process in started:
            told, _ = process.communicate()  # the end of its input asks it to end
            counts += [int(word) for word in told.split()]
