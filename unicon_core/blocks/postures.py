"""Blocks `pose`, `hold`, `damp` and `sway`: postures, and what moves about one.

With what they share with other blocks: the command states, the robot's gains, times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from unicon_base.arrays import Array, Float32
from unicon_base.errors import RobotError, WorkflowError
from unicon_base.schema.marks import Within, Write
from unicon_core.bounds import (
    DURATION,
    POSE_DURATION,
    POSE_SPEED,
    Damping,
    DampingScale,
    Seconds,
    StiffnessScale,
)
from unicon_core.flow.block import Bundle, Reads, Writes
from unicon_core.robots import Robot
from unicon_core.robots.load import joints_like, named_pose


@dataclass(frozen=True, eq=False)
class JointCommand(Bundle):
    """The command states of the tick and where the joints are, each of shape (..., n).

    Attributes:
        joint_pos: measured positions in [rad].
        joint_pos_target: in [rad].
        joint_vel_target: in [rad/s].
        joint_effort_ff: in [N·m].
        joint_stiffness: in [N·m/rad].
        joint_damping: in [N·m·s/rad].
    """

    joint_pos: Reads
    joint_pos_target: Writes
    joint_vel_target: Writes
    joint_effort_ff: Writes
    joint_stiffness: Writes
    joint_damping: Writes

    def entry(self, out: Array) -> None:
        """Write where a movement begins in [rad], shape (..., n).

        A joint that holds a target begins there, so that the torque does not jump; a limp one
        (stiffness 0) begins where it was measured.
        """
        out[...] = np.where(self.joint_stiffness > 0.0, self.joint_pos_target, self.joint_pos)


@dataclass(frozen=True, eq=False)
class Commands(Bundle):
    """The command states as a block reads them, in their order, each of shape (..., n)."""

    joint_pos_target: Reads
    joint_vel_target: Reads
    joint_effort_ff: Reads
    joint_stiffness: Reads
    joint_damping: Reads

    def __iter__(self) -> Iterator[Float32]:
        return iter(vars(self).values())


def robot_gains(
    robot: Robot,
    needed_for: str,
    stiffness_scale: float = 1.0,
    damping_scale: float = 1.0,
    stiffness: float | Mapping[str, float] | None = None,
    damping: float | Mapping[str, float] | None = None,
) -> tuple[Float32, Float32]:
    """Return the stiffness [N·m/rad] and damping [N·m·s/rad] of a robot file, each shape (n,).

    A robot whose vendor closes the position loop has none: 1 then stands for "on".

    Args:
        robot: the robot.
        needed_for: the block, for the message.
        stiffness_scale: factor on the stiffness.
        damping_scale: factor on the damping.
        stiffness: in [N·m/rad], in place of the robot file's and not scaled: of all joints, or of
            groups, joints and patterns.
        damping: in [N·m·s/rad], likewise.

    Raises:
        RobotError: a gain is unknown, or a word means no joint.
    """
    gains = []
    for key, values, scale, given in (
        ("stiffness", robot.joint_stiffness, stiffness_scale, stiffness),
        ("damping", robot.joint_damping, damping_scale, damping),
    ):
        known = np.where(np.isnan(values) & robot.by_position, 1.0, values) * np.float32(scale)
        each = given if isinstance(given, Mapping) else {} if given is None else {"*": given}
        for word, gain in each.items():
            known[robot.group([word])] = gain
        unknown = [name for name, value in zip(robot.joint_names, known) if math.isnan(value)]
        if unknown:
            raise RobotError(
                f"block {needed_for!r}: robot {robot.name} does not say the {key} of joint "
                f"{unknown[0]} ({len(unknown)} joints); give it in {robot.file_of(unknown[0])}"
            )
        gains.append(known.astype(np.float32))
    return gains[0], gains[1]


class Counting:
    """Base of blocks that count their ticks from 1 on since their flow entered them."""

    memory: tuple[str, ...] = ("_tick",)
    _tick = 0

    def reset(self) -> None:
        """Begin anew with the next tick."""
        self._tick = 0


def ticks_of(seconds: float, period: float) -> int:
    """Return a time as a number of ticks, at least 1."""
    return max(round(seconds / period), 1)


NEVER = (1 << 63) - 1
"""A number of ticks that is never reached."""


def end_of(duration: float | None, period: float) -> int:
    """Return a duration as a number of ticks, at least 1; `NEVER` for None."""
    return NEVER if duration is None else ticks_of(duration, period)


def single(view: Array) -> None:
    """Refuse states of several robots, by a view whose robots are its first axis but one.

    Raises:
        WorkflowError: they are.
    """
    if view.ndim > 1:
        raise WorkflowError("it is for one robot; leave num_robots out, or leave it out")


LONGEST = 1e9
"""Ticks of a pose at most: a position of 1e30 rad is garbage, and no robot gets there."""


class Pose(Counting):
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

    memory = ("_start", "_way", "_first", "_ticks")

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

    def __call__(self) -> bool:
        command = self._command
        if self._tick == 0:
            command.entry(self._start)
            np.subtract(self._goal, self._start, out=self._way)
            self._way *= self._said
            farthest = float(np.abs(self._way).max())
            if self._way.ndim == 1 and math.isfinite(farthest):  # a batch is simulated
                ticks = math.ceil(min(farthest * self._ticks_per_rad, LONGEST))
                self._ticks = max(self._asked, ticks)
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


class Hold(Counting):
    """Keep the position targets of the moment of entry; limp joints keep their measured position.

    Args:
        duration: in [s]; None never ends.
        keep_gains: leave stiffness and damping as the block before set them (a policy's), instead
            of the robot file's.
    """

    memory = ("_held",)

    def __init__(
        self,
        command: JointCommand,
        *,
        robot: Robot,
        period: float,
        duration: Seconds | None = None,
        keep_gains: bool = False,
    ) -> None:
        self._command = command
        self._ticks = end_of(duration, period)
        self.endless = duration is None
        self.gains = None if keep_gains else robot_gains(robot, "hold")
        self._held = np.zeros_like(command.joint_pos_target)

    def __call__(self) -> bool:
        command = self._command
        if self._tick == 0:
            command.entry(self._held)
        self._tick += 1
        command.joint_pos_target[...] = self._held
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        if self.gains is not None:
            command.joint_stiffness[...], command.joint_damping[...] = self.gains
        return self._tick >= self._ticks


class Damp(Counting):
    """Let go: stiffness 0, damping against every motion, targets at the measured positions.

    Args:
        duration: in [s]; None never ends.
        damping: of every joint in [N·m·s/rad]; None for the robot file's.
    """

    def __init__(
        self,
        command: JointCommand,
        *,
        robot: Robot,
        period: float,
        duration: Seconds | None = None,
        damping: Damping | None = None,
    ) -> None:
        self._command = command
        self._ticks = end_of(duration, period)
        self._gain = (
            robot_gains(robot, "damp")[1]
            if damping is None
            else np.full(robot.num_joints, damping, np.float32)
        )
        self.endless = duration is None

    def __call__(self) -> bool:
        command = self._command
        command.joint_pos_target[...] = command.joint_pos
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        command.joint_stiffness[...] = 0.0
        command.joint_damping[...] = self._gain
        self._tick += 1
        return self._tick >= self._ticks


OTHERS = "give gains of its joints, or run h1_stand, which names none"
"""What helps a robot that the workflow was not written for."""


class Sway(Counting):
    """Move the position targets around a pose: target = pose + K (command + own oscillation).

    The targets stay within the robot's joint limits.

    Args:
        gains: joint names and patterns to their row of K: radians for each m/s of vx, m/s of vy and
            rad/s of wz; rows of patterns that meet on a joint add up.
        amplitude: of the block's own sine command, vx, vy in [m/s] and wz in [rad/s].
        frequency: of that sine in [Hz].
        time_constant: of the first-order filter on the targets in [s].
        around: the pose, as for `pose`.
        duration: in [s]; None never ends.
    """

    memory = ("_filtered",)

    def __init__(
        self,
        command: JointCommand,
        velocity_command: Reads,
        *,
        robot: Robot,
        period: float,
        gains: Mapping[
            str, Annotated[tuple[float, float, float], Write("[per vx, per vy, per wz]")]
        ],
        amplitude: Annotated[tuple[float, float, float], Write("[vx, vy, wz]")] = (0.0, 0.0, 0.0),
        frequency: float = 0.5,
        time_constant: float = 0.3,
        around: str | Mapping[str, float] = "stand",
        duration: Seconds | None = None,
    ) -> None:
        matrix = np.zeros((3, robot.num_joints), np.float32)
        for pattern, row in gains.items():
            matrix[:, joints_like(pattern, robot, OTHERS)] += np.asarray(row, np.float32)[:, None]
        centre, said = named_pose(around, robot, "block 'sway'")
        self._centre = np.where(said > 0.0, centre, np.nan_to_num(robot.default_joint_pos))
        self._command = command
        self._velocity = velocity_command
        self._amplitude = np.asarray(amplitude, np.float32)
        self._turn = 2.0 * math.pi * frequency * period
        self._share = 1.0 if time_constant <= 0.0 else -math.expm1(-period / time_constant)
        self._lower, self._upper = robot.limits()
        self.gains = robot_gains(robot, "sway")
        self._ticks = end_of(duration, period)
        self.endless = duration is None
        self._filtered, self._wanted, self._moved = (
            np.zeros_like(command.joint_pos_target) for _ in range(3)
        )
        self._twist = np.zeros_like(velocity_command)
        self._parts = [(self._twist[..., i : i + 1], row) for i, row in enumerate(matrix)]

    def __call__(self) -> bool:
        command = self._command
        wanted = self._wanted
        filtered = self._filtered
        if self._tick == 0:
            command.entry(filtered)
        self._tick += 1
        np.multiply(self._amplitude, math.sin(self._turn * self._tick), out=self._twist)
        self._twist += self._velocity
        # No matrix product: BLAS rounds a batch otherwise than a single robot.
        wanted[...] = self._centre
        for part, row in self._parts:
            np.multiply(part, row, out=self._moved)
            wanted += self._moved
        np.maximum(wanted, self._lower, out=wanted)
        np.minimum(wanted, self._upper, out=wanted)
        wanted -= filtered
        wanted *= self._share
        filtered += wanted
        command.joint_pos_target[...] = filtered
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        command.joint_stiffness[...], command.joint_damping[...] = self.gains
        return self._tick >= self._ticks
