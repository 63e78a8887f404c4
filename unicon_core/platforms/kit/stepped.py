"""A simulator that is stepped from Python: give it six methods, and it is a platform."""

from __future__ import annotations

import os
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import Timer
from typing import ClassVar

import numpy as np

from unicon_base import AnyDict, Fault, PlatformError
from unicon_base.arrays import Float64
from unicon_core.models.load import effort_ranges
from unicon_core.models.loaded import import_mujoco
from unicon_core.platforms.kit.base import BaseStates, WorldPose, cross, rotation
from unicon_core.platforms.kit.command import (
    Command,
    JointDelay,
    Servo,
    delay_of,
    steps_in,
    strength_of,
    tick_ns,
)
from unicon_core.platforms.kit.joint_model import (
    JointModel,
    Passive,
    ground_friction,
    joint_model,
    lost,
)
from unicon_core.platforms.kit.scene import BODY_PHYSICS, Scene
from unicon_core.platforms.kit.start import Start, start_of
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.robots import Robot
from unicon_core.robots.load import JOINT_PHYSICS
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES, JOINT_STATES

# Also what simulators import from here.
__all__ = [
    "BODY_PHYSICS",
    "JOINT_PHYSICS",
    "SIMULATED",
    "Facts",
    "Float64",
    "JointModel",
    "Passive",
    "Robot",
    "Scene",
    "Start",
    "States",
    "WorldPose",
    "cross",
    "ground_friction",
    "import_mujoco",
    "rotation",
]

GRAVITY = np.array((0.0, 0.0, -9.81))
"""On earth, in the world in [m/s²], shape (3,)."""

_TOO_FAST = 1e5  # [rad/s]: no robot's joint turns that fast


@dataclass(frozen=True, eq=False)
class Setup:
    """What a simulator is built with.

    Attributes:
        states: the states; N is the length of their batch axis, 1 without.
        robot: the robot.
        period: of a tick in [s].
        timestep: of the physics in [s].
        start: where it begins; states of a base that cannot move are not written.
        figures: of the joints, as the engine is told them.
    """

    states: States
    robot: Robot
    period: float
    timestep: float
    start: Start
    figures: JointModel

    @property
    def num_robots(self) -> int:
        """N."""
        return self.states.num_robots or 1


def setup_of(
    states: States,
    robot: Robot,
    period: float,
    scene: Scene,
    timestep: float | None,
    passive: Passive,
) -> Setup:
    """Return what a factory builds its simulator with.

    Args:
        states: of the workflow.
        robot: the robot.
        period: of a tick in [s].
        scene: how it begins.
        timestep: physics step in [s], None for the model's.
        passive: whether the damping of the model's joints acts.

    Raises:
        ModelError: the model is missing or wrong, or lacks a joint.
        PlatformError: no such pose, or no such body.
    """
    start = start_of(robot, scene)
    step = float(start.loaded.model.opt.timestep) if timestep is None else timestep
    return Setup(states, robot, period, step, start, joint_model(start, passive))


class SteppedSimulator(ABC):
    """N robots, each in a world of its own, their servos computed here at each physics step.

    A class of it says `facts` and `represents`, builds its worlds before it calls
    `super().__init__`, and has `place`, `joints`, `base`, `step`, `add_velocity` and `close`.
    All of them have the robots as first axis, also of one. Where the physics of a whole tick are
    one call, it has `simulate` too.

    Args:
        setup: as of its factory; the engine has been told the joints' figures.
        notes: what of the model the engine does otherwise, one line each, where `represents` has no
            word for it.

    Attributes:
        num_robots: N.
        torque: of the last physics step in [N·m], shape (N, n).
        notes: what of the model is left out or otherwise, one line each.
    """

    facts: Facts
    represents: ClassVar[Collection[str]] = ()
    """Words of `kit/joint_model.py` for what the engine has as the model says."""

    def __init__(self, setup: Setup, notes: Sequence[str] = ()) -> None:
        states, robot, timestep, start = setup.states, setup.robot, setup.timestep, setup.start
        figures = self.figures = setup.figures
        unmeasured = () if start.floating else BASE_STATES
        told = [name for name in self.facts.writes if name not in unmeasured]
        self.notes = [*start.loaded.notes, *lost(start, robot, figures, self.represents), *notes]
        told_of = (*self.facts.notes, *self.notes)
        self.facts = replace(self.facts, writes=tuple(told), notes=told_of)
        self._names = robot.joint_names
        self.start = start
        self.model_path = start.loaded.path
        self.timestep = timestep
        self.decimation = steps_in(setup.period, timestep, self.model_path, self.facts.name)
        self._tick_ns = tick_ns(timestep, self.decimation)
        self.num_robots, self._alone = setup.num_robots, states.num_robots is None
        self._command = Command(states, robot.joint_names)
        rows = self._rows = self._command.rows.reshape(5, self.num_robots, -1)
        self._acting = np.zeros_like(rows)
        lower, upper = effort_ranges(start.loaded, robot.effort_limit)
        self._servo = Servo(self._acting, upper, lower)
        self._effort = dict(zip(("effort_lower", "effort_upper"), (lower, upper)))
        self.torque = self._servo.torque
        self._strength = strength_of(start.physics)
        delay = delay_of(start.physics, timestep)
        self._delay = None if delay is None else JointDelay(rows, delay, self.decimation)
        views = {
            name: states[name][None] if self._alone else states[name] for name in self.facts.writes
        }
        self._told = [views[name] for name in JOINT_STATES]
        self._stamp = views["stamp_ns"]
        base = {name: view for name, view in views.items() if name in BASE_STATES}
        self._where = self.base if start.floating else self.nowhere
        self._base_states = BaseStates(base, robot, timestep, start.gravity)
        self.reset()

    @abstractmethod
    def place(self) -> None:
        """Put all robots where they begin, at rest, to the same bytes each time."""

    @abstractmethod
    def joints(self) -> tuple[Float64, Float64]:
        """Return positions [rad] and velocities [rad/s] in the robot's order, shape (N, n) each."""

    @abstractmethod
    def base(self) -> WorldPose:
        """Return where the bases are; asked only where they can move."""

    def nowhere(self) -> WorldPose:
        """Return what stands for bases that cannot move; nobody is told."""
        zeros = np.zeros((self.num_robots, 3))
        return WorldPose(zeros, np.tile((1.0, 0.0, 0.0, 0.0), (self.num_robots, 1)), zeros, zeros)

    @abstractmethod
    def step(self, torque: Float64) -> None:
        """Apply torques [N·m], shape (N, n), and step the physics once."""

    @abstractmethod
    def add_velocity(self, velocity: Float64) -> None:
        """Add to the bases' velocities along the world's axes in [m/s], shape (N, 3)."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the engine; safe to call twice."""

    def push(self, velocity: Float64) -> None:
        """Add to the bases' horizontal velocity [m/s] in the world, shape (2,) or (N, 2).

        Raises:
            PlatformError: they cannot move.
        """
        if not self.start.floating:
            raise PlatformError(f"platform {self.facts.name!r} cannot push a base that is fixed")
        level = np.atleast_2d(velocity)
        self.add_velocity(np.hstack((level, np.zeros((len(level), 1)))))

    def reset(self) -> None:
        """Put the robots back where they began, at time 0, limp."""
        self.place()
        self._ticks = 0
        self.torque[...] = 0.0
        if self._delay is not None:
            self._delay.reset()
        self._measured = self.joints()
        self._now = self._before = self._where()

    def recv(self) -> bool | None:
        """Copy what the simulation says into the states."""
        for view, value in zip(self._told, (*self._measured, self.torque)):
            view[...] = value
        if self.start.floating:
            self._base_states(self._before, self._now)
        self._stamp[...] = round(self._ticks * self._tick_ns)
        return None

    def send(self) -> bool | None:
        """Take the command and simulate one tick.

        Raises:
            Fault: a command is not finite, or the physics blew up.
        """
        self._command.take()
        self.advance()
        self._ticks += 1
        speeds = self._measured[1]
        if not np.vdot(speeds, speeds) < _TOO_FAST**2:  # false for NaN too
            self._blown_up()
        return None

    def advance(self) -> None:
        """Simulate one tick of the command that was taken, and read what came of it."""
        whole = ((self.decimation, self._rows),)
        self._before = self.simulate(whole if self._delay is None else self._delay())
        self._measured, self._now = self.joints(), self._where()

    def simulate(self, parts: Iterable[tuple[int, Float64]]) -> WorldPose:
        """Simulate one tick; write `torque`.

        Args:
            parts: physics steps, and the command that acts in them: q*, qd*, tau_ff, kp, kd, shape
                (5, N, n).

        Returns:
            Where the bases were one physics step before its end.
        """
        left, servo, strength, measured = self.decimation, self._servo, self._strength, self.joints
        pos, vel = self._measured
        for steps, command in parts:
            self._acting[...] = command
            for _ in range(steps):
                torque = servo(pos, vel)
                if strength is not None:
                    torque *= strength
                left -= 1
                if not left:
                    before = self._where()
                self.step(torque)
                if left:
                    pos, vel = measured()
        return before

    def _blown_up(self) -> None:
        """Raise the fault of the first robot whose joints move too fast.

        Raises:
            Fault: there is one; the sum of many that move fast is none.
        """
        speeds = np.abs(self._measured[1])
        wrong = np.argwhere(~(speeds < _TOO_FAST))
        if not len(wrong):
            return
        robot = int(wrong[0, 0])
        joint = int(np.argmax(np.nan_to_num(speeds[robot], nan=np.inf)))
        who = "" if self._alone else f"robot {robot}: "
        raise Fault(
            f"{who}the physics blew up before {self._ticks * self._tick_ns * 1e-9:.3f} s: joint "
            f"{self._names[joint]} moves at {speeds[robot, joint]:.3g} rad/s; lower the gains or "
            "the physics step (timestep)"
        )

    def info(self) -> AnyDict:
        """Return model, physics step, number of robots, and what of the model is otherwise."""
        return {
            "model": str(self.model_path),
            "physics_step_s": self.timestep,
            "physics_steps_per_tick": self.decimation,
            "num_robots": self.num_robots,
            **{key: dict(zip(self._names, of.tolist())) for key, of in self._effort.items()},
            "passive": self.figures.passive,
            "notes": list(self.notes),
        }


class DampedSimulator(SteppedSimulator):
    """One whose joints' own damping can be changed while it runs: it has `damp` besides."""

    @abstractmethod
    def damp(self, damping: Float64) -> None:
        """Give the joints damping [N·m·s/rad], shape (n,)."""

    @property
    def passive_damping(self) -> Float64:
        """Damping of the joints themselves in [N·m·s/rad], shape (n,)."""
        return self.figures.damping

    @contextmanager
    def undamped(self) -> Iterator[None]:
        """Do without the joints' own damping for a while, as with `passive: replace`."""
        self.damp(np.zeros_like(self.figures.damping))
        try:
            yield
        finally:
            self.damp(self.figures.damping)


@contextmanager
def quiet(handle: int = 1) -> Iterator[None]:
    """Let nothing reach standard output, of Python or of C, as long as it lasts.

    Short, and while no other thread prints: what goes there is lost. Errors have an output of
    their own, which stays.

    Args:
        handle: 2 for that of errors, where a library complains of what is not an error.
    """
    stream = sys.stdout if handle == 1 else sys.stderr
    stream.flush()
    try:
        kept = os.dup(handle)
    except OSError:  # there is none
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), handle)
        try:
            yield
        finally:
            stream.flush()
            os.dup2(kept, handle)
    finally:
        os.close(kept)


AFTER = 2.0
"""Seconds for which nobody asks."""


@contextmanager
def patience(what: str) -> Iterator[None]:
    """Say on standard error what takes long, once it does, and how long it took.

    Args:
        what: such as "mjx: compiling the physics of 64 robots, some 10 s the first time".
    """
    begin = time.monotonic()
    said = []

    def say() -> None:
        said.append(True)
        print(f"{what} …", file=sys.stderr, flush=True)

    timer = Timer(AFTER, say)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if said:
            took = time.monotonic() - begin
            print(f"{what.partition(':')[0]}: ready after {took:.0f} s", file=sys.stderr)
