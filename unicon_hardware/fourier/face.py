"""Fourier's FSA v2 actuators as they look on the wire, one socket each; for the emulator."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.facts import ipv4
from unicon_hardware.fourier.codec import (
    ACKNOWLEDGED_GAINS,
    ARM_DEAD_MAN,
    CLEAR_DEAD_MAN,
    COMMAND,
    DISABLE,
    ENABLE,
    GAINS,
    PD_MODE,
    STATE,
    STATE_TYPE,
    TEMPERATURE,
    TIMED_OUT,
    Actuators,
)
from unicon_hardware.fourier.fsa1_codec import Servos
from unicon_hardware.fourier.fsa1_face import ActuatorEndpoint, Fsa1Endpoint

ACKNOWLEDGED = {
    ACKNOWLEDGED_GAINS: ">ff",
    ARM_DEAD_MAN: ">IIIII",
    CLEAR_DEAD_MAN: ">I",
    PD_MODE: ">",
    ENABLE: ">",
}
"""Code to the format of what follows its count."""


class Actuator:
    """One of them: what it was told."""

    def __init__(self) -> None:
        self.enabled, self.pd_mode = False, False
        self.kp = self.kd = 0.0
        self.timeout, self.commanded = math.inf, -math.inf
        self.timed_out = False
        self.asked: list[int] = []

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return self.enabled and self.pd_mode and not self.timed_out

    def told(self, code: int, values: tuple[float, ...]) -> None:
        """Carry out a setting that is acknowledged."""
        if code == ACKNOWLEDGED_GAINS:
            self.kp, self.kd = values
        elif code == ARM_DEAD_MAN:
            self.timeout = 1e-3 * values[1] if values[0] else math.inf
            self.commanded = time.monotonic()
        elif code == CLEAR_DEAD_MAN:
            self.timed_out = False
        elif code == PD_MODE:
            self.pd_mode = True
        else:
            self.enabled = True


class FourierEndpoint(ActuatorEndpoint):
    """See `Face`; `face` builds it."""

    def __init__(self, states: States, actuators: Actuators) -> None:
        super().__init__(states, actuators.addresses[0], len(actuators.names))
        self._facts, n = actuators, len(actuators.names)
        self.where = f"{actuators.addresses[0]}:{actuators.port} and {n - 1} more"
        self._actuators = [Actuator() for _ in actuators.names]
        self._listening(actuators.addresses, actuators.port)

    @property
    def obeys(self) -> bool:
        """Whether all actuators are enabled."""
        return all(actuator.obeys for actuator in self._actuators)

    @property
    def dead_man(self) -> float:
        """What was armed, in [s]; infinity before."""
        return min(actuator.timeout for actuator in self._actuators)

    def hear(self) -> bool:
        """See `Face`."""
        heard = False
        for joint, data, socket in self._said(self._sockets):
            heard |= self._acts(joint, self._heard(joint, data, socket.send))
        states, facts = self._states, self._facts
        for joint, actuator in enumerate(self._actuators):
            if time.monotonic() - actuator.commanded > actuator.timeout:
                actuator.timed_out = actuator.timed_out or actuator.enabled
            on = actuator.obeys
            states["joint_stiffness"][joint] = on * actuator.kp / facts.kp[joint]
            if on:
                states["joint_damping"][joint] = actuator.kd / facts.kd[joint]
        return heard

    def _heard(self, joint: int, data: bytes, reply: Callable[[bytes], None]) -> bool:
        """Carry out a datagram; True where it was a command that acts."""
        actuator, code, size = self._actuators[joint], data[0] if data else 0, len(data)
        if code in (STATE, TEMPERATURE) and size == 1:
            actuator.asked.append(code)
        elif code == GAINS and size == 9:
            actuator.kp, actuator.kd = struct.unpack_from(">ff", data, 1)
        elif code == DISABLE and size == 1:
            actuator.enabled = False
        elif code in ACKNOWLEDGED and size == 5 + struct.calcsize(ACKNOWLEDGED[code]):
            (count,) = struct.unpack_from(">I", data, 1)
            actuator.told(code, struct.unpack_from(ACKNOWLEDGED[code], data, 5))
            reply(struct.pack(">BII", code, count, 0))
        elif code == COMMAND and size == 13 and actuator.obeys:
            actuator.commanded = time.monotonic()
            pos, vel, current = struct.unpack_from(">fff", data, 1)
            facts, states = self._facts, self._states
            states["joint_pos_target"][joint] = pos / facts.degrees[joint]
            states["joint_vel_target"][joint] = vel / facts.degrees[joint]
            if facts.current is not None:
                states["joint_effort_ff"][joint] = current / facts.current[joint]
            return True
        return False

    def tell(self) -> None:
        """See `Face`: the answers to what was asked."""
        states, facts, answer = self._states, self._facts, np.zeros(1, STATE_TYPE)
        answer["code"] = STATE
        for joint, (actuator, socket) in enumerate(zip(self._actuators, self._sockets)):
            scale = facts.degrees[joint]
            for code in actuator.asked:
                if code == TEMPERATURE:
                    celsius = float(states["motor_temperature"][joint])
                    socket.send(struct.pack(">Bff", code, celsius, celsius))
                    continue
                answer["measured"] = (
                    states["joint_pos"][joint] * scale,
                    states["joint_vel"][joint] * scale,
                    0.0,
                    states["joint_effort"][joint] * np.sign(scale),
                )
                answer["errors"] = 0
                answer["errors"][0, 1] = 1  # the kind of its encoder, which is not an error
                answer["errors"][0, 0] = int(states["motor_error"][joint]) & 0xFFFFFFFF
                answer["errors"][0, TIMED_OUT[0]] = TIMED_OUT[1] * actuator.timed_out
                socket.send(answer.tobytes())
            actuator.asked.clear()


def face(states: States, robot: Robot, *, address: str = "127.0.0.1") -> FourierEndpoint | Fsa1Endpoint:
    """Return the robot's end of its protocol.

    Args:
        states: of the emulator.
        robot: its file.
        address: any of the network of 256 in which the actuators listen; all of 127 is this
            machine (Linux).

    Raises:
        PlatformError: the address is wrong, or taken.
        RobotError: the robot file lacks a fact.
    """
    network = ipv4(address, "fourier")
    if robot.transport.get("fsa") == 1:
        return Fsa1Endpoint(states, Servos.of(robot, network))
    return FourierEndpoint(states, Actuators.of(robot, network))
