"""Block `motor_heat`: motor temperatures that follow the torque, for simulated robots.

deferred: [{motor_heat: {rise: 0.5, time_constant: 60.0}}]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from unicon_base.schema.marks import Within, positive
from unicon_core.blocks.joint_command import Commands
from unicon_core.bounds import DURATION
from unicon_core.flow.block import Reads, Writes
from unicon_core.platforms.kit.servo import Servo
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import hardware_states

STATE = "motor_temperature"
AMBIENT = 25.0
"""Unless said, in [°C]."""
RISE = 100.0
"""In [K/(N·m)²]: leg motors with gears have 0.05 to 1."""


class MotorHeat:
    """Heat each motor by what it is asked for, and cool it by its surroundings.

    c dT/dt = ambient + rise · tau² - T, with the time constant c and the torque of the servo,
    tau = kp (q* - q) + kd (qd* - qd) + tau_ff, clipped to the effort limits. That is the current in
    torques: a motor that is weak, or works against friction, is asked for more and gets hotter.

    Args:
        ambient: temperature of the surroundings, and at the beginning, in [°C].
        rise: in the end for each squared torque in [K/(N·m)²].
        time_constant: in [s].
    """

    memory = ("_now",)

    endless = True

    def __init__(
        self,
        joint_pos: Reads,
        joint_vel: Reads,
        command: Commands,
        motor_temperature: Writes,
        *,
        robot: Robot,
        period: float,
        ambient: Annotated[float, Within(-40.0, 100.0, "°C")] = AMBIENT,
        rise: Annotated[float, Within(0.0, RISE, "K/(N·m)²")] = 0.5,
        time_constant: Annotated[float, positive(DURATION, "s")] = 60.0,
    ) -> None:
        self._servo = Servo(tuple(command), robot.effort_limit)
        self._measured, temperature = (joint_pos, joint_vel), motor_temperature
        self._temperature, self._ambient, self._rise = temperature, ambient, rise
        self._share = -math.expm1(-period / time_constant)
        # In float64: 1e-4 K a tick would vanish in a float32 of 25.
        self._now = np.full(temperature.shape, ambient)
        self._goal = np.zeros(temperature.shape)

    @staticmethod
    def declares(*, robot: Robot, ambient: float = AMBIENT, **_: Any) -> Mapping[str, StateSpec]:
        """Return the temperature as it is at the beginning."""
        spec = hardware_states(robot.joint_names)[STATE]
        return {STATE: replace(spec, initial=ambient)}

    def __call__(self) -> None:
        torque, goal, now = self._servo(*self._measured), self._goal, self._now
        np.multiply(torque, torque, out=goal)
        goal *= self._rise
        goal += self._ambient
        goal -= now
        goal *= self._share
        now += goal
        self._temperature[...] = now
