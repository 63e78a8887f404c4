"""Cases: ROS 2 peers that command, are the robot, or press ~/estop."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from unicon_ros.bench.faults.case import WALK, WOBBLE, Case, Wants
from unicon_ros.bench.faults.cases_program import second_ctrl_c

__all__ = ["CASES"]

_node = partial(Case, "unicon_node", node=True)
_both = partial(Case, "two at once")
_RANGES = (1.0, 0.4, 1.0)  # command_ranges of go2_velocity, the larger side
_COMMANDED = Wants(most=None, ms=None, status=(), report=False)
_SILENCED = replace(_COMMANDED, zero_ms=650.0)
# From the call on: the request's way is in it, and a loaded machine takes 150 ms for that.
_PRESSED = Wants(most=10, ms=300.0, reason="estop", report=False)
_WAITING = ("-p", "autostart:=false")


def _cmd_vel(name: str, what: str, wants: Wants, failing: str = "") -> Case:
    return Case(
        "commands from ROS",
        name,
        wants,
        fault={},  # the peer's, or the middleware's
        flow=WALK,
        arguments=("--ros",),
        duration=12.0,
        peer=("commander", what),
        failing=failing,
        quick=what == "nan",
    )


def _robot(name: str, what: str, wants: Wants, failing: str = "") -> Case:
    """Commands are those that the robot got; its time-out is 0.5 s."""
    return Case(
        "platform ros",
        name,
        wants,
        workflow={"platforms": {"ros": {"connect": 6.0}}},
        duration=3.0,
        peer=("robot", what),
        topics=True,
        failing=failing,
        quick=what == "nan",
    )


def _silent(reason: str) -> Wants:
    return Wants(most=32, ms=650.0, reason=reason)


def _estop(name: str, wants: Wants, *words: str, wait: int = 60, **others: Any) -> Case:
    return Case(
        "~/estop",
        name,
        wants,
        node=True,
        peer=("caller", str(wait), *words),
        duration=1.0,
        **others,
    )


CASES = (
    _cmd_vel("cmd_vel falls silent (time-out 0.5 s)", "silence", _SILENCED),
    _cmd_vel("cmd_vel NaN at 1 kHz (time-out 0.5 s)", "nan", _SILENCED),
    _cmd_vel("cmd_vel cannot be taken (time-out 0.5 s)", "good", _SILENCED, failing="take"),
    *(
        _cmd_vel(f"cmd_vel of {what}", what, replace(_COMMANDED, speed=_RANGES))
        for what in ("50", "1e30")
    ),
    _robot("joint_states fall silent", "silence", _silent("joint_states")),
    _robot("the robot's process is killed", "killed", _silent("joint_states")),
    _robot("NaN in joint_states", "nan", _silent("joint_states")),
    _robot("joint_states of 5 of 12 joints", "subset", _silent("joint_states")),
    _robot("joint_states 1e30, then silence", "far", Wants(most=45, ms=900.0, reason="")),
    _robot("IMU falls silent, tilt_stop reads it", "imu_silence", _silent("imu/data")),
    _robot("NaN from the IMU", "imu_nan", _silent("imu/data")),
    _robot("quaternion 0, 0, 0, 0", "quat_zero", _silent("")),
    _robot(
        "IMU never comes, tilt_stop reads it",
        "imu_never",
        Wants(most=0, ms=None, status=(1, 3), reason="imu/data", report=False),
    ),
    _robot(
        "another robot's joint names",
        "another",
        Wants(most=0, ms=None, status=(1,), reason="joint_states", report=False),
    ),
    _robot(
        "commands cannot be published",
        "good",
        Wants(most=0, ms=None, ended_ms=2000.0, reason="joint_commands"),
        failing="publish",
    ),
    _estop("idle ticks", _PRESSED, "estop"),
    _estop("ticks of 19 of 20 ms", _PRESSED, "estop", fault={"slow": 0.018}),
    _estop("ticks of 25 of 20 ms", _PRESSED, "estop", fault={"slow": 0.025}, quick=True),
    _estop(
        "during a hang of 2 s: acts when it ends",
        Wants(most=0, ms=2300.0, report=False),
        "estop",
        wait=101,
        at=100,
        fault={"hang": 2.0},
    ),
    _estop(
        "pressed while nothing runs, then ~/start",
        Wants(most=0, closed=False, status=(), report=False),
        "estop",
        "start",
        wait=0,
        arguments=_WAITING,
    ),
    _estop(
        "…, then ~/clear_estop and ~/start: it runs",
        Wants(most=None, least=10, closed=False, status=(), report=False),
        "estop",
        "clear_estop",
        "start",
        wait=0,
        arguments=_WAITING,
    ),
    _node(
        "SIGHUP",
        Wants(most=1, ms=400.0, ended_ms=3000.0, status=(), report=False),
        fault={"signals": ["SIGHUP"]},
    ),
    _node(
        "ValueError in recv, exit_on_fault",
        Wants(most=0, reason="made by the bench", report=False),
        fault={"raise": "ValueError"},
    ),
    second_ctrl_c("unicon_node", node=True),
    _both(
        "NaN in joint_pos and SIGTERM in one tick",
        Wants(most=0, ended_ms=1500.0, reason="joint_pos_target"),
        fault={"set": {"joint_pos": "nan"}, "signals": ["SIGTERM"]},
    ),
    _both(
        "SIGTERM and an OSError in one tick",
        Wants(most=0, ended_ms=1500.0, reason="made by the bench"),
        fault={"raise": "OSError", "signals": ["SIGTERM"]},
        flow=WOBBLE,
    ),
)
