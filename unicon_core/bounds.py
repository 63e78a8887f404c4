"""What is plausible: the bounds of robot files, contracts and safety options, each with its reason.

Wide enough for every robot and contract that we know, narrow enough that a slip of the decimal
point, degrees for radians or an infinity does not pass. The largest figure known stands beside
each. Message maps have bounds of their own (`unicon_msgs_map/mapfile/document.py`), since they know
no robots.
"""

from __future__ import annotations

import math
from typing import Any

from unicon_core.errors import WorkflowError

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
GAIN_SCALES = {"stiffness_scale": 2.0, "damping_scale": 5.0}
"""Factors on a robot file's gains, as of the node's parameters of these names."""
POSE_DURATION = 0.1
"""Least duration of `pose` in [s]: what is shorter is a step."""
POSE_SPEED = 10.0
"""In [rad/s]: a joint that `pose` would move faster is given the time that it takes; lying to
standing in 2 s is 1.2 for go2, and legs can do 20 to 30."""
DURATION = 1e7
"""In [s]: four months; what is longer has no end, and says so by having no duration."""


def within(
    value: Any,
    option: str,
    unit: str,
    highest: float,
    lowest: float = 0.0,
    *,
    above: bool = True,
    what: str = "",
) -> float:
    """Return an option that is a number within its bounds.

    Args:
        value: as given.
        option: its name, for the message.
        unit: such as `rad/s`; "" for a factor.
        highest: allowed.
        lowest: allowed, or not allowed itself where `above` is true.
        above: whether `lowest` itself is refused.
        what: it would switch off, a block; the message then says how to do so honestly.

    Raises:
        WorkflowError: it is not; the message has the range and the remedy.
    """
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and value <= highest and (value > lowest if above else value >= lowest)):
        end = f" [{unit}]" if unit else ""
        start = f"above {lowest:g}" if above else f"from {lowest:g}"
        off = f"; to run without {what} leave it out of safety:" if what else ""
        raise WorkflowError(
            f"{option} is {value!r}; give a number {start} to {highest:g}{end}{off}"
        )
    return float(value)
