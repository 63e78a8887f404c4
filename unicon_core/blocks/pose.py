"""Block `pose`: goes smoothly into a posture and is done there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np

from unicon_core.blocks.joint_command import JointCommand, robot_gains, ticks_of
from unicon_core.bounds import (
    DURATION,
    POSE_DURATION,
    POSE_SPEED,
    DampingScale,
    Seconds,
    StiffnessScale,
)
from unicon_core.robots import Robot
from unicon_core.robots.poses import named_pose
from unicon_core.schema.marks import Within


class Pose:
    """Interpolate the position targets from where they are to a pose.

    The path is half a cosine: it begins and ends at rest, and its largest speed is
    π/2 · distance / duration. A joint that would be faster than 10 rad/s is given the time that
    it takes, so the block may last longer than told.

    Args:
        to: `stand` (`default`), `rest` (`lie`), or joint names and patterns (`*_knee_joint`) to
            [rad]; joints that are not named stay where they are.
        duration: in [s], at least 0.1; done at its end.
        fade_in: time in [s] over which the gains go from their present values to the robot's.
        stiffness_scale: factor on the robot file's stiffness.
        damping_scale: factor on the robot file's damping.
    """

    memory = ("_start", "_way", "_first", "_ticks", "_tick")

    def __init__(
        self,
        command: JointCommand,
        *,
        robot: Robot,
        period: float,
        to: str | Mapping[str, float] = "stand",
        duration: Annotated[float, Within(POSE_DURATION, DURATION, "s")] = 2.0,
        fade_in: Seconds = 0.0,
        stiffness_scale: StiffnessScale = 1.0,
        damping_scale: DampingScale = 1.0,
    ) -> None:
        self._command = command
        self._goal, self._said = named_pose(to, robot, "block 'pose'")
        if isinstance(to, str):  # a wheel is left where it stands
            self._said = np.where(robot.endless, np.float32(0.0), self._said)
        self.gains = gains = robot_gains(robot, "pose", stiffness_scale, damping_scale)
        self._asked = self._ticks = ticks_of(duration, period)
        # Peak speed π/2 · way / time: ticks that a way of 1 rad takes at the speed allowed.
        self._ticks_per_rad = 0.5 * math.pi / (POSE_SPEED * period)
        self._fade_ticks = ticks_of(fade_in, period)
        self._start, self._way = (np.zeros_like(command.joint_pos_target) for _ in range(2))
        # The states, what they held at the beginning, and the gains that they go to.
        states = (command.joint_stiffness, command.joint_damping)
        self._first = [out.copy() for out in states]
        self._fades = list(zip(states, self._first, gains))
        self._tick = 0

    def __call__(self) -> bool:
        command = self._command
        if self._tick == 0:
            command.entry(self._start)
            np.subtract(self._goal, self._start, out=self._way)
            self._way *= self._said
            farthest = float(np.abs(self._way).max())
            if self._way.ndim == 1 and math.isfinite(farthest):  # a batch is simulated
                self._ticks = max(self._asked, math.ceil(farthest * self._ticks_per_rad))
            for out, first, _ in self._fades:
                first[...] = out
        self._tick += 1
        done = self._tick >= self._ticks
        share = 1.0 if done else 0.5 - 0.5 * math.cos(math.pi * self._tick / self._ticks)
        target = command.joint_pos_target
        np.multiply(self._way, share, out=target)
        target += self._start
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        self._write_gains()
        return done

    def _write_gains(self) -> None:
        faded = min(self._tick / self._fade_ticks, 1.0)
        for out, first, gain in self._fades:
            if faded == 1.0:
                out[...] = gain
            else:  # first + faded · (gain - first), in place
                np.subtract(gain, first, out=out)
                out *= faded
                out += first

    def reset(self) -> None:
        """Begin anew from wherever the joints are at the next tick."""
        self._tick = 0
