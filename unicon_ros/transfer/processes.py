"""Processes of a transfer: a sweep's worker for each run, with that one row, since it is timed.

An engine that crashes takes nothing else with it, and nothing is tried again.
"""

from __future__ import annotations

import json
import re
import select
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_core.page import write_file
from unicon_core.signals import SIGNALS, signal_name
from unicon_ros.ending import LOG_BYTES
from unicon_ros.sweep.piped import PipedProcess
from unicon_ros.sweep.plan import Row
from unicon_ros.sweep.pool import LOOK
from unicon_ros.transfer.plan import Plan
from unicon_ros.transfer.rollout import KEPT

Tell = Callable[[float], None]
"""Takes the time in [s] that a run has simulated, 0 before its first tick; called often."""


def run_one(plan: Plan, row: Row, folder: Path, tell: Tell) -> dict[str, Any]:
    """Run a platform with a seed to its end, whatever that is.

    Args:
        plan: of the transfer.
        row: one of it.
        folder: where its files go: `PLATFORM/seed_K.npz`, `.json` and `.log`.
        tell: called as it goes on.

    Returns:
        What the run told; `outcome` is `ran`, `missing` (not installed), `refused`, `crashed`,
        `timeout` or `interrupted`, and `text` says why.

    Raises:
        UniconError: its files cannot be written.
    """
    platform, seed = row.values
    files = folder / re.sub(r"[^\w.-]", "_", platform) / row.name
    keep = {"folder": str(files.parent.absolute()), "states": KEPT}
    try:
        files.parent.mkdir(parents=True, exist_ok=True)
        files.with_suffix(".npz").unlink(missing_ok=True)
        process = PipedProcess("unicon_ros.transfer.rollout", files.with_suffix(".log"), {})
    except OSError as error:
        raise UniconError(
            f"cannot write {error.filename or files}: {error.strerror}; give a writable folder "
            "with room to --out"
        ) from error
    process.write(plan.task() | {"keep": keep})
    process.write({"index": row.index, "settings": row.settings, "name": row.name})
    told: dict[str, Any] = {}
    try:
        told = _watched(process, plan.timeout, tell)
    finally:
        how = process.end()
    if SIGNALS.asked and not told:
        told = {"outcome": "interrupted", "text": f"ended by {signal_name(SIGNALS.asked)}"}
    elif not told:
        told = {"outcome": "crashed", "text": how}
    told = {"seed": seed} | told
    if told["outcome"] == "ran":
        told["file"] = str(files.with_suffix(".npz").relative_to(folder.parent))
        told["log"] = ""
        with suppress(UniconError):  # a full disk: the caller's own file tells
            write_file(files.with_suffix(".json"), (json.dumps(told) + "\n").encode())
    return told


def _watched(process: PipedProcess, timeout: float, tell: Tell) -> dict[str, Any]:
    """Wait for what a process tells of its row; return {} of one that ended, or was not awaited."""
    seconds, end = 0.0, time.monotonic() + timeout
    while not SIGNALS.asked and not process.over:
        tell(seconds)
        if select.select([process.results], [], [], LOOK)[0]:
            for told in process.heard():
                if "error" in told:
                    return {"outcome": "refused", "text": told["error"]}
                if "run" in told:
                    return {"outcome": "ran", "text": "", **told["run"]}
                if "row" in told:
                    return {key: told["row"][key] for key in ("outcome", "text")}
                seconds = told["at"]
        if time.monotonic() > end:
            text = f"no end within {timeout:g} s; it was ended (--timeout S)"
            return {"outcome": "timeout", "text": text}
        if process.log.stat().st_size > LOG_BYTES:
            text = f"printed more than {LOG_BYTES // 1_000_000} MB"
            return {"outcome": "crashed", "text": text}
    return {}
