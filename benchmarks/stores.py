"""`unicon bench stores`: how a group of states gets to another process, ours beside rclpy.

One way: a group of 512 bytes at 500 Hz, from one process to another, on each way in turn: what the
writer stamps before it sends, the reader subtracts when the value is in its states. All pairs
live at once and take turns of half a second, so that the machine's noise meets all alike; ratios
are those of the medians of each round, and of them the median. rclpy carries the same bytes as a
reused UInt8MultiArray, keep-last-1, Fast DDS with its defaults, into an executor with a callback.

Each way has two ends. A sender publishes the states as they are; a receiver waits and puts what has
come into its states. They meet at a place: a path that nobody else uses.

The cores are kept awake by a process each of the kernel's idle class, which gives way to everything
else: on a virtual machine the wake of a core that was halted takes 50 to 100 µs, several times what
a way takes, and would be measured on each way in the way's place.

Publish: `ShmWriter.publish` of a group of 1 kB, which nobody sleeps for, beside one NumPy copy of
the same bytes, in turns within this process.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.samples import Samples
from unicon_base import StateError
from unicon_base.arrays import Int64
from unicon_base.resources import same_modules
from unicon_core.signals import SIGNALS
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter, remove_dead
from unicon_core.states.backends.zmq import ZmqReader, ZmqWriter
from unicon_ros.bench.loops import Loop, Slice
from unicon_ros.bench.pipelines.log import Log, Stop, arguments
from unicon_ros.bench.report import Bench, loopback_environment
from unicon_ros.bench.rounds import Rows, take_turns

GROUP = "bench"
PATIENCE = 20.0  # s until the other end must be there


def group() -> States:
    """Return the states that are carried: 512 bytes, all of which tell the value's number."""
    specs = {"data": StateSpec((112,)), "number": StateSpec((), "int64")}
    return States(specs | {"stamp_ns": StateSpec((), "int64")})


def segment_name(place: Path) -> str:
    """Return the name of the shared memory at a place."""
    return f"{place.parent.name}-{place.name}"


def _shm_sender(place: Path, states: States) -> ShmWriter:
    segment = Segment.create(segment_name(place), {GROUP: states.layout})
    return ShmWriter(segment, GROUP, states)


class _Waiting:
    """Waits for one of our readers, asleep."""

    def __init__(self, reader: Any) -> None:
        self._reader, self.close = reader, reader.close

    def receive(self, timeout: float) -> bool:
        """Wait for a value; return whether one has come."""
        return bool(self._reader.wait(timeout) and self._reader.take())


def _shm_receiver(place: Path, states: States) -> _Waiting:
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return _Waiting(ShmReader(segment_name(place), GROUP, states))
        except StateError:  # the writer is not there yet
            if time.monotonic() > end:
                raise
            time.sleep(0.01)


class _RosNode:
    def __init__(self, name: str, states: States) -> None:
        import rclpy
        from std_msgs.msg import UInt8MultiArray

        from unicon_ros.bench.pipelines.plain import qos

        self._rclpy, self._type, self._qos = rclpy, UInt8MultiArray, qos(False)
        rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self.node, self._data = rclpy.node.Node(name), states.buffer.data

    def close(self) -> None:
        """Let go."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()


class RosSender(_RosNode):
    """Publishes the bytes in a message."""

    def __init__(self, place: Path, states: States) -> None:
        super().__init__("writer", states)
        self._send = self.node.create_publisher(self._type, "group", self._qos).publish
        self._message = self._type()

    def publish(self) -> None:
        """Send the states as they are."""
        self._message.data = array("B", self._data)
        self._send(self._message)


class RosReceiver(_RosNode):
    """Receives in the callback of a single-threaded executor."""

    def __init__(self, place: Path, states: States) -> None:
        super().__init__("reader", states)
        self._come = False
        self.node.create_subscription(self._type, "group", self._heard, self._qos)
        self._executor = self._rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def _heard(self, message: Any) -> None:
        self._data[:] = message.data
        self._come = True

    def receive(self, timeout: float) -> bool:
        """Wait for a value; return whether one has come."""
        self._come = False
        self._executor.spin_once(timeout_sec=timeout)
        return self._come


WAYS: Mapping[str, tuple[Callable[..., Any], Callable[..., Any], str]] = {
    "shm, sleeping": (_shm_sender, _shm_receiver, "sys"),
    "zmq ipc": (
        lambda place, states: ZmqWriter(f"ipc://{place}", GROUP, states.layout, states),
        lambda place, states: _Waiting(ZmqReader(f"ipc://{place}", GROUP, states.layout, states)),
        "zmq",
    ),
    "rclpy": (RosSender, RosReceiver, "rclpy"),
}
"""Name of each way to its ends, made of a place and the states, and the module that it needs."""

RATE = 500.0  # Hz
SECONDS = 0.5
SAMPLES, REPEATS = 50, 200  # of publish in a round; a clock reading costs a tenth of one

PUBLISH, COPY = "publish 1 kB: shm", "publish 1 kB: a plain copy"

INSTALL = {
    "zmq": "pip install 'unicon_ros[zmq]'",
    "rclpy": "pip install 'unicon_ros[ros]', or source /opt/ros/<distro>/setup.bash",
}

TIMES = ("one way", "send", "reader's CPU [% of a core]")


def run(rounds: int = 20) -> Bench:
    """Run the comparison; Ctrl-C ends it with the rounds that are whole.

    Args:
        rounds: interleaved rounds.
    """
    skipped = {
        name: f"skipped: {INSTALL[module]}"
        for name, (_, _, module) in WAYS.items()
        if module in INSTALL and find_spec(module) is None
    }
    names = [name for name in WAYS if name not in skipped]
    samples = Samples()
    with tempfile.TemporaryDirectory(prefix="unicon-") as folder:
        places = {name: Path(folder) / f"{i}" for i, name in enumerate(names)}
        makers = {name: partial(_loop, name, place) for name, place in places.items()}
        try:
            with SIGNALS.guard(), _cores_awake():  # Ctrl-C is looked for between turns
                whole, loops = take_turns(makers, rounds, SECONDS)
            results = {name: _rows(loop)[:whole] for name, loop in loops.items()}
        finally:
            for place in places.values():  # of a writer that was killed
                remove_dead(segment_name(place))
        if whole and not SIGNALS.asked:
            _publish(f"{Path(folder).name}-publish", whole, samples)
    bench = Bench("stores", whole)
    bench.facts |= {"rate_hz": RATE, "group": "512 bytes", **skipped}
    for name, result in results.items():
        bench.facts[name] = _counts(result)
    for round_ in zip(*results.values()):
        if all(round_):  # what a ratio compares is of one round
            for name, rows in zip(results, round_):
                for row in TIMES:
                    samples.add(f"{name}: {row}", rows[row])
    samples.add_to(bench)
    return bench


@contextmanager
def _cores_awake() -> Iterator[None]:
    """Keep every core from halting, with processes that run when nothing else does."""
    code = (
        "import os\n"
        "os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\n"
        "parent = os.getppid()\n"
        "while os.getppid() == parent: sum(range(10_000))"
    )
    spinners = [
        subprocess.Popen([sys.executable, "-S", "-c", code]) for _ in range(os.cpu_count() or 1)
    ]
    try:
        yield
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()


def _loop(name: str, place: Path) -> Loop:
    def command(side: str) -> list[str]:
        module = "benchmarks.stores"
        variant = ["--variant", f"{name}: {side}", "--state-rate", f"{RATE}"]
        return [sys.executable, "-m", module, *variant]

    log = place.with_suffix(".npz")
    path = {"PYTHONPATH": same_modules()["PYTHONPATH"]}
    return Loop(name, command("reader"), command("writer"), loopback_environment() | path, log)


def _rows(loop: Loop) -> list[Rows]:
    """Return the rows of each slice: times in [µs], shares in [%] of a core, counts."""
    if not (loop.log.exists() and loop.controller_log.exists()):
        return [{} for _ in loop.slices]
    read, written = dict(np.load(loop.log)), dict(np.load(loop.controller_log))
    return [_slice_rows(each, read, written) for each in loop.slices]


def _slice_rows(each: Slice, read: dict[str, Int64], written: dict[str, Int64]) -> Rows:
    # Whole within the slice: what was under way at a hold has waited for the next turn.
    come = each.holds(read["stamp"]) & each.holds(read["received"])
    sent = each.holds(written["begin"]) & each.holds(written["end"])
    if not come.any() or not sent.any():
        return {}
    return {
        "one way": (read["received"] - read["stamp"])[come] * 1e-3,
        "send": (written["end"] - written["begin"])[sent] * 1e-3,
        "reader's CPU [% of a core]": np.array([100.0 * each.measuring_share]),
        "torn": read["torn"][come].astype(float),
        "not seen": np.diff(read["number"][come]) - 1.0,
    }


def _counts(result: list[Rows]) -> str:
    """Return how many values came, and what became of the others, in words."""
    parts = [rows for rows in result if rows]
    values = sum(rows["one way"].size for rows in parts)
    counts = [f"{sum(r[k].sum() for r in parts):.0f} {k}" for k in ("torn", "not seen")]
    return ", ".join([f"{values} values", *counts])


def _publish(name: str, rounds: int, samples: Samples) -> None:
    """Add the times of a publish and of a plain copy of the same bytes."""
    states = States({"data": StateSpec((240,)), "number": StateSpec((), "int64")})
    segment = Segment.create(name, {"bench": states.layout})
    writer = ShmWriter(segment, "bench", states)
    source, target = states.buffer, np.zeros_like(states.buffer)

    def copy() -> None:
        target[:] = source

    try:
        for _ in range(rounds):
            samples.take({PUBLISH: writer.publish, COPY: copy}, SAMPLES, REPEATS)
    finally:
        writer.close()


LONGEST = 0.1  # s of one wait, so that SIGTERM is heard
LARGEST = 1 << 24  # numbers that a float32 holds without loss


def main() -> None:
    """Write at `--state-rate`, or read, until SIGTERM."""
    options = arguments()
    stop = Stop()
    name, _, side = options.variant.rpartition(": ")
    (sender, receiver, _), states = WAYS[name], group()
    # The log's own name leads to the place, and that of the writer's log begins as the reader's.
    place = options.out.with_name(options.out.stem.partition("_")[0])
    if side == "writer":
        _write(sender(place, states), states, 1.0 / options.state_rate, options.out, stop)
    else:
        _read(receiver(place, states), states, options.out, stop)


def _write(sender: Any, states: States, period: float, out: Path, stop: Stop) -> None:
    log = Log(out, "begin", "end")
    data, number, stamp = states.data, states.number, states.stamp_ns
    now, publish = time.time_ns, sender.publish
    due = time.monotonic() + period
    while not stop:
        time.sleep(max(0.0, due - time.monotonic()))
        due = max(due + period, time.monotonic())  # after a hold there is nothing to catch up
        number += 1
        data[:] = int(number) % LARGEST
        begin = now()
        stamp[...] = begin
        publish()
        log.add(begin, now())
    log.save()
    sender.close()


def _read(receiver: Any, states: States, out: Path, stop: Stop) -> None:
    log = Log(out, "stamp", "received", "number", "torn")
    data, number, stamp = states.data, states.number, states.stamp_ns
    while not stop:
        if receiver.receive(LONGEST):
            received = time.time_ns()
            torn = bool(np.any(data != int(number) % LARGEST))
            log.add(int(stamp), received, int(number), torn)
    log.save()
    receiver.close()


if __name__ == "__main__":
    main()
