"""Nothing that a terminal, a pipe or a log does holds the ticks up."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import signal
import subprocess
import termios
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest
from runs import Run

from unicon_core.non_blocking_writer import NonBlockingWriter


def gaps(run: Run) -> float:
    """Return the longest time between two commands in [s]."""
    times = run.times("send")
    return max(b - a for a, b in pairwise(times)) * 1e-9


@pytest.mark.slow
def test_ctrl_s_on_the_terminal_does_not_stop_the_commands(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    run = Run(tmp_path, arguments=[], more="duration: 4.0\npacing: {hang: 10.0}")
    run.start(stdout=subprocess.DEVNULL, stderr=theirs)
    run.until_sent()
    termios.tcflow(theirs, termios.TCOOFF)  # what the terminal does at Ctrl-S
    before = run.sent()
    time.sleep(2.5)  # two status lines
    assert run.sent() - before > 60
    status, _, _ = run.wait()
    assert status == 0
    assert gaps(run) < 1.0
    os.close(ours)
    os.close(theirs)


@pytest.mark.slow
def test_a_pipe_that_nobody_reads_does_not_stop_the_commands(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writer, b"x" * 512)
    os.set_blocking(writer, True)
    # A warning at the start goes to it: the core that is asked for does not exist.
    more = "duration: 2.0\npacing: {hang: 10.0, cpu: 60000}"
    run = Run(tmp_path, more=more).start(stderr=writer)
    status, _, _ = run.wait()
    assert status == 0
    assert run.report["ticks"] == 100
    assert gaps(run) < 1.0
    os.close(reader)
    os.close(writer)


@pytest.mark.slow
def test_a_background_job_is_not_stopped_by_its_own_status_line(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    attributes = termios.tcgetattr(theirs)
    attributes[3] |= termios.TOSTOP  # `stty tostop`
    termios.tcsetattr(theirs, termios.TCSANOW, attributes)

    def in_the_background() -> None:
        os.setsid()
        fcntl.ioctl(theirs, termios.TIOCSCTTY, 0)
        if os.fork():  # the leader of the session keeps the foreground
            os.wait()
            os._exit(0)
        os.setpgid(0, 0)

    run = Run(tmp_path, arguments=[], more="duration: 2.5\npacing: {hang: 10.0}")
    run.start(stdout=subprocess.DEVNULL, stderr=theirs, preexec_fn=in_the_background)
    reader = threading.Thread(target=_drain, args=(ours,), daemon=True)
    reader.start()
    run.wait()
    assert run.report["ended"] == "duration"
    assert gaps(run) < 1.0


def _drain(ours: int) -> None:
    with contextlib.suppress(OSError):
        while os.read(ours, 1024):
            pass


def test_what_a_blocked_sink_does_not_take_is_dropped_and_counted() -> None:
    release = threading.Event()
    taken: list[str] = []

    def sink(line: str) -> None:
        release.wait(20.0)
        taken.append(line)

    outlet = NonBlockingWriter(sink, capacity=10)
    for i in range(100):
        outlet(f"{i}")
    assert not outlet.flush(0.05)
    assert 85 <= outlet.dropped <= 90
    release.set()
    assert outlet.flush(10.0)
    assert taken[:5] == ["0", "1", "2", "3", "4"]
    assert len(taken) == 100 - outlet.dropped
    outlet.close()


def test_a_sink_that_fails_is_counted_and_the_next_line_comes() -> None:
    taken: list[str] = []

    def sink(line: str) -> None:
        if line == "bad":
            raise OSError("gone")
        taken.append(line)

    outlet = NonBlockingWriter(sink)
    outlet("bad")
    outlet("good")
    outlet.close()
    assert (taken, outlet.dropped) == (["good"], 1)


@pytest.mark.parametrize("number", [signal.SIGINT])
def test_ctrl_c_ends_a_run_whose_terminal_is_stopped(tmp_path: Path, number: int) -> None:
    ours, theirs = pty.openpty()
    run = Run(tmp_path, arguments=[], more="pacing: {hang: 10.0}")
    run.start(stdout=theirs, stderr=theirs)
    run.until_sent()
    termios.tcflow(theirs, termios.TCOOFF)
    time.sleep(1.2)
    run.process.send_signal(number)
    run.until(lambda: run.closed, timeout=3.0)
    # The report is on disk before anything is printed; then a signal ends what is left.
    run.until((tmp_path / "report.json").exists, timeout=5.0)
    time.sleep(0.5)
    run.process.send_signal(number)
    run.wait(timeout=5.0)
    assert run.report["ended"] == "SIGINT"
    os.close(ours)
    os.close(theirs)
