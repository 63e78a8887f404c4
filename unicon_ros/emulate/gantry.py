"""Gantry: holds the base of a simulated robot in the air, upright, by springs and dampers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from unicon_core.platforms.kit.base import rotation
from unicon_core.platforms.kit.stepped import GRAVITY

__all__ = ["Gantry"]

FREQUENCY = 2.0
"""Of the critically damped springs in [Hz]: slow against a physics step, quick against a leg."""
RADIUS = 0.3
"""Of gyration that the turning springs are made for, in [m]: a lighter robot hangs stiffer."""


class Gantry:
    """Called before each step; it holds the base where it is when this is made.

        f = m w² (p* - p) - 2 m w v - m g,   t = m r² (w² z × e_z - 2 w omega)

    with the mass m [kg] of all that hangs, position p [m] and velocity v [m/s] of the base, its own
    vertical axis z in the world and its rate omega [rad/s]. It may turn about the vertical.

    Args:
        model: the `MjModel`.
        data: its `MjData`.
        base: number of the free joint.
    """

    def __init__(self, model: Any, data: Any, base: int) -> None:
        body = int(model.jnt_bodyid[base])
        pose, twist = int(model.jnt_qposadr[base]), int(model.jnt_dofadr[base])
        self._pose, self._twist = data.qpos[pose : pose + 7], data.qvel[twist : twist + 6]
        self._force = data.xfrc_applied[body]
        self._mass = float(model.body_subtreemass[body])
        self._place = self._pose[:3].copy()
        self._weight = self._mass * GRAVITY

    def __call__(self) -> None:
        """Apply force [N] and torque [N·m] to the base."""
        w, mass, pose, twist = 2.0 * math.pi * FREQUENCY, self._mass, self._pose, self._twist
        world_from_base = rotation(pose[3:])
        vertical, omega = world_from_base[:, 2], world_from_base @ twist[3:]
        lean = np.array((vertical[1], -vertical[0], 0.0))  # vertical × e_z
        self._force[:3] = mass * (w * w * (self._place - pose[:3]) - 2.0 * w * twist[:3])
        self._force[:3] -= self._weight
        self._force[3:] = mass * RADIUS**2 * (w * w * lean - 2.0 * w * omega)

    def let_go(self) -> None:
        """Apply nothing any more."""
        self._force[:] = 0.0
