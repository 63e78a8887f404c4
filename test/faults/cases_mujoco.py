"""Cases: a robot walks in MuJoCo at real rate, over ROS, in a child, or with a bridge apart."""

from __future__ import annotations

import signal
from dataclasses import replace
from functools import partial
from typing import Any

from faults.case import BLOCKS, COMMANDED, WALK, Case, Wants
from faults.cases_program import (
    BUSY_MS,
    kill_the_child,
    signal_the_child,
    until_the_child_damps,
)
from faults.cases_ros import COMMANDS, PRESSED, RANGES, SILENCED
from faults.fault_run import SIMULATOR

_TICKS = (40, 90)
"""While it walks, also where it was told to only after half a second."""

_over_ros = partial(Case, "MuJoCo over ROS", mujoco=True, flow=COMMANDED, ticks=_TICKS)
_child = partial(
    Case, "MuJoCo in a child process", mujoco=True, flow=WALK, ticks=_TICKS, duration=8.0
)
_SILENCE, _WATCHDOG = 1.0, 0.5
"""For which a child and its parent may be silent in [s]: physics takes time on a busy machine."""

_CHILD: dict[str, Any] = {
    "platform": {"child": SIMULATOR, "watchdog": _WATCHDOG, "silence": _SILENCE}
}
_G1_RANGES = (1.0, 0.5, 1.0)
"""Command ranges of its policy, the larger side: `deploy.yaml` of g1_velocity_mjlab."""

_STANDS = replace(SILENCED, stands_ms=2000.0)
"""Zero 0.5 s after the last message; 0.3 s later it begins to stand, which takes 0.3 s."""

_FLOODED = "~/estop in a flood of calls"
_THEN = ", then the robot stands"
_PARTS: dict[str, Any] = {
    "store": {"shm": "faults-{name}"},
    "parts": {
        "robot": {"silent": {"after": 0.2}},
        "desk": {"publishes": ["velocity_command"], "silent": {"after": 1.0, "then": "hold"}},
    },
    "commands": [{"velocity_command": {"constant": [0.1, 0.0, 0.0]}, "on": "desk"}],
}
"""The robot goes on alone 0.2 s after the bridge was heard last."""


def _cmd_vel(name: str, what: str, wants: Wants) -> Case:
    peer = ("commander", what, "{at}")
    return _over_ros(name, wants, fault={}, arguments=("--ros",), duration=15.0, peer=peer)


def _bridge(name: str, number: signal.Signals) -> Case:
    return Case(
        "a bridge in a process of its own",
        name,
        replace(_STANDS, zero_ms=400.0, stands_ms=2000.0),
        fault={},
        mujoco=True,
        flow=COMMANDED,
        workflow=_PARTS,
        arguments=("--part", "robot"),
        duration=60.0,
        peer=("bridge", number.name, "{at}", "{workflow}"),
    )


def _damped_by_the_child(name: str, number: signal.Signals | None, ms: float, **more: Any) -> Case:
    return _child(
        name,
        Wants(most=1, ms=ms, status=(-9,), report=False),
        workflow=_CHILD,
        outside=partial(until_the_child_damps, number),
        **more,
    )


def _in_g1(case: Case) -> Case:
    """Return the case with a G1, whose policy has command ranges of its own.

    Where nobody commands at first its policy runs all the time: a G1 does not stand without one.
    """
    wants = replace(case.wants, speed=_G1_RANGES if case.wants.speed else None)
    case = replace(case, robot="g1", wants=wants)
    if case.flow is not COMMANDED or "--ros" in case.arguments:
        return case
    name = case.name.replace(_THEN, "")
    return replace(case, name=name, flow=WALK, wants=replace(wants, stands_ms=None))


_CASES = (
    _cmd_vel("cmd_vel NaN at 1 kHz: zero, then it stands", "nan", _STANDS),
    *(
        _cmd_vel(f"cmd_vel of {value} at 1 kHz", f"{value} flood", replace(COMMANDS, speed=RANGES))
        for value in ("50", "1e30")
    ),
    _cmd_vel(
        "bytes that are not a Twist at 1 kHz: zero, then it stands",
        "garbage",
        replace(_STANDS, report=True, refused=100),
    ),
    _cmd_vel("random numbers in cmd_vel at 1 kHz", "bits", replace(COMMANDS, speed=RANGES)),
    _cmd_vel("the operator's process is killed: zero, then it stands", "killed", _STANDS),
    _over_ros(
        "~/estop while it walks",
        PRESSED,
        fault={},
        node=True,
        peer=("caller", "{at}", "estop"),
    ),
    _over_ros(
        _FLOODED,
        PRESSED,
        fault={},
        node=True,
        peer=("caller", "{at}", "flood estop"),
    ),
    _bridge(f"it is killed: zero after 0.2 s{_THEN}", signal.SIGKILL),
    _bridge(f"it is stopped (SIGSTOP): zero after 0.2 s{_THEN}", signal.SIGSTOP),
    _child(
        "SIGKILL of the child: a fault, nothing can damp",
        Wants(most=1, closed=False, ms=None, ended_ms=6000.0, reason="SIGKILL"),
        workflow=_CHILD,
        outside=kill_the_child,
    ),
    _child(
        f"SIGSTOP of the child: a fault after {_SILENCE:g} s",
        Wants(most=1, closed=False, ms=None, ended_ms=6000.0, reason="has not answered"),
        workflow=_CHILD,
        outside=partial(signal_the_child, signal.SIGSTOP),
    ),
    _damped_by_the_child("SIGKILL of the ticks", signal.SIGKILL, BUSY_MS),
    _damped_by_the_child(
        f"SIGSTOP of the ticks: the watchdog, {_WATCHDOG:g} s",
        signal.SIGSTOP,
        1e3 * _WATCHDOG + BUSY_MS,
    ),
    _damped_by_the_child(
        f"a block hangs for ever: the watchdog, {_WATCHDOG:g} s",
        None,
        1e3 * _WATCHDOG + BUSY_MS,
        flow={"zip": [WALK, {f"{BLOCKS}:broken": {"hang": 60.0, "at": "{at}"}}]},
    ),
)
_IN_G1 = (case for case in _CASES if case.name != _FLOODED)  # it falls when ~/reset comes each tick
CASES = (*_CASES, *map(_in_g1, _IN_G1))
