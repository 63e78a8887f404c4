"""Runs at real rate with and without a part: recording, viewer, safety blocks.

`unicon bench record`: what recording adds to a tick, in a run in real time with ROS on.

go2_teleop in MuJoCo ticks at 500 Hz, its policy at every tenth tick, and walks; runs with and
without `--record` take turns. Timed are the way from recv to the end of send, and the whole tick
with all that is put off. Both keep the ticks of a fault record, as every run does.

`unicon bench view`: what a viewer adds to a tick at 500 Hz, nobody looking and three looking.

go2_teleop in MuJoCo ticks at 500 Hz, its policy at every tenth tick, and walks; runs take turns:
without a viewer, with the live page and nobody at it, and with two clients that read what the page
sends and one that has stalled. Timed are the way from recv to the end of send, and the whole tick.

`unicon bench safety`: what a robot's safety blocks add to its tick, at real rate.

Two graphs of a robot with 29 joints and a policy tick in turns, 10 ms apart, each with warm-ups
before its deadline as a run has them: one with the set of safety blocks that a robot has, one
without any. What is timed is the way from recv to the end of send.
"""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from benchmarks.samples import Samples, random_policy, tick_times, timed, unsaid
from unicon_base import AnyDict
from unicon_base.located_yaml import read_yaml
from unicon_base.resources import same_modules
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions, WallClock, WarmUp, prepare_process
from unicon_core.workflow import load_workflow
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording.run_recording import Recording
from unicon_lab.view import PORT
from unicon_lab.view.view import View
from unicon_ros import compat
from unicon_ros.bench.report import Bench, stay_on_loopback

RATE = 500.0  # Hz
SECONDS = 10.0  # of each run
_WALK: AnyDict = {
    "rate": RATE,
    "commands": [{"velocity_command": {"constant": [0.3, 0.0, 0.0]}}],  # as a desk would
}
_FIRST = round(RATE)
"""Ticks of its first second, which are not counted: the posture's, and cold memory."""
RECORD_WITH, RECORD_WITHOUT = "recorded", "not recorded"


def run_record(rounds: int = 6, seconds: float = SECONDS) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
        seconds: of each run, in [s].

    Raises:
        MissingDependencyError: rclpy, rosbags or MuJoCo is not installed.
    """
    stay_on_loopback()
    compat.import_rclpy("unicon bench record")
    bench = Bench("record", rounds)
    times = Samples()
    written: AnyDict = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(bench.rounds):
            turns = [RECORD_WITHOUT, RECORD_WITH] if number % 2 else [RECORD_WITH, RECORD_WITHOUT]
            for name in turns:
                file = Path(folder) / f"{number}.mcap" if name == RECORD_WITH else None
                written |= _run_record(file, seconds, times, name)
                if file is not None:
                    file.unlink()
    times.add_to(bench)
    bench.facts = {
        "rate": f"{RATE:g} Hz, {seconds:g} s a run",
        "written": f"{written['bytes'] / seconds * 1e-6:.2f} MB/s, {written['messages']} messages",
        "dropped": written["dropped"],
    }
    return bench


def _run_record(file: Path | None, seconds: float, times: Samples, name: str) -> AnyDict:
    """Add the times of a run's ticks; return what was recorded."""
    from unicon_ros.bridge import RosSession

    session = RosSession(node_name="bench_record", warn=unsaid)
    try:
        recording = None if file is None else Recording(file, None, session, unsaid)
        record = FaultRecord(None, unsaid, recording)
        hooks = [session.hook, *([recording.hook] if recording else []), record.hook]
        program = load_workflow("go2_teleop", _WALK, hooks=hooks)
        runner = Runner(program, RunOptions(duration=seconds, warn=unsaid))
        session.attach(runner)
        record.attach(runner)
        _time(runner, times, name)
    finally:
        session.close()
    return {} if recording is None else recording.counts()


def _time(runner: Runner, times: Samples, name: str) -> None:
    """Run, and add the times of ticks to those of a case."""
    report = runner.run()
    if report.faults:
        raise RuntimeError(f"bench: {report.faults[0]}")
    for part, values in tick_times(runner.statistics, _FIRST).items():
        times.add(f"{part}, {name}", values)


def main() -> int:
    """Be a client of a viewer: read and answer what is sent, or stall; 0 once the input has ended.

        python -m benchmarks.runs ADDRESS reads|stalled

    It says `connected`, and how many messages it has read once its input ends.
    """
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    address, kind = sys.argv[1:]
    os.nice(19)  # a browser is on another machine, or comes after the tick
    split = urlsplit(address)
    raw = socket.create_connection((split.hostname, split.port))
    if kind == "stalled":
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with connect(
        f"ws://{split.netloc}",
        sock=raw,
        origin=f"http://{split.netloc}",
        subprotocols=[Subprotocol(f"viser-v{version('viser')}")],
        max_size=None,
        compression=None,
    ) as client:
        client.send(_camera())
        print("connected", flush=True)
        count = 0
        while not select.select([0], [], [], 0.0 if kind == "reads" else 0.2)[0]:
            if kind == "reads":
                try:
                    told = client.recv(timeout=0.2)
                except TimeoutError:
                    continue
                count += 1
                if isinstance(told, bytes):
                    for answer in _answers(told):
                        client.send(answer)
        print(count, flush=True)
    return 0


def _camera() -> bytes:
    """Return where the client's eye is: viser counts a page from that message on."""
    import msgspec

    eye = read_yaml(Path(__file__).with_name("viewer_camera.yaml")).value
    return msgspec.msgpack.encode(eye)


def _answers(told: bytes) -> list[bytes]:
    """Return what a page answers: it has handled what was sent so far (see `page/link.py`)."""
    import msgspec
    import zstandard

    size = int.from_bytes(told[8:16], "little")
    words = msgspec.msgpack.decode(zstandard.decompress(told[16 : 16 + size]))
    asked = (m for m in words["messages"] if m["type"] == "LocalStorageGetItemRequestMessage")
    answer = {"type": "LocalStorageGetItemResponseMessage", "value": "{}", "error": None}
    return [msgspec.msgpack.encode({**answer, "request_uuid": m["request_uuid"]}) for m in asked]


NONE, ALONE, LOOKED_AT = "no viewer", "viewer", "viewer, 3 clients"
CLIENTS = ("reads", "reads", "stalled")


def run_view(rounds: int = 5, seconds: float = SECONDS) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
        seconds: of each run, in [s].

    Raises:
        MissingDependencyError: viser or MuJoCo is not installed.
    """
    bench = Bench("view", rounds)
    times = Samples()
    received: list[int] = []
    for number in range(bench.rounds):
        turns = [NONE, ALONE, LOOKED_AT]
        for name in turns[number % 3 :] + turns[: number % 3]:
            received += _run(name, seconds, times)
    times.add_to(bench)
    bench.facts = {
        "rate": f"{RATE:g} Hz, {seconds:g} s a run",
        "messages a client got": f"{min(received):,} to {max(received):,}" if received else "none",
    }
    return bench


def _run(name: str, seconds: float, times: Samples) -> list[int]:
    """Add the times of a run's ticks; return how many messages each client has read."""
    options = {"sink": "page", "host": "127.0.0.1", "port": PORT, "token": "", "fps": 30.0}
    view = None if name == NONE else View(options, warn=unsaid)
    hooks = [view.hook] if view else []
    program = load_workflow("go2_teleop", _WALK | {"ros": False}, hooks=hooks)
    runner = Runner(program, RunOptions(duration=seconds, warn=unsaid))
    counts: list[int] = []
    try:
        if view is not None:
            view.attach(runner)
        address = "" if view is None or name != LOOKED_AT else view.address
        with _clients(address, counts):
            _time(runner, times, name)
        return counts  # which the clients' end completes
    finally:
        if view is not None:
            view.close()


@contextmanager
def _clients(address: str, counts: list[int]) -> Iterator[None]:
    """Let clients look while a run ticks, each a process of its own."""
    if not address:
        yield
        return
    command = [sys.executable, "-m", "benchmarks.runs", address]
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


TICKS = 150
"""Of each graph in a round."""
APART_NS = 10_000_000

WITH, WITHOUT = "tick with a robot's safety blocks", "tick without"


def run_safety(rounds: int = 10) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("safety", rounds)
    times = Samples()
    with tempfile.TemporaryDirectory() as folder:
        random_policy(Path(folder), load_robot("g1_29dof"))
        workflow, policy = Path(__file__).with_name("safety.yaml"), {"policies": {"walk": folder}}
        programs = {
            WITH: load_workflow(workflow, policy),
            WITHOUT: load_workflow(workflow, policy | {"safety": "none"}),
        }
        runners = {name: Runner(each, RunOptions(warn=unsaid)) for name, each in programs.items()}
        restore = prepare_process(programs[WITH].pacing, unsaid)
        try:
            for _ in range(bench.rounds):
                for name, samples in _turn(runners).items():
                    times.add(name, samples)
        finally:
            restore()
            for runner in runners.values():
                runner.close()
    times.add_to(bench)
    added = float(np.median(np.subtract(times.of(WITH), times.of(WITHOUT))))  # 10 ms apart
    bench.facts = {
        "blocks": ", ".join(programs[WITH].safety),
        "they add to a tick, median": f"{added:.1f} µs",
    }
    return bench


def _turn(runners: dict[str, Runner]) -> AnyDict:
    """Return the times of one round of ticks in [µs]."""
    now = time.perf_counter_ns
    waits = {
        name: WarmUp(runner.graph.warm_up, WallClock(0), round(runner.pacing.dry_run_us * 1e3))
        for name, runner in runners.items()
    }
    times = {name: np.zeros(TICKS) for name in runners}
    due = now() + APART_NS
    for i in range(TICKS):
        for name, runner in runners.items():
            waits[name].until(due)
            times[name][i] = timed(runner.graph.step)
            runner.graph.deferred()
            due = max(due + APART_NS, now())
    return {name: values[10:] for name, values in times.items()}  # warm-ups learn their lead


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)
