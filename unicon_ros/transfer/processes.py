"""Processes of a transfer: one for each run, so that an engine that crashes takes nothing else."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_core.resources import same_modules
from unicon_core.signals import SIGNALS, signal_name
from unicon_ros.bench.loops import die_with_parent
from unicon_ros.last_words import LOG_BYTES, last_words
from unicon_ros.transfer.plan import Plan

__all__ = ["Tell", "run_one"]

Tell = Callable[[float], None]
"""Takes the time in [s] that a run has simulated, 0 before its first tick; called often."""

LOOK = 0.1
"""Time in [s] between two looks at a process and at signals."""


def run_one(plan: Plan, platform: str, seed: int, folder: Path, tell: Tell) -> dict[str, Any]:
    """Run a platform with a seed to its end, whatever that is.

    Args:
        plan: of the transfer.
        platform: name.
        seed: of the scene.
        folder: where its files go: `PLATFORM/seed_K.npz`, `.json` and `.log`.
        tell: called as it goes on.

    Returns:
        What the rollout told; `outcome` is `ran`, `missing` (not installed), `refused`, `crashed`,
        `timeout` or `interrupted`, and `text` says why.

    Raises:
        UniconError: its files cannot be written.
    """
    files = folder / re.sub(r"[^\w.-]", "_", platform) / f"seed_{seed}"
    task = plan.task(platform, seed) | {"files": str(files.absolute())}
    try:
        files.parent.mkdir(parents=True, exist_ok=True)
        for suffix in (".json", ".npz"):
            files.with_suffix(suffix).unlink(missing_ok=True)
        with files.with_suffix(".log").open("wb") as log:
            outcome, text = _watched(task, log.fileno(), plan.timeout, tell)
    except OSError as error:
        raise UniconError(
            f"cannot write {error.filename or files}: {error.strerror}; give a writable folder "
            "with room to --out"
        ) from error
    said = files.with_suffix(".log")
    told: dict[str, Any] = {"seed": seed, "outcome": outcome, "text": text}
    if outcome == "ran":
        try:
            told |= json.loads(files.with_suffix(".json").read_bytes())
        except (OSError, ValueError):
            told |= {"outcome": "crashed", "text": f"wrote no result: {last_words(said)}"}
    elif outcome == "crashed":
        told["text"] += f": {last_words(said)}"
    if told["outcome"] == "ran":
        told["file"] = str(files.with_suffix(".npz").relative_to(folder.parent))
        told["log"] = ""
    return told


def _watched(task: dict[str, Any], log: int, timeout: float, tell: Tell) -> tuple[str, str]:
    """Start a rollout and wait for its end; return what became of it, and why."""
    ours, theirs = os.pipe()
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "unicon_ros.transfer.rollout"],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            pass_fds=[theirs],
            env=same_modules(),
            start_new_session=True,  # Ctrl-C is ours
            preexec_fn=die_with_parent if sys.platform == "linux" else None,
        )
    except BaseException:
        os.close(ours)
        raise
    finally:
        os.close(theirs)
    try:
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin:
            process.stdin.write(json.dumps(task | {"pipe": theirs}).encode())
        return _wait(process, ours, log, time.monotonic() + timeout, tell, timeout)
    finally:
        with suppress(ProcessLookupError):  # also what it started, and what is stopped
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        os.close(ours)


def _wait(
    process: subprocess.Popen[bytes], pipe: int, log: int, end: float, tell: Tell, timeout: float
) -> tuple[str, str]:
    open_, seconds = True, 0.0
    while process.poll() is None:
        if SIGNALS.asked:
            return "interrupted", f"ended by {signal_name(SIGNALS.asked)}"
        if time.monotonic() > end:
            return "timeout", f"no end within {timeout:g} s; it was ended (--timeout S)"
        if os.fstat(log).st_size > LOG_BYTES:
            return "crashed", f"printed more than {LOG_BYTES // 1_000_000} MB"
        tell(seconds)
        if open_ and select.select([pipe], [], [], LOOK)[0]:
            words = os.read(pipe, 1 << 16).split()
            open_ = bool(words)
            seconds = float(words[-1]) if words else seconds
        elif not open_:
            time.sleep(LOOK)
    if process.returncode == 0:
        return "ran", ""
    if process.returncode < 0:
        return "crashed", f"ended by {signal_name(-process.returncode)}"
    return "crashed", f"exit status {process.returncode}"
