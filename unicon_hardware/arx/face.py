"""ARX's EC and DM motors as they look on the bus, for the emulator."""

from __future__ import annotations

import math

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.arx.codec import DM, ENABLE, ENABLED, Motors, Reply, answer, command_of
from unicon_hardware.arx.platform import MOST, import_can, open_bus
from unicon_hardware.modes import EmulatedModes

EMPTY = 0.1
"""[N·m]: torques of 12 bits have no zero."""


class ArxEndpoint:
    """The arm's end of the bus; see `Face`.

    Args:
        states: of the emulator.
        robot: its file.
        channel: of the bus; the robot file's.
        interface: of python-can; `virtual` is seen in this process alone.

    Attributes:
        modes: of the motors.

    Raises:
        PlatformError: the bus cannot be opened.
        RobotError: the robot file lacks a fact.
    """

    dead_man = math.inf
    """Whether motors let go when commands stop is not known."""

    def __init__(
        self, states: States, robot: Robot, *, channel: str = "", interface: str = "virtual"
    ) -> None:
        self._states, self._motors = states, Motors.of(robot)
        channel = channel or self._motors.channel
        self._bus = open_bus(channel, interface)
        self.rate, self.where = self._motors.rate, self._bus.channel_info
        reach = {"channel": channel, "interface": interface, "unverified": True}
        self.reach: dict[str, object] = reach if interface != "virtual" else {}
        self.platform = "arx" if self.reach else ""
        self._can = import_can()
        self._joints = {number: joint for joint, number in enumerate(self._motors.numbers)}
        self._on = np.array([ENABLED * (lay is DM) for lay in self._motors.layouts], np.uint8)
        self._entered = np.zeros_like(self._on)
        self.modes = EmulatedModes(np.zeros_like(self._on))
        self._asked: list[int] = []

    @property
    def obeys(self) -> bool:
        """Whether all motors are enabled."""
        return bool((self._entered == self._on).all())

    def hear(self) -> bool:
        """See `Face`; a command without gains and torque only asks."""
        heard = False
        for _ in range(MOST):
            frame = self._bus.recv(0.0)
            if frame is None:
                break
            joint = self._joints.get(frame.arbitration_id)
            if joint is None or frame.is_extended_id or len(frame.data) != 8:
                continue
            self._asked.append(joint)
            if bytes(frame.data) == ENABLE:
                self._entered[joint] = self._on[joint]
            elif self._entered[joint] == self._on[joint]:
                heard |= self._commanded(joint, bytes(frame.data))
        self.modes.command(self._entered, self._states)
        return heard

    def _commanded(self, joint: int, data: bytes) -> bool:
        pos, vel, torque, kp, kd = command_of(self._motors.layouts[joint], data)
        torque /= self._motors.command[joint]
        figures = (pos, vel, torque, kp, kd)
        for name, figure in zip(COMMAND_STATES, figures):
            self._states[name][joint] = figure
        return kp > 0.0 or kd > 0.0 or abs(torque) > EMPTY

    def tell(self) -> None:
        """See `Face`: the answers to what was asked."""
        states, motors = self._states, self._motors
        for joint in self._asked:
            told = Reply(
                motors.numbers[joint],
                float(states["joint_pos"][joint]),
                float(states["joint_vel"][joint]),
                float(states["joint_effort"][joint] / motors.state[joint]),
                float(states["motor_temperature"][joint]),
                int(states["motor_error"][joint]),
                int(self.modes.reported[joint]),
            )
            number, data = answer(motors.numbers[joint], motors.layouts[joint], told)
            self._bus.send(
                self._can.Message(arbitration_id=number, data=data, is_extended_id=False)
            )
        self._asked.clear()

    def close(self) -> None:
        """See `Face`."""
        self._bus.shutdown()


face = ArxEndpoint
