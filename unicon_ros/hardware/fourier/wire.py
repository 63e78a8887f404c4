"""FourierWire: a socket to each of Fourier's FSA actuators; for their platform.

One tick asks, the next one takes. A frame is complete when every joint has answered; who has not
stands in `where`, and so in the fault of a robot that is silent.
"""

from __future__ import annotations

import select
import time

import numpy as np

from unicon_core.errors import Fault
from unicon_core.states import States
from unicon_core.states.standard import HARDWARE_STATES
from unicon_ros.hardware.answers import Answers
from unicon_ros.hardware.fourier.codec import (
    ACKNOWLEDGED,
    COMMAND,
    COMMAND_TYPE,
    DISABLE,
    GAINS,
    GAINS_TYPE,
    STATE,
    STATE_TYPE,
    TEMPERATURE,
    TEMPERATURE_TYPE,
    TIMED_OUT,
    Actuators,
)
from unicon_ros.hardware.fourier.enabling import Enabling
from unicon_ros.hardware.udp import Udp
from unicon_ros.hardware.wire import Counts

__all__ = ["FourierWire"]

LARGEST = 1e6
"""[deg], and of gains and currents: nothing beyond it is meant, and its float stays finite."""
KIND_OF_ENCODER = 1, 0x03
"""Of `errors`: a word whose lowest two bits are no error."""


class FourierWire:
    """See the module.

    Args:
        states: of the workflow.
        actuators: of the robot.
        dead_man: after so long without a command an actuator lets go by itself, [s].
    """

    def __init__(self, states: States, actuators: Actuators, dead_man: float) -> None:
        self._states, self._actuators, n = states, actuators, len(actuators.names)
        self.counts = Counts()
        self._labels = tuple(map("{} ({})".format, actuators.names, actuators.addresses))
        self._enabling = Enabling(self._labels, self._tell, dead_man, actuators.timeout_mode)
        self._answers = bytearray(n * STATE_TYPE.itemsize)
        self._frames = np.frombuffer(self._answers, STATE_TYPE)
        self._answered, self._new = Answers(self._labels), np.zeros(n, bool)
        self._errors = np.zeros((n, 8), np.uint32)
        self._commands = np.zeros(n, COMMAND_TYPE)
        self._commands["code"] = COMMAND
        self._gains = np.zeros(n, GAINS_TYPE)
        self._gains["code"] = GAINS
        self._sent_gains = np.full((2, n), np.nan, np.float32)
        self._asked, self._turn, self._strangers = 0.0, 0, 0
        hardware = {name: states[name] for name in HARDWARE_STATES if name in states}
        self._hot, self._error = hardware.get("motor_temperature"), hardware.get("motor_error")
        self._sockets: list[Udp] = []
        try:
            for label, address in zip(self._labels, actuators.addresses):
                what = f"fourier: actuator {label}"
                self._sockets.append(Udp(("0.0.0.0", 0), (address, actuators.port), what))
        except BaseException:
            self._let_go()
            raise

    @property
    def where(self) -> str:
        """The actuators that have not answered since all did last."""
        return str(self._answered)

    def _tell(self, joint: int, data: bytes | memoryview) -> None:
        self._sockets[joint].send(data)

    def take(self) -> int:
        """See `Wire`."""
        for joint, socket in enumerate(self._sockets):
            for data in socket.received():
                self._sort(joint, data)
        strangers = sum(socket.strangers for socket in self._sockets)
        self.counts.refused["of a stranger"] += strangers - self._strangers
        self._strangers = strangers
        self._measured()
        self._ask()
        complete = self._answered.complete()
        self.counts.good += complete
        return int(complete)

    def _sort(self, joint: int, data: bytes) -> None:
        code, size = data[0] if data else 0, len(data)
        if code == STATE and size == STATE_TYPE.itemsize:
            start = joint * size
            self._answers[start : start + size] = data
            self._new[joint] = True
        elif code == TEMPERATURE and size == TEMPERATURE_TYPE.itemsize:
            celsius = np.frombuffer(data, TEMPERATURE_TYPE)["celsius"]
            if not np.isfinite(celsius).all():
                self.counts.refuse("not finite", f"temperature of {self._labels[joint]}")
            elif self._hot is not None:
                self._hot[joint] = celsius.max()
        elif size == ACKNOWLEDGED.itemsize and 0x51 <= code <= 0x66:
            answer = np.frombuffer(data, ACKNOWLEDGED)[0]
            count, result = int(answer["count"]), int(answer["result"])
            self._enabling.answered(joint, code, count, result)
        else:
            self.counts.refuse("not understood", f"code {code:#x}, {size} bytes")

    def _measured(self) -> None:
        """Bring what came of states into ours, where it is finite."""
        if not self._new.any():
            return
        measured = self._frames["measured"]
        good = self._new & np.isfinite(measured).all(axis=1)
        for joint in np.flatnonzero(self._new & ~good):
            self.counts.refuse("not finite", self._labels[joint])
        self._new[...] = False
        degrees, states = self._actuators.degrees, self._states
        signs = np.sign(degrees)
        np.copyto(states["joint_pos"], measured[:, 0] / degrees, where=good, casting="same_kind")
        np.copyto(states["joint_vel"], measured[:, 1] / degrees, where=good, casting="same_kind")
        np.copyto(states["joint_effort"], measured[:, 3] * signs, where=good, casting="same_kind")
        self._errors[good] = self._frames["errors"][good]
        self._errors[:, KIND_OF_ENCODER[0]] &= ~np.uint32(KIND_OF_ENCODER[1])
        if not self._enabling.done:
            # Of an earlier run that died: it is cleared behind the gates, which stop at any error.
            self._errors[:, TIMED_OUT[0]] &= ~np.uint32(TIMED_OUT[1])
        if self._error is not None:
            # The main word, or else the first extended one that is not 0.
            first = np.argmax(self._errors != 0, axis=1)
            words = self._errors[np.arange(len(first)), first]
            self._error[...] = words.view(np.int32)
        self._answered.heard |= good

    def _ask(self) -> None:
        now = time.monotonic()
        if now - self._asked < 0.9 / self._actuators.rate:
            return
        self._asked = now
        query = bytes([STATE])
        for socket in self._sockets:
            socket.send(query)
        self._turn = (self._turn + 1) % len(self._sockets)
        self._sockets[self._turn].send(bytes([TEMPERATURE]))

    def prepare(self) -> str:
        """See `Prepared`: gains 0, PD mode, enabled, with the actuators' own dead man."""
        joints = np.flatnonzero(self._errors.any(axis=1))
        if len(joints) and not self._enabling.began:
            words = " ".join(f"{word:#x}" for word in self._errors[joints[0]])
            return (
                f"actuator {self._labels[joints[0]]} tells an error: {words}; see the "
                "vendor's list, and switch the robot off and on"
            )
        return self._enabling()

    def put(self) -> None:
        """See `Wire`.

        Raises:
            Fault: a feed-forward torque is asked for, and nobody knows the current for it; or the
                network does not take it.
        """
        states, actuators, commands = self._states, self._actuators, self._commands
        beyond = False
        for field, state in (("pos", "joint_pos_target"), ("vel", "joint_vel_target")):
            wanted = states[state] * actuators.degrees
            commands[field] = sent = np.clip(wanted, -LARGEST, LARGEST)
            beyond |= not np.array_equal(wanted, sent)
        self.counts.clamped += beyond
        torque = states["joint_effort_ff"]
        if actuators.current is not None:
            commands["current"] = np.clip(torque * actuators.current, -LARGEST, LARGEST)
        elif torque.any():
            joint = int(np.flatnonzero(torque)[0])
            raise Fault(
                f"fourier: {torque[joint]:.3g} N·m are to be fed forward at "
                f"{actuators.names[joint]}, and the robot file does not say what current that is "
                "(transport.current_scale)"
            )
        gains = self._gains
        gains["kp"] = np.clip(states["joint_stiffness"] * actuators.kp, 0.0, LARGEST)
        gains["kd"] = np.clip(states["joint_damping"] * actuators.kd, 0.0, LARGEST)
        both = np.array((gains["kp"], gains["kd"]), np.float32)
        changed = (both != self._sent_gains).any(axis=0)
        # Datagrams get lost and these are not repeated each tick: one joint's are, in turn.
        changed[self._turn] = True
        self._sent_gains = both
        size, data = GAINS_TYPE.itemsize, gains.view(np.uint8).data
        for joint in np.flatnonzero(changed).tolist():
            self._tell(joint, data[joint * size : (joint + 1) * size])
        size, data = COMMAND_TYPE.itemsize, commands.view(np.uint8).data
        for joint in range(len(self._sockets)):
            self._tell(joint, data[joint * size : (joint + 1) * size])

    def wait(self, timeout: float) -> bool:
        """See `Wire`."""
        return bool(select.select(self._sockets, [], [], timeout)[0])

    def close(self) -> None:
        """See `Wire`: what we have enabled is off behind the damping."""
        try:
            if self._enabling.began:
                for joint in range(len(self._sockets)):
                    self._tell(joint, bytes([DISABLE]))
        finally:
            self._let_go()

    def _let_go(self) -> None:
        for socket in self._sockets:
            socket.close()
