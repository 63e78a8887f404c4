"""`unicon bench record`: what recording adds to a tick, in a run in real time with ROS on.

go2_teleop in MuJoCo ticks at 500 Hz, its policy at every tenth tick, and walks; runs with and
without `--record` take turns. Timed are the way from recv to the end of send, and the whole tick
with all that is put off. Both keep the ticks of a fault record, as every run does.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.samples import TICK, WHOLE, Samples, tick_times, unsaid
from unicon_base.arrays import Float64
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_workflow
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording.run_recording import Recording
from unicon_ros import compat
from unicon_ros.bench.domains import stay_on_loopback
from unicon_ros.bench.report import Bench

RATE = 500.0  # Hz
RECORD_SECONDS = 10.0  # of each run
SETTLED = 1.0
"""Of its beginning in [s] that are not counted: the posture's, and cold memory."""
RECORD_WITH, RECORD_WITHOUT = "recorded", "not recorded"


def run_record(rounds: int | None = None, seconds: float = RECORD_SECONDS) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 6 unless told.
        seconds: of each run, in [s].

    Raises:
        MissingDependencyError: rclpy, rosbags or MuJoCo is not installed.
    """
    stay_on_loopback()
    compat.import_rclpy("unicon bench record")
    bench = Bench("record", rounds or 6)
    times = Samples()
    written: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(bench.rounds):
            turns = [RECORD_WITHOUT, RECORD_WITH] if number % 2 else [RECORD_WITH, RECORD_WITHOUT]
            for name in turns:
                file = Path(folder) / f"{number}.mcap" if name == RECORD_WITH else None
                samples, counts = _run_record(file, seconds)
                for part, values in samples.items():
                    times.add(f"{part}, {name}", values)
                written |= counts
                if file is not None:
                    file.unlink()
    times.add_to(bench)
    bench.facts = {
        "rate": f"{RATE:g} Hz, {seconds:g} s a run",
        "written": f"{written['bytes'] / seconds * 1e-6:.2f} MB/s, {written['messages']} messages",
        "dropped": written["dropped"],
    }
    ratio = {p: times.ratio(f"{p}, {RECORD_WITH}", f"{p}, {RECORD_WITHOUT}", percent=99) for p in (TICK, WHOLE)}
    bench.facts["whole tick, p99, recorded / not"] = f"{ratio[WHOLE]:.2f}"
    bench.ratio("record_p99", ratio[TICK], 1.2)
    return bench


def _run_record(file: Path | None, seconds: float) -> tuple[dict[str, Float64], dict[str, Any]]:
    """Return the times of a run's ticks in [µs], and what was recorded."""
    from unicon_ros.bridge import RosSession

    session = RosSession(node_name="bench_record", warn=unsaid)
    try:
        recording = None if file is None else Recording(file, None, session, unsaid)
        record = FaultRecord(None, unsaid, recording)
        hooks = [session.hook, walk, *([recording.hook] if recording else []), record.hook]
        program = load_workflow("go2_teleop", {"rate": RATE}, hooks=hooks)
        runner = Runner(program, RunOptions(duration=seconds, warn=unsaid))
        session.attach(runner)
        record.attach(runner)
        report = runner.run()
    finally:
        session.close()
    if report.faults:
        raise RuntimeError(f"bench record: {report.faults[0]}")
    counts = {} if recording is None else recording.counts()
    return tick_times(runner.statistics, round(SETTLED * RATE)), counts


def walk(program: Program) -> dict[Stage, list[Block]]:
    """Command a slow walk, as a desk would."""
    command = program.states["velocity_command"]

    def walk() -> None:
        command[:] = (0.3, 0.0, 0.0)

    return {Stage.INPUT: [Block("walk", walk, amends=("velocity_command",), endless=True)]}
