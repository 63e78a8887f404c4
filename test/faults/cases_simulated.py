"""Cases in MuJoCo: sensors, hardware, policy, commands and posture; with those of phases all."""

from __future__ import annotations

import math
from functools import partial

from faults import mishaps
from faults.cases_phases import ESTOP, PHASES, PROGRAM, TIME, VELOCITY
from faults.simulated_case import SimulatedCase, set_to
from unicon_core.workflow.tick_tree import ROBOT_SAFETY

_sensor = partial(SimulatedCase, "sensors")
_hardware = partial(SimulatedCase, "hardware")
_policy = partial(SimulatedCase, "policy", ticks=(35, 140))  # from there on it is asked
_command = partial(SimulatedCase, "commands")
_body = partial(SimulatedCase, "posture")
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


SENSORS = (
    *(
        _sensor(
            f"{value} in {state}",
            fault=set_to(state, value),
            reason="",
            quick=(state, value) == ("joint_pos", "nan"),
        )
        for state in MEASURED
        for value in ("nan", "inf", "1e30")
    ),
    _sensor("NaN in one joint's position", fault=set_to("joint_pos", "nan", 3)),
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
        fault=set_to("base_ang_vel", 2.0, 2, add=True),
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
        fault=set_to("joint_pos", 0.3, KNEE, add=True),
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
            ("are zero", set_to("joint_vel", 0.0)),
            ("have the other sign", {"scale": {"joint_vel": -1.0}}),
        )
    ),
    _sensor("stamps stand still", within=5, reason="stale", fault={"freeze": ["stamp_ns"]}),
    _sensor("the robot falls silent (recv tells)", reason="made by", fault={"raise": "Fault"}),
)

HARDWARE = (
    _hardware(
        "a motor at 120 °C", reason="motor_temp", fault=set_to("motor_temperature", 120.0, 2)
    ),
    _hardware("NaN in motor_temperature", reason="nan", fault=set_to("motor_temperature", "nan")),
    _hardware("a motor tells an error", reason="motor_error", fault=set_to("motor_error", 7, 5)),
    _hardware("a motor leaves its mode", reason="is in mode", fault={"mode": 0, "joint": KNEE}),
    _hardware("a motor is too hot to go on, mode 8", reason="is", fault={"mode": 8, "joint": 0}),
    _hardware(
        "the operator holds all buttons of the remote",
        within=1,
        reason="the operator pressed",
        fault=set_to("buttons", 1),
    ),
    _hardware("NaN in battery_charge", reason="nan", fault=set_to("battery_charge", "nan")),
    _hardware("the battery is empty", reason="battery", fault=set_to("battery_charge", 0.01)),
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
    _body("the base leans by 90°", reason="leans", fault=set_to("projected_gravity", 0.0)),
    _body(
        "the base is too low, height_stop",
        reason="base_pos_w",
        fault=set_to("base_pos_w", 0.02),
        also=({"height_stop": {"lowest": 0.05}},),
    ),
    _body(
        "NaN in base_pos_w, height_stop",
        reason="base_pos_w",
        fault=set_to("base_pos_w", "nan"),
        also=({"height_stop": {"lowest": 0.05}},),
    ),
    _body(
        "a joint is 1 rad past its limit", reason="joint_pos", fault=set_to("joint_pos", 4.5, KNEE)
    ),
    _body("a joint turns at 300 rad/s", reason="joint_vel", fault=set_to("joint_vel", 300.0, KNEE)),
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

NOT_CAUGHT = (
    _unseen("NaN in base_lin_vel, which nobody reads", fault=set_to("base_lin_vel", "nan")),
)

CASES: tuple[SimulatedCase, ...] = (
    *(*SENSORS, *HARDWARE, *POLICY, *COMMANDS, *POSTURE, *PROGRAM),
    *(*ESTOP, *PHASES, *TIME, *VELOCITY, *NOT_CAUGHT),
)
