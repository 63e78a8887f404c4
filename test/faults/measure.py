"""Measures a case from the command log, the report and the files that the run left."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import unicon_ros
from faults.blocks import swing
from faults.case import Measured
from faults.command_log import CLOSE, FAULT, RECV, SEND
from faults.damping_judge import TOLERANCE, Commands, beyond_damping
from faults.fault_run import FaultRun
from faults.on_disk import recorded_span, report_of, what_is_there
from unicon_core.robots import Robot

_STANDS = 10  # ticks
_BUSY = 0.2  # s by which a busy machine may be late with the end of the blend


def measure(run: FaultRun, status: int | None) -> Measured:
    """Return what was measured of a run that has ended.

    Args:
        status: its exit status; None where it had to be killed.
    """
    got = Measured(status=status, disk=what_is_there(run.folder))
    report = report_of(run.folder)
    got.overruns = int(report.get("overruns", 0))
    faults = report.get("faults", []) if run.case.again is None else []
    got.reason = "; ".join(faults) or _said(run.said())
    for folder in (run.folder, Path(unicon_ros.__path__[0]).parent):  # of this run, this machine
        got.reason = got.reason.replace(f"{folder}/", "")
    sent, fault = run.motors.of(SEND), _fault_ns(run)
    if not fault:
        got.reached = False
        got.reason = got.reason or "the fault was never reached"
        return got
    after = sent[sent["time"] > fault]
    damping = _damping(sent)[len(sent) - len(after) :]
    moving = _moving(sent, fault) if run.case.topics else after[~damping]
    got.commands, got.wild = len(moving), _wild(after, run.robot)
    if damping.any() and not run.case.topics:
        first = len(sent) - len(after) + int(np.argmax(damping))
        got.beyond = _beyond(sent, first, run.robot)
    ends = np.concatenate((after["time"][damping], run.log.of(CLOSE)["time"]))
    late = ends[ends > fault]
    if run.case.topics:
        got.ms = (int(moving["time"][-1]) - fault) * 1e-6 if len(moving) else 0.0
        got.ticks = round(got.ms / 20.0)
    elif len(late):
        end = int(late[0])
        begun = run.log.of(RECV)["time"]
        got.ms = (end - fault) * 1e-6
        got.ticks = int(np.count_nonzero((begun > fault) & (begun < end)))
        if "platform" in run.case.workflow:  # a child takes data far more often than a tick
            got.ticks = round(got.ms / 20.0)
    if run.ended_ns:
        got.ended_ms = (run.ended_ns - fault) * 1e-6
    times = np.concatenate(([fault], moving["time"]))
    got.gap_ms = float(np.diff(times).max(initial=0)) * 1e-6
    _velocity(got, after, fault)
    _standing(got, after[~damping], fault)
    _wobbling(got, after[~damping], run.robot)
    of_topics = report.get("bridge", {}).get("topics", {}).values()
    got.refused = sum(int(topic.get("rejected", 0)) for topic in of_topics)
    _recording(got, run, sent)
    return got


def _fault_ns(run: FaultRun) -> int:
    """Return when the fault began; 0 where it never did."""
    if run.fault_ns:
        return run.fault_ns
    for log in (run.peer_log, run.log):
        marks = log.of(FAULT)["time"]
        if len(marks):
            return int(marks[0])
    return 0


def _damping(sent: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which commands do not exceed the damping command, of all that were sent.

    Stiffness is gone, or less than before; targets stand, and nothing else pushes.
    """
    stiffness, target = sent["stiffness"], sent["target"]
    limp = ~stiffness.any(axis=1)
    less = (stiffness[1:] < stiffness[:-1]) | (stiffness[1:] == 0.0)
    stands = np.abs(target[1:] - target[:-1]) <= TOLERANCE
    falls = np.concatenate(([False], (less & stands).all(axis=1)))[: len(sent)]
    found: NDArray[np.bool_] = limp | falls
    return found


def _beyond(sent: NDArray[Any], first: int, robot: Robot) -> list[str]:
    """Return what of the commands from the first damping one on exceeds the damping command."""
    names = ("target", "speed", "effort", "stiffness", "damping")
    commands = Commands(sent["time"] * 1e-9, *(sent[name] for name in names))
    return beyond_damping(commands, first, robot, slack=_BUSY)


def _moving(sent: NDArray[Any], fault: int) -> NDArray[Any]:
    """Return commands after the fault that differ from those before them: closing ones stand."""
    if len(sent) < 2:
        return sent[sent["time"] > fault]
    step = np.abs(np.diff(sent["target"], axis=0)).max(axis=1) > 1e-6
    moving: NDArray[Any] = sent[1:][step & (sent["time"][1:] > fault)]
    return moving


def _wild(rows: NDArray[Any], robot: Robot) -> int:
    lower, upper = robot.lower, robot.upper
    target = rows["target"]
    with np.errstate(invalid="ignore"):
        inside = (target >= lower - TOLERANCE) & (target <= upper + TOLERANCE)
    gains = np.isfinite(rows["stiffness"]) & np.isfinite(rows["damping"])
    return int(np.count_nonzero(~(inside & gains).all(axis=1)))


def _velocity(got: Measured, after: NDArray[Any], fault: int) -> None:
    speeds = np.abs(after["velocity"])
    if not len(after):
        return
    largest = np.nan_to_num(speeds, nan=np.inf).max(axis=0)
    got.speed = (float(largest[0]), float(largest[1]), float(largest[2]))
    driven = np.flatnonzero(speeds.any(axis=1))
    first = driven[-1] + 1 if len(driven) else 0
    if first < len(after):  # it stays zero from there on
        got.zero_ms = (int(after["time"][first]) - fault) * 1e-6


def _standing(got: Measured, rows: NDArray[Any], fault: int) -> None:
    """Tell since when the targets have not moved, if for some ticks at least."""
    moves = np.abs(np.diff(rows["target"], axis=0)).max(axis=1, initial=0.0) > 1e-6
    last = int(np.flatnonzero(moves)[-1]) + 1 if moves.any() else 0
    if len(rows) - last > _STANDS:
        got.stands_ms = (int(rows["time"][last]) - fault) * 1e-6


def _wobbling(got: Measured, rows: NDArray[Any], robot: Robot) -> None:
    """Count the commands that `wobble` did not give so, and tell the factors of their gains."""
    if not len(rows):
        return
    offset = np.array([swing(float(tick)) for tick in rows["tick"]])
    wrong = np.abs(rows["target"] - robot.default_joint_pos - offset[:, None]) > TOLERANCE
    wrong |= (rows["speed"] != 0.0) | (rows["effort"] != 0.0)
    got.changed = int(np.count_nonzero(wrong.any(axis=1)))
    last = rows[-1]
    got.gains = (
        float(np.median(last["stiffness"] / robot.joint_stiffness)),
        float(np.median(last["damping"] / robot.joint_damping)),
    )


def _recording(got: Measured, run: FaultRun, sent: NDArray[Any]) -> None:
    span = recorded_span(run.folder)
    if span is None or len(sent) < 2:
        return
    recorded, driven = (span[1] - span[0]) * 1e-9, (sent["time"][-1] - sent["time"][0]) * 1e-9
    got.lost_s = max(0.0, float(driven) - recorded)
    got.disk.append(f"recording {recorded:.1f} of {driven:.1f} s")


def _said(text: str) -> str:
    """Return the line of an output that tells why it ended."""
    lines = [line.strip() for line in re.split(r"[\r\n]+", text) if line.strip()]
    for mark in ("fault: ", "unicon: error: ", "unicon_node: error: "):
        for line in lines:
            if mark in line:
                return line.partition(mark)[2]
    errors = [line for line in lines if re.match(r"[A-Za-z]*(Error|Exception|Interrupt)\b", line)]
    return errors[-1] if errors else ""
