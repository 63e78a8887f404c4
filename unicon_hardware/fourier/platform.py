"""Platform `fourier`: robots of Fourier's FSA actuators, each at an address of its own.

The robot file says the version: v2 (N1), or v1 (GR-1), which has no dead man and no PD mode.

Their IMU is a serial device whose frames the vendor does not document: no state of the base.
"""

from __future__ import annotations

import struct
from functools import partial

import numpy as np

from unicon_base.errors import Fault, PlatformError
from unicon_core.bounds import within
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_hardware.facts import ipv4
from unicon_hardware.fourier.actuator_wire import LARGEST, ActuatorWire, Enabling
from unicon_hardware.fourier.codec import (
    ACKNOWLEDGED,
    ACKNOWLEDGED_GAINS,
    ARM_DEAD_MAN,
    CLEAR_DEAD_MAN,
    COMMAND,
    ENABLE,
    GAINS,
    GAINS_TYPE,
    PD_MODE,
    STATE,
    STATE_TYPE,
    TEMPERATURE,
    TEMPERATURE_TYPE,
    TIMED_OUT,
    Actuators,
)
from unicon_hardware.fourier.fsa1_codec import Servos
from unicon_hardware.fourier.fsa1_wire import Fsa1Wire
from unicon_hardware.wired_robot import WiredRobot, opened

LEAST = np.array(3 * [-LARGEST] + 2 * [0.0])[:, None]
"""Of targets, in [deg], [deg/s] and [A], and of gains."""
KIND_OF_ENCODER = 1, 0x03
"""Of `errors`: a word whose lowest two bits are not an error."""


def acknowledged(code: int, payload: bytes, count: int) -> bytes:
    """Return a setting whose answer has its count."""
    return struct.pack(">BI", code, count) + payload


def steps(dead_man: float, mode: int) -> list[tuple[str, partial[bytes]]]:
    """Return how actuators are enabled.

    Gains are zero before an actuator is enabled, so that it does not jump; the dead man is armed
    last, since the first command follows at once.

    Args:
        dead_man: after so long without a command an actuator leaves for `mode`, [s].
        mode: of operation.
    """
    limit = round(1e3 * dead_man)
    wanted = [
        # Of an earlier run: it would count on while nothing is commanded.
        ("disarm the dead man", ARM_DEAD_MAN, struct.pack(">IIIII", 0, limit, mode, 0, 0)),
        ("clear a time-out", CLEAR_DEAD_MAN, struct.pack(">I", 0)),
        ("no gains", ACKNOWLEDGED_GAINS, struct.pack(">ff", 0.0, 0.0)),
        ("PD mode", PD_MODE, b""),
        ("enable", ENABLE, b""),
        ("arm the dead man", ARM_DEAD_MAN, struct.pack(">IIIII", 1, limit, mode, 0, 0)),
    ]
    return [(f"{w!r} (code {code:#x})", partial(acknowledged, code, p)) for w, code, p in wanted]


class FourierWire(ActuatorWire):
    """See the module.

    Args:
        states: of the workflow.
        actuators: of the robot.
        dead_man: after so long without a command an actuator lets go by itself, [s].
    """

    def __init__(self, states: States, actuators: Actuators, dead_man: float) -> None:
        super().__init__(states, actuators, COMMAND)
        self._actuators, n = actuators, len(actuators.names)
        wanted = steps(dead_man, actuators.timeout_mode)
        self._enabling = Enabling(self._labels, wanted, self._tell)
        self._frames = np.zeros(n, STATE_TYPE)
        self._new = np.zeros(n, bool)
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
            answer = np.frombuffer(data, ACKNOWLEDGED)[0]
            result = int(answer["result"])  # 0 is taken for success
            self._enabling.answered(joint, int(answer["count"]), str(result) if result else "")
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
        for socket in self._sockets:
            socket.send(bytes([STATE]))
        self._sockets[self._turn].send(bytes([TEMPERATURE]))

    def prepare(self) -> str:
        """See `Prepared`: gains 0, PD mode, enabled, with the actuators' own dead man."""
        joints = np.flatnonzero(self._errors.any(axis=1)).tolist()
        errors = {joint: " ".join(f"{word:#x}" for word in self._errors[joint]) for joint in joints}
        return self._prepared(errors, self._enabling)

    def put(self) -> None:
        """See `Wire`.

        Raises:
            Fault: a feed-forward torque is asked for, and nobody knows the current for it; or the
                network does not take it.
        """
        states, actuators = self._states, self._actuators
        torque, current = states["joint_effort_ff"], actuators.current
        if current is None and torque.any():
            joint = int(np.flatnonzero(torque)[0])
            raise Fault(
                f"fourier: {torque[joint]:.3g} N·m are to be fed forward at "
                f"{actuators.names[joint]}, and the robot file does not say what current that is "
                "(transport.current_scale)"
            )
        commands, gains = self._commands, self._gains
        held = self._held(
            states["joint_pos_target"] * actuators.degrees,
            states["joint_vel_target"] * actuators.degrees,
            torque * (0.0 if current is None else current),
            states["joint_stiffness"] * actuators.kp,
            states["joint_damping"] * actuators.kd,
            least=LEAST,
        )
        commands["pos"], commands["vel"], commands["current"], gains["kp"], gains["kd"] = held
        due = [(self._sockets[joint], gains[joint].tobytes()) for joint in self._due(held[3:])]
        self._tell_all(due + self._datagrams())

    def close(self) -> None:
        """See `Wire`: what we have enabled is off behind the damping."""
        self._close(self._enabling.began)


SILENCE = 0.1
"""In [s]: ten answers at the 100 Hz at which the vendor asks."""
DEAD_MAN = 0.2
"""In [s]: as a child process's watchdog, with a tick of 50 Hz to spare eight times."""


class Fourier(WiredRobot):
    """See the module."""

    facts = Facts(
        "fourier",
        writes=(
            *JOINT_STATES,
            "motor_temperature",
            "motor_error",
            "stamp_ns",
        ),
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
