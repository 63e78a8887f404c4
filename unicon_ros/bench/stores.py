"""`unicon bench stores`: how a group of states gets to another process, ours beside other ways.

One way: a group of 512 bytes at 500 Hz, from one process to another, on each way in turn: what the
writer stamps before it sends, the reader subtracts when the value is in its states. All pairs
live at once and take turns of half a second, so that the machine's noise meets all alike; ratios
are those of the medians of each round, and of them the median. rclpy carries the same bytes as a
UInt8MultiArray, Fast DDS with its defaults: a node with a reused message and an executor ("rclpy"),
and the same with bytes that are serialized by hand ("raw").

Publish: `ShmWriter.publish` of a group of 1 kB, which nobody sleeps for, beside one NumPy copy of
the same bytes, in turns within this process.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unicon_core.signals import SIGNALS
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmWriter, remove_dead
from unicon_ros.bench.domains import loopback_environment
from unicon_ros.bench.loops import Loop, Slice
from unicon_ros.bench.pipelines.store_ways import WAYS, segment_name
from unicon_ros.bench.report import Bench
from unicon_ros.bench.turns import take_turns

__all__ = ["run"]

RATE = 500.0  # Hz
SECONDS = 0.5
ROUNDS = 20
SAMPLES, REPEATS = 50, 200  # of publish in a round; a clock reading costs a tenth of one

RATIOS = (
    # name, way, way of the baseline, bar
    ("shm_one_way", "shm, sleeping", "rclpy", 0.15),
    ("shm_wake", "shm, sleeping", "zmq ipc", 0.5),
    ("zmq_one_way", "zmq ipc", "rclpy", 0.4),
)
PUBLISH_BAR = 4.0

INSTALL = {
    "zmq": "pip install 'unicon_ros[zmq]'",
    "rclpy": "pip install 'unicon_ros[ros]', or source /opt/ros/<distro>/setup.bash",
    "iceoryx2": "pip install iceoryx2",
}

Samples = dict[str, NDArray[np.float64]]


def run(rounds: int | None = None, *, only: Callable[[str], bool] | None = None) -> Bench:
    """Run the comparison; Ctrl-C ends it with the rounds that are whole.

    Args:
        rounds: interleaved rounds, 20 unless told.
        only: which ways to run; all that are installed if None.
    """
    rounds = rounds or ROUNDS
    skipped = {
        name: f"skipped: {INSTALL[module]}"
        for name, way in WAYS.items()
        for module in way.needs
        if find_spec(module) is None
    }
    names = [name for name in WAYS if name not in skipped and (only is None or only(name))]
    with tempfile.TemporaryDirectory(prefix="unicon-") as folder:
        places = {name: Path(folder) / f"{i}" for i, name in enumerate(names)}
        makers = {name: partial(_loop, name, place) for name, place in places.items()}
        try:
            with SIGNALS.guard():  # Ctrl-C is looked for between turns
                whole, loops = take_turns(makers, rounds, SECONDS)
            results = {name: _samples(loop)[:whole] for name, loop in loops.items()}
        finally:
            for place in places.values():  # of a writer that was killed
                remove_dead(segment_name(place))
        publish = _publish(Path(folder).name, rounds) if not SIGNALS.asked else None
    bench = Bench("stores", seed=0, rounds=whole)
    bench.facts |= {"rate_hz": RATE, "group": "512 bytes", **skipped}
    for name, result in results.items():
        _tell(bench, name, result)
    for name, ours, theirs, bar in RATIOS:
        pairs = zip(results.get(ours, []), results.get(theirs, []))
        medians = [np.median(a["one way"]) / np.median(b["one way"]) for a, b in pairs if a and b]
        if medians:
            bench.ratio(name, float(np.median(medians)), bar)
    if publish is not None:
        times, copies = publish
        bench.case("publish 1 kB: shm", times)
        bench.case("publish 1 kB: a plain copy", copies)
        ratio = np.median(np.median(times, 1) / np.median(copies, 1))
        bench.ratio("publish", float(ratio), PUBLISH_BAR)
    return bench


def _loop(name: str, place: Path) -> Loop:
    def command(side: str) -> list[str]:
        module = "unicon_ros.bench.pipelines.stores"
        variant = ["--variant", f"{name}: {side}", "--state-rate", f"{RATE}"]
        return [sys.executable, "-m", module, *variant]

    log = place.with_suffix(".npz")
    return Loop(name, command("reader"), command("writer"), loopback_environment(), log)


def _samples(loop: Loop) -> list[Samples]:
    """Return the rows of each slice: times in [µs], shares in [%] of a core, counts."""
    read, written = dict(np.load(loop.log)), dict(np.load(loop.controller_log))
    return [_slice_samples(each, read, written) for each in loop.slices]


def _slice_samples(
    each: Slice, read: dict[str, NDArray[np.int64]], written: dict[str, NDArray[np.int64]]
) -> Samples:
    come, sent = each.holds(read["received"]), each.holds(written["end"])
    if not come.any() or not sent.any():
        return {}
    numbers, starved = read["number"][come], read["starved"][come]
    return {
        "one way": (read["received"] - read["stamp"])[come] * 1e-3,
        "send": (written["end"] - written["begin"])[sent] * 1e-3,
        "reader's CPU [% of a core]": np.array([100.0 * each.measuring_share]),
        "torn": np.array([float(read["torn"][come].sum())]),
        "starved": np.array([float(starved[-1] - starved[0])]),
        "not seen": np.array([float((np.diff(numbers) - 1).sum())]),
    }


def _tell(bench: Bench, name: str, result: list[Samples]) -> None:
    parts = [each for each in result if each]
    for row in ("one way", "send", "reader's CPU [% of a core]"):
        if parts:
            bench.case(f"{name}: {row}", np.concatenate([each[row] for each in parts]))
    counts = {row: sum(int(each[row][0]) for each in parts) for row in ("torn", "starved")}
    values = sum(each["one way"].size for each in parts)
    missed = sum(int(each["not seen"][0]) for each in parts)
    told = f"{values} values, {missed} not seen, {counts['torn']} torn, {counts['starved']} starved"
    bench.facts[name] = told if parts else "nothing has come"


def _publish(name: str, rounds: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the time of a publish and of a plain copy in [µs], shape (rounds, SAMPLES)."""
    states = States({"data": StateSpec((240,)), "number": StateSpec((), "int64")})
    segment = Segment.create(f"{name}-publish", {"bench": states.layout})
    writer = ShmWriter(segment, "bench", states)
    source, target = states.buffer, np.zeros_like(states.buffer)

    def copy() -> None:
        target[:] = source

    times = np.zeros((2, rounds, SAMPLES))
    try:
        for i in range(rounds):
            for j in range(SAMPLES):
                for k, step in enumerate((writer.publish, copy)):
                    begin = time.perf_counter_ns()
                    for _ in range(REPEATS):
                        step()
                    times[k, i, j] = (time.perf_counter_ns() - begin) * 1e-3 / REPEATS
    finally:
        writer.close()
    return times[0], times[1]
