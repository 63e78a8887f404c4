"""Block `moving_target`: a target on a circle for an end effector, to try out what follows it.

commands: [{moving_target: {effector: left_hand, radius: 0.08, frequency: 0.4}}]
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import Point, Within
from unicon_core.blocks.joint_command import single
from unicon_core.blocks.whole_body.frames import effector_of
from unicon_core.bounds import DURATION
from unicon_core.flow.block import Reads
from unicon_core.models.frames import Frames
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import target_of, target_states
from unicon_core.workflow.autowire import BuildContext

LARGEST = 1.0
"""Radius in [m]: an arm is no longer."""
QUICKEST = 10.0
"""In [Hz]: a person shakes a hand at 5 to 8."""
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


class MovingTarget:
    """Move an end effector's target on a circle in the base frame, from its centre on.

    The orientation is that of the end effector at the robot's default pose. Over `ramp` the radius
    grows from 0, as half a cosine; velocity and stamp are told with the target.

    Args:
        stamp_ns: source time of the robot's data, shape ().
        effector: of the robot file.
        centre: x, y, z in [m], or `default`: where it is at the robot's default pose.
        radius: in [m].
        frequency: in [Hz].
        plane: of the circle; it turns from the first axis to the second.
        ramp: in [s].

    Raises:
        WorkflowError: no such end effector, or the states are of a batch.
        ModelError: there is no model, or it lacks the body.
    """

    memory = ("_ticks",)

    endless = True

    def __init__(
        self,
        stamp_ns: Reads,
        *,
        context: BuildContext,
        effector: str,
        centre: Literal["default"] | Point = "default",
        radius: Annotated[float, Within(0.0, LARGEST, "m")] = 0.08,
        frequency: Annotated[float, Within(0.0, QUICKEST, "Hz")] = 0.4,
        plane: Literal["xy", "xz", "yz"] = "yz",
        ramp: Annotated[float, Within(0.0, DURATION, "s")] = 2.0,
    ) -> None:
        single(stamp_ns[..., None])
        robot = context.robot
        places = {effector: effector_of(effector, robot, "moving_target")}
        frames = Frames(context.model("moving_target"), robot, places)
        middle = self._middle = frames.of(robot.default_joint_pos)[effector]
        if centre != "default":
            middle[:3] = centre
        if not np.isfinite(middle).all():
            raise WorkflowError(
                f"robot {robot.name} does not say its default pose; give centre: [x, y, z], and "
                f"the default of every joint in {robot.path}"
            )
        self.writes = target_of(effector)
        self._target, self._velocity, self._said = (context.states[name] for name in self.writes)
        self._stamp, self._radius, self._turn = stamp_ns, radius, 2.0 * math.pi * frequency
        self._axes, self._ramp, self._period = PLANES[plane], ramp, context.period
        self._ticks = 0

    @staticmethod
    def declares(*, robot: Robot, effector: str = "", **_: Any) -> dict[str, StateSpec]:
        """Return the states of the target; without an end effector none, which the build tells."""
        if not effector:
            return {}
        effector_of(effector, robot, "moving_target")
        return target_states(effector)

    def __call__(self) -> None:
        time = self._ticks * self._period
        self._ticks += 1
        # r(t) = R (1 - cos πt/T) / 2, and its velocity.
        radius, grows = self._radius, 0.0
        if time < self._ramp:
            angle = math.pi * time / self._ramp
            grows = 0.5 * math.pi / self._ramp * radius * math.sin(angle)
            radius *= 0.5 - 0.5 * math.cos(angle)
        target, velocity, middle, (i, j) = self._target, self._velocity, self._middle, self._axes
        c, s = math.cos(self._turn * time), math.sin(self._turn * time)
        target[:] = middle
        target[i], target[j] = middle[i] + radius * c, middle[j] + radius * s
        velocity[:] = 0.0
        velocity[i] = grows * c - radius * self._turn * s
        velocity[j] = grows * s + radius * self._turn * c
        self._said[...] = self._stamp

    def reset(self) -> None:
        """Begin at the centre again."""
        self._ticks = 0
