"""Stops for what no robot measures and nobody means: `range_stop`, `command_stop`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import DAMPING, EFFORT, POSITION, STIFFNESS, VELOCITY, within
from unicon_core.errors import Fault, WorkflowError
from unicon_core.flow.block import Reads
from unicon_core.flow.stage import Stage
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.stacked import flat
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.autowire import BuildContext

__all__ = ["MEASURED", "RangeStop", "command_stop", "range_stop"]

Float = NDArray[np.float32]

ANGULAR_VELOCITY = 70.0
"""Of a base in [rad/s]: MEMS gyroscopes end at 2000 or 4000 °/s, 35 or 70 rad/s."""
QUATERNION = 1.01
"""Of a component: those of a unit quaternion, and of the direction of gravity, end at 1."""
UNBOUNDED = 1e6
"""Of what has no plausible bound, such as an acceleration at an impact: it has to be finite."""

MEASURED = (
    "joint_pos",
    "joint_vel",
    "joint_effort",
    "base_quat",
    "base_ang_vel",
    "base_lin_acc",
    "projected_gravity",
)
"""What `range_stop` looks at, as far as the platform measures it."""


def range_stop(context: BuildContext, *, margin: float = 0.5, factor: float = 3.0) -> RangeStop:
    """Stop where what was measured is NaN, infinite, or more than any robot of this kind does.

    Args:
        context: the platform says what is measured.
        margin: beyond the position limits in [rad]: 0.5 unless given; an encoder is off by more.
        factor: of the robot file's velocity limits.

    Raises:
        WorkflowError: an option is not plausible, or nothing is measured.
    """
    robot, states, platform = context.robot, context.states, context.platform
    margin = within(margin, "margin", "rad", POSITION, above=False, what="range_stop")
    factor = within(factor, "factor", "", 10.0, 1.0, above=False, what="range_stop")
    told = MEASURED if platform is None else platform.facts.writes
    names = [name for name in MEASURED if name in told and name in states]
    if not names:
        raise WorkflowError("the platform measures nothing that it looks at; leave it out")
    lower = np.nan_to_num(robot.lower, nan=-POSITION) - np.float32(margin)
    upper = np.nan_to_num(robot.upper, nan=POSITION) + np.float32(margin)
    speed = np.nan_to_num(robot.velocity_limit * factor, nan=VELOCITY)
    bounds: dict[str, tuple[Any, Any]] = {
        "joint_pos": (lower, upper),
        "joint_vel": (-speed, speed),
        "base_quat": (-QUATERNION, QUATERNION),
        "base_ang_vel": (-ANGULAR_VELOCITY, ANGULAR_VELOCITY),
        "projected_gravity": (-QUATERNION, QUATERNION),
    }
    return RangeStop(states, robot, {n: bounds.get(n, (-UNBOUNDED, UNBOUNDED)) for n in names})


def command_stop(
    joint_pos_target: Reads,
    joint_vel_target: Reads,
    joint_effort_ff: Reads,
    joint_stiffness: Reads,
    joint_damping: Reads,
    *,
    states: States,
    robot: Robot,
    stiffness: float = STIFFNESS,
    damping: float = DAMPING,
    factor: float = 2.0,
) -> RangeStop:
    """Stop where a command is NaN, infinite, or one that nobody can mean.

    A gain below 0 drives a joint away from its target; one beyond the bound is a slip of a decimal.

    Args:
        stiffness: the highest in [N·m/rad].
        damping: the highest in [N·m·s/rad].
        factor: of the robot file's limits of velocity and effort, for the velocity target and the
            feed-forward effort.
    """
    what = "command_stop"
    stiffness = within(stiffness, "stiffness", "N·m/rad", STIFFNESS, what=what)
    damping = within(damping, "damping", "N·m·s/rad", DAMPING, what=what)
    factor = within(factor, "factor", "", 10.0, what=what)
    speed = np.nan_to_num(robot.velocity_limit * factor, nan=VELOCITY)
    effort = np.nan_to_num(robot.effort_limit * factor, nan=EFFORT)
    bounds = dict(
        zip(
            COMMAND_STATES,
            (
                (-2.0 * POSITION, 2.0 * POSITION),
                (-speed, speed),
                (-effort, effort),
                (0.0, stiffness),
                (0.0, damping),
            ),
        )
    )
    return RangeStop(states, robot, bounds)


class RangeStop:
    """The tick of `range_stop` and `command_stop`.

    Args:
        states: of the workflow.
        robot: names the joints.
        bounds: state to its lowest and highest value, numbers or of shape (n,).
    """

    stage = Stage.SAFETY

    def __init__(self, states: States, robot: Robot, bounds: Mapping[str, tuple[Any, Any]]) -> None:
        self.reads = tuple(bounds)
        self._states, self._joints = states, robot.joint_names
        self._bounds = {
            name: tuple(np.broadcast_to(np.float32(bound), states[name].shape) for bound in pair)
            for name, pair in bounds.items()
        }
        lower, upper = (
            np.concatenate([pair[k].ravel() for pair in self._bounds.values()]).astype(np.float64)
            for k in (0, 1)
        )
        self._views = flat([states[name] for name in bounds])
        self._middle = (0.5 * (lower + upper)).astype(np.float32)
        self._scale = (2.0 / (upper - lower)).astype(np.float32)
        self._values = np.zeros(lower.size, np.float32)

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: a value is out of range; with state, element, value and range.
        """
        values, views = self._values, self._views
        whole = views[0] if len(views) == 1 else np.concatenate(views, out=values)
        np.subtract(whole, self._middle, out=values)
        np.multiply(values, self._scale, out=values)
        np.abs(values, out=values)
        if not values.max() <= 1.00001:  # true for NaN too; rounding is no fault
            self._raise()

    def _raise(self) -> None:
        for name, (lower, upper) in self._bounds.items():
            view = self._states[name]
            wrong = np.argwhere(~((view >= lower - 1e-4) & (view <= upper + 1e-4)))
            if not len(wrong):
                continue
            index = tuple(int(i) for i in wrong[0])
            who = f"robot {index[0]}: " if self._states.num_robots is not None else ""
            names: Sequence[str] = self._states.spec(name).names or self._joints
            which = names[index[-1]] if index and len(names) == view.shape[-1] else ""
            low, high = float(lower[index]), float(upper[index])
            unit = self._states.spec(name).unit
            raise Fault(
                f"{who}{name} of {which} is {view[index]:g} {unit}, which is not plausible: "
                f"{low:.4g} to {high:.4g}"
            )
