"""Defects: what may be wrong with an emulated robot, for who tests drivers, gates and preflight."""

from __future__ import annotations

from dataclasses import dataclass

from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES


@dataclass(frozen=True)
class Defects:
    """What is wrong with a robot; joints by their numbers.

    Attributes:
        swapped: two joints whose encoders are exchanged, or none.
        dead: joints whose motors do nothing.
        imu_upside_down: the IMU is mounted on its head: turned by half a turn about its x axis.
        rate: of the frames in [Hz], less than the face's; None for that.
        leaves: a joint whose motor leaves the commanded mode, and how long after the first command
            that acts, [s]; None for none.
    """

    swapped: tuple[int, ...] = ()
    dead: tuple[int, ...] = ()
    imu_upside_down: bool = False
    rate: float | None = None
    leaves: tuple[int, float] | None = None

    def sensed(self, states: States) -> None:
        """Change what was measured."""
        if self.swapped:
            there, back = list(self.swapped), list(reversed(self.swapped))
            for name in JOINT_STATES:
                states[name][there] = states[name][back]
        if self.imu_upside_down:
            for name in ("base_ang_vel", "base_lin_acc", "projected_gravity"):
                states[name][1:] *= -1.0
            w, x, y, z = states["base_quat"].tolist()
            states["base_quat"][...] = (-x, w, z, -y)  # q (0, 1, 0, 0)

    def acted(self, states: States) -> None:
        """Change what the motors do."""
        if self.dead:
            dead = list(self.dead)
            for name in ("joint_stiffness", "joint_damping", "joint_effort_ff"):
                states[name][dead] = 0.0
