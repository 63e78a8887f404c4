"""Loops of the latency comparison: held, let go, and ended with their logs, of any kind."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

from unicon_base.errors import UniconError
from unicon_ros.bench import loops
from unicon_ros.bench.loops import Loop

# Notes the time until it is asked to end; then it takes signals as they come, as a run does that
# has put the handlers back, and needs a while for its log.
NOTES = """
import signal, sys, time
from pathlib import Path
import numpy as np
path, times = Path(sys.argv[sys.argv.index("--out") + 1]), []
ended = []
signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
while not ended:
    times.append(time.time_ns())
    path.with_suffix(".ready").touch()
    time.sleep(0.002)
signal.signal(signal.SIGTERM, signal.SIG_DFL)
time.sleep(0.3)
columns = dict.fromkeys(("stamp", "seen", "begin", "end", "received"), np.array(times))
np.savez(path, **columns)
"""

# Is ready late, and grows a file for as long as it runs.
PULSE = """
import sys, time
from pathlib import Path
log = Path(sys.argv[-1])
pulse = log.with_name("pulse").open("ab", buffering=0)
for i in range(100_000):
    pulse.write(b".")
    time.sleep(0.01)
    if i == 50:
        log.with_suffix(".ready").touch()
"""


def test_a_loop_costs_nothing_while_it_is_held_and_ends_with_both_logs(tmp_path: Path) -> None:
    command = [sys.executable, "-c", NOTES]
    loop = Loop("two", command, command, dict(os.environ), tmp_path / "two.npz")
    loop.start()
    for _ in range(2):
        loop.run(0.2)
        time.sleep(0.5)
    loop.end()
    loop.close()
    assert loop.log.exists()
    assert loop.controller_log.exists()
    first, second = loop.slices
    assert second.begin - first.end > 500_000_000
    for rows in loop.samples():
        assert 0 < rows["end_to_end"].size <= 110  # about 100 on a machine that is not busy
        assert rows["lost"].size == rows["cpu"].size == 1


def test_a_loop_whose_process_ends_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loops, "PATIENCE", 1.0)
    command = [sys.executable, "-c", "pass"]
    loop = Loop("short", command, None, dict(os.environ), tmp_path / "short.npz")
    with pytest.raises(UniconError, match=r"^short: no command arrived"):
        loop.start()


def test_who_waits_for_a_turn_is_held_and_breathes_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loops, "BREATHS", 0.1)
    breaths: list[float] = []
    pulse = tmp_path / "pulse"
    command = [sys.executable, "-c", PULSE]
    loop = Loop("one", command, None, dict(os.environ), tmp_path / "log.npz")
    try:
        loop.start(meanwhile=lambda: breaths.append(time.monotonic()))
        assert len(breaths) >= 3
        time.sleep(0.05)
        before = pulse.stat().st_size
        time.sleep(0.2)
        assert pulse.stat().st_size == before  # held
        loops.breathe([loop])
        time.sleep(0.05)
        after = pulse.stat().st_size
        assert after > before
        time.sleep(0.2)
        assert pulse.stat().st_size == after
    finally:
        loop.end()
        loop.close()
