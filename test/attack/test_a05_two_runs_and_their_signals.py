"""Runs in two threads share the handlers; a second signal hides no fault."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.signals import SIGNALS, Signals
from unicon_core.workflow import load_workflow

STAND = """\
robot: go2
platform: fake
rate: 50
pacing: {hang: 10}
flow: {hold: {}}
"""


def runner(folder: Path, duration: float) -> Runner:
    path = folder / "stand.yaml"
    path.write_text(STAND)
    return Runner(load_workflow(path), RunOptions(duration=duration))


def test_a_run_that_outlives_the_main_threads_ends_well(tmp_path: Path) -> None:
    ended: list[Report] = []
    other = runner(tmp_path, 0.6)
    thread = threading.Thread(target=lambda: ended.append(other.run()))
    before = signal.getsignal(signal.SIGTERM)
    with SIGNALS:
        thread.start()
        time.sleep(0.2)
    assert signal.getsignal(signal.SIGTERM) == before
    thread.join(20)
    assert ended
    assert ended[0].ended == "duration"


def test_a_run_elsewhere_keeps_nobody_from_handling_signals(tmp_path: Path) -> None:
    signals = Signals()
    entered, leave = threading.Event(), threading.Event()

    def host() -> None:
        with signals:
            entered.set()
            leave.wait(20)

    thread = threading.Thread(target=host)
    thread.start()
    assert entered.wait(20)
    with signals:
        handler = signal.getsignal(signal.SIGTERM)
    leave.set()
    thread.join(20)
    assert handler == signals._handle


class Slow(Exception):
    """Takes its time to be told, as a long traceback does."""

    told = False

    def __str__(self) -> str:
        if not self.told:
            self.told = True
            for _ in range(2):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.3)
        return "the cable is out"


def test_a_second_signal_while_a_fault_is_told_hides_it_not(tmp_path: Path) -> None:
    run = runner(tmp_path, 5.0)

    def fail() -> None:
        raise Slow

    run.call_soon(fail)
    report = run.run()
    assert report.ended == "fault"
    assert report.faults[0].startswith("Slow: the cable is out")
    assert run.program.gate.closed


def test_what_cannot_be_told_is_a_fault_all_the_same(tmp_path: Path) -> None:
    class Mute(Exception):
        def __str__(self) -> str:
            raise ValueError("no words")

    run = runner(tmp_path, 5.0)

    def fail() -> None:
        raise Mute

    run.call_soon(fail)
    assert run.run().faults == ["Mute"]
