"""A simulator that is stepped from Python: give it four methods, and it is a platform."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import Fault
from unicon_core.platforms.kit.base import BaseStates, WorldPose
from unicon_core.platforms.kit.clock import steps_in, tick_ns
from unicon_core.platforms.kit.command import Command
from unicon_core.platforms.kit.joint_delay import JointDelay, delay_of, strength_of
from unicon_core.platforms.kit.servo import Servo
from unicon_core.platforms.kit.start import Start
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES, JOINT_STATES

__all__ = ["GRAVITY", "SteppedSimulator"]

Float = NDArray[np.float64]

GRAVITY = np.array((0.0, 0.0, -9.81))
"""In the world in [m/s²], shape (3,)."""

_TOO_FAST = 1e5  # [rad/s]: no robot's joint turns that fast


class SteppedSimulator(ABC):
    """One robot, its servos computed here at each physics step.

    A class of it says `facts`, builds its world before it calls `super().__init__`, and has
    `place`, `joints`, `base` and `step`.

    Args:
        states: the states, without a batch axis.
        robot: the robot.
        period: of a tick in [s].
        timestep: of the physics in [s].
        start: where it begins; states of a base that cannot move are not written.
    """

    facts: Facts

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        timestep: float,
        start: Start,
    ) -> None:
        unmeasured = () if start.floating else BASE_STATES
        told = [name for name in self.facts.writes if name not in unmeasured]
        self.facts = replace(self.facts, writes=tuple(told))
        self._names, self.start, self.model_path = robot.joint_names, start, start.loaded.path
        self.timestep, self.decimation = timestep, steps_in(period, timestep, self.model_path)
        self._tick_ns = tick_ns(timestep, self.decimation)
        self._command = Command(states, robot.joint_names)
        self._acting = np.zeros_like(self._command.rows)
        self._servo = Servo(self._acting, robot.effort_limit)
        self._strength = strength_of(start.physics)
        delay = delay_of(start.physics, timestep)
        rows = self._command.rows
        self._delay = None if delay is None else JointDelay(rows, delay, self.decimation)
        views = {name: states[name] for name in self.facts.writes}
        self._told = [views[name] for name in JOINT_STATES]
        self._stamp = views["stamp_ns"]
        self._base_states = BaseStates(views, robot, timestep, GRAVITY)
        self.reset()

    @abstractmethod
    def place(self) -> None:
        """Put the robot where it begins, at rest."""

    @abstractmethod
    def joints(self) -> tuple[Float, Float]:
        """Return positions [rad] and velocities [rad/s] in the robot's order, shape (n,) each."""

    @abstractmethod
    def base(self) -> WorldPose:
        """Return where the base is."""

    @abstractmethod
    def step(self, torque: Float) -> None:
        """Apply torques [N·m], shape (n,), and step the physics once."""

    def reset(self) -> None:
        """Put the robot back where it began, at time 0, limp."""
        self.place()
        self._ticks = 0
        self._servo.torque[...] = 0.0
        if self._delay is not None:
            self._delay.reset()
        self._measured = self.joints()
        self._now = self._before = self.base()

    def recv(self) -> bool | None:
        """Copy what the simulation says into the states."""
        for view, value in zip(self._told, (*self._measured, self._servo.torque)):
            view[...] = value
        self._base_states(self._before, self._now)
        self._stamp[...] = round(self._ticks * self._tick_ns)
        return None

    def send(self) -> bool | None:
        """Take the command and simulate one tick.

        Raises:
            Fault: a command is not finite, or the physics blew up.
        """
        self._command.take()
        left, rows = self.decimation, self._command.rows
        for steps, command in ((left, rows),) if self._delay is None else self._delay():
            self._acting[...] = command
            for _ in range(steps):
                if left == 1:
                    self._before = self.base()
                left -= 1
                torque = self._servo(*self._measured)
                if self._strength is not None:
                    torque *= self._strength
                self.step(torque)
                self._measured = self.joints()
        self._now = self.base()
        self._ticks += 1
        speeds = np.abs(self._measured[1])
        if not speeds.max() < _TOO_FAST:  # true for NaN too
            joint = int(np.argmax(np.nan_to_num(speeds, nan=np.inf)))
            raise Fault(
                f"the physics blew up before {self._ticks * self._tick_ns * 1e-9:.3f} s: joint "
                f"{self._names[joint]} moves at {speeds[joint]:.3g} rad/s; lower the gains or the "
                "physics step (timestep)"
            )
        return None

    def info(self) -> dict[str, Any]:
        """Return model and physics step."""
        return {
            "model": str(self.model_path),
            "physics_step_s": self.timestep,
            "physics_steps_per_tick": self.decimation,
        }
