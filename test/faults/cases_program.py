"""Cases: the program itself goes wrong: exceptions, signals, hangs, slow ticks."""

from __future__ import annotations

import os
import signal
import time
from functools import partial
from pathlib import Path

from faults.case import BLOCKS, NAN, WOBBLE, Case, Wants
from faults.command_log import CLOSE
from faults.fault_run import PLATFORM, FaultRun

_raising = partial(Case, "exceptions")
_signalled = partial(Case, "signals")
_child = partial(Case, "platform in a child process")
_timing = partial(Case, "time")
WATCHDOG = 0.2
"""Of the child processes in [s]."""
BUSY_MS = 300.0
"""For a machine that is busy."""
_SILENCE = 0.3
"""Of their parents in [s]: a robot's is 0.02 s, which a busy machine may take by itself."""
CHILD = {"platform": {"child": PLATFORM, "watchdog": WATCHDOG, "silence": _SILENCE}}
_RAISED = (
    "ValueError",
    "MemoryError",
    "OSError",
    "RecursionError",
    "SystemExit",
    "KeyboardInterrupt",
)
_AT_ONCE = Wants(most=1, ms=400.0, ended_ms=2500.0, status=(), report=False)
_SIGNALS = (
    *("HUP", "INT", "QUIT", "USR1", "USR2", "ALRM", "VTALRM", "PROF"),
    *("TERM", "XCPU", "POLL", "PWR", "STKFLT"),
)
_DOUBTFUL = ("KeyboardInterrupt",)  # how somebody else's Ctrl-C may come up: any status but 0


def _stop_and_continue(number: signal.Signals, seconds: float, run: FaultRun) -> None:
    run.wait_for_tick(run.case.at)
    run.mark()
    run.process.send_signal(number)
    time.sleep(seconds)
    run.process.send_signal(signal.SIGCONT)


def _two_ctrl_c(run: FaultRun) -> None:
    run.wait_for_tick(run.case.at)
    time.sleep(0.2)
    run.process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    run.mark()
    run.process.send_signal(signal.SIGINT)


def until_the_child_damps(number: signal.Signals | None, run: FaultRun) -> None:
    """Stop or kill the ticks, or let them hang; only their child can damp then."""
    run.wait_for_tick(run.case.at)
    if number is not None:
        run.mark()
        run.process.send_signal(number)
    end = time.monotonic() + 5.0
    while not run.log.of(CLOSE).size and time.monotonic() < end:
        time.sleep(0.005)
    run.process.kill()


def signal_the_child(number: signal.Signals, run: FaultRun) -> None:
    """Send a signal to the processes that the run has started."""
    run.wait_for_tick(run.case.at)
    pid = run.process.pid
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    except FileNotFoundError:  # it has ended by itself: the fault is not reached
        return
    run.mark()
    for child in children:
        os.kill(int(child), number)


kill_the_child = partial(signal_the_child, signal.SIGKILL)


def _in_a_child(
    name: str, number: signal.Signals | None, ms: float, most: int, flow: object = WOBBLE
) -> Case:
    return _child(
        name,
        Wants(most=most, ms=ms, status=(-9,), report=False),
        flow=flow,
        workflow=CHILD,
        duration=8.0,
        outside=partial(until_the_child_damps, number),
    )


def _term_in_the_group(run: FaultRun) -> None:
    run.wait_for_tick(run.case.at)
    run.mark()
    os.killpg(run.process.pid, signal.SIGTERM)
    os.killpg(run.process.pid, signal.SIGINT)


def second_ctrl_c(group: str, node: bool = False) -> Case:
    """A second Ctrl-C, which damps at once though a tick hangs."""
    return Case(
        group,
        "second Ctrl-C in a hang of 3 s",
        Wants(most=0, ms=300.0, status=(), report=False),
        fault={"hang": 3.0},
        outside=_two_ctrl_c,
        duration=4.0,
        node=node,
    )


def _building(name: str) -> Case:
    slow = {f"{BLOCKS}:slow_build": {"log": "{log}", "signals": f"SIG{name}"}}
    return _signalled(
        f"SIG{name} while building, the platform is open",
        Wants(most=0, ms=None, ended_ms=2500.0, status=(), report=False),
        flow={"zip": [WOBBLE, slow]},
        spread=0,
    )


def _refused(name: str, reason: str, workflow: dict[str, object]) -> Case:
    wants = Wants(most=0, closed=False, ms=None, status=(1,), reason=reason, report=False)
    return Case("refused before a motor moves", name, wants, workflow=workflow, at=1, spread=0)


CASES = (
    *(
        _raising(
            f"{error} in {where}",
            Wants(most=0, reason="" if error in _DOUBTFUL else "made by the bench"),
            fault={"raise": error, "in": where},
            quick=(error, where) == ("ValueError", "recv"),
        )
        for error, where in [
            *((error, "recv") for error in _RAISED),
            ("OSError", "send"),
            ("SystemExit", "send"),
        ]
    ),
    _raising(
        "close raises at the end",
        Wants(most=0, reason="made by the bench"),
        spread=0,
        fault={"raise": "OSError", "in": "close"},
    ),
    _raising(
        "NaN, then close raises",
        Wants(most=0, reason="joint_pos_target"),
        fault={"raise": "OSError", "in": "close", "mark": True},
        flow=NAN,
    ),
    _in_a_child("SIGKILL of the ticks", signal.SIGKILL, BUSY_MS, most=1),
    _in_a_child(
        "SIGSTOP of the ticks: the watchdog, 0.2 s",
        signal.SIGSTOP,
        1e3 * WATCHDOG + BUSY_MS,
        most=1,
    ),
    _in_a_child(
        "a block hangs for ever: the watchdog, 0.2 s",
        None,
        1e3 * WATCHDOG + BUSY_MS,
        most=1,
        flow={"zip": [WOBBLE, {f"{BLOCKS}:broken": {"hang": 60.0, "at": "{at}"}}]},
    ),
    _child(
        "SIGKILL of the child: a fault, nothing can damp",
        Wants(most=1, closed=False, ms=None, ended_ms=6000.0, reason="SIGKILL"),
        workflow=CHILD,
        outside=kill_the_child,
    ),
    _signalled(
        "SIGINT: the wind-down follows, then it damps",
        Wants(most=None, least=15, ms=2000.0, status=(), report=False),
        fault={"signals": ["SIGINT"]},
        workflow={"wind_down": {"hold": {"duration": 0.5}}},
    ),
    _signalled(
        "second SIGINT, in the wind-down: damps at once",
        Wants(most=1, ms=400.0, ended_ms=2500.0, status=(), report=False),
        outside=_two_ctrl_c,
        workflow={"wind_down": {"hold": {"duration": 3.0}}},
        duration=4.0,
    ),
    *(
        _signalled(
            f"SIG{name}",
            _AT_ONCE,
            fault={"signals": [f"SIG{name}"]},
            quick=name == "HUP",
        )
        for name in _SIGNALS
        if hasattr(signal, f"SIG{name}")
    ),
    _signalled("SIGTERM and SIGINT at once", _AT_ONCE, outside=_term_in_the_group),
    _signalled(
        "Ctrl-Z (SIGTSTP): damps, then stops",
        Wants(most=1, ms=400.0, status=(), report=False),
        outside=partial(_stop_and_continue, signal.SIGTSTP, 1.0),
    ),
    second_ctrl_c("signals"),
    _building("TERM"),
    _building("HUP"),
    _building("INT"),
    _timing(
        "hang of 0.12 s: ticks missed are counted",
        Wants(most=None, least=15, ms=None, status=(0,), overruns=5),
        fault={"hang": 0.12},
    ),
    _timing("hang of 0.5 s in recv", Wants(most=1, ms=800.0), fault={"hang": 0.5}, quick=True),
    _timing("hang of 2 s in recv", Wants(most=1, ms=2300.0), fault={"hang": 2.0}),
    _timing(
        "hang of 0.5 s in a block",
        Wants(most=1, ms=800.0),
        flow={"zip": [WOBBLE, {f"{BLOCKS}:broken": {"hang": 0.5, "at": "{at}"}}]},
    ),
    _timing(
        "SIGSTOP for 2 s, then SIGCONT",
        Wants(most=2, ms=2400.0),
        outside=partial(_stop_and_continue, signal.SIGSTOP, 2.0),
    ),
    _timing(
        "every tick takes 25 of 20 ms",
        Wants(most=None, least=15, ms=None, status=(0, 3), overruns=15),
        fault={"slow": 0.025},
    ),
    _refused("overrun: catch_up on hardware", "catch_up", {"pacing": {"overrun": "catch_up"}}),
    _refused(
        "joint_limits with a margin of -10",
        "margin",
        {"safety": ["finite", {"joint_limits": {"margin": -10.0}}]},
    ),
    _refused(
        "velocity_stop with a factor of -1",
        "factor",
        {"safety": ["finite", "joint_limits", {"velocity_stop": {"factor": -1.0}}]},
    ),
    _refused("joint_limits before finite", "finite", {"safety": ["joint_limits", "finite"]}),
)
