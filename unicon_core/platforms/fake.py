"""A robot of pure NumPy whose joints follow their targets, for development and benchmarks."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from unicon_base import AnyMapping
from unicon_base.arrays import Float32
from unicon_base.schema.marks import Unit, Within
from unicon_core.platforms.kit.command import Command, Servo
from unicon_core.platforms.kit.scene import GANTRY, TERRAIN, Scene
from unicon_core.platforms.kit.start import start_of
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.robots import Robot
from unicon_core.states import States

TimeConstant = Annotated[float, Unit("s"), Within(0.0)]

_GRAVITY = 9.81  # [m/s²]


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene | None = None,
    time_constant: TimeConstant = 0.0,
) -> FakePlatform:
    """Build the platform.

    Args:
        period: of a tick in [s].
        scene: how it begins; None for the default pose.
        time_constant: of the joints' first-order response in [s]; 0 follows within the tick.
    """
    return FakePlatform(states, robot, period, scene or Scene(), time_constant)


def make_robot(
    states: States,
    robot: Robot,
    period: float,
    *,
    time_constant: TimeConstant = 0.0,
    silent: bool = False,
) -> FakeRobot:
    """Build a fake that counts as a robot; see `make`. Its `close` sends nothing in any case."""
    return FakeRobot(states, robot, period, Scene(), time_constant)


class FakePlatform:
    """Joints that approach their targets within the robot's limits; the base stands still.

    A joint without stiffness turns at its velocity target as long as it has damping, and else stays
    where it is. `joint_effort` is the servo's torque
    kp (q* - q) + kd (qd* - qd) + tau_ff, clipped to the effort limits.
    """

    # No foot touches the terrain: height scans alone see it.
    facts = Facts("fake", simulated=True, batch=True, writes=SIMULATED, physics=(GANTRY, TERRAIN))

    def __init__(
        self, states: States, robot: Robot, period: float, scene: Scene, time_constant: float
    ) -> None:
        writes = tuple(name for name in self.facts.writes if name in states)
        self.facts = replace(self.facts, writes=writes)
        self._period = period
        self._time_constant = time_constant
        self._share = 1.0 if time_constant == 0.0 else -math.expm1(-period / time_constant)
        by_model = scene.posed_by_model
        self._initial = start_of(robot, scene).joint_pos if by_model else scene.joint_pos(robot)
        self._lower, self._upper = robot.limits()
        self._longest: Float32 | None = None
        self._command = Command(states, robot.joint_names, dtype=np.float32)
        self._servo = Servo(self._command.rows, robot.effort_limit)
        shape = states["joint_pos_target"].shape
        self._pos, self._vel = (np.zeros(shape, np.float32) for _ in range(2))
        self._next = np.zeros(shape, np.float32)
        self._gain = np.zeros(shape, np.float32)
        self._still = bytes(self._pos.nbytes)
        self._stamp = states["stamp_ns"] if "stamp_ns" in writes else np.zeros((), np.int64)
        self._outputs = [
            (states[name], value)
            for name, value in (
                ("joint_pos", self._pos),
                ("joint_vel", self._vel),
                ("joint_effort", self._servo.torque),
                ("base_quat", np.array((1.0, 0.0, 0.0, 0.0), np.float32)),
                ("base_ang_vel", np.zeros(3, np.float32)),
                ("base_lin_acc", np.array((0.0, 0.0, _GRAVITY), np.float32)),
                ("projected_gravity", np.array((0.0, 0.0, -1.0), np.float32)),
                ("base_pos_w", np.zeros(3, np.float32)),
                ("base_lin_vel", np.zeros(3, np.float32)),
            )
            if name in states
        ]
        self.reset()

    def recv(self) -> bool | None:
        """Write the joints, a base at rest and the time."""
        for out, value in self._outputs:
            out[...] = value
        self._stamp[...] = self._now_ns()
        return None

    def _now_ns(self) -> int:
        return round(self._ticks * self._period * 1e9)

    def send(self) -> bool | None:
        """Move the joints towards their targets for one tick.

        Raises:
            Fault: a command is not finite.
        """
        self._command.take()
        target, speed, _, stiffness, damping = self._command.rows
        self._servo(self._pos, self._vel)
        new = self._next
        np.subtract(target, self._pos, out=new)
        np.greater(stiffness, 0.0, out=self._gain, casting="unsafe")
        new *= self._gain
        if speed.tobytes() != self._still:
            turned = np.where((stiffness <= 0.0) & (damping > 0.0), speed, np.float32(0.0))
            new += turned * np.float32(self._period)
        new *= self._share
        new += self._pos
        np.clip(new, self._lower, self._upper, out=new)
        np.subtract(new, self._pos, out=self._vel)
        if self._longest is not None:
            np.clip(self._vel, -self._longest, self._longest, out=self._vel)
            np.add(self._pos, self._vel, out=new)
        self._vel /= self._period
        self._pos[...] = new
        self._ticks += 1
        return None

    def reset(self) -> None:
        """Put the joints back where they began, at time 0."""
        self._pos[...] = self._initial
        self._vel[...] = 0.0
        self._servo.torque[...] = 0.0
        self._ticks = 0

    def save(self) -> list[Any]:
        """Return what the joints go on from."""
        return [self._pos.copy(), self._vel.copy(), self._servo.torque.copy(), self._ticks]

    def load(self, saved: list[Any]) -> None:
        """Go on as another platform would that was built alike."""
        self._pos[...], self._vel[...], self._servo.torque[...], self._ticks = saved

    def close(self) -> None:
        """Let go; there is nothing to damp."""

    def info(self) -> AnyMapping:
        """Return the joints' response."""
        return {"model": None, "time_constant_s": self._time_constant}


class FakeRobot(FakePlatform):
    """The same where a robot is meant: real time, the machine's clock, and a robot's rules.

    Its joints move by one period's worth from command to command, in the time that lies between.
    Its joints are not faster than the robot's, and its IMU has the noise that every real one has:
    one without counts as frozen (`imu_stop`).
    """

    facts = replace(FakePlatform.facts, name="fake_robot", simulated=False, batch=False)

    PAUSE = 100_000_000
    """After so long a first move takes one period, [ns]."""

    def __init__(
        self, states: States, robot: Robot, period: float, scene: Scene, time_constant: float
    ) -> None:
        super().__init__(states, robot, period, scene, time_constant)
        self._told = self._moved = 0
        self._sent = False
        self._period_ns = round(period * 1e9)
        step = np.nan_to_num(robot.velocity_limit, nan=np.inf) * period
        self._longest = step.astype(np.float32)
        rng = np.random.default_rng(0)
        noise = {"base_ang_vel": 1e-3, "base_lin_acc": 1e-2}
        self._noise = [
            (states[name], rng.normal(0.0, scale, (1000, 3)).astype(np.float32))
            for name, scale in noise.items()  # [rad/s] and [m/s²], of a MEMS sensor
            if name in states
        ]

    def recv(self) -> bool | None:
        """Write the same, with noise in the IMU, and velocities of the time since the last move.

        At full speed that is one period, too.
        """
        now = max(time.monotonic_ns(), self._told)
        if self._sent:
            self._sent = False
            since = self._moved if now - self._moved < self.PAUSE else self._told
            self._moved = now = max(now, since + self._period_ns)
            self._vel *= self._period_ns / (now - since)
        self._told = now
        super().recv()
        for view, values in self._noise:
            view += values[self._ticks % len(values)]
        return None

    def _now_ns(self) -> int:
        return self._told

    def send(self) -> bool | None:
        """Move the joints."""
        self._sent = True
        return super().send()
