"""Cases: where a run writes to fails: the terminal, a pipe, the disk; and what SIGKILL leaves."""

from __future__ import annotations

import os
import time
from functools import partial

from faults.case import NAN, Case, Wants
from faults.fault_run import FaultRun

_output = partial(Case, "output")
_disk = partial(Case, "disk")
_GOES_ON = Wants(most=None, least=50, ms=None, gap_ms=400.0, status=(), report=False)
_RECORD = ("--record", "{folder}/run.mcap")


def _ctrl_s(run: FaultRun) -> None:
    """Stop the terminal in the second tick; go on after 3 s, so that it can end."""
    run.wait_for_tick(25)
    run.mark()
    os.write(run.terminal, b"\x13")
    time.sleep(3.0)
    os.write(run.terminal, b"\x11")
    end = time.monotonic() + 3.0
    os.set_blocking(run.terminal, False)
    while run.process.poll() is None and time.monotonic() < end:
        try:
            os.read(run.terminal, 4096)
        except BlockingIOError:
            time.sleep(0.01)


def _fill_the_pipe(run: FaultRun) -> None:
    # Opened anew, so that only our end does not block.
    pipe = os.open(f"/proc/self/fd/{run.stream}", os.O_WRONLY | os.O_NONBLOCK)
    try:
        while True:
            os.write(pipe, b"." * 4096)
    except BlockingIOError:
        os.close(pipe)


CASES = (
    _output(
        "the terminal is stopped (Ctrl-S) for 3 s",
        _GOES_ON,
        outside=_ctrl_s,
        output="terminal",
        duration=2.6,
        spread=0,
    ),
    _output(
        "a pipe that nobody reads; refused messages are warned of",
        _GOES_ON,
        arguments=("--ros",),
        duration=12.0,
        peer=("commander", "nan", "30"),
        outside=_fill_the_pipe,
        output="pipe",
        spread=0,
    ),
    _output(
        "NaN, stdout closed (`unicon run … | true`)",
        Wants(most=0),
        flow=NAN,
        output="closed",
        quick=True,
    ),
    _output("NaN, stdout on a full device", Wants(most=0), flow=NAN, output="device full"),
    _disk(
        "NaN: report, trace, picture and recording are whole",
        Wants(most=0, files=("trace", "picture"), lost_s=0.2),
        flow=NAN,
        arguments=(*_RECORD, "--trace", "{folder}/trace.json", "--picture", "{folder}/picture.png"),
    ),
    _disk(
        "ValueError in send: report, trace and recording are whole",
        Wants(most=0, files=("trace",), lost_s=0.2),
        fault={"raise": "ValueError", "in": "send"},
        arguments=(*_RECORD, "--trace", "{folder}/trace.json"),
    ),
    _disk(
        "SIGKILL after 3 s (nothing can damp: the robot's watchdog must)",
        Wants(most=0, closed=False, status=(-9,), report=False, lost_s=1.2),
        fault={"signals": ["SIGKILL"]},
        at=150,
        spread=0,
        duration=4.0,
        arguments=_RECORD,
    ),
    _disk(
        "the disk is full while recording (files end at 256 kB)",
        Wants(most=None, least=100, ms=None, gap_ms=400.0, status=(0,)),
        duration=4.0,
        arguments=_RECORD,
        file_limit=1 << 18,
        spread=0,
    ),
)
