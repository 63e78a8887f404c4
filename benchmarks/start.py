"""`unicon bench start`: from the start of a process to the first tick, beside what it must import.

Each run is a process of its own: one that only imports MuJoCo and ONNX Runtime, and `unicon run
go2_walk`, without and with ROS, the built-in check included. All have their bytecode written
before, as what is installed has, wherever this one may write.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from benchmarks.samples import Samples
from unicon_base.errors import MissingDependencyError
from unicon_ros import compat
from unicon_ros.bench.domains import loopback_environment
from unicon_ros.bench.report import Bench

ROUNDS = 10
PATIENCE = 60.0  # s for a process

BASE = "import mujoco, onnxruntime"
RUN, ROS, LIST = "unicon run go2_walk", "unicon run go2_walk --ros", "unicon workflows"
BARS = (("start", RUN, 2.0), ("start_ros", ROS, 3.3))
"""Ratio, case and bar: 0.5 s and 0.85 s where the two imports take 0.255 s."""

_CODE = {
    BASE: BASE,
    LIST: "from unicon_ros.cli.main import main; main(['workflows'])",
}
_AGE = """
import time
done = time.monotonic()
from unicon_core.pacing import process_age_s
print(process_age_s() - (time.monotonic() - done))
"""


def run_start(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 10 unless told.

    Raises:
        MissingDependencyError: MuJoCo or ONNX Runtime is not installed.
        RuntimeError: a run fails.
    """
    bench, times = Bench("start", rounds or ROUNDS), Samples()
    cases = [BASE, RUN, LIST]
    with suppress(MissingDependencyError):
        compat.import_rclpy("unicon bench start")
        cases.insert(2, ROS)
    with tempfile.TemporaryDirectory() as folder:
        environment = _environment(Path(folder))
        for number in range(-1, bench.rounds):  # the first one writes bytecode and warms files up
            for case in cases:
                seconds = _seconds(case, Path(folder), environment)
                if number >= 0:
                    times.add(f"{case} [ms]", seconds * 1e3)
    times.add_to(bench, *((name, f"{case} [ms]", f"{BASE} [ms]", bar) for name, case, bar in BARS))
    bench.facts["measured"] = "age of the process at the first tick, or at its end, to 10 ms"
    return bench


def _environment(folder: Path) -> dict[str, str]:
    values = loopback_environment() | {"PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    for name in ("PYTHONDONTWRITEBYTECODE", "MUJOCO_GL"):
        values.pop(name, None)
    return values


def _seconds(case: str, folder: Path, environment: Mapping[str, str]) -> float:
    """Return how old the process was when it was ready, in [s].

    Raises:
        RuntimeError: it failed.
    """
    report = folder / "report.json"
    if case in _CODE:
        command = ["-c", _CODE[case] + _AGE]
    else:
        command = ["-m", "unicon_ros", *case.split()[1:], "--speed", "max", "--duration", "0.02"]
        command += ["--quiet", "--faults", "off", "--report", str(report)]
    done = subprocess.run(
        [sys.executable, *command],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    if done.returncode:
        line = (done.stderr.strip().splitlines() or ["it told nothing"])[-1]
        raise RuntimeError(f"bench start: {case!r} ended with {done.returncode}: {line}")
    if case in _CODE:
        return float(done.stdout.splitlines()[-1])
    return float(json.loads(report.read_text(encoding="utf-8"))["startup_s"])
