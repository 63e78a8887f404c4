"""A robot of pure NumPy whose joints follow their targets, for development and benchmarks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import Fault, PlatformError, alternatives
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES, JOINT_STATES

__all__ = ["FakePlatform", "make"]

_GRAVITY = 9.81  # [m/s²]
_WRITES = (*JOINT_STATES, *BASE_STATES, "stamp_ns")


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    time_constant: float = 0.0,
    initial_pose: Literal["default", "rest"] = "default",
    clock: Literal["simulated", "monotonic"] = "simulated",
) -> FakePlatform:
    """Build the platform.

    Args:
        period: of a tick in [s].
        time_constant: of the joints' first-order response in [s]; 0 follows within the tick.
        initial_pose: `default` or `rest` of the robot file.
        clock: of `stamp_ns`: ticks times the period, or the machine's monotonic clock.

    Raises:
        PlatformError: an option is wrong.
    """
    if initial_pose not in ("default", "rest"):
        known = alternatives(initial_pose, ("default", "rest"))
        raise PlatformError(f"platform 'fake': no initial_pose {initial_pose!r}; {known}")
    if clock not in ("simulated", "monotonic"):
        known = alternatives(clock, ("simulated", "monotonic"))
        raise PlatformError(f"platform 'fake': no clock {clock!r}; {known}")
    if not time_constant >= 0.0:
        raise PlatformError(f"platform 'fake': time_constant is {time_constant} s; give 0 or more")
    return FakePlatform(states, robot, period, time_constant, initial_pose, clock)


class FakePlatform:
    """Joints that approach their targets within the robot's limits; the base stands still.

    A joint without stiffness stays where it is. `joint_effort` is the servo's torque
    kp (q* - q) + kd (qd* - qd) + tau_ff, clipped to the effort limits.
    """

    name = "fake"
    reads: tuple[str, ...] = COMMAND_STATES
    notes: tuple[str, ...] = ()
    require: Callable[[Mapping[str, str]], None] | None = None

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        time_constant: float,
        initial_pose: str,
        clock: str,
    ) -> None:
        self.simulated = clock == "simulated"
        self.writes = tuple(name for name in _WRITES if name in states)
        self._states, self._robot = states, robot
        self._period, self._time_constant = period, time_constant
        self._share = 1.0 if time_constant == 0.0 else -math.expm1(-period / time_constant)
        pose = robot.rest_joint_pos if initial_pose == "rest" else robot.default_joint_pos
        self._initial = np.nan_to_num(pose)
        self._lower = np.nan_to_num(robot.lower, nan=-np.inf)
        self._upper = np.nan_to_num(robot.upper, nan=np.inf)
        self._effort = np.nan_to_num(robot.effort_limit, nan=np.inf)
        shape = states["joint_pos_target"].shape
        self._pos, self._vel, self._torque = (np.zeros(shape, np.float32) for _ in range(3))
        self._next, self._gain = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._commands: list[NDArray[Any]] = [states[name] for name in COMMAND_STATES]
        self._stamp = states["stamp_ns"] if "stamp_ns" in self.writes else np.zeros((), np.int64)
        self._outputs = [
            (states[name], value)
            for name, value in (
                ("joint_pos", self._pos),
                ("joint_vel", self._vel),
                ("joint_effort", self._torque),
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
        if self.simulated:
            self._stamp[...] = round(self._ticks * self._period * 1e9)
        else:
            self._stamp[...] = time.monotonic_ns()
        return None

    def send(self) -> bool | None:
        """Move the joints towards their targets for one tick.

        Raises:
            Fault: a command is not finite.
        """
        target, velocity, feed_forward, stiffness, damping = self._commands
        for name, command in zip(COMMAND_STATES, self._commands):
            if not np.isfinite(command).all():
                joint = int(np.argwhere(~np.isfinite(command))[0][-1])
                raise Fault(
                    f"command {name} of joint {self._robot.joint_names[joint]} is "
                    f"{command[..., joint].tolist()} at tick {self._ticks}; nothing was sent"
                )
        torque, new = self._torque, self._next
        np.subtract(target, self._pos, out=new)
        np.multiply(stiffness, new, out=torque)
        torque += damping * (velocity - self._vel) + feed_forward
        np.clip(torque, -self._effort, self._effort, out=torque)
        np.greater(stiffness, 0.0, out=self._gain, casting="unsafe")
        new *= self._gain
        new *= self._share
        new += self._pos
        np.clip(new, self._lower, self._upper, out=new)
        np.subtract(new, self._pos, out=self._vel)
        self._vel /= self._period
        self._pos[...] = new
        self._ticks += 1
        return None

    def reset(self) -> None:
        """Put the joints back where they began, at time 0."""
        self._pos[...] = self._initial
        self._vel[...] = 0.0
        self._torque[...] = 0.0
        self._ticks = 0

    def close(self) -> None:
        """Let go; there is nothing to damp."""

    def info(self) -> Mapping[str, Any]:
        """Return the joints' response and the clock."""
        return {
            "model": None,
            "time_constant_s": self._time_constant,
            "clock": "simulated" if self.simulated else "monotonic",
        }
