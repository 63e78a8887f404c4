"""Cases in MuJoCo: sensors, policy, commands, blocks, ~/estop, phases, and time."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from unicon_core.flow import Stage
from unicon_core.workflow.safety_set import ROBOT_SAFETY
from unicon_ros.bench.faults import mishaps
from unicon_ros.bench.faults.case import BLOCKS
from unicon_ros.bench.faults.simulated_case import SimulatedCase

_sensor = partial(SimulatedCase, "sensors")
_hardware = partial(SimulatedCase, "hardware")
_policy = partial(SimulatedCase, "policy", ticks=(35, 140))  # from there on it is asked
_command = partial(SimulatedCase, "commands")
_body = partial(SimulatedCase, "posture")
_block = partial(SimulatedCase, "blocks and platform")
_estop = partial(SimulatedCase, "~/estop", reason="emergency stop", mishap=mishaps.estop())
_phase = partial(SimulatedCase, "phases")
_time = partial(SimulatedCase, "time")
_velocity = partial(SimulatedCase, "velocity command")
_unseen = partial(SimulatedCase, "not caught, and goes on", outcome="go on")

MEASURED = (
    "joint_pos",
    "joint_vel",
    "joint_effort",
    "base_quat",
    "base_ang_vel",
    "base_lin_acc",
    "projected_gravity",
)
IMU = ["base_quat", "base_ang_vel", "base_lin_acc", "projected_gravity"]
JOINTS = ["joint_pos", "joint_vel", "joint_effort"]
WALKING = (60, 140)
"""Ticks in which both robots walk: what stands still is found where something moves."""

KNEE = {"go2": 5, "g1": 3}
"""A joint that moves far in each step: FL_calf, left_knee."""
SWAPPED = {"go2": [3, 5], "g1": [0, 3]}
"""Hip and calf, hip pitch and knee."""
RAISED = (
    *("Fault", "ValueError", "StopIteration", "MemoryError", "RecursionError"),
    *("SystemExit", "KeyboardInterrupt", "GeneratorExit"),
)
HOUR = 3_600_000_000_000


def _set(state: str, value: object, joint: Any = None, **more: Any) -> dict[str, Any]:
    return {"set": {state: value}, "joint": joint, **more}


BUSY = {"pacing": {"hang": 2.0}}
"""A machine that is busy is not the fault that is looked for."""
WIND_DOWN = {"wind_down": {"chain": [{"pose": {"to": "default", "duration": 0.3}}]}}

SENSORS = (
    *(
        _sensor(
            f"{value} in {state}",
            fault=_set(state, value),
            reason="",
            quick=(state, value) == ("joint_pos", "nan"),
        )
        for state in MEASURED
        for value in ("nan", "inf", "1e30")
    ),
    _sensor("NaN in one joint's position", fault=_set("joint_pos", "nan", 3)),
    _sensor("the IMU stands still", within=30, ticks=WALKING, reason="IMU", fault={"freeze": IMU}),
    _sensor(
        "base_quat is the identity",
        within={"go2": 45, "g1": 60},
        ticks=WALKING,
        reason="IMU",
        fault={"set": {"base_quat": [1.0, 0.0, 0.0, 0.0]}},
    ),
    _sensor(
        "base_quat stands still",
        within={"go2": 45, "g1": 60},
        ticks=WALKING,
        reason="IMU",
        fault={"freeze": ["base_quat"]},
    ),
    _sensor(
        "the IMU says that it is level",
        within=30,
        ticks=WALKING,
        reason="IMU",
        fault={
            "set": {
                "base_quat": [1.0, 0.0, 0.0, 0.0],
                "projected_gravity": [0.0, 0.0, -1.0],
                "base_ang_vel": 0.0,
            }
        },
    ),
    _sensor(
        "the IMU is mounted upside down",
        within=12,
        fault={"set": {"projected_gravity": [0.0, 0.0, 1.0]}},
    ),
    _sensor(
        "one encoder stands still",
        within=25,
        ticks=WALKING,
        reason="stuck",
        fault={"freeze": ["joint_pos", "joint_vel"], "joint": KNEE},
    ),
    _sensor(
        "all sensors stand still, stamps go on",
        within=25,
        ticks=WALKING,
        fault={"freeze": [*IMU, *JOINTS]},
        quick=True,
    ),
    _sensor(
        "the yaw gyroscope is off by 2 rad/s",
        within=13,
        reason="turned otherwise than the gyroscope",
        fault=_set("base_ang_vel", 2.0, 2, add=True),
        quick=True,
    ),
    _sensor(
        "the gyroscope has the other sign",
        within={"go2": 60, "g1": 60},
        ticks=WALKING,
        reason="turned otherwise than the gyroscope",
        fault={"scale": {"base_ang_vel": -1.0}},
    ),
    _sensor(
        "an encoder jumps by 0.3 rad",
        within=1,
        reason="is its encoder sound",
        fault=_set("joint_pos", 0.3, KNEE, add=True),
        quick=True,
    ),
    *(
        _sensor(
            f"all joint velocities {what}",
            within=30,
            ticks=WALKING,
            reason="velocit",
            fault=fault,
        )
        for what, fault in (
            ("stand still", {"freeze": ["joint_vel"]}),
            ("are zero", _set("joint_vel", 0.0)),
            ("have the other sign", {"scale": {"joint_vel": -1.0}}),
        )
    ),
    _sensor("stamps stand still", within=5, reason="stale", fault={"freeze": ["stamp_ns"]}),
    _sensor("the robot falls silent (recv tells)", reason="made by", fault={"raise": "Fault"}),
)

HARDWARE = (
    _hardware("a motor at 120 °C", reason="motor_temp", fault=_set("motor_temperature", 120.0, 2)),
    _hardware("NaN in motor_temperature", reason="nan", fault=_set("motor_temperature", "nan")),
    _hardware("a motor tells an error", reason="motor_error", fault=_set("motor_error", 7, 5)),
    _hardware("a motor leaves its mode", reason="is in mode", fault={"mode": 0, "joint": KNEE}),
    _hardware("a motor is too hot to go on, mode 8", reason="is", fault={"mode": 8, "joint": 0}),
    _hardware(
        "the operator holds all buttons of the remote",
        within=1,
        reason="the operator pressed",
        fault=_set("buttons", 1),
    ),
    _hardware("NaN in battery_charge", reason="nan", fault=_set("battery_charge", "nan")),
    _hardware("the battery is empty", reason="battery", fault=_set("battery_charge", 0.01)),
)

ACTION_STOP = {"safety": [*ROBOT_SAFETY[:1], "action_stop", *ROBOT_SAFETY[1:]]}
"""Before what finds the same in the targets, where they are not clipped."""
POLICY = (
    _policy("the policy gives NaN", reason="not finite", mishap=mishaps.policy_gives(math.nan)),
    _policy("the policy gives infinity", reason="not fin", mishap=mishaps.policy_gives(math.inf)),
    _policy(
        "the policy gives 1e30, action_stop",
        reason="action",
        mishap=mishaps.policy_gives(1e30),
        workflow=ACTION_STOP,
        quick=True,
    ),
    _policy(
        "the policy gives 100, action_stop",
        reason="action",
        mishap=mishaps.policy_gives(100.0),
        workflow=ACTION_STOP,
    ),
    _policy("the policy gives 1e30: the base leans", within=12, mishap=mishaps.policy_gives(1e30)),
    _policy("an array of another length", reason="shape", mishap=mishaps.policy_gives("shape")),
)

COMMANDS = (
    *(
        _command(
            f"{state} is {value:g}",
            reason=state,
            mishap=mishaps.commands(state, value, 1),
            quick=value == 1e9,
        )
        for state, value in (
            ("joint_stiffness", 1e9),
            ("joint_stiffness", -50.0),
            ("joint_damping", 1e9),
            ("joint_damping", -50.0),
            ("joint_vel_target", 1e6),
            ("joint_effort_ff", 1e6),
            ("joint_pos_target", math.nan),
            ("joint_stiffness", math.nan),
            ("joint_effort_ff", math.inf),
        )
    ),
    _command(
        "targets jump by ±0.8 rad, rate_limit trips",
        reason="in one tick",
        within=1,
        mishap=mishaps.jumps(0.8),
        also=({"rate_limit": {"max_rate": 30.0, "beyond": "trip"}},),
    ),
    _command("targets jump by ±0.8 rad in every tick", within=60, mishap=mishaps.jumps(0.8)),
    _command("the stiffness is scaled by 1000", reason="stiffness", mishap=mishaps.tunes(1000.0)),
    _command("the stiffness is scaled by NaN", reason="stiffness", mishap=mishaps.tunes(math.nan)),
    _command("the damping is scaled by -1", reason="damping", mishap=mishaps.tunes(1.0, -1.0)),
)

POSTURE = (
    _body("the base leans by 90°", reason="leans", fault=_set("projected_gravity", 0.0)),
    _body(
        "the base is too low, height_stop",
        reason="base_pos_w",
        fault=_set("base_pos_w", 0.02),
        also=({"height_stop": {"lowest": 0.05}},),
    ),
    _body(
        "NaN in base_pos_w, height_stop",
        reason="base_pos_w",
        fault=_set("base_pos_w", "nan"),
        also=({"height_stop": {"lowest": 0.05}},),
    ),
    _body(
        "a joint is 1 rad past its limit", reason="joint_pos", fault=_set("joint_pos", 4.5, KNEE)
    ),
    _body("a joint turns at 300 rad/s", reason="joint_vel", fault=_set("joint_vel", 300.0, KNEE)),
    _body(
        "the encoders of two joints are swapped",
        within=25,
        ticks=WALKING,
        fault={"swap": SWAPPED},
    ),
    _body(
        "a joint does not follow, tracking_stop",
        within=15,
        ticks=WALKING,
        reason="follow",
        mishap=mishaps.both(
            mishaps.commands("joint_stiffness", 0.01, KNEE),
            mishaps.commands("joint_pos_target", 2.8, KNEE),
        ),
        also=({"tracking_stop": {"bound": 1.0, "timeout": 0.1}},),
    ),
)

PROGRAM = (
    *(
        _block(
            f"{error} in a block",
            reason="made by the bench",
            mishap=mishaps.raises(error),
            quick=error == "SystemExit",
        )
        for error in RAISED
    ),
    _block("a block calls itself for ever", reason="Recursion", mishap=mishaps.recurses()),
    _block(
        "ValueError in an estimator",
        reason="made by the bench",
        mishap=mishaps.raises("ValueError", Stage.ESTIMATE),
    ),
    _block(
        "ValueError in an observer",
        within=1,
        reason="made by the bench",
        mishap=mishaps.raises("ValueError", Stage.OBSERVE),
    ),
    *(
        _block(
            f"{error} in {where}", reason="made by the bench", fault={"raise": error, "in": where}
        )
        for error in ("Fault", "OSError", "SystemExit")
        for where in ("recv", "send")
    ),
)

_ONCE = {"elapsed": 60.0}
COMPOSITES: dict[str, Any] = {
    "chain": {"chain": [{"hold": {"duration": 0.1}}, "{walk}"]},
    "loop": {"loop": {"do": "{walk}", "until": _ONCE}},
    "zip": {"zip": ["{walk}", {f"{BLOCKS}:nothing": {}}]},
    "switch": {"switch": {"on": {"commanded": {}}, "cases": {"no": {"hold": {}}, "yes": "{walk}"}}},
    "every": {"every": {"n": 2, "do": "{walk}"}},
    "when": {"when": {"if": "projected_gravity[2] < 0.0", "do": "{walk}"}},
    "deferred": {"zip": ["{walk}", {"deferred": {f"{BLOCKS}:nothing": {}}}]},
    "chain of a loop of a switch of a zip": {
        "chain": [
            {"hold": {"duration": 0.1}},
            {
                "loop": {
                    "do": {
                        "switch": {
                            "on": {"commanded": {}},
                            "cases": {
                                "no": {"hold": {}},
                                "yes": {"zip": ["{walk}", {f"{BLOCKS}:nothing": {}}]},
                            },
                        }
                    },
                    "until": _ONCE,
                }
            },
        ]
    },
}
ESTOP = (
    *(_estop(f"in a {word}", flow=flow, quick=word == "loop") for word, flow in COMPOSITES.items()),
    _estop("in wait", during="wait", ticks=(2, 20), outcome="refuse", real=True, workflow=BUSY),
    _estop("in the approach", during="approach", ticks=(2, 12), real=True, workflow=BUSY),
    _estop("in the run, as a robot", ticks=(5, 40), real=True, workflow=BUSY),
    _estop(
        "in the wind-down",
        during="soft",
        ticks=(2, 12),
        workflow=WIND_DOWN,
        mishap=mishaps.both(mishaps.ends(30), mishaps.estop()),
    ),
    _estop(
        "while it damps already",
        during="damp",
        ticks=(1, 15),
        reason="made by the bench",
        mishap=mishaps.both(mishaps.breaks(30), mishaps.estop()),
    ),
)

PHASES = (
    _phase(
        "asked to end: the wind-down follows",
        outcome="soft",
        within=1,
        workflow=WIND_DOWN,
        mishap=mishaps.ends(),
    ),
    _phase(
        "NaN in the wind-down",
        during="soft",
        ticks=(2, 12),
        workflow=WIND_DOWN,
        mishap=mishaps.ends(30),
        fault=_set("joint_pos", "nan"),
    ),
    _phase(
        "NaN in the approach",
        during="approach",
        ticks=(2, 12),
        real=True,
        workflow=BUSY,
        fault=_set("joint_pos", "nan"),
    ),
    _phase(
        "another variant than the robot file's",
        outcome="refuse",
        during="wait",
        ticks=(1, 5),
        reason="variant",
        real=True,
        workflow=BUSY,
        fault={"variant": {"protocol": "unheard of"}},
    ),
)

TIME = (
    _time(
        "a block hangs for 200 ms: told as overruns",
        outcome="go on",
        ticks=(5, 40),
        mishap=mishaps.hangs(0.2),
        overruns=8,
        real=True,
    ),
    _time(
        "a block hangs for 0.5 s",
        within=1,
        ticks=(5, 40),
        reason="hung",
        mishap=mishaps.hangs(0.5),
        real=True,
    ),
    _time(
        "every tick takes 1.6 periods, overrun_stop",
        within=25,
        ticks=(5, 40),
        reason="missed",
        mishap=mishaps.slows(1.6),
        also=("overrun_stop",),
        real=True,
    ),
    _time("stamps jump by an hour", outcome="go on", fault=_set("stamp_ns", HOUR, add=True)),
    _time("stamps jump back by an hour", outcome="go on", fault=_set("stamp_ns", -HOUR, add=True)),
    _time("the clock jumps by an hour", outcome="go on", mishap=mishaps.jumps_clock(3600.0)),
    _time("the clock jumps back", outcome="go on", mishap=mishaps.jumps_clock(-3600.0)),
)

VELOCITY = (
    _velocity("velocity command of 1e30", outcome="go on", mishap=mishaps.velocity(1e30)),
    _velocity("velocity command NaN", outcome="zero command", mishap=mishaps.velocity(math.nan)),
    _velocity("velocity command -inf", outcome="zero command", mishap=mishaps.velocity(-math.inf)),
)

NOT_CAUGHT = (
    _unseen("NaN in base_lin_vel, which nobody reads", fault=_set("base_lin_vel", "nan")),
)

CASES: tuple[SimulatedCase, ...] = (
    *(*SENSORS, *HARDWARE, *POLICY, *COMMANDS, *POSTURE, *PROGRAM),
    *(*ESTOP, *PHASES, *TIME, *VELOCITY, *NOT_CAUGHT),
)
