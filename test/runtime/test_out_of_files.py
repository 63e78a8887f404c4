"""A process without file descriptors damps, reports and ends with a fault's status."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from unicon_core.runtime.report import SPARE, SpareFiles

LEAK = """
import os
from unicon_core.flow import Tick

def leak(states) -> Tick:
    kept = []

    def tick():
        while {reached}:
            kept.append(os.open(os.devnull, os.O_RDONLY))

    return tick
"""


def _open() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_what_is_held_back_is_given_back_once() -> None:
    before = _open()
    spare = SpareFiles()
    assert _open() == before + SPARE
    spare.release()
    spare.release()
    assert _open() == before


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no /proc")
def test_it_is_a_fault_that_names_the_limit_and_everything_is_written(tmp_path: Path) -> None:
    (tmp_path / "leaking.py").write_text(LEAK.format(reached="states['tick'] >= 20"), "utf-8")
    command = (
        f"ulimit -n 128; exec {sys.executable} -m unicon_ros run go2_stand --set platform=fake "
        "--set 'commands=[leaking:leak]' --speed=max --duration=1 --report=report.json"
    )
    done = subprocess.run(
        ["sh", "-c", command],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 3, done.stderr
    assert "this process may have 128 files open" in done.stdout
    assert "ulimit -n 4096" in done.stdout
    assert "not foreseen" not in done.stderr
    assert (tmp_path / "report.json").exists()
