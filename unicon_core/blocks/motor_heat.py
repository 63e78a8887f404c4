"""Block `motor_heat`: motor temperatures that follow the torque, for simulated robots.

deferred: [{motor_heat: {rise: 0.5, time_constant: 60.0}}]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import DURATION, within
from unicon_core.flow.block import Reads, Writes
from unicon_core.platforms.kit.servo import Servo
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import hardware_states

STATE = "motor_temperature"
RISE = 100.0
"""In [K/(N·m)²]: leg motors with gears have 0.05 to 1."""


def motor_heat(
    joint_pos: Reads,
    joint_vel: Reads,
    joint_pos_target: Reads,
    joint_vel_target: Reads,
    joint_effort_ff: Reads,
    joint_stiffness: Reads,
    joint_damping: Reads,
    motor_temperature: Writes,
    *,
    robot: Robot,
    period: float,
    ambient: float = 25.0,
    rise: float = 0.5,
    time_constant: float = 60.0,
) -> MotorHeat:
    """Heat each motor by what it is asked for, and cool it by its surroundings.

    c dT/dt = ambient + rise · tau² - T, with the time constant c and the torque of the servo,
    tau = kp (q* - q) + kd (qd* - qd) + tau_ff, clipped to the effort limits. That is the current in
    torques: a motor that is weak, or works against friction, is asked for more and gets hotter.

    Args:
        ambient: temperature of the surroundings, and at the beginning, in [°C].
        rise: in the end for each squared torque in [K/(N·m)²].
        time_constant: in [s].
    """
    within(ambient, "ambient", "°C", 100.0, -40.0, above=False)
    within(rise, "rise", "K/(N·m)²", RISE, above=False)
    within(time_constant, "time_constant", "s", DURATION)
    command = joint_pos_target, joint_vel_target, joint_effort_ff, joint_stiffness, joint_damping
    servo = Servo(command, robot.effort_limit)
    share = -math.expm1(-period / time_constant)
    return MotorHeat(servo, (joint_pos, joint_vel), motor_temperature, ambient, rise, share)


def _declares(*, robot: Robot, ambient: float = 25.0, **_: Any) -> Mapping[str, StateSpec]:
    spec = hardware_states(robot.joint_names)[STATE]
    return {STATE: replace(spec, initial=ambient)}


setattr(motor_heat, "declares", _declares)  # noqa: B010  a function has no such attribute to mypy


class MotorHeat:
    """The tick of `motor_heat`."""

    memory = ("_now",)

    endless = True

    def __init__(
        self,
        servo: Servo,
        measured: tuple[NDArray[np.float32], NDArray[np.float32]],
        temperature: NDArray[np.float32],
        ambient: float,
        rise: float,
        share: float,
    ) -> None:
        self._servo, self._measured, self._temperature = servo, measured, temperature
        self._ambient, self._rise, self._share = ambient, rise, share
        # In float64: 1e-4 K a tick would vanish in a float32 of 25.
        self._now = np.full(temperature.shape, ambient)
        self._goal = np.zeros(temperature.shape)

    def __call__(self) -> None:
        torque, goal, now = self._servo(*self._measured), self._goal, self._now
        np.multiply(torque, torque, out=goal)
        goal *= self._rise
        goal += self._ambient
        goal -= now
        goal *= self._share
        now += goal
        self._temperature[...] = now
