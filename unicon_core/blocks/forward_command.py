"""Block `forward_command`: follows joint commands of somebody else, such as a ROS topic's.

flow: {chain: [{pose: {to: stand}}, {forward_command: {max_rate: 2.0}}]}

What ros2_control's forward_command_controller is to its hardware, with bounds: no joint
moves faster than the bound, no matter what commands. An element that is NaN is ignored.

    forward_command: {moves: [arms], silent: home}     # beside a policy that walks on the legs
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.errors import RobotError
from unicon_base.schema.marks import Within, positive
from unicon_core.blocks.postures import JointCommand, end_of, robot_gains
from unicon_core.blocks.safety.limits import rates_of
from unicon_core.bounds import (
    DURATION,
    Damping,
    DampingScale,
    MaxRate,
    Motion,
    Speed,
    Stiffness,
    StiffnessScale,
)
from unicon_core.flow.block import Bundle, Reads
from unicon_core.models.loaded import index_of
from unicon_core.robots import Robot
from unicon_core.robots.load import named_pose
from unicon_core.states import StateSpec
from unicon_core.states.groups import COMMAND, subset
from unicon_core.states.links import Incoming, Silent, Store, open_reader
from unicon_core.states.standard import COMMAND_STATES, forwarded_states
from unicon_core.workflow.autowire import BuildContext

MAX_RATE = 2.0
"""In [rad/s], unless told: an arm that is jogged has 0.5 to 3, and a person can step back."""

HOME_RATE = 1.0
"""In [rad/s] to the robot's default pose where nobody commands: an arm is home within 2 s."""

MOST_INTEGRAL = 20.0
"""In [1/s]: a joint's servo settles in 0.1 to 0.3 s, and has to be quicker."""
FARTHEST = 0.25
"""In [rad], that the integral moves a target at most: a leg's sag is 0.05 to 0.15."""


@dataclass(frozen=True, eq=False)
class CommandStates(Bundle):
    """What somebody else wants of the joints, each of shape (..., n); NaN where nothing.

    Attributes:
        joint_pos_command: in [rad].
        joint_vel_command: in [rad/s].
        joint_effort_command: in [N·m].
    """

    joint_pos_command: Reads
    joint_vel_command: Reads
    joint_effort_command: Reads


class ForwardCommand:
    """Let the position targets go to the commanded positions, no faster than a speed.

    A joint without a command keeps its target; it begins where it is on entry, as `hold`. Commanded
    velocities and efforts are added as feed-forward, within `max_rate` and the robot's efforts.
    Positions stay within the robot's joint limits.

    Args:
        max_rate: of a target in [rad/s], or `robot` for the robot file's velocity limits.
        moves: groups, joints or patterns that it moves, all unless told; others are left alone.
        silent: where nothing at all is commanded of these joints, they `hold`, or go `home`, to the
            robot file's default pose unless told; when commands come back they go there from where
            they are.
        home_rate: in [rad/s], on the way home.
        home: pose to go to instead, as of block `pose`; joints that it does not say go to the
            default one.
        start_tolerance: how far from the present target in [rad] the first command after silence
            may be; one that is farther off is told once and not followed. None: any.
        integral: gain in [1/s] by which a target is moved on, by 0.25 rad at most, against what
            gravity leaves between the commanded and the measured position; 0 for none.
        stiffness_scale: factor on the robot file's stiffness; 0 follows efforts and velocities.
        damping_scale: factor on the robot file's damping.
        stiffness: in [N·m/rad] in place of the robot file's: a number for all joints that it
            moves, or groups, joints and patterns to numbers.
        damping: in [N·m·s/rad], likewise.
        duration: in [s]; None never ends.

    Attributes:
        max_rate: of each target in [rad/s], shape (n,).
        moves: groups, joints or patterns, as they were given; none for all joints.
        held: positions that are commanded in this tick in [rad], shape (..., n).
        ticks: that it has run since its flow entered it; who gives commands sees whether anybody
            follows them.

    Raises:
        RobotError: the robot file lacks a gain or the pose to go home to, or a word means no joint.
        WorkflowError: there is no such pose to go home to, or it is beyond a limit.
    """

    memory = ("held", "ticks", "_offset", "_heard", "_refused")

    def __init__(
        self,
        command: JointCommand,
        commanded: CommandStates,
        *,
        context: BuildContext,
        max_rate: MaxRate = MAX_RATE,
        moves: Sequence[str] = (),
        silent: Literal["hold", "home"] = "hold",
        home_rate: Speed = HOME_RATE,
        home: str | Mapping[str, float] = "default",
        start_tolerance: Motion | None = None,
        integral: Annotated[float, Within(0.0, MOST_INTEGRAL, "1/s")] = 0.0,
        stiffness_scale: StiffnessScale = 1.0,
        damping_scale: DampingScale = 1.0,
        stiffness: Stiffness | Mapping[str, Stiffness] | None = None,
        damping: Damping | Mapping[str, Damping] | None = None,
        duration: Annotated[float | None, positive(DURATION, "s")] = None,
    ) -> None:
        robot = context.robot
        period = context.period
        scales = stiffness_scale, damping_scale
        self.gains = robot_gains(robot, "forward_command", *scales, stiffness, damping)
        self.moves = tuple(moves)
        self._places = robot.group(self.moves or robot.joint_names)
        self._at = (..., index_of(self._places.tolist()))
        self._command = command
        self._commanded = commanded
        self._robot = robot
        self._ends = end_of(duration, period)
        self.endless = duration is None
        self.max_rate = rates_of(max_rate, robot, "forward_command")
        self.ticks = 0
        self._period = np.float32(period)
        self._step = self._steps = (self.max_rate * period).astype(np.float32)
        self._lower, self._upper = robot.limits()
        self._effort = np.nan_to_num(robot.effort_limit, nan=np.inf)
        target = command.joint_pos_target
        self.held, self._bound, self._wanted, self._fed = (np.zeros_like(target) for _ in range(4))
        self._share = np.float32(integral * period)
        self._offset = np.zeros_like(target)
        self._silent = np.zeros(target.shape, np.bool_)
        self._home: tuple[Float32, Float32] | None = None
        self._tolerance = np.inf if start_tolerance is None else start_tolerance
        self._tell = context.tell
        self._heard = False
        self._refused = False
        if silent == "home":
            self._go_home(home_rate, home)

    @staticmethod
    def declares(*, robot: Robot, **_: Any) -> Mapping[str, StateSpec]:
        """Return the states of joint commands."""
        return forwarded_states(robot.joint_names)

    def _go_home(self, rate: float, to: str | Mapping[str, float]) -> None:
        """Let joints of which nothing is commanded go to a pose, at a rate in [rad/s]."""
        robot = self._robot
        home = self._robot.default_joint_pos
        if to != "default":
            pose, said = named_pose(to, robot, "block 'forward_command'")
            home = np.where(said, pose, home).astype(np.float32)
        for place in self._places:
            if np.isnan(home[place]):
                joint = robot.joint_names[place]
                raise RobotError(
                    f"block 'forward_command': robot {robot.name} does not say the default pose of "
                    f"joint {joint}, where silent: home goes; give it in {robot.file_of(joint)}, "
                    "or take silent: hold"
                )
        step = np.fmin(self._step, np.float32(rate) * self._period)
        self._home = home, np.where(robot.endless, np.float32(0.0), step)  # a wheel stays
        self._steps = np.empty_like(self.held)
        self._goes = np.empty_like(self._silent)

    def __call__(self) -> bool:
        command = self._command
        held = self.held
        if self.ticks == 0:
            command.entry(held)
            self._offset[...] = 0.0
            self._heard = self._refused = False
        self.ticks += 1
        wanted = self._wanted
        np.copyto(wanted, self._commanded.joint_pos_command)
        np.isnan(wanted, out=self._silent)
        np.copyto(wanted, held, where=self._silent)
        if self._tolerance < np.inf:
            self._begin()
        if self._home is not None:
            self._head_home(*self._home)
        # Within the limits, and no faster than allowed from where the target is.
        np.maximum(wanted, self._lower, out=wanted)
        np.minimum(wanted, self._upper, out=wanted)
        np.copyto(wanted, held, where=self._silent)  # a target beyond a limit is not pulled in
        np.subtract(held, self._steps, out=self._bound)
        np.maximum(wanted, self._bound, out=wanted)
        np.add(held, self._steps, out=self._bound)
        np.minimum(wanted, self._bound, out=held)
        at = self._at
        command.joint_pos_target[at] = held[at]
        if self._share:
            np.subtract(held, command.joint_pos, out=self._bound)
            self._bound *= self._share
            self._offset += self._bound
            np.maximum(self._offset, -FARTHEST, out=self._offset)
            np.minimum(self._offset, FARTHEST, out=self._offset)
            command.joint_pos_target[at] += self._offset[at]
        self._feed_forward(
            self._commanded.joint_vel_command, self.max_rate, command.joint_vel_target
        )
        self._feed_forward(
            self._commanded.joint_effort_command, self._effort, command.joint_effort_ff
        )
        stiffness, damping = self.gains
        command.joint_stiffness[at], command.joint_damping[at] = stiffness[at], damping[at]
        return self.ticks >= self._ends

    def _head_home(self, home: Float32, step: Float32) -> None:
        """Let robots of which nothing is commanded want to be home, slowly."""
        goes = self._goes
        at = self._at
        goes[...] = self._silent[at].all(axis=-1, keepdims=True)
        np.copyto(self._steps, self._step)
        if not goes.any():
            return
        for said in (self._commanded.joint_vel_command, self._commanded.joint_effort_command):
            goes &= np.isnan(said[at]).all(axis=-1, keepdims=True)
        np.copyto(self._wanted, home, where=goes)
        np.copyto(self._steps, step, where=goes)
        np.greater(self._silent, goes, out=self._silent)

    def _begin(self) -> None:
        """Refuse what comes first after silence and is too far off."""
        if self._silent[self._at].all():
            self._heard = self._refused = False
            return
        if self._heard:
            return
        np.subtract(self._wanted, self.held, out=self._bound)
        np.abs(self._bound, out=self._bound)
        off = self._bound[self._at]
        if float(off.max()) <= self._tolerance:
            self._heard = True
            self._refused = False
            return
        if not self._refused:
            self._refused = True
            *_, worst = np.unravel_index(int(off.argmax()), off.shape)
            joint = self._robot.joint_names[self._places[int(worst)]]
            self._tell(
                f"forward_command: the first command is {float(off.max()):.2f} rad from the target "
                f"of {joint}, allowed are {self._tolerance:g} (start_tolerance); the joints hold "
                "until it is nearer"
            )
        self._wanted[...] = self.held

    def _feed_forward(self, said: Float32, most: Float32, out: Float32) -> None:
        if self._refused:
            out[self._at] = 0.0
            return
        fed = self._fed
        np.copyto(fed, said)
        np.isnan(fed, out=self._silent)
        np.copyto(fed, 0.0, where=self._silent)
        np.minimum(fed, most, out=fed)
        np.negative(most, out=self._bound)
        np.maximum(fed, self._bound, out=fed)
        out[self._at] = fed[self._at]

    def reset(self) -> None:
        """Begin anew from wherever the joints are at the next tick."""
        self.ticks = 0


class External(Incoming):
    """Send the motor commands that another process publishes, such as an exported controller.

    Its segment of shared memory has the group `command` of this run: targets and gains. They
    pass the safety blocks as any others.

    Args:
        segment: its name.
        timeout: age of the newest command in [s] at which the run is at fault, and damps; also
            where there is none when the flow comes to this block.

    Raises:
        StateError: a segment cannot have that name.
    """

    outside = True

    def __init__(
        self,
        *,
        context: BuildContext,
        segment: str,
        timeout: Annotated[float, positive(DURATION, "s")] = 0.1,
    ) -> None:
        from unicon_core.states.backends.shm import segment_path  # of Linux alone

        segment_path(segment)  # a wrong name is an error now
        states, store = context.states, Store("shm", segment)
        groups = {COMMAND: subset(states.layout, COMMAND_STATES)}
        opened = partial(open_reader, store, "", "", groups, states=states, late=timeout)
        silent = Silent(timeout, "fault")
        super().__init__(segment, groups, opened, states, silent, context.tell)
        self.heard = True  # so that silence is a fault from the first tick on
