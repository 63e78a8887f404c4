"""The standard vocabulary: the states that every robot of n joints has, and those of end effectors.

`standard.json` has a line for each but those of end effectors. Names, units and frames are those of
REP-103, REP-105 and REP-145; quaternions are wxyz. Of an end effector they are, for example,
left_hand_target, left_hand_target_velocity, left_hand_target_stamp_ns, left_hand_pose.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Sequence
from pathlib import Path

from unicon_base import AnyDict
from unicon_core.bounds import BUTTONS
from unicon_core.states.layout import StateSpec

JOINT_STATES = ("joint_pos", "joint_vel", "joint_effort")
"""What the motors tell of the joints."""

BASE_STATES = (
    "base_quat",
    "base_ang_vel",
    "base_lin_acc",
    "projected_gravity",
    "base_pos_w",
    "base_lin_vel",
)
"""What is measured of a base that moves, the last two by simulators and trackers alone."""

ESTIMATORS = {
    "projected_gravity": "projected_gravity",
    "base_lin_vel": "leg_odometry",
    "base_pos_w": "leg_odometry",
}
"""What may not be measured to the block that computes it of what is; the latter two of legs."""

COMMAND_STATES = (
    "joint_pos_target",
    "joint_vel_target",
    "joint_effort_ff",
    "joint_stiffness",
    "joint_damping",
)
"""What leaves for the motors: the states that a platform's `send` reads."""

GAIN_SCALE = "gain_scale"
GAIN_SCALE_SPEC = StateSpec(
    (2,),
    "float64",
    names=("joint_stiffness", "joint_damping"),
    description="factors of the gains, by the host of the workflow",
    initial=1.0,
)
"""Of the state that a host which scales gains adds to a workflow, so that records tell it."""


MOTOR_STATES = ("motor_temperature", "motor_error", "motor_status")
"""What a robot may tell of its motors, an element for each joint."""

HARDWARE_STATES = (*MOTOR_STATES, "battery_charge", "battery_voltage")
"""What a robot may tell of itself: states only of workflows whose platform writes them."""


FORWARDED_STATES = ("joint_pos_command", "joint_vel_command", "joint_effort_command")
"""What somebody outside wants of the joints: states of workflows with a `forward_command`."""

CONTROL_STATES = ("sticks", "buttons", "controls_alive")
"""What an operator holds in his hands: states of workflows whose platform or block writes them."""


_TABLE: dict[str, dict[str, AnyDict]] = json.loads(
    Path(__file__).with_suffix(".json").read_text("utf-8")
)
"""Group to its states, each with what differs from a plain number: `names` are elements, or
`joints` or `buttons` for those of a robot or a remote."""


def _states_of(group: str, joint_names: Sequence[str] = ()) -> dict[str, StateSpec]:
    """Return the states of a group in the table."""
    known: AnyDict = {"joints": joint_names, "buttons": BUTTONS}
    found = {}
    for name, said in _TABLE[group].items():
        values: AnyDict = {k: tuple(x) if isinstance(x, list) else x for k, x in said.items()}
        if "names" in values:
            names = values["names"]
            values["names"] = tuple(known[names] if isinstance(names, str) else names)
            values["shape"] = (len(values["names"]),)
        found[name] = StateSpec(**values)
    return found


def control_states() -> dict[str, StateSpec]:
    """Return the states of a remote, gamepad or keyboard, all zero where nobody holds one."""
    return _states_of("control")


def forwarded_states(joint_names: Sequence[str]) -> dict[str, StateSpec]:
    """Return the states of joint commands from outside, all NaN where nobody commands.

    Args:
        joint_names: names in the robot's (vendor's) order, length n.
    """
    return _states_of("forwarded", joint_names)


def hardware_states(joint_names: Sequence[str]) -> dict[str, StateSpec]:
    """Return the states of hardware, which a workflow has where its platform writes them.

    Args:
        joint_names: names in the robot's (vendor's) order, length n.
    """
    return _states_of("hardware", joint_names)


def standard_states(joint_names: Sequence[str]) -> dict[str, StateSpec]:
    """Return the standard states of a robot.

    Args:
        joint_names: names in the robot's (vendor's) order, length n.

    Returns:
        Name to specification: `joint_*` of shape (n,), base states, command and time.
    """
    return _states_of("standard", joint_names)


EXTERNAL_FORCE, EXTERNAL_PUSH = "external_force", "external_push"
"""What acts on a simulated robot from outside: states of runs in which a viewer may push it."""


def external_states() -> dict[str, StateSpec]:
    """Return the states of a force on one body, and of an impulse on the base.

    A simulator whose facts name `external_force` applies the force for as long as it stands there;
    a block that writes `external_push` pushes the platform in the same tick.
    """
    return _states_of("external")


POSE_NAMES = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Elements of a pose: position in [m], orientation as a unit quaternion."""

_TWIST_NAMES = ("vx", "vy", "vz", "wx", "wy", "wz")


def target_of(effector: str) -> tuple[str, str, str]:
    """Return the names of an end effector's target, its velocity and its stamp."""
    return f"{effector}_target", f"{effector}_target_velocity", f"{effector}_target_stamp_ns"


def pose_of(effector: str) -> str:
    """Return the name of the state that tells where an end effector is."""
    return f"{effector}_pose"


def target_states(effector: str) -> dict[str, StateSpec]:
    """Return the states of a target in the robot's base frame, NaN where nobody gives one.

    Args:
        effector: name of the end effector in the robot file.

    Returns:
        `E_target`: position [m] and quaternion wxyz, shape (7,); `E_target_velocity`: linear [m/s]
        and angular [rad/s], shape (6,), 0 where it is not known; `E_target_stamp_ns`: when the
        target was true, in the time of `stamp_ns`, 0 for now.
    """
    target, velocity, stamp = target_of(effector)
    what = f"of the target of {effector}"
    return {
        target: StateSpec(
            (7,),
            frame="base",
            names=POSE_NAMES,
            description=f"position [m] and orientation {what}; NaN: none",
            initial=math.nan,
        ),
        velocity: StateSpec(
            (6,),
            frame="base",
            names=_TWIST_NAMES,
            description=f"velocity [m/s, rad/s] {what}; 0 where not known",
        ),
        stamp: StateSpec((), "int64", "ns", description=f"source time {what}; 0: now"),
    }


def pose_states(effector: str, frame: str = "base") -> dict[str, StateSpec]:
    """Return the state of where an end effector is, NaN until somebody knows it.

    Args:
        effector: its name.
        frame: `base` or `world`.
    """
    said = f"position [m] and orientation of {effector}; NaN: not known"
    spec = StateSpec((7,), frame=frame, names=POSE_NAMES, description=said, initial=math.nan)
    return {pose_of(effector): spec}


def unsaid_states(names: Collection[str]) -> list[str]:
    """Return the states of targets that nobody has to write: 0 is a velocity, and a stamp, unknown.

    Args:
        names: of all states.
    """
    ends = ("_velocity", "_stamp_ns")
    targets = [name for name in names if name.endswith("_target")]
    return [name + end for name in targets for end in ends if name + end in names]
