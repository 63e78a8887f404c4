"""Fourier's FSA v2 actuators as they look on the wire, one socket each; for the emulator."""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

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
from unicon_hardware.fourier.fsa1_codec import (
    ENABLE,
    ERROR,
    POSITION,
    POSITION_MODE,
    SERVO_OFF,
    SERVO_ON,
    STATE,
    Servos,
    number,
    understood,
)
from unicon_hardware.wire import Udp

MODES = {0x04: POSITION_MODE, 0x05: 3, 0x06: 6, 0x07: 4}
"""Code to mode of operation."""
GAINS = ("control_position_kp_imm", "control_velocity_kp_imm")


class ActuatorEndpoint:
    """Sockets of actuators, for the faces of both versions.

    Args:
        states: of the emulator.
        where: first address of the actuators.
        joints: how many they are.
    """

    platform, rate = "fourier", 500.0

    def __init__(self, states: States, where: str, joints: int) -> None:
        self._states, self.reach, self._joints = states, {"address": where}, joints
        self._sockets: list[Udp] = []
        self._commanded: set[int] = set()

    def _listening(self, addresses: tuple[str, ...], port: int) -> list[Udp]:
        """Open a socket at each address; where one fails, all are closed."""
        first = len(self._sockets)
        try:
            for address in addresses:
                self._sockets.append(Udp((address, port), ("", 0), "emulated fourier"))
        except BaseException:
            self.close()
            raise
        return self._sockets[first:]

    def _acts(self, joint: int, commanded: bool) -> bool:
        """Return whether a command is whole: datagrams come one after the other, all count."""
        if commanded:
            self._commanded.add(joint)
        return commanded and len(self._commanded) == self._joints

    @staticmethod
    def _said(sockets: list[Udp]) -> Iterator[tuple[int, bytes, Udp]]:
        """Give what has come: number of the socket, datagram, and the socket to answer with."""
        for joint, socket in enumerate(sockets):
            for data, sender in socket.datagrams():
                socket.peer = sender
                yield joint, data, socket

    def close(self) -> None:
        """See `Face`."""
        for socket in self._sockets:
            socket.close()


class Fsa1Endpoint(ActuatorEndpoint):
    """See `Face`; `face` of `fourier.face` builds it.

    An actuator counts from where its joint is when this is built, as if it were switched on then.

    Args:
        states: of the emulator.
        servos: of the robot file.

    Raises:
        PlatformError: an address is taken.
    """

    dead_man = math.inf

    def __init__(self, states: States, servos: Servos) -> None:
        super().__init__(states, servos.addresses[0], len(servos.names))
        self._servos, n = servos, len(servos.names)
        self.enabled, self.mode = np.zeros(n, bool), np.zeros(n, int)
        self.gains = np.zeros((2, n))
        self._begun = states["joint_pos"] * servos.degrees
        self._begun[len(servos.encoders) :] = 0.0
        self._asked: list[tuple[Udp, int, int]] = []
        self._fast = self._listening(servos.addresses, servos.port)
        self._controls = self._listening(servos.addresses, servos.control_port)
        self._encoders = self._listening(servos.encoders, servos.control_port)

    @property
    def obeys(self) -> bool:
        """Whether all actuators are enabled in position mode."""
        return bool((self.enabled & (self.mode == POSITION_MODE)).all())

    def hear(self) -> bool:
        """See `Face`."""
        heard, states = False, self._states
        for joint, data, socket in self._said(self._controls):
            self._set(joint, understood(data) or {}, socket.send)
        for encoder, data, socket in self._said(self._encoders):
            if (understood(data) or {}).get("reqTarget") == "/measured":
                socket.send(self._angle(encoder))
        for joint, data, socket in self._said(self._fast):
            heard |= self._acts(joint, self._heard(joint, data, socket))
        for joint in range(len(self._fast)):
            on = self.enabled[joint] and self.mode[joint] == POSITION_MODE
            stiffness, damping = self._servos.joint_gains(joint, *self.gains[:, joint].tolist())
            states["joint_stiffness"][joint] = on * stiffness
            if on:
                states["joint_damping"][joint] = damping
        return heard

    def _set(self, joint: int, asked: dict[str, Any], reply: Callable[[bytes], None]) -> None:
        """Carry out a setting, or answer a question, of JSON."""
        target, status, told = asked.get("reqTarget"), "OK", {}
        if asked.get("method") == "GET" and target == "/get_ntc_temperature":
            hot = float(self._states["motor_temperature"][joint])
            told = {"mos_temperature": hot, "armature_temperature": hot}
        elif asked.get("method") != "SET":
            status = "ERROR"
        elif target == "/control_word" and asked.get("control_word") in (SERVO_ON, SERVO_OFF):
            self.enabled[joint] = asked["control_word"] == SERVO_ON
        elif target == "/mode_of_operation" and type(asked.get("mode_of_operation")) is int:
            self.mode[joint] = asked["mode_of_operation"]
        elif target == "/pid_param_imm" and None not in (
            values := [*map(number, map(asked.get, GAINS))]
        ):
            self.gains[:, joint] = values
        else:
            status = "ERROR"
        reply(json.dumps({"status": status, **told}).encode())

    def _angle(self, encoder: int) -> bytes:
        servos, pos = self._servos, float(self._states["joint_pos"][encoder])
        turned = pos * servos.degrees[encoder] / servos.encoder_degrees[encoder]
        angle = (float(turned) + servos.encoder_zero[encoder]) % 360.0
        return json.dumps({"status": "OK", "angle": angle}).encode()

    def _heard(self, joint: int, data: bytes, socket: Udp) -> bool:
        """Carry out a code; True where it was a command that acts."""
        code, size = data[0] if data else 0, len(data)
        if code in (STATE, ERROR) and size == 1:
            self._asked.append((socket, joint, code))
        elif code in (ENABLE, DISABLE) and size == 1:
            self.enabled[joint] = code == ENABLE
        elif code in MODES and size == 1:
            self.mode[joint] = MODES[code]
        elif code == POSITION and size == 13:
            if not (self.enabled[joint] and self.mode[joint] == POSITION_MODE):
                return False
            pos, _, current = struct.unpack_from(">fff", data, 1)
            servos, states = self._servos, self._states
            pos += self._begun[joint]
            if not math.isfinite(pos + current):
                return False
            states["joint_pos_target"][joint] = pos / servos.degrees[joint]
            states["joint_effort_ff"][joint] = current * servos.torque[joint]
            return True
        return False

    def tell(self) -> None:
        """See `Face`: the answers to what was asked."""
        states, servos = self._states, self._servos
        for socket, joint, code in self._asked:
            if code == ERROR:
                socket.send(struct.pack(">Bi", code, int(states["motor_error"][joint])))
                continue
            degrees = servos.degrees[joint]
            pos = states["joint_pos"][joint] * degrees - self._begun[joint]
            current = states["joint_effort"][joint] / servos.torque[joint]
            vel = states["joint_vel"][joint] * degrees
            socket.send(struct.pack(">Bfff", code, pos, vel, current))
        self._asked.clear()


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


def face(
    states: States, robot: Robot, *, address: str = "127.0.0.1"
) -> FourierEndpoint | Fsa1Endpoint:
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
