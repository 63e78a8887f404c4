"""The servo of a model that several robots of a batch share, one after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.platforms.sim.mujoco.servo import Servo

Float = NDArray[np.float64]
Told = tuple[Float, Float, Float]
"""Controls, gains and biases of one robot's actuators: shapes (n,), (n,) and (n, 3)."""


class SharedServo(Servo):
    """Reckons the commands of all robots at once, and writes each one before its robot's step."""

    def told(self, command: Float) -> list[Told]:
        """Return what `push` would bring into the model, of every robot of a batch at once.

        Args:
            command: rows as of `push`, shape (5, N, n).

        Returns:
            What `write` takes, for each robot.
        """
        if self._strength is not None:
            command = np.concatenate((command[:2], command[2:] * self._strength))
        stiffness, damping = command[3:] / self.gear**2
        b0 = (command[4] * command[1] + command[2]) / self.gear
        bias = np.stack((b0, -stiffness, -damping), axis=-1)
        return list(zip(command[0] * self.gear, stiffness, bias))

    def write(self, ctrl: Float, told: Told) -> None:
        """Put what `told` returned into the model and one robot's controls.

        Args:
            ctrl: `MjData.ctrl` of the robot.
            told: of the robot.
        """
        index = self.index
        ctrl[index], self._gain[index], self._bias[index, :3] = told
        self._written = b""  # it is not what was pushed any more
