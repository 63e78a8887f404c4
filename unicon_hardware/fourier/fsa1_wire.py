"""Fsa1Wire: position commands, gains and encoders of Fourier's FSA v1 actuators (GR-1).

These actuators have no dead man: what they do without commands is not known. An actuator counts
from where it was switched on, and the absolute encoder at its joint knows where that was.
"""

from __future__ import annotations

import numpy as np

from unicon_base import Fault
from unicon_core.states import States
from unicon_hardware.fourier.actuator_wire import LARGEST, ActuatorWire
from unicon_hardware.fourier.fsa1_codec import (
    ERROR,
    ERROR_TYPE,
    MEASURED,
    POSITION,
    POSITION_MODE,
    SERVO_OFF,
    SERVO_ON,
    STATE,
    STATE_TYPE,
    TEMPERATURE,
    Servos,
    control_word,
    loop_gains,
    mode_of_operation,
    number,
    understood,
)

SAMPLES = 10
"""Of each encoder, whose mean counts."""
APART = 3.0
"""Two samples of a joint's zero may differ by so much, in [deg] of the actuator."""


class Zero:
    """See the module.

    Args:
        servos: of the robot.

    Attributes:
        offset: what is to be added to what an actuator tells, in [deg], shape (n,); 0 for a joint
            without encoder.
    """

    def __init__(self, servos: Servos) -> None:
        self._servos = servos
        self.offset = np.zeros(len(servos.names))
        self._samples: list[list[float]] = [[] for _ in servos.encoders]

    @property
    def missing(self) -> list[int]:
        """The encoders that have not answered often enough."""
        return [i for i, samples in enumerate(self._samples) if len(samples) < SAMPLES]

    def told(self, encoder: int, angle: float, position: float) -> None:
        """Take a sample.

        Args:
            encoder: which.
            angle: what it tells, [deg].
            position: what its actuator told at the same time, [deg].

        Raises:
            Fault: samples contradict each other.
        """
        samples, servos = self._samples[encoder], self._servos
        if len(samples) == SAMPLES:
            return
        turned = (angle - servos.encoder_zero[encoder] + 180.0) % 360.0 - 180.0
        samples.append(float(turned * servos.encoder_degrees[encoder]) - position)
        if len(samples) < SAMPLES:
            return
        apart = max(samples) - min(samples)
        if apart > APART:
            raise Fault(
                f"fourier: encoder {servos.encoders[encoder]} of {servos.names[encoder]} and its "
                f"actuator disagree by {apart:.1f} deg within {SAMPLES} samples; keep the robot "
                "still until it is connected, and look at the encoder"
            )
        self.offset[encoder] = float(np.mean(samples))


HOTTEST = 1e3
"""[°C]: beyond it nothing is a temperature."""


STEPS = (
    (f"'servo off' (control word {SERVO_OFF:#x})", lambda _: control_word(SERVO_OFF)),
    ("'no gains' (pid_param_imm)", lambda _: loop_gains(0.0, 0.0)),
    (f"'position mode' ({POSITION_MODE})", lambda _: mode_of_operation(POSITION_MODE)),
    (f"'servo on' (control word {SERVO_ON:#x})", lambda _: control_word(SERVO_ON)),
)
"""How actuators are enabled: gains are zero before, so that none jumps."""


class Fsa1Wire(ActuatorWire):
    """See the module.

    Args:
        states: of the workflow.
        servos: of the robot.
    """

    off_times = 3  # nothing else lets these actuators go

    def __init__(self, states: States, servos: Servos) -> None:
        super().__init__(states, servos, POSITION, STEPS)
        n = len(servos.names)
        self._controls = self._open(self._labels, servos.addresses, servos.control_port)
        labels = tuple(f"{address} (encoder)" for address in servos.encoders)
        self._encoders = self._open(labels, servos.encoders, servos.control_port)
        self._zero = Zero(servos)
        self._measurements, self._errors = np.zeros((n, 3)), np.zeros(n, np.uint32)

    @property
    def where(self) -> str:
        """The actuators that have not answered since all did last, or the encoders that miss."""
        missing = self._zero.missing
        if missing and self._answered.heard.all():
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            return f"encoder {self._facts.encoders[missing[0]]}{more}"
        return super().where

    def _step(self, joint: int, data: bytes) -> None:
        self._controls[joint].send(data)

    def take(self) -> int:
        """See `Wire`."""
        for joint, socket in enumerate(self._controls):
            for data in socket.received():
                self._told(joint, data)
        for encoder, socket in enumerate(self._encoders):
            for data in socket.received():
                self._encoder(encoder, data)
        return super().take()

    def _complete(self) -> bool:
        return not self._zero.missing and super()._complete()

    def _sort(self, joint: int, data: bytes) -> None:
        code, size = data[0] if data else 0, len(data)
        if code == STATE and size == STATE_TYPE.itemsize:
            measured = np.frombuffer(data, STATE_TYPE)["measured"][0]
            if np.isfinite(measured).all():
                self._measurements[joint], self._answered.heard[joint] = measured, True
            else:
                self.counts.refuse("not finite", self._labels[joint])
        elif code == ERROR and size == ERROR_TYPE.itemsize:
            self._errors[joint] = np.frombuffer(data, ERROR_TYPE)["error"][0]
        else:
            self.counts.refuse("not understood", f"code {code:#x}, {size} bytes")

    def _told(self, joint: int, data: bytes) -> None:
        """Take a JSON answer of an actuator."""
        answer = understood(data)
        if answer is None or "status" not in answer:
            self.counts.refuse("not understood", f"{len(data)} bytes of {self._labels[joint]}")
        elif "mos_temperature" in answer:
            celsius = [number(answer.get(f"{of}_temperature")) for of in ("mos", "armature")]
            known = [value for value in celsius if value is not None and abs(value) < HOTTEST]
            if len(known) < len(celsius):
                self.counts.refuse("not finite", f"temperature of {self._labels[joint]}")
            elif self._hot is not None:
                self._hot[joint] = max(known)
        else:
            refusal = "" if answer["status"] == "OK" else repr(answer["status"])[:40]
            if refusal and self._enabling.done:
                self.counts.refuse("not carried out", f"gains of {self._labels[joint]}: {refusal}")
            self._enabling.answered(joint, self._enabling.count, refusal)

    def _encoder(self, encoder: int, data: bytes) -> None:
        angle = number((understood(data) or {}).get("angle"))
        if angle is None or abs(angle) > LARGEST:
            self.counts.refuse("not understood", f"encoder {self._facts.encoders[encoder]}")
        elif self._answered.heard[encoder]:
            self._zero.told(encoder, angle, float(self._measurements[encoder, 0]))

    def _measured(self) -> None:
        # All of them, as the zero may have become known since.
        servos, states, measured = self._facts, self._states, self._measurements
        states["joint_pos"][...] = (measured[:, 0] + self._zero.offset) / servos.degrees
        states["joint_vel"][...] = measured[:, 1] / servos.degrees
        states["joint_effort"][...] = measured[:, 2] * servos.torque
        if self._error is not None:
            self._error[...] = self._errors.view(np.int32)

    def _ask(self) -> None:
        queries = bytes([STATE]), bytes([ERROR])
        for socket in self._sockets:
            for query in queries:
                socket.send(query)
        for encoder in self._zero.missing:
            self._encoders[encoder].send(MEASURED)
        if self._enabling.done or not self._enabling.count:
            # Answers have no number: between them nothing else is asked.
            self._controls[self._turn].send(TEMPERATURE)

    def prepare(self) -> str:
        """See `Prepared`: off, gains 0, position mode, enabled."""
        joints = np.flatnonzero(self._errors).tolist()
        told = self._prepared({joint: hex(self._errors[joint]) for joint in joints})
        if self._enabling.count:
            # Where they are is where they stay, whatever had been sent before.
            self._commands["pos"], self._commands["current"] = self._measurements[:, 0], 0.0
            self._tell_all(self._datagrams())
        return told

    def put(self) -> None:
        """See `Wire`; target speeds are not sent, since the unit of their field is not known.

        Raises:
            Fault: stiffness without damping is asked for, or a velocity without stiffness; or the
                network does not take it.
        """
        states, servos = self._states, self._facts
        stiffness, damping = states["joint_stiffness"], states["joint_damping"]
        loose = np.flatnonzero((stiffness > 0.0) & ~(damping > 0.0))
        if len(loose):
            raise Fault(
                f"fourier: {servos.names[loose[0]]} shall have stiffness without damping, which "
                "the position loop of FSA v1 cannot; give it a damping above 0"
            )
        turned = np.flatnonzero((stiffness <= 0.0) & (states["joint_vel_target"] != 0.0))
        if len(turned):
            raise Fault(
                f"fourier: {servos.names[turned[0]]} shall turn at a velocity without stiffness, "
                "which the position loop of FSA v1 cannot; command it a position"
            )
        commands = self._commands
        held = self._held(
            states["joint_pos_target"] * servos.degrees - self._zero.offset,
            states["joint_effort_ff"] / servos.torque,
            *servos.gains(stiffness, damping),
            beyond=bool(states["joint_vel_target"].any()),
        )
        commands["pos"], commands["current"] = held[:2]
        gains = held[2:]
        due = [(self._controls[i], loop_gains(*gains[:, i].tolist())) for i in self._due(gains)]
        self._tell_all(self._datagrams() + due)
