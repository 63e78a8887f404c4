"""A platform whose robot is memory of this process, as a vendor's driver fills and reads it."""

from __future__ import annotations

import time

import numpy as np

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES


class LocalPlatform:
    """Copies a driver's arrays into the states and the targets back."""

    facts = Facts("local", writes=(*JOINT_STATES, "stamp_ns"), reads=("joint_pos_target",))

    def __init__(self, states: States, robot: Robot, period: float) -> None:
        self._stamp = states["stamp_ns"]
        # One copy in and one out: the joint states stand back to back in the buffer.
        n = robot.num_joints
        first = states.offset("joint_pos")
        self._measured = states.buffer_of(np.float32)[first : first + 3 * n]
        self._driver_in = np.zeros(3 * n, np.float32)
        self._target = states["joint_pos_target"]
        self._driver_out = np.zeros(n, np.float32)
        self._scratch_in, self._scratch_out = np.zeros_like(self._driver_in), np.zeros(n, "f4")

    def recv(self) -> None:
        self._stamp[...] = time.monotonic_ns()
        self._measured[...] = self._driver_in

    def send(self) -> None:
        self._driver_out[...] = self._target

    def warm_up(self) -> None:
        time.monotonic_ns()
        self._scratch_in[...] = self._driver_in
        self._scratch_out[...] = self._target

    def close(self) -> None:
        self._driver_out[...] = 0.0
