"""Process of a robot behind Unitree's DDS, our own face: the peer of the official SDK and of ours.

The state carries when it was made in the first 8 bytes of the wireless remote. Commands have no
room for it, but identity control hands the first joint's position on, which numbers the states.
"""

from __future__ import annotations

import os
import time

import numpy as np

from unicon_base.arrays import Int64
from unicon_base.errors import UniconError
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.workflow.registry import find_factory
from unicon_ros.bench.pipelines.log import Log, Stop, arguments

WINDOW = 4096
"""So many states have a number of their own: 8 s at 500 Hz. A power of two, exact in float32."""


class Made:
    """When the latest states were made, by the position that tells their number in [rad]."""

    def __init__(self) -> None:
        self._stamps: Int64 = np.zeros(WINDOW, np.int64)
        self._number = 0

    def add(self, stamp: int) -> float:
        """Note when a state is made, in [ns]; return the position that it has to tell."""
        self._number = (self._number + 1) % WINDOW
        self._stamps[self._number] = stamp
        return self._number / WINDOW

    def when(self, position: float) -> int:
        """Return when the state was made that told this position; 0 where it is of no state."""
        number = position * WINDOW
        if not (0.0 <= number < WINDOW and number == int(number)):
            return 0
        return int(self._stamps[int(number)])


def main() -> None:
    """Tell states at `--state-rate` and note commands, until SIGTERM; the variant is the robot."""
    options = arguments()
    robot = load_robot(options.variant)
    states = States(standard_states(robot.joint_names))
    states["base_quat"][...] = (1, 0, 0, 0)
    states["base_lin_acc"][...] = (0, 0, 9.81)
    stop, log, made = Stop(), Log(options.out, "stamp", "received"), Made()
    served = find_factory("faces", "unitree_go", UniconError)(
        states, robot, address="127.0.0.1", domain=int(os.environ["ROS_DOMAIN_ID"]), mode=""
    )
    told = np.frombuffer(served.remote, np.int64)
    position, target = states["joint_pos"], states["joint_pos_target"]
    now, period = time.time_ns, round(1e9 / options.state_rate)
    due = now() + period
    while not stop:
        remaining = due - now()
        if remaining > 0 and not served.wait(remaining * 1e-9):
            continue
        received = now()
        if served.hear() and (stamp := made.when(float(target[0]))):
            log.add(stamp, received)
        present = now()
        if present >= due:
            due += period * ((present - due) // period + 1)
            told[0] = present
            position[0] = made.add(present)
            served.tell()
    log.save()
    served.close()


if __name__ == "__main__":
    main()
