"""Stop where the robot does not do what its live twin does under the same commands: `twin_stop`."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.joint_command import ticks_of
from unicon_core.bounds import Timeout
from unicon_core.errors import Fault
from unicon_core.flow.block import Reads
from unicon_core.flow.stage import Stage
from unicon_core.robots import Robot


class TwinStop:
    """Stop where the twin's flag stays raised; the workflow has a `twin:`, whose bound counts.

    It looks right behind the twin, which simulates behind `send`.

    Args:
        timeout: for which one joint's flag is raised without a break in [s]; at least one tick.
    """

    memory = ("_count",)

    stage = Stage.SAFETY
    awaits = True  # that the robot follows its commands
    patient = True

    def __init__(
        self,
        twin_flag: Reads,
        twin_gap: Reads,
        *,
        robot: Robot,
        period: float,
        timeout: Timeout = 0.2,
    ) -> None:
        self._flag, self._gap, self._robot = twin_flag, twin_gap, robot
        self._ticks = ticks_of(timeout, period)
        self._count = np.zeros(twin_flag.shape, np.int64)

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: a joint differs from its twin's.
        """
        self._count += 1
        self._count *= self._flag
        worst = int(self._count.argmax())
        if self._count[worst] >= self._ticks:
            worst = int(np.argmax(np.where(self._count >= self._ticks, self._gap, -1.0)))
            raise Fault(
                f"joint {self._robot.joint_names[worst]} is {self._gap[worst]:.2f} rad from its "
                f"twin for {self._count[worst]} ticks; is its motor weak, hot or blocked?"
            )

    def reset(self) -> None:
        """Count anew."""
        self._count[...] = 0
