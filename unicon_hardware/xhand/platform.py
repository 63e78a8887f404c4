"""Platform `xhand`: a RobotEra XHand1 through its maker's module, best in a process of its own.

    platform: {body: unitree, left_hand: {child: xhand}}
    platforms: {left_hand: {device: /dev/ttyUSB0}}          # without a device: EtherCAT

The maker's code may wait, hold Python's lock or crash: as a child it keeps all that to itself. Its
frames are not public. Calls and fields as in jefferzn2001/XhandControl xhandlib/xhand.py (module
1.1.7): positions in [rad], temperature in the low byte. Over RS-485 `read_state(id, True)` sends
the last command again, so that `False` is asked for: what the module's own thread received last.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

from unicon_base import Fault, MissingDependencyError, PlatformError
from unicon_base.arrays import Float64
from unicon_base.schema.marks import Text
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.facts import Baud, Word, fact
from unicon_hardware.wire import Counts, Wire, known
from unicon_hardware.wired_robot import WiredRobot, opened

POWERLESS = 0
"""Mode in which a joint gives no torque; the robot file says that of positions."""
FROZEN = 2.0
"""For so long the module may tell the very same numbers, [s]: then its thread hears nothing more.
Twelve measured currents have noise; unverified on a real hand."""


class XhandWire(Wire):
    """The hand behind the module.

    Args:
        states: of the hand.
        robot: its file: baud rate, gains, largest torque, mode.
        serial: device of an RS-485 adapter, or "" for EtherCAT.
        hand_id: which hand of the line; None for the only one.

    Raises:
        MissingDependencyError: the module is not installed.
        PlatformError: it cannot be opened, or which hand is meant is not clear.
        RobotError: the robot file lacks a fact.
    """

    def __init__(self, states: States, robot: Robot, serial: str, hand_id: int | None) -> None:
        name = fact(robot, "module", Text)
        try:
            module = importlib.import_module(f"{name}.xhand_control")
        except ImportError as error:
            raise MissingDependencyError(
                "platform 'xhand'", name, "install the wheel that RobotEra delivers with the hand"
            ) from error
        self.counts = Counts()
        baudrate = fact(robot, "baudrate", Baud)
        self._mode = fact(robot, "mode", Word)
        gains = [fact(robot, key, Word) for key in ("kp", "ki", "kd", "max_torque")]
        self._count = robot.num_joints
        self._lower, self._upper = robot.lower.astype(float), robot.upper.astype(float)
        self._states = states
        self._hot, self._error = known(states, "motor_temperature"), known(states, "motor_error")
        self._last: Float64 | None = None
        self._changed = time.monotonic()
        self._device: Any = module.XHandControl()
        self.where = self._open(serial, baudrate)
        try:
            self._id = self._only(hand_id)
            self._command: Any = module.HandCommand_t()
            for joint in range(self._count):
                each = self._command.finger_command[joint]
                each.id = joint
                each.kp, each.ki, each.kd, each.tor_max = gains
        except BaseException:
            self._device.close_device()
            raise

    def _open(self, serial: str, baudrate: int) -> str:
        if serial:
            where, answer = serial, self._device.open_serial(serial, baudrate)
        else:
            found = list(self._device.enumerate_devices("EtherCAT"))
            if not found:
                raise PlatformError(
                    "platform 'xhand': no network interface with an EtherCAT hand is found; give "
                    "its serial line: device: /dev/ttyUSB0, or run with the rights that EtherCAT "
                    "needs"
                )
            where, answer = str(found[0]), self._device.open_ethercat(found[0])
        if answer.error_code:
            raise PlatformError(
                f"platform 'xhand': cannot open {where}: {answer.error_message} (error "
                f"{answer.error_code}); switch the hand on, and check cable and device"
            )
        return where

    def _only(self, hand_id: int | None) -> int:
        found = [int(each) for each in self._device.list_hands_id()]
        if hand_id is None and len(found) == 1:
            return found[0]
        if hand_id in found:
            return int(hand_id)
        told = f"hands {', '.join(map(str, found))}" if found else "no hand"
        asked = "give hand_id" if hand_id is None else f"hand_id {hand_id} is not there"
        raise PlatformError(f"platform 'xhand': {told} at {self.where}; {asked}")

    def take(self) -> int:
        """Bring what the module heard last into the states; 1 where it is new."""
        error, state = self._device.read_state(self._id, False)
        if error.error_code:
            self.counts.refuse(f"error {error.error_code}", str(error.error_message))
            return 0
        fingers = [state.finger_state[joint] for joint in range(self._count)]
        numbers = [int(each.id) for each in fingers]
        if numbers != [*range(self._count)]:
            self.counts.refuse("other joints", numbers)
            return 0
        told = np.array([(each.position, each.torque) for each in fingers], np.float64)
        finite = np.isfinite(told[:, 0])
        if not finite.all():
            self.counts.refuse("not a number", f"of joint {np.argmin(finite)}")
            return 0
        now = time.monotonic()
        if self._last is None or not np.array_equal(told, self._last, equal_nan=True):
            self._last, self._changed = told, now
        if now - self._changed > FROZEN:
            self.counts.refuse("the same again", f"for {now - self._changed:.1f} s")
            return 0
        self._states["joint_pos"][...] = told[:, 0]
        if self._hot is not None:
            self._hot[...] = [int(each.temperature) & 0xFF for each in fingers]
        if self._error is not None:  # "jonit" is the maker's spelling
            self._error[...] = [
                int(each.commboard_err)
                | int(each.jonitboard_err) << 8
                | int(each.tipboard_err) << 16
                for each in fingers
            ]
        self.counts.good += 1
        return 1

    def put(self) -> None:
        """Send the targets, within the limits; a joint without stiffness gives no torque.

        Raises:
            Fault: the module does not take them.
        """
        wanted = self._states["joint_pos_target"].astype(float)
        held = np.clip(wanted, self._lower, self._upper)
        self.counts.clamped += not np.array_equal(held, wanted)
        on = self._states["joint_stiffness"] > 0.0
        for joint in range(self._count):
            each = self._command.finger_command[joint]
            each.position = float(held[joint])
            each.mode = self._mode if on[joint] else POWERLESS
        error = self._device.send_command(self._id, self._command)
        if error.error_code:
            raise Fault(
                f"platform 'xhand': {self.where} does not take a command: {error.error_message} "
                f"(error {error.error_code})"
            )

    def wait(self, timeout: float) -> bool:
        """Return False: the module does not tell when data come."""
        return False

    def close(self) -> None:
        """Let go of the device."""
        self._device.close_device()


class Xhand(WiredRobot):
    """The hand as a platform."""

    facts = Facts(
        "xhand",
        writes=("joint_pos", "motor_error", "motor_temperature", "stamp_ns"),
        protocols=("xhand",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    device: str = "",
    hand_id: int | None = None,
    connect: float = 2.0,
    silence: float = 0.2,
    silent: bool = False,
) -> Xhand:
    """Build the platform.

    Args:
        device: of an RS-485 adapter such as /dev/ttyUSB0; without one EtherCAT.
        hand_id: which hand of the line; None for the only one.
        connect: how long to wait for the first state, [s].
        silence: of the hand that is a fault, [s].
        silent: it is only read.

    Raises:
        MissingDependencyError: the maker's module is not installed.
        PlatformError: the hand does not answer, or it is not clear which is meant.
    """
    wire = XhandWire(states, robot, device, hand_id)
    return opened(Xhand(states, robot, period, wire, silence=silence, silent=silent), connect)
