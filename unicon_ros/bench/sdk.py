"""The official unitree_sdk2_python beside platform `unitree`, for `unicon bench latency`.

The paper's columns SDK (sync) and SDK (async), with H1's own messages, and what receiving and
sending cost in a loop of 500 Hz with a G1's 29 joints. The peer is our emulated robot's face. The
SDK wants another CycloneDDS than we do, and runs in an interpreter of its own:
UNICON_UNITREE_SDK names a checkout of it, UNICON_UNITREE_PYTHON a Python with cyclonedds 0.10.2
and NumPy.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from unicon_ros.bench.domains import loopback_environment
from unicon_ros.bench.loops import Loop
from unicon_ros.bench.report import Bench
from unicon_ros.bench.rounds import Claim, Rows, add_ratios, add_rows, rounds_of, take_turns

PIPELINES = "unicon_ros.bench.pipelines"
CONTROLLER = Path(__file__).parent / "pipelines" / "unitree_sdk.py"
PATIENCE = 30.0  # s to import the SDK


@dataclass(frozen=True)
class SdkVariant:
    """One way to close the loop over Unitree's DDS.

    Attributes:
        name: row of the table.
        robot: whose file and messages.
        way: of the SDK (`sync`, `async`), or the trigger of our tick (`state`, `deadline`).
        rate: of commands in [Hz]; None for that of the bench, which sweeps all phases.
        rows: what is told; () for all.
    """

    name: str
    robot: str
    way: str
    rate: float | None = None
    rows: tuple[str, ...] = ()


COST, END = "recv_and_send", "end_to_end"
SYNC, ASYNC = "SDK (sync)", "SDK (async)"
FREE, ON_STATE = "unicon, unitree, free tick", "unicon, unitree, on state"
SYNC_500, OURS_500 = "SDK (sync), G1 at 500 Hz", "unicon, unitree, G1 at 500 Hz"

VARIANTS = (
    SdkVariant(SYNC, "h1", "sync"),
    SdkVariant(ASYNC, "h1", "async"),
    SdkVariant(FREE, "h1", "deadline"),
    SdkVariant(ON_STATE, "h1", "state"),
    SdkVariant(SYNC_500, "g1_29dof", "sync", 500.0, (COST,)),
    SdkVariant(OURS_500, "g1_29dof", "deadline", 500.0, (COST,)),
)

RATIOS: tuple[Claim, ...] = (
    ("unitree_recv_and_send", COST, OURS_500, COST, SYNC_500, 0.2),
    ("unitree, recv and send at 50 Hz, of SDK (sync)", COST, FREE, COST, SYNC, None),
    ("unitree, end to end, of SDK (sync)", END, ON_STATE, END, SYNC, None),
    ("unitree, end to end, of SDK (async)", END, ON_STATE, END, ASYNC, None),
    ("unitree, free tick, end to end, of SDK (sync)", END, FREE, END, SYNC, None),
    ("unitree, free tick, end to end, of SDK (async)", END, FREE, END, ASYNC, None),
)


def unavailable() -> str:
    """Return why the SDK cannot run here, in one line; "" where it can."""
    if find_spec("cyclonedds") is None:
        return "cyclonedds is not installed: pip install 'unicon_ros[hw-unitree]'"
    checkout, python = (os.environ.get(f"UNICON_UNITREE_{name}", "") for name in ("SDK", "PYTHON"))
    if not (Path(checkout) / "unitree_sdk2py").is_dir():
        return f"UNICON_UNITREE_SDK is {checkout!r}; name a checkout of unitree_sdk2_python"
    needed = "a Python with cyclonedds 0.10.2 and NumPy"
    try:
        said = subprocess.run(
            [python, "-c", "import numpy, unitree_sdk2py.core.channel"],
            env={**os.environ, "PYTHONPATH": checkout},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        return f"UNICON_UNITREE_PYTHON is {python!r}, which does not run ({error}); name {needed}"
    if said.returncode:
        why = (said.stderr.strip().splitlines() or ["no message"])[-1]
        return f"UNICON_UNITREE_PYTHON is {python!r}, where the SDK fails ({why}); name {needed}"
    return ""


def measure(
    rounds: int, seconds: float, swept_rate: float, state_rate: float, folder: Path
) -> list[dict[str, Rows]]:
    """Let the variants take their turns; call it within `SIGNALS.guard()`.

    Args:
        rounds: how many turns each has.
        seconds: measured time of a turn.
        swept_rate: of commands in [Hz], where a variant says none.
        state_rate: of states in [Hz].
        folder: for logs.

    Returns:
        Of each whole round, variant to row to samples.

    Raises:
        UniconError: a loop does not start, or a process of it has ended.
    """
    makers = {
        variant.name: partial(_loop, variant, swept_rate, state_rate, folder / f"sdk_{i}.npz")
        for i, variant in enumerate(VARIANTS)
    }
    return rounds_of(*take_turns(makers, rounds, seconds))


def _loop(variant: SdkVariant, swept_rate: float, state_rate: float, log: Path) -> Loop:
    rate = swept_rate if variant.rate is None else variant.rate
    common = ["--rate", f"{rate}", "--state-rate", f"{state_rate}"]
    environment = loopback_environment()
    kind = "hg" if variant.robot.startswith("g1") else "go"
    if variant.way in ("sync", "async"):
        python = os.environ["UNICON_UNITREE_PYTHON"]
        path = f"PYTHONPATH={os.environ['UNICON_UNITREE_SDK']}"
        start = ["env", path, python, str(CONTROLLER), "--variant", f"{kind}:{variant.way}"]
    else:
        ours = f"{variant.robot}:{variant.way}"
        start = [sys.executable, "-m", f"{PIPELINES}.unitree", "--variant", ours]
    robot = [sys.executable, "-m", f"{PIPELINES}.unitree_robot", "--variant", variant.robot]
    return Loop(variant.name, [*robot, *common], [*start, *common], environment, log)


def add(bench: Bench, results: list[dict[str, Rows]]) -> None:
    """Add rows and ratios to a bench; `results` as `measure` returns them."""
    for variant in VARIANTS:
        add_rows(bench, results, variant.name, variant.rows)
    add_ratios(bench, results, RATIOS)
