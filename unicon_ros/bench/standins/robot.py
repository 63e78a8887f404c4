"""A robot behind plain topics, for whoever drives platform `ros` without one: tests, trials, demos.

    python -m unicon_ros.bench.standins.robot go2 --seed 3
    unicon preflight go2_walk --set platform=ros
    unicon run go2_walk --set platform=ros

It speaks config/maps/ros_robot.yaml: publishes `joint_states` and `imu/data`, and its joints go to
the positions of `joint_commands` with a first-order response, within their limits and no faster
than the robot's. It begins in a posture drawn at random, and its sensors have noise. It knows
nothing of unicon but the robot file. Where a map sends the stiffness as the effort of
`joint_gains`, it hears when that is gone. Without stiffness, or 0.5 s after the last command, which
its own watchdog notices, it is limp: its joints sink slowly towards the middle of their range, as
if it hung on a gantry.

On standard output it says JSON lines: `ready` with its posture, `first` with how far the first
command, and each after a silence, was from where the joints were, `commands` after every 50 of
them with the largest step between two of these, `silence` when its watchdog acts, and `limp` when
all stiffness is gone. With `--each` it says every `command`: its stamp, target and distance.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from contextlib import suppress
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import Imu, JointState

from unicon_core.robots import Robot, load_robot

__all__ = ["StandIn", "main", "random_posture"]

GRAVITY = 9.81
LEAN = 0.1
"""Largest lean of the base in [rad], drawn at random."""
SPARE = 0.05
"""Share of a joint's range that a posture drawn at random keeps from either limit."""
TOLD_EVERY = 50
SILENCE = 0.5
"""After so long without a command joints are limp, and the next command is a first one again, [s].
"""
SINKING = 20.0
"""Time constant of limp joints in [s]."""


def random_posture(robot: Robot, random: np.random.Generator) -> NDArray[np.float64]:
    """Return joint positions within the limits in [rad], shape (n,); default where unknown."""
    spare = SPARE * (robot.upper - robot.lower)
    known = ~np.isnan(spare)
    lower = np.where(known, robot.lower + spare, robot.default_joint_pos)
    upper = np.where(known, robot.upper - spare, robot.default_joint_pos)
    return random.uniform(lower, upper)


class StandIn:
    """One robot, and its node.

    Args:
        robot: the robot file.
        seed: of posture, lean and noise.
        rate: of the states in [Hz].
        time_constant: of the joints in [s].
        swapped: two joints whose encoders are exchanged.
        posture: `random`, or `default` for the robot file's.
        still: no noise at all.
        imu_seconds: after so many the IMU is silent; 0 for never there.
        each: say every command.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        seed: int = 0,
        rate: float = 200.0,
        time_constant: float = 0.05,
        swapped: tuple[str, ...] = (),
        posture: str = "random",
        still: bool = False,
        imu_seconds: float = math.inf,
        each: bool = False,
    ) -> None:
        self._random = np.random.default_rng(seed)
        self._names, self._noise = list(robot.joint_names), 0.0 if still else 1.0
        self._lower = np.nan_to_num(robot.lower, nan=-np.inf)
        self._upper = np.nan_to_num(robot.upper, nan=np.inf)
        self.pos = random_posture(robot, self._random)
        if posture == "default":
            self.pos[...] = robot.default_joint_pos
        self._target, self._middle = self.pos.copy(), 0.5 * (robot.lower + robot.upper)
        self._middle = np.where(np.isnan(self._middle), self.pos, self._middle)
        self._longest = np.nan_to_num(robot.velocity_limit, nan=np.inf) / rate  # step in [rad]
        self._rate, self._share = rate, 1.0 - math.exp(-1.0 / (rate * time_constant))
        self._sunk = 1.0 - math.exp(-1.0 / (rate * SINKING))
        self._order = np.arange(len(self._names))
        if swapped:
            a, b = (self._names.index(name) for name in swapped)
            self._order[[a, b]] = b, a
        lean = self._random.uniform(-LEAN, LEAN, 2)
        self._quat = np.array((1.0, *(0.5 * lean), 0.0))  # wxyz, small angles
        self._quat /= np.linalg.norm(self._quat)
        self.commands, self._worst, self._heard = 0, 0.0, 0.0
        self._largest_step, self._stiff, self._limp, self._watched = 0.0, False, False, False
        self._imu_until, self._each = time.monotonic() + imu_seconds, each
        self.node: Any = rclpy.create_node("stand_in")
        self._states = self.node.create_publisher(JointState, "joint_states", 10)
        self._imu = self.node.create_publisher(Imu, "imu/data", 10)
        self.node.create_subscription(JointState, "joint_commands", self._commanded, 10)
        self.node.create_subscription(JointState, "joint_gains", self._gained, 10)
        self.node.create_timer(1.0 / rate, self._step)
        say("ready", posture=dict(zip(self._names, self.pos.round(4).tolist())))

    def _commanded(self, message: Any) -> None:
        target = self._target.copy()
        for name, position in zip(message.name, message.position):
            target[self._names.index(name)] = position
        if not np.isfinite(target).all():
            say("refused", names=list(message.name))
            return
        away = np.abs(target - self.pos)
        if self._each:
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            say("command", stamp=stamp, distance=float(away.max()), target=target.tolist())
        self._worst = max(self._worst, float(away.max()))
        self.commands += 1
        if not self._watched:
            say("first", distance=float(away.max()), joint=self._names[int(away.argmax())])
        else:
            step = float(np.abs(target - self._target).max())
            self._largest_step = max(self._largest_step, step)
        self._heard, self._watched = time.monotonic(), True
        self._target[...] = np.clip(target, self._lower, self._upper)
        if self.commands % TOLD_EVERY == 0:
            say("commands", count=self.commands, worst=self._worst, step=self._largest_step)
            self._largest_step = 0.0

    def _gained(self, message: Any) -> None:
        stiff = any(message.effort)
        self._limp = not stiff
        if self._stiff and not stiff:
            say("limp", after=time.monotonic(), moved=float(np.abs(self._target - self.pos).max()))
        self._stiff = stiff

    def _step(self) -> None:
        before, now = self.pos.copy(), time.monotonic()
        if self._watched and now - self._heard > SILENCE:
            self._watched = False
            say("silence", after=now)
        if self._limp or (self.commands and not self._watched):
            self.pos += self._sunk * (self._middle - self.pos)
        else:
            step = self._share * (self._target - self.pos)
            self.pos += np.clip(step, -self._longest, self._longest)
        stamp = self.node.get_clock().now().to_msg()
        states = JointState(name=self._names)
        states.header.stamp = stamp
        shown = (self.pos + self._noisy(1e-4, self.pos.size))[self._order]
        states.position = shown.tolist()
        speed = (self.pos - before) * self._rate + self._noisy(1e-3, self.pos.size)
        states.velocity = speed[self._order].tolist()
        self._states.publish(states)
        if now > self._imu_until:
            return
        imu = Imu()
        imu.header.stamp = stamp
        quat = self._quat + self._noisy(1e-4, 4)
        w, x, y, z = (quat / np.linalg.norm(quat)).tolist()
        down = np.array((2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1))
        imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z = w, x, y, z
        for vector, values in (
            (imu.angular_velocity, self._noisy(2e-3, 3)),
            (imu.linear_acceleration, -GRAVITY * down + self._noisy(0.02, 3)),
        ):
            vector.x, vector.y, vector.z = values.tolist()
        self._imu.publish(imu)

    def _noisy(self, deviation: float, size: int) -> NDArray[np.float64]:
        return self._random.normal(0.0, self._noise * deviation, size)


def say(kind: str, **facts: Any) -> None:
    """Say a JSON line."""
    print(json.dumps({"kind": kind, **facts}), flush=True)


def main() -> int:
    """Run until killed."""
    parser = argparse.ArgumentParser(description="A robot behind plain topics.")
    parser.add_argument("robot", help="name in config/robots/, or a path")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=200.0, help="of the states in [Hz]")
    parser.add_argument("--time-constant", type=float, default=0.05, help="of the joints in [s]")
    parser.add_argument("--swapped", nargs=2, default=(), metavar="JOINT", help="their encoders")
    parser.add_argument("--posture", choices=("random", "default"), default="random")
    parser.add_argument("--still", action="store_true", help="no noise")
    parser.add_argument("--each", action="store_true", help="say every command")
    parser.add_argument(
        "--imu-seconds",
        type=float,
        default=math.inf,
        metavar="S",
        help="then the IMU is silent; 0: it has none",
    )
    options = vars(parser.parse_args())
    robot = load_robot(options.pop("robot"))
    rclpy.init()
    stand_in = StandIn(robot, **{**options, "swapped": tuple(options["swapped"])})
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(stand_in.node)
    say("commands", count=stand_in.commands, worst=stand_in._worst)
    return 0


if __name__ == "__main__":
    sys.exit(main())
