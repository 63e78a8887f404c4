"""Trajectories: joint trajectories by topic and action, played into the states of joint commands.

What joint_trajectory_controller of ros2_control offers, for a flow with a `forward_command`. A
message is checked in the slack of a tick, and played from the next one on.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from unicon_base import TextSink, UniconError
from unicon_core.blocks.forward_command import ForwardCommand
from unicon_core.flow import Block
from unicon_core.trajectory.accepted import Code, Limits, Points, Refusal
from unicon_core.trajectory.player import Ending, Player, Tolerances
from unicon_core.workflow import Program
from unicon_core.workflow.program_data import ProgramData
from unicon_msgs_map.spec import TrajectorySpec
from unicon_ros import compat
from unicon_ros.bridge.action_server import ABORTED, CANCELED, SUCCEEDED, ActionServer, Goal
from unicon_ros.bridge.bindings import arrays_of

PLAYED = ("joint_pos_command", "joint_vel_command")
"""States that trajectories write."""
ACTION = "control_msgs/action/FollowJointTrajectory"
TOPIC = "trajectory_msgs/msg/JointTrajectory"
FEEDBACK = 20.0
"""In [Hz], as joint_trajectory_controller's `action_monitor_rate`."""
REASONS = 10
"""Different reasons of refused messages that are told."""
LINGER_S = 0.1
"""So long after the last results the services stay, for the middleware to repeat what was lost."""


def followers(spec: TrajectorySpec, program: ProgramData) -> list[ForwardCommand]:
    """Return the blocks that follow what is played.

    Raises:
        UniconError: there are none, or of some of the joints.
    """
    found = [block.tick for block in program.blocks if isinstance(block.tick, ForwardCommand)]
    if not found:
        raise UniconError(
            f"{spec.where}: workflow {program.name} has no block forward_command that would follow "
            "trajectories; put one into its flow, or take another map"
        )
    for each in found:
        if each.moves or each.max_rate.shape != (program.robot.num_joints,):
            raise UniconError(
                f"{spec.where}: trajectories are followed by all joints; give forward_command of "
                f"workflow {program.name} the whole robot"
            )
    return found


class Trajectories:
    """The topic and the action of one map.

    Args:
        node: rclpy node.
        spec: what the map says.
        program: whose flow follows.
        warn: takes warnings, one line each.

    Attributes:
        player: plays what was accepted.
        topic: full name, or "".
        received: trajectories that came by the topic.
        rejected: of those, refused.

    Raises:
        UniconError: nobody would follow, or control_msgs is needed and not installed.
    """

    def __init__(self, node: Any, spec: TrajectorySpec, program: Program, warn: TextSink) -> None:
        self._node, self._spec, self._warn = node, spec, warn
        following = followers(spec, program)
        arrays, robot, size = arrays_of(program), program.robot, program.robot.num_joints
        speed = np.min([each.max_rate for each in following], axis=0).astype(np.float64)
        lower, upper = robot.limits()
        limits = Limits(
            robot.joint_names,
            lower.astype(np.float64),
            upper.astype(np.float64),
            np.nan_to_num(speed, nan=np.inf),
            partial=spec.missing == "hold",
            start=spec.start_tolerance,
        )
        self.player = Player(
            limits,
            program.period,
            arrays[PLAYED[0]],
            arrays[PLAYED[1]],
            lambda: next(each.held for each in following if each.ticks).reshape(-1, size)[0],
            arrays["joint_pos"],
            lambda: sum(each.ticks for each in following),
        )
        self._measured = (arrays["joint_pos"], arrays["joint_vel"])
        stamp = arrays["stamp_ns"]
        simulated = program.platform.facts.simulated
        self._now = partial(int, stamp) if simulated else time.time_ns
        self._every = self._due = max(1, round(1.0 / (FEEDBACK * program.period)))
        self._goal: Goal | None = None
        self._told: set[str] = set()
        self.received = self.rejected = 0
        self.topic = ""
        self._subscription: Any = None
        self._kind = compat.message_class(ACTION)
        self._action = self._served()
        if spec.topic is not None:
            message = compat.message_class(TOPIC)
            self._subscription = node.create_subscription(message, spec.topic, self._heard, 10)
            self.topic = str(self._subscription.topic_name)

    def _served(self) -> ActionServer | None:
        spec = self._spec
        if spec.action is None:
            return None
        if self._kind is None:
            missing = (
                f"action {spec.action} is left out: control_msgs is not installed "
                "(apt install ros-$ROS_DISTRO-control-msgs, or build it in the workspace)"
            )
            if spec.topic is None:
                raise UniconError(f"{spec.where}: {missing}; or give a topic beside the action")
            self._warn(f"{missing}; trajectories come by topic {spec.topic}")
            return None
        return ActionServer(self._node, self._kind, spec.action, self._begin, self._cancel)

    # -- in ticks -------------------------------------------------------------------------------

    def before_flow(self) -> Block:
        """Return the block that plays."""
        return Block("ros trajectory", self._play, writes=PLAYED, endless=True)

    def after_send(self) -> Block:
        """Return the block that answers and tells how far it is."""
        return Block("ros trajectory feedback", self._tell, endless=True)

    def _play(self) -> None:
        if self._goal is not None and self._action is not None:
            self._action.look()
        self.player()

    def _tell(self) -> None:
        action, goal = self._action, self._goal
        if action is None:
            return
        action.answer()
        if goal is None:
            return
        self._due -= 1
        if not self._due:
            self._due = self._every
            action.tell(goal, self._progress(goal))

    def _progress(self, goal: Goal) -> Any:
        feedback = self._kind.Feedback(joint_names=list(self.player.limits.joints))
        now, seconds = self._now(), self.player.time
        feedback.header.stamp.sec, feedback.header.stamp.nanosec = divmod(now, 1_000_000_000)
        for point, values in (
            (feedback.desired, self.player.desired),
            (feedback.actual, self._measured),
            (feedback.error, [d - m for d, m in zip(self.player.desired, self._measured)]),
        ):
            point.positions, point.velocities = (value.tolist() for value in values)
            point.time_from_start.sec = int(seconds)
            point.time_from_start.nanosec = int(seconds % 1.0 * 1e9)
        return feedback

    # -- between ticks --------------------------------------------------------------------------

    def _heard(self, message: Any) -> None:
        """Play a trajectory of the topic; a refused one is told."""
        self.received += 1
        try:
            self.player.play(self._points(message), self._tolerances(), bool)
        except Refusal as refusal:
            self.rejected += 1
            if refusal.reason not in self._told and len(self._told) < REASONS:
                self._told.add(refusal.reason)
                self._warn(f"a trajectory on {self.topic} was refused: {refusal.reason}")

    def _begin(self, goal: Goal) -> None:
        request = goal.request
        try:
            points = self._points(request.trajectory)
            tolerances = self._tolerances(request)
            self.player.play(points, tolerances, partial(self._ended, goal))
        except Refusal as refusal:
            self._ended(goal, Ending(refusal.code, refusal.reason))
        else:
            self._goal, self._due = goal, self._every

    def _cancel(self, goal: Goal) -> None:
        self.player.cancel()

    def _ended(self, goal: Goal, ending: Ending) -> None:
        if goal is self._goal:
            self._goal = None
        good = ending.code is Code.SUCCESSFUL
        status = CANCELED if ending.canceled else SUCCEEDED if good else ABORTED
        result = self._kind.Result(error_code=int(ending.code))
        result.error_string = ending.reason
        assert self._action is not None
        self._action.end(goal, status, result)

    def _points(self, message: Any) -> Points:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        points = message.points
        return Points(
            list(message.joint_names),
            [_seconds(p.time_from_start) for p in points],
            [p.positions for p in points],
            [p.velocities for p in points],
            [p.accelerations for p in points],
            [p.effort for p in points],
            (stamp - self._now()) * 1e-9 if stamp else None,
        )

    def _tolerances(self, request: Any = None) -> Tolerances | None:
        """Return what is asked for, the map's where a goal does not say; None for nothing."""
        spec, size = self._spec, len(self.player.limits.joints)
        found = Tolerances(
            np.full(size, spec.path_tolerance or np.inf),
            np.full(size, spec.goal_tolerance or np.inf),
            spec.goal_time,
        )
        if request is not None:
            for said, values in (
                (request.path_tolerance, found.path),
                (request.goal_tolerance, found.goal),
            ):
                self._said(said, values)
            seconds = _seconds(request.goal_time_tolerance)
            if seconds:  # a negative one waits without an end, as the map's 0
                found = replace(found, time=max(seconds, 0.0))
        asked = np.isfinite(found.path).any() or np.isfinite(found.goal).any()
        return found if asked else None

    def _said(self, tolerances: Any, values: Any) -> None:
        """Write tolerances of a goal: 0 is the map's, a negative one any distance."""
        joints = self.player.limits.joints
        for each in tolerances:
            if each.name not in joints:
                raise Refusal(
                    f"there is a tolerance of {each.name[:60]!r}, which the robot has not",
                    Code.INVALID_JOINTS,
                )
            if each.velocity > 0.0 or each.acceleration > 0.0 or not np.isfinite(each.position):
                raise Refusal(
                    f"tolerances of {each.name}: positions alone are compared; give a number "
                    "there, and 0 for velocity and acceleration"
                )
            if each.position:
                values[joints.index(each.name)] = each.position if each.position > 0 else np.inf

    def counts(self) -> dict[str, dict[str, int]]:
        """Return what came by the topic and by the action, by their names."""
        found = {}
        if self.topic:
            found[self.topic] = {"received": self.received, "rejected": self.rejected}
        if self._action is not None:
            found[self._action.name] = {"goals": self._action.received}
        return found

    def close(self) -> None:
        """End what is played, tell those who wait for it, and let go."""
        action = self._action
        waiting = action is not None and bool(action.open)
        self.player.cancel(Ending(Code.INVALID_GOAL, "the run has ended"))
        if action is not None:
            if waiting:
                time.sleep(LINGER_S)
            action.close()
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)


def _seconds(duration: Any) -> float:
    return float(duration.sec + duration.nanosec * 1e-9)
