"""Ctrl-C ends every command, whatever it falls into: an import, a destructor, a wait."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent


# Into the interpreter's start, the imports and the build; more moments are slow.
MOMENTS = [
    *(0.15, 0.5, 1.5),
    *(pytest.param(after, marks=pytest.mark.slow) for after in (0.3, 0.8, 3.0)),
]


@pytest.mark.parametrize("after", MOMENTS)
@pytest.mark.parametrize("words", [["bench", "latency", "--rounds", "1000"], ["run", "go2_walk"]])
def test_ctrl_c_at_any_moment_ends_the_command(words: list[str], after: float) -> None:
    command = [sys.executable, "-m", "unicon_ros", *words]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, env=dict(os.environ)
    )
    try:
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=25.0)
    finally:
        process.kill()
    assert b"Exception ignored" not in errors
    # Ended by default before anything was open, asked while it was built, or an orderly end. The
    # interpreter's own start comes before us, and tells an interrupt as an exception.
    assert process.returncode in (-signal.SIGINT, 128 + signal.SIGINT, 0, 1)
    assert process.returncode != 1 or b"KeyboardInterrupt" in errors
    assert b"\x1b" not in errors  # no cursor codes where nobody has a cursor
