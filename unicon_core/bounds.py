"""What is plausible: the bounds of robot files, contracts and safety options, each with its reason.

Wide enough for every robot and contract that we know, narrow enough that a slip of the decimal
point, degrees for radians or an infinity does not pass. The largest figure known stands beside
each. Message maps have bounds of their own (`unicon_msgs_map/mapfile/document.py`), since they know
no robots.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, get_args

from unicon_base import WorkflowError
from unicon_base.schema.marks import Within, positive

POSITION = 4.0 * math.pi
"""|position| in [rad], [m] of sliding joints: two turns; go2's rear thighs have 4.54."""
VELOCITY = 200.0
"""In [rad/s]: azureloong's quickest joint has 110, legs 20 to 37."""
EFFORT = 1000.0
"""In [N·m]: azureloong's knees have 396."""
STIFFNESS = 2000.0
"""In [N·m/rad]: adam_lite's legs have 700, and A1's wire format ends at 2048."""
DAMPING = 200.0
"""In [N·m·s/rad]: adam_lite's legs have 30; beyond the like a sampled servo shakes."""
ACTION_SCALE = POSITION
"""In [rad] for one unit of action: published contracts have 0.07 to 1."""
SCALE = 1e6
"""Of an observation's term: published contracts have 0.05 to 2."""

SHARE = 1.0
"""Of the effort limits that `effort_limits` may allow: more than all is not a limit."""
TRIP_SHARE = 10.0
"""The same where it trips: a servo may ask for more than its motor gives, and does at a touch."""
VELOCITY_FACTOR = 3.0
"""Of the velocity limits at which `velocity_stop` trips: 1.5 unless given; a joint of 20 rad/s
seen at more than 60 is a broken encoder."""
TILT = 0.5 * math.pi
"""In [rad] for `tilt_stop`: a robot that lies on its side has fallen."""
STALE = 5.0
"""In [s] for `stale_stop`: 0.1 unless given; a humanoid falls within 1."""
POSE_DURATION = 0.1
"""Least duration of `pose` in [s]: what is shorter is a step."""
POSE_SPEED = 10.0
"""In [rad/s]: a joint that `pose` would move faster is given the time that it takes; lying to
standing in 2 s is 1.2 for go2, and legs can do 20 to 30."""
DURATION = 1e7
"""In [s]: four months; what is longer has no end, and says so by having no duration."""

LONGEST = 1e9
"""In [s], that a block counts: thirty years."""

Timeout = Annotated[float, positive(STALE, "s")]
"""Time after which a stop trips."""
Seconds = Annotated[float, Within(0.0, LONGEST, "s")]
"""Time that a block counts."""
Motion = Annotated[float, positive(POSITION, "rad")]
"""By which a joint moves, or is off."""
Speed = Annotated[float, positive(VELOCITY, "rad/s")]
"""Of a joint."""
MaxRate = Speed | Literal["robot"]
"""Of each joint, or the robot file's velocity limits."""
Stiffness = Annotated[float, Within(0.0, STIFFNESS, "N·m/rad")]
Damping = Annotated[float, Within(0.0, DAMPING, "N·m·s/rad")]
StiffnessScale = Annotated[float, Within(0.0, 2.0)]
DampingScale = Annotated[float, Within(0.0, 5.0)]
"""Factors on the robot file's gains."""
Scale = Annotated[float | None, positive(TRIP_SHARE)]
"""Of the robot file's limits; None for the usual."""


def within(
    value: Any, option: str, unit: str, highest: float, lowest: float = 0.0, *, above: bool = True
) -> float:
    """Return a value that is a number within its bounds.

    What a hint can say stands there instead: `Annotated[float, Unit(…), Within(…)]`.

    Args:
        value: as given.
        option: its name, for the message.
        unit: such as `rad/s`; "" for a factor.
        highest: allowed.
        lowest: allowed, or not allowed itself where `above` is true.
        above: whether `lowest` itself is refused.

    Raises:
        WorkflowError: it is not; the message has the range and the remedy.
    """
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and value <= highest and (value > lowest if above else value >= lowest)):
        end = f" [{unit}]" if unit else ""
        start = f"above {lowest:g}" if above else f"from {lowest:g}"
        raise WorkflowError(f"{option} is {value!r}; give a number {start} to {highest:g}{end}")
    return float(value)


Button = Literal[
    "R1",
    "L1",
    "start",
    "select",
    "R2",
    "L2",
    "F1",
    "F2",
    "A",
    "B",
    "X",
    "Y",
    "up",
    "right",
    "down",
    "left",
]
BUTTONS: tuple[Button, ...] = get_args(Button)
"""The elements of `buttons`, in the order of Unitree's remote."""
