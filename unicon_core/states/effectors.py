"""States of an end effector: where it shall be and where it is, for blocks that bring it there.

left_hand_target, left_hand_target_velocity, left_hand_target_stamp_ns, left_hand_pose
"""

from __future__ import annotations

import math
from collections.abc import Collection

from unicon_core.states.spec import StateSpec

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
