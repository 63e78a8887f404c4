"""Cases: ROS 2 peers that command, are the robot, or press ~/estop."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from faults.case import AS_THEY_ARE, TICKS, WALK, WOBBLE, Case, Wants
from faults.cases_program import second_ctrl_c

_node = partial(Case, "unicon_node", node=True)
_both = partial(Case, "two at once")
_POLICY, NODE_TICKS = (25, 50), (60, 110)
"""Ticks in which a policy runs, and in which those that call a node have found it."""
RANGES = (1.0, 0.4, 1.0)  # command_ranges of go2_velocity, the larger side
COMMANDS = Wants(most=None, ms=None, status=(), report=False)
SILENCED = replace(COMMANDS, zero_ms=650.0)
_GARBAGE = replace(SILENCED, report=True, refused=100)
# From the call on: the request's way is in it, and a loaded machine takes 150 ms for that.
PRESSED = Wants(most=10, ms=300.0, reason="estop", report=False)
_WAITING = ("-p", "autostart:=false")
BUSY = {"pacing": {"hang": 1.0}}
"""A robot's is 0.25 s, which a busy machine may take by itself: its figure stands in the table."""
_GOES_ON = replace(COMMANDS, least=50, gap_ms=1e3, gains=AS_THEY_ARE)


def _cmd_vel(name: str, what: str, wants: Wants, failing: str = "") -> Case:
    return Case(
        "commands from ROS",
        name,
        wants,
        fault={},  # the peer's, or the middleware's
        flow=WALK,
        arguments=("--ros",),
        duration=12.0,
        peer=("commander", what, "{at}"),
        ticks=_POLICY,
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
        peer=("robot", what, "{at}"),
        topics=True,
        ticks=_POLICY,
        spread=0 if what in ("imu_never", "another") else TICKS,
        failing=failing,
        quick=what == "nan",
    )


_LOST = Wants(most=0, ms=None, reason="joint_commands", ended_ms=4000.0)


def _silent(reason: str) -> Wants:
    return Wants(most=32, ms=650.0, reason=reason)


def _called(
    group: str, name: str, wants: Wants, *words: str, when: str = "{at}", **others: Any
) -> Case:
    """Somebody calls services of the node; it is run until he is done."""
    peer = ("caller", when, *words)
    return Case(group, name, wants, node=True, peer=peer, ticks=NODE_TICKS, **others)


_estop = partial(_called, "~/estop", workflow=BUSY)
_services = partial(_called, "services", workflow=BUSY)
_asleep = partial(_estop, when="-1", spread=0, arguments=_WAITING)  # nothing ticks yet


CASES = (
    _cmd_vel("cmd_vel falls silent (time-out 0.5 s)", "silence", SILENCED),
    _cmd_vel("cmd_vel NaN at 1 kHz (time-out 0.5 s)", "nan", SILENCED),
    _cmd_vel("cmd_vel cannot be taken (time-out 0.5 s)", "good", SILENCED, failing="take"),
    *(
        _cmd_vel(f"cmd_vel of {what}", what, replace(COMMANDS, speed=RANGES))
        for what in ("50", "1e30")
    ),
    _cmd_vel("bytes that are not a Twist at 1 kHz (time-out 0.5 s)", "garbage", _GARBAGE),
    _cmd_vel("random numbers in cmd_vel at 1 kHz", "bits", replace(COMMANDS, speed=RANGES)),
    _cmd_vel("the middleware refuses everything (time-out 0.5 s)", "good", SILENCED, failing="all"),
    Case(
        "commands from ROS",
        "noise at the ports of DDS",
        replace(_GOES_ON, least=50),
        arguments=("--ros",),
        duration=12.0,
        workflow=BUSY,
        peer=("datagrams", "{at}"),
        ticks=NODE_TICKS,
    ),
    _robot("joint_states fall silent", "silence", _silent("joint_states")),
    _robot("the robot's process is killed", "killed", _silent("topic")),
    _robot("NaN in joint_states", "nan", _silent("joint_states")),
    _robot("joint_states of 5 of 12 joints", "subset", _silent("joint_states")),
    _robot("joint_states 1e30, then silence", "far", Wants(most=45, ms=900.0, reason="")),
    _robot("IMU falls silent, tilt_stop reads it", "imu_silence", _silent("imu/data")),
    _robot("NaN from the IMU", "imu_nan", _silent("imu/data")),
    _robot("quaternion 0, 0, 0, 0", "quat_zero", _silent("")),
    _robot("garbage instead of joint_states", "garbage", _silent("joint_states")),
    _robot("garbage instead of the IMU", "imu_garbage", _silent("imu/data")),
    _robot("the middleware refuses everything", "good", _LOST, failing="all"),
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
    _estop("idle ticks", PRESSED, "estop"),
    _estop("ticks of 19 of 20 ms", PRESSED, "estop", fault={"slow": 0.018}, when="{later}"),
    _estop(
        "ticks of 25 of 20 ms",
        PRESSED,
        "estop",
        fault={"slow": 0.025},
        when="{later}",
        quick=True,
    ),
    _estop(
        "during a hang of 2 s: acts when it ends",
        Wants(most=0, ms=2300.0, report=False),
        "estop",
        fault={"hang": 2.0},
    ),
    _estop("in a flood of calls", PRESSED, "flood estop"),
    _asleep(
        "pressed while nothing runs, then ~/start",
        Wants(most=0, closed=False, status=(), report=False),
        "estop",
        "start",
    ),
    _asleep(
        "…, then ~/clear_estop and ~/start: it runs",
        Wants(most=None, least=10, closed=False, status=(), report=False),
        "estop",
        "clear_estop",
        "start",
    ),
    _services("a flood of calls to all but ~/stop and ~/estop", _GOES_ON, "flood"),
    _services(
        "the gains are scaled: stiffness by 1.5, damping by 1.3",
        replace(_GOES_ON, least=20, gains=(1.5, 1.3)),
        "stiffness_scale=1.5,damping_scale=1.3",
    ),
    *(
        _services(f"{word} is refused", replace(_GOES_ON, least=20), word)
        for word in ("stiffness_scale=1000", "stiffness_scale=nan", "damping_scale=-1")
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
        Wants(most=0, ended_ms=2500.0, reason="joint_pos_target"),
        fault={"set": {"joint_pos": "nan"}, "signals": ["SIGTERM"]},
    ),
    _both(
        "SIGTERM and an OSError in one tick",
        Wants(most=0, ended_ms=2500.0, reason="made by the bench"),
        fault={"raise": "OSError", "signals": ["SIGTERM"]},
        flow=WOBBLE,
    ),
)
