"""Fourier's FSA actuators as they look on the wire, a socket each; both versions' endpoints."""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from unicon_base import AnyDict
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.endpoint import Endpoint
from unicon_hardware.facts import ipv4
from unicon_hardware.fourier import fsa1_codec as v1
from unicon_hardware.fourier import platform as v2
from unicon_hardware.fourier.actuator_wire import DISABLE
from unicon_hardware.wire import Udp

ACKNOWLEDGED = {
    v2.ACKNOWLEDGED_GAINS: ">ff",
    v2.ARM_DEAD_MAN: ">IIIII",
    v2.CLEAR_DEAD_MAN: ">I",
    v2.PD_MODE: ">",
    v2.ENABLE: ">",
}
"""Code of version 2 to the format of what follows its count."""
MODES = {0x04: v1.POSITION_MODE, 0x05: 3, 0x06: 6, 0x07: 4}
"""Code of version 1 to mode of operation."""
GAINS = ("control_position_kp_imm", "control_velocity_kp_imm")


class ActuatorEndpoint(Endpoint):
    """Sockets of actuators, for the endpoints of both versions.

    Args:
        states: of the emulator.
        facts: of the actuators.
    """

    platform, rate = "fourier", 500.0

    def __init__(self, states: States, facts: Any) -> None:
        self._states, self._facts, self._joints = states, facts, len(facts.names)
        self.reach = {"address": facts.addresses[0]}
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
    def _said(sockets: Sequence[Udp]) -> Iterator[tuple[int, bytes, Udp]]:
        """Give what has come: number of the socket, datagram, and the socket to answer with."""
        for joint, socket in enumerate(sockets):
            for data, sender in socket.datagrams():
                socket.peer = sender
                yield joint, data, socket

    def close(self) -> None:
        """Close all sockets."""
        for socket in self._sockets:
            socket.close()


class Actuator:
    """An emulated actuator of version 2: what it was commanded."""

    def __init__(self) -> None:
        self.enabled = self.pd_mode = self.timed_out = False
        self.kp = self.kd = 0.0
        self.timeout, self.commanded = math.inf, -math.inf
        self.asked: list[int] = []

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return self.enabled and self.pd_mode and not self.timed_out

    def told(self, code: int, values: tuple[float, ...]) -> None:
        """Carry out a setting that is acknowledged."""
        if code == v2.ACKNOWLEDGED_GAINS:
            self.kp, self.kd = values
        elif code == v2.ARM_DEAD_MAN:
            self.timeout = 1e-3 * values[1] if values[0] else math.inf
            self.commanded = time.monotonic()
        elif code == v2.CLEAR_DEAD_MAN:
            self.timed_out = False
        elif code == v2.PD_MODE:
            self.pd_mode = True
        else:
            self.enabled = True


class FourierEndpoint(ActuatorEndpoint):
    """Actuators of version 2; `face` builds it."""

    def __init__(self, states: States, actuators: v2.Actuators) -> None:
        super().__init__(states, actuators)
        self.where = f"{actuators.addresses[0]}:{actuators.port} and {self._joints - 1} more"
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
        """Carry out what has come; True where a command was whole."""
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
        if code in (v2.STATE, v2.TEMPERATURE) and size == 1:
            actuator.asked.append(code)
        elif code == v2.GAINS and size == 9:
            actuator.kp, actuator.kd = struct.unpack_from(">ff", data, 1)
        elif code == DISABLE and size == 1:
            actuator.enabled = False
        elif code in ACKNOWLEDGED and size == 5 + struct.calcsize(ACKNOWLEDGED[code]):
            (count,) = struct.unpack_from(">I", data, 1)
            actuator.told(code, struct.unpack_from(ACKNOWLEDGED[code], data, 5))
            reply(struct.pack(">BII", code, count, 0))
        elif code == v2.COMMAND and size == 13 and actuator.obeys:
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
        """Answer what was asked."""
        states, facts, answer = self._states, self._facts, np.zeros((), v2.STATE_TYPE)
        answer["code"] = v2.STATE
        for joint, (actuator, socket) in enumerate(zip(self._actuators, self._sockets)):
            degrees = facts.degrees[joint]
            for code in actuator.asked:
                if code == v2.TEMPERATURE:
                    celsius = float(states["motor_temperature"][joint])
                    socket.send(struct.pack(">Bff", code, celsius, celsius))
                    continue
                pos, vel = (
                    states["joint_pos"][joint] * degrees,
                    states["joint_vel"][joint] * degrees,
                )
                torque = states["joint_effort"][joint] * facts.signs[joint]
                answer["measured"] = pos, vel, 0.0, torque
                answer["errors"] = 0
                answer["errors"][1] = 1  # the kind of its encoder, which is not an error
                answer["errors"][0] = int(states["motor_error"][joint]) & 0xFFFFFFFF
                word, bit = v2.TIMED_OUT
                answer["errors"][word] = bit * actuator.timed_out
                socket.send(answer.tobytes())
            actuator.asked.clear()


class Fsa1Endpoint(ActuatorEndpoint):
    """Actuators of version 1 and their encoders; `face` builds it.

    An actuator counts from where its joint is when this is built, as if it were switched on then.

    Args:
        states: of the emulator.
        servos: of the robot file.

    Raises:
        PlatformError: an address is taken.
    """

    def __init__(self, states: States, servos: v1.Servos) -> None:
        super().__init__(states, servos)
        n = self._joints
        self.enabled, self.mode, self.gains = np.zeros(n, bool), np.zeros(n, int), np.zeros((2, n))
        self._begun = states["joint_pos"] * servos.degrees
        self._begun[len(servos.encoders) :] = 0.0
        self._asked: list[tuple[Udp, int, int]] = []
        self._fast = self._listening(servos.addresses, servos.port)
        self._controls = self._listening(servos.addresses, servos.control_port)
        self._encoders = self._listening(servos.encoders, servos.control_port)

    @property
    def obeys(self) -> bool:
        """Whether all actuators are enabled in position mode."""
        return bool((self.enabled & (self.mode == v1.POSITION_MODE)).all())

    def hear(self) -> bool:
        """Carry out what has come; True where a command was whole."""
        heard, states = False, self._states
        for joint, data, socket in self._said(self._controls):
            self._set(joint, v1.understood(data) or {}, socket.send)
        for encoder, data, socket in self._said(self._encoders):
            if (v1.understood(data) or {}).get("reqTarget") == "/measured":
                socket.send(self._angle(encoder))
        for joint, data, socket in self._said(self._fast):
            heard |= self._acts(joint, self._heard(joint, data, socket))
        for joint in range(self._joints):
            on = self.enabled[joint] and self.mode[joint] == v1.POSITION_MODE
            stiffness, damping = self._facts.joint_gains(joint, *self.gains[:, joint].tolist())
            states["joint_stiffness"][joint] = on * stiffness
            if on:
                states["joint_damping"][joint] = damping
        return heard

    def _set(self, joint: int, asked: AnyDict, reply: Callable[[bytes], None]) -> None:
        """Carry out a setting, or answer a question, of JSON."""
        method, target, told = asked.get("method"), asked.get("reqTarget"), {"status": "OK"}
        word, mode = asked.get("control_word"), asked.get("mode_of_operation")
        gains = [v1.number(asked.get(key)) for key in GAINS]
        if method == "GET" and target == "/get_ntc_temperature":
            hot: Any = float(self._states["motor_temperature"][joint])
            told |= {"mos_temperature": hot, "armature_temperature": hot}
        elif method != "SET":
            told["status"] = "ERROR"
        elif target == "/control_word" and word in (v1.SERVO_ON, v1.SERVO_OFF):
            self.enabled[joint] = word == v1.SERVO_ON
        elif target == "/mode_of_operation" and type(mode) is int:
            self.mode[joint] = mode
        elif target == "/pid_param_imm" and None not in gains:
            self.gains[:, joint] = gains
        else:
            told["status"] = "ERROR"
        reply(json.dumps(told).encode())

    def _angle(self, encoder: int) -> bytes:
        servos, pos = self._facts, float(self._states["joint_pos"][encoder])
        turned = pos * servos.degrees[encoder] / servos.encoder_degrees[encoder]
        angle = (float(turned) + servos.encoder_zero[encoder]) % 360.0
        return json.dumps({"status": "OK", "angle": angle}).encode()

    def _heard(self, joint: int, data: bytes, socket: Udp) -> bool:
        """Carry out a code; True where it was a command that acts."""
        code, size = data[0] if data else 0, len(data)
        if code in (v1.STATE, v1.ERROR) and size == 1:
            self._asked.append((socket, joint, code))
        elif code in (v1.ENABLE, DISABLE) and size == 1:
            self.enabled[joint] = code == v1.ENABLE
        elif code in MODES and size == 1:
            self.mode[joint] = MODES[code]
        elif code == v1.POSITION and size == 13:
            if not (self.enabled[joint] and self.mode[joint] == v1.POSITION_MODE):
                return False
            pos, _, current = struct.unpack_from(">fff", data, 1)
            servos, states = self._facts, self._states
            pos += self._begun[joint]
            if not math.isfinite(pos + current):
                return False
            states["joint_pos_target"][joint] = pos / servos.degrees[joint]
            states["joint_effort_ff"][joint] = current * servos.torque[joint]
            return True
        return False

    def tell(self) -> None:
        """Answer what was asked."""
        states, servos = self._states, self._facts
        for socket, joint, code in self._asked:
            if code == v1.ERROR:
                socket.send(struct.pack(">Bi", code, int(states["motor_error"][joint])))
                continue
            degrees = servos.degrees[joint]
            pos = states["joint_pos"][joint] * degrees - self._begun[joint]
            current = states["joint_effort"][joint] / servos.torque[joint]
            vel = states["joint_vel"][joint] * degrees
            socket.send(struct.pack(">Bfff", code, pos, vel, current))
        self._asked.clear()


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
        return Fsa1Endpoint(states, v1.Servos.of(robot, network))
    return FourierEndpoint(states, v2.Actuators.of(robot, network))
