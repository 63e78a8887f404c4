"""Platform `fourier`: robots of Fourier's FSA actuators, each at an address of its own.

The robot file says the version: v2 (N1), or v1 (GR-1), which has no command timeout and no PD mode.
Their IMU is a serial device whose frames the vendor does not document: no state of the base.

Here is version 2: datagrams on port 2335, big endian. The first byte is a code. A query is answered
under its own code; a setting that is acknowledged carries a count, and its answer that count and a
result. Source: PyPI fi_fsa 0.3.17, fi_fsa/v2/fi_fsa_v2.py. Positions are in [deg], speeds in
[deg/s], currents in [A]; gains are the actuator's own, and the robot file says what they are.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from unicon_base import Fault, PlatformError
from unicon_base.arrays import Float64
from unicon_base.schema.marks import Key
from unicon_core.bounds import within
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_hardware.facts import Octet, each, ipv4
from unicon_hardware.fourier.actuator_wire import (
    LARGEST,
    ActuatorWire,
    Addressed,
    addressed,
    complete,
)
from unicon_hardware.fourier.fsa1_codec import Servos
from unicon_hardware.fourier.fsa1_wire import Fsa1Wire
from unicon_hardware.wire import frame_type
from unicon_hardware.wired_robot import WiredRobot, opened

COMMAND, GAINS = 0x0E, 0xA1
STATE, TEMPERATURE = 0x21, 0x22
ENABLE, PD_MODE, ACKNOWLEDGED_GAINS, ARM_DEAD_MAN, CLEAR_DEAD_MAN = 0x51, 0x59, 0x61, 0x64, 0x65

GAINS_TYPE = frame_type("code u1, kp >f4, kd >f4")
STATE_TYPE = frame_type("code u1, measured >f4 4, errors >u4 8")
"""Position, speed, current and torque; the main error and seven words of extended ones."""
TEMPERATURE_TYPE = frame_type("code u1, celsius >f4 2")
"""Of the transistors and of the windings."""
ACKNOWLEDGED = frame_type("code u1, count >u4, result >u4")

TIMED_OUT = 7, 0x01
"""Of `errors`: the word and the bit which say that no command came in time."""
KIND_OF_ENCODER = 1, 0x03
"""Of `errors`: a word whose lowest two bits are not an error."""
LEAST = np.array(3 * [-LARGEST] + 2 * [0.0])[:, None]
"""Of targets, in [deg], [deg/s] and [A], and of gains."""
UNITS = ("stiffness_scale", "damping_scale", "timeout_mode")
WHY = "what its actuators' gains are in N·m/rad, nor what they do when commands stop"


@dataclass(frozen=True)
class Actuators(Addressed):
    """What the robot file says of the actuators; arrays of shape (n,).

    Attributes:
        kp: of an actuator for 1 N·m/rad of the joint.
        kd: of an actuator for 1 N·m·s/rad of the joint.
        timeout_mode: which mode an actuator enters that gets no commands.
        scale: of the current for 1 N·m of the joint in [A]; None where it is not known.
    """

    kp: Annotated[Float64, Key("stiffness_scale"), each(1e-9, 1e9)]
    kd: Annotated[Float64, Key("damping_scale"), each(1e-9, 1e9)]
    timeout_mode: Octet
    scale: Annotated[Float64 | None, Key("current_scale"), each(1e-9, 1e9)] = None

    @classmethod
    def of(cls, robot: Robot, network: str = "") -> Actuators:
        """Return those of a robot file.

        Args:
            robot: the file.
            network: an address in another network of 256 in which they are; the last number of
                each address stays.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        complete(robot, 2, UNITS, WHY)
        return addressed(cls, robot, network)

    @cached_property
    def current(self) -> Float64 | None:
        """For 1 N·m of the joint in [A], with its sign; None where it is not known."""
        return None if self.scale is None else self.signs * self.scale


def steps(dead_man: float, mode: int) -> list[tuple[str, partial[bytes]]]:
    """Return how actuators are enabled.

    Gains are zero before an actuator is enabled, so that it does not jump; the command timeout is
    armed last, since the first command follows at once.

    Args:
        dead_man: after so long without a command an actuator leaves for `mode`, [s].
        mode: of operation.
    """
    limit = round(1e3 * dead_man)
    wanted = [
        # Of an earlier run: it would count on while nothing is commanded.
        ("disarm the dead man", ARM_DEAD_MAN, struct.pack(">IIIII", 0, limit, mode, 0, 0)),
        ("clear a time-out", CLEAR_DEAD_MAN, bytes(4)),
        ("no gains", ACKNOWLEDGED_GAINS, bytes(8)),
        ("PD mode", PD_MODE, b""),
        ("enable", ENABLE, b""),
        ("arm the dead man", ARM_DEAD_MAN, struct.pack(">IIIII", 1, limit, mode, 0, 0)),
    ]
    return [(f"{w!r} (code {code:#x})", partial(acknowledged, code, p)) for w, code, p in wanted]


def acknowledged(code: int, payload: bytes, count: int) -> bytes:
    """Return a setting whose answer has its count."""
    return struct.pack(">BI", code, count) + payload


class FourierWire(ActuatorWire):
    """See the module.

    Args:
        states: of the workflow.
        actuators: of the robot.
        dead_man: after so long without a command an actuator lets go by itself, [s].
    """

    def __init__(self, states: States, actuators: Actuators, dead_man: float) -> None:
        super().__init__(states, actuators, COMMAND, steps(dead_man, actuators.timeout_mode))
        n = len(actuators.names)
        self._frames, self._new = np.zeros(n, STATE_TYPE), np.zeros(n, bool)
        self._errors = np.zeros((n, 8), np.uint32)
        self._gains = np.zeros(n, GAINS_TYPE)
        self._gains["code"] = GAINS

    def _sort(self, joint: int, data: bytes) -> None:
        code, size = data[0] if data else 0, len(data)
        if code == STATE and size == STATE_TYPE.itemsize:
            self._frames[joint : joint + 1] = np.frombuffer(data, STATE_TYPE)
            self._new[joint] = True
        elif code == TEMPERATURE and size == TEMPERATURE_TYPE.itemsize:
            celsius = np.frombuffer(data, TEMPERATURE_TYPE)["celsius"]
            if not np.isfinite(celsius).all():
                self.counts.refuse("not finite", f"temperature of {self._labels[joint]}")
            elif self._hot is not None:
                self._hot[joint] = celsius.max()
        elif size == ACKNOWLEDGED.itemsize and 0x51 <= code <= 0x66:
            _, count, result = np.frombuffer(data, ACKNOWLEDGED)[0].item()
            # 0 is taken for success.
            self._enabling.answered(joint, count, str(result) if result else "")
        else:
            self.counts.refuse("not understood", f"code {code:#x}, {size} bytes")

    def _measured(self) -> None:
        if not self._new.any():
            return
        facts, errors, measured = self._facts, self._errors, self._frames["measured"]
        good = self._new & np.isfinite(measured).all(axis=1)
        for joint in np.flatnonzero(self._new & ~good):
            self.counts.refuse("not finite", self._labels[joint])
        self._new[...] = False
        pos, vel, _, torque = measured.T
        figures = pos / facts.degrees, vel / facts.degrees, torque * facts.signs
        for name, values in zip(JOINT_STATES, figures):
            np.copyto(self._states[name], values, where=good, casting="same_kind")
        errors[good] = self._frames["errors"][good]
        errors[:, KIND_OF_ENCODER[0]] &= ~np.uint32(KIND_OF_ENCODER[1])
        if not self._enabling.done:
            # Of an earlier run that died: it is cleared behind the gates, which stop at any error.
            errors[:, TIMED_OUT[0]] &= ~np.uint32(TIMED_OUT[1])
        if self._error is not None:
            # The main word, or else the first extended one that is not 0.
            first = np.argmax(errors != 0, axis=1)
            self._error[...] = errors[np.arange(len(first)), first].view(np.int32)
        self._answered.heard |= good

    def _ask(self) -> None:
        for socket in self._sockets:
            socket.send(bytes([STATE]))
        self._sockets[self._turn].send(bytes([TEMPERATURE]))

    def prepare(self) -> str:
        """Set gains 0 and PD mode, and enable, with the actuators' own command timeout."""
        joints = np.flatnonzero(self._errors.any(axis=1)).tolist()
        return self._prepared({joint: " ".join(map(hex, self._errors[joint])) for joint in joints})

    def put(self) -> None:
        """Send the command states.

        Raises:
            Fault: a feed-forward torque is asked for, and the current for it is not known; or the
                network does not take it.
        """
        states, facts = self._states, self._facts
        torque, current = states["joint_effort_ff"], facts.current
        if current is None and torque.any():
            joint = int(np.flatnonzero(torque)[0])
            raise Fault(
                f"fourier: {torque[joint]:.3g} N·m are to be fed forward at "
                f"{facts.names[joint]}, and the robot file does not say what current that is "
                "(transport.current_scale)"
            )
        commands, gains = self._commands, self._gains
        held = self._held(
            states["joint_pos_target"] * facts.degrees,
            states["joint_vel_target"] * facts.degrees,
            torque * (0.0 if current is None else current),
            states["joint_stiffness"] * facts.kp,
            states["joint_damping"] * facts.kd,
            least=LEAST,
        )
        commands["pos"], commands["vel"], commands["current"], gains["kp"], gains["kd"] = held
        due = [(self._sockets[joint], gains[joint].tobytes()) for joint in self._due(held[3:])]
        self._tell_all(due + self._datagrams())


SILENCE = 0.1
"""In [s]: ten answers at the 100 Hz at which the vendor asks."""
DEAD_MAN = 0.2
"""In [s]: as a child process's watchdog, with a tick of 50 Hz to spare eight times."""


class Fourier(WiredRobot):
    """See the module."""

    facts = Facts(
        "fourier",
        writes=(*JOINT_STATES, "motor_temperature", "motor_error", "stamp_ns"),
        protocols=("fourier_fsa",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str = "",
    connect: float = 5.0,
    silence: float = SILENCE,
    dead_man: float | None = None,
    silent: bool = False,
) -> Fourier:
    """Open the robot.

    Args:
        states: of the workflow.
        robot: its file.
        period: of a tick in [s].
        address: any of another network of 256 addresses in which the actuators are, such as
            127.0.0.1; the last number of each stays.
        connect: how long to wait until all have answered, [s].
        silence: of any actuator that is a fault, [s].
        dead_man: after so long without a command each actuator of FSA v2 lets go by itself, [s];
            0.2 unless said. Those of FSA v1 cannot.
        silent: nothing is sent but questions.

    Raises:
        PlatformError: an option is wrong, or an actuator does not answer.
        RobotError: the robot file lacks a fact.
        WorkflowError: `dead_man` is out of range.
    """
    network = ipv4(address, "fourier") if address else ""
    wire: FourierWire | Fsa1Wire
    if robot.transport.get("fsa") == 1:
        if dead_man is not None:
            raise PlatformError(
                "platform 'fourier': dead_man is given, and actuators of FSA v1 have none; leave "
                "it out, and write platform: {child: fourier}"
            )
        wire = Fsa1Wire(states, Servos.of(robot, network))
    else:
        limit = DEAD_MAN if dead_man is None else dead_man
        limit = within(limit, "dead_man", "s", 5.0, max(0.01, period))
        wire = FourierWire(states, Actuators.of(robot, network), limit)
    return opened(Fourier(states, robot, period, wire, silence=silence, silent=silent), connect)
