"""`unicon bench latency`: our controllers beside plain ROS 2 pipelines, over real DDS.

Every variant is real processes on this host: a robot with states at 500 Hz and a controller with
identity control (q_d = q) at 50 Hz, as in the UniCon paper's table of latencies. The controller's
rate is off by so much that the phase between states and commands sweeps through all its values in
every turn: locked, it alone would decide the result. All variants live at once and take turns in
many short rounds: a machine's speed changes within seconds.

The paper's columns SDK (sync) and SDK (async) are the official unitree_sdk2_python beside platform
`unitree`, with H1's own messages, and what receiving and sending cost in a loop of 500 Hz with a
G1's 29 joints. The peer is our emulator endpoint. The SDK wants another CycloneDDS than we do, and
runs in an interpreter of its own: UNICON_UNITREE_SDK names a checkout of it, UNICON_UNITREE_PYTHON
a Python with cyclonedds 0.10.2 and NumPy.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from unicon_base import UniconError
from unicon_core.signals import SIGNALS
from unicon_ros import compat
from unicon_ros.bench.loops import LEASE, SETTLE, Loop
from unicon_ros.bench.pipelines.budget import measure_budget
from unicon_ros.bench.report import Bench, free_domain, loopback_environment
from unicon_ros.bench.rounds import (
    TABLES,
    Claim,
    Rows,
    add_pooled_ratios,
    add_ratios,
    add_rows,
    beside_paper,
    c_level_floor,
    rounds_of,
    take_turns,
)

PIPELINES = "unicon_ros.bench.pipelines"
SDK_CONTROLLER = Path(__file__).parent / "pipelines" / "unitree_sdk.py"
SWEEPS = 2  # of all phases in one turn: 0.9 % of the rate
ROUNDS = 20
SECONDS = 0.4
PATIENCE = 30.0  # s to import the SDK


@dataclass(frozen=True)
class Variant:
    """One way to close the loop.

    Attributes:
        name: row of the table.
        measuring: PIPELINE/VARIANT that notes what arrives: the robot, or an observer.
        controller: PIPELINE/VARIANT, or None where one process is both.
        best_effort: QoS of all topics.
        shared_memory: our controller takes Fast DDS's shared memory, as the plain ones do.
        rate: of commands in [Hz]; None for that of the bench, which sweeps all phases.
        rows: rows of the table; () for all.
    """

    name: str
    measuring: str
    controller: str | None = None
    best_effort: bool = False
    shared_memory: bool = False
    rate: float | None = None
    rows: Sequence[str] = ()


def _variants(part: str) -> tuple[Variant, ...]:
    return tuple(Variant(**row) for row in TABLES[part])


VARIANTS, STRONGEST, SDK_VARIANTS = map(_variants, ("variants", "strongest", "sdk"))
LONGER, MORE_ROUNDS = 1.5, 72
"""Of the strongest rows alone, in [s] and rounds: 5,400 commands each, in ten minutes."""


def run(
    rounds: int | None = None,
    *,
    rate: float = 50.0,
    state_rate: float = 500.0,
    joints: int = 20,
    seconds: float | None = None,
    strongest: bool = False,
    budget: bool = False,
) -> Bench:
    """Run the comparison; Ctrl-C ends it with the rounds that are whole.

    Args:
        rounds: interleaved rounds, 20 if None, with `strongest` 72.
        rate: commands per second.
        state_rate: states per second.
        joints: number of joints.
        seconds: measured time of one variant in one round in [s]; 0.4 if None, with `strongest`
            1.5.
        strongest: run the strongest plain controllers and ours alone, with more commands of each.
        budget: measure what the time of our tick goes to, and nothing else.

    Raises:
        MissingDependencyError: rclpy is not installed.
        UniconError: a slice is no time, or so long that the others would be taken for dead.
    """
    compat.import_rclpy("unicon bench latency")
    common = ["--state-rate", f"{state_rate}", "--joints", f"{joints}"]
    if budget:
        return measure_budget([*common, "--rate", f"{rate}"], seconds)
    variants = STRONGEST if strongest else VARIANTS
    if seconds is None:
        seconds = LONGER if strongest else SECONDS
    longest = LEASE / len(variants) - SETTLE
    if not 0.0 < seconds <= longest:
        raise UniconError(
            f"--seconds {seconds:g}: with {len(variants)} variants in turn give more than 0 and at "
            f"most {longest:.2g}; for more samples raise --rounds"
        )
    rounds = rounds or (MORE_ROUNDS if strongest else ROUNDS)
    # So that a turn sees commands at all phases between two states.
    swept = rate * state_rate / (state_rate + SWEEPS / seconds)
    official: list[dict[str, Rows]] = []
    with tempfile.TemporaryDirectory() as folder, SIGNALS.guard():  # Ctrl-C: between turns
        results = measure(variants, rounds, seconds, swept, common, Path(folder))
        lacking = "" if strongest else sdk_lacks()
        if not (lacking or strongest) and results and not SIGNALS.asked:
            official = measure(SDK_VARIANTS, rounds, seconds, swept, common, Path(folder))
    bench = Bench("latency", len(results))
    bench.facts |= {
        "rate_hz": swept,
        "state_rate_hz": state_rate,
        "joints": joints,
        "seconds": seconds,
        **TABLES["facts"],
    }
    if rmw := os.environ.get("RMW_IMPLEMENTATION"):
        bench.facts["rmw"] = rmw
    add(bench, variants, TABLES["ratios"], results)
    # Few commands tell nothing of a tail.
    claims = [each for each in TABLES["strongest_ratios"] if strongest or each[4] is None]
    add_pooled_ratios(bench, results, claims)
    if results and not strongest:
        beside_paper(bench, [variant.name for variant in variants])
    add(bench, SDK_VARIANTS, TABLES["sdk_ratios"], official)
    if lacking:
        bench.facts["left out: SDK (sync), SDK (async)"] = lacking
    if results and not (strongest or SIGNALS.asked):
        floor = c_level_floor(free_domain(), state_rate)
        if floor is not None:
            bench.facts["one hop of DDS in C (ddsperf, 512 B)"] = floor
    return bench


def measure(
    variants: Sequence[Variant],
    rounds: int,
    seconds: float,
    rate: float,
    common: list[str],
    folder: Path,
) -> list[dict[str, Rows]]:
    """Let variants take their turns; call it within `SIGNALS.guard()`.

    Args:
        variants: all of them live at once.
        rounds: how many turns each has.
        seconds: measured time of a turn.
        rate: of commands in [Hz], where a variant says none.
        common: further arguments of every process.
        folder: for logs.

    Returns:
        Of each whole round, variant to row to samples.

    Raises:
        UniconError: a loop does not start, or a process of it has ended.
    """
    makers = {
        each.name: partial(
            _loop,
            each,
            ["--rate", f"{each.rate or rate}", *common],
            folder / f"{number}.npz",
        )
        for number, each in enumerate(variants)
    }
    return rounds_of(*take_turns(makers, rounds, seconds))


def add(
    bench: Bench,
    variants: Sequence[Variant],
    ratios: Iterable[Claim],
    results: list[dict[str, Rows]],
) -> None:
    """Add rows and ratios to a bench; `results` as `measure` returns them."""
    for variant in variants:
        add_rows(bench, results, variant.name, variant.rows)
    add_ratios(bench, results, ratios)


def sdk_lacks() -> str:
    """Return why the SDK cannot run here, in one line; "" where it can."""
    if find_spec("cyclonedds") is None:
        return "cyclonedds is not installed: pip install 'unicon_ros[hw-unitree]'"
    checkout, python = (os.environ.get(f"UNICON_UNITREE_{name}", "") for name in ("SDK", "PYTHON"))
    if not (Path(checkout) / "unitree_sdk2py").is_dir():
        return f"UNICON_UNITREE_SDK is {checkout!r}; name a checkout of unitree_sdk2_python"
    try:
        said = subprocess.run(
            [python, "-c", "import numpy, unitree_sdk2py.core.channel"],
            env={**os.environ, "PYTHONPATH": checkout},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        if not said.returncode:
            return ""
        why = f"where the SDK fails ({(said.stderr.strip().splitlines() or ['no message'])[-1]})"
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        why = f"which does not run ({error})"
    needed = "a Python with cyclonedds 0.10.2 and NumPy"
    return f"UNICON_UNITREE_PYTHON is {python!r}, {why}; name {needed}"


def _loop(variant: Variant, given: list[str], log: Path) -> Loop:
    given = [*given, *["--best-effort"] * variant.best_effort]

    def command(pipeline: str) -> list[str]:
        module, _, kind = pipeline.partition("/")
        start = [sys.executable, "-m", f"{PIPELINES}.{module}"]
        if module == "unitree_sdk":
            path = f"PYTHONPATH={os.environ['UNICON_UNITREE_SDK']}"
            start = ["env", path, os.environ["UNICON_UNITREE_PYTHON"], str(SDK_CONTROLLER)]
        return [*start, "--variant", kind, *given]

    environment = loopback_environment()
    if variant.shared_memory:
        environment["FASTDDS_BUILTIN_TRANSPORTS"] = "DEFAULT"
    controller = None if variant.controller is None else command(variant.controller)
    return Loop(variant.name, command(variant.measuring), controller, environment, log)


def main() -> int:
    """Run it with the process's arguments, as `ros2 run unicon_ros latency_bench` does."""
    from unicon_ros.cli.main import main as unicon

    return unicon(["bench", "latency", *sys.argv[1:]])
