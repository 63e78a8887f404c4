"""Platform `unitree_legged`: an A1, Aliengo or Go1 over UDP, for workflows.

platform: unitree_legged
platforms:
  unitree_legged: {generation: legged_sdk_3.8.4}     # of an Aliengo, which has several
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from unicon_base import AnyMapping, PlatformError
from unicon_core.platforms.kit.base import IMU_STATES
from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, JOINT_STATES
from unicon_hardware.endpoint import EmulatedModes, Endpoint, Milliseconds
from unicon_hardware.unitree_legged.codec import (
    CELL_VOLT,
    DAMPING,
    NAME,
    STIFFNESS,
    TORQUE,
    Frame,
    LeggedTransport,
    link_of,
)
from unicon_hardware.unitree_legged.wire import FOOT_FORCE, LeggedWire
from unicon_hardware.wire import Udp
from unicon_hardware.wired_robot import SILENCE, WiredRobot, opened

WATCHDOG = 0.25
"""A tick that is later damps the robot, [s]; three ticks where those are longer. So late a tick may
be before the runner calls it hung (`pacing.hang`)."""
OPTIONS = ("generation", "address", "port", "local_port")
"""Of the link."""
_BATTERY = ("battery_charge", "battery_voltage")
_WRITES = (
    *JOINT_STATES,
    *IMU_STATES,
    "projected_gravity",
    "motor_temperature",
    "motor_error",
    *_BATTERY,
    "stamp_ns",
    *CONTROL_STATES,
)


def _told(states: States, link: LeggedTransport) -> tuple[str, ...]:
    """Return the states that a robot of this generation tells, as far as they are there."""
    without = () if "bms" in (link.layout.state.names or ()) else _BATTERY
    names = (*_WRITES, FOOT_FORCE)
    return tuple(name for name in names if name in states and name not in without)


def _examined(states: States, robot: Robot, period: float, **options: Any) -> Binding:
    """Tell `unicon check` what would be told, without opening anything.

    Raises:
        PlatformError: an option is wrong.
        RobotError: the robot file lacks a fact.
    """
    link = link_of(robot, **{name: options.get(name) for name in OPTIONS})
    return Binding(replace(UnitreeLegged.facts, writes=_told(states, link)))


class UnitreeLegged(WiredRobot):
    """The robot; build it with `make`."""

    facts = Facts(NAME, writes=_WRITES, protocols=(NAME,), examine=_examined)
    _wire: LeggedWire

    def info(self) -> AnyMapping:
        """Return the generation too, and how many came from others."""
        return {
            **super().info(),
            "generation": self._wire.link.generation,
            "strangers": self._wire.strangers,
        }


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    generation: str | None = None,
    address: str | None = None,
    port: int | None = None,
    local_port: int | None = None,
    encrypted: bool = False,
    check_mode: bool = True,
    poll: bool = False,
    connect: float = 5.0,
    silence: float = SILENCE,
    watchdog: float | None = None,
    silent: bool = False,
) -> UnitreeLegged:
    """Build the platform and wait for the robot's first answer.

    Args:
        period: of a tick in [s].
        generation: of the protocol, a word of the robot file's `generations`; needed where there
            are several.
        address: of the robot, in place of the file's.
        port: of the robot, in place of the file's.
        local_port: of this machine, in place of the file's.
        encrypted: with the checksum of a Go1 that is not an EDU.
        check_mode: wait until every motor tells that it is in servo mode.
        poll: send idle commands where nothing may be sent (`--dry`, `preflight`): the robot says
            nothing without.
        connect: how long to wait for the first answer, [s].
        silence: of the robot that is a fault, [s].
        watchdog: a tick that is later damps the robot, [s]; None for 0.25 or three ticks.
        silent: nothing is sent, but for idle commands with `poll`.

    Raises:
        PlatformError: an option is wrong, the port is taken, or no good answer came.
        RobotError: the robot file lacks a fact.
    """
    link = link_of(robot, generation=generation, address=address, port=port, local_port=local_port)
    if encrypted and not link.layout.head:
        raise PlatformError(
            f"platform {NAME!r}: encrypted is known of Go1's datagrams alone; leave it out"
        )
    if watchdog is None:
        watchdog = max(WATCHDOG, 3.0 * period)
    if not period < watchdog <= 10.0:
        raise PlatformError(
            f"platform {NAME!r}: watchdog is {watchdog} s; give more than a tick of {period:g} s, "
            "at most 10 s"
        )
    if silent and not poll:
        raise PlatformError(
            f"platform {NAME!r}: {robot.name} answers commands and says nothing by itself, so that "
            "it cannot be heard silently; lay it down and let idle commands ask it, without "
            f"stiffness, damping and torque: platforms: {{{NAME}: {{poll: true}}}}"
        )
    wire = LeggedWire(states, robot, link, watchdog, encrypted=encrypted, check_mode=check_mode)
    told = replace(UnitreeLegged.facts, writes=_told(states, link))
    built = UnitreeLegged(states, robot, period, wire, silence=silence, silent=silent, facts=told)
    return opened(built, connect)


BRAKE = 2.0
"""Damping of an emulated motor in mode 0x00 in [N·m·s/rad]; a real one's is not public."""
CELLS = 8
"""Of the emulated battery, of ten places."""


class LeggedEndpoint(Endpoint):
    """The board; see `Face`.

    Args:
        states: of the emulated robot.
        robot: its file.
        generation: of the protocol; needed where the file has several.
        address: to listen at.
        port: to listen at, in place of the file's.
        encrypted: the other checksum is asked for, and a plain one refused.
        obeys: commands act from the beginning; else until somebody sets `obeys`, as with the
            remote, motors tell mode 0x00.

    Attributes:
        rate: of its frames in [Hz].
        dead_man: infinity.
        obeys: commands act.
        where: address and port.
        good: good commands so far.
        refused: others so far.
        remote: the 40 bytes of the wireless remote that it tells.
        modes: of the motors.

    Raises:
        PlatformError: an option is wrong, or the port is taken.
        RobotError: the robot file lacks a fact.
    """

    platform = "unitree_legged"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        generation: str | None = None,
        address: str = "127.0.0.1",
        port: int | None = None,
        encrypted: bool = False,
        obeys: bool = True,
    ) -> None:
        link = link_of(robot, generation=generation, address=address, port=port)
        self.rate, self.obeys, self._encrypted, self._link = link.rate, obeys, encrypted, link
        self.good = self.refused = 0
        self.where = f"{link.address}:{link.port}"
        reach = {"address": link.address, "port": link.port, "generation": link.generation}
        self.reach = reach | ({"encrypted": True} if encrypted else {})
        self.remote = bytearray(40)
        self._states = states
        self.clock = Milliseconds(1000.0 / self.rate)
        self._in, self._out = Frame(link.layout.command), Frame(link.layout.state)
        self._commanded = self._in["motors"][link.motors]
        self._motors = self._out["motors"][link.motors]
        self._out.buffer[: len(link.layout.head)] = link.layout.head
        self._out["level"][...] = link.level_flag
        self._out["quat"][...] = (1.0, 0.0, 0.0, 0.0)
        self.modes = EmulatedModes(self._motors["mode"])
        self.modes.reported[...] = link.damping
        self._udp = Udp((link.address, link.port), (link.address, 9), f"robot {robot.name}")
        self._owed: dict[tuple[str, int], None] = {}

    def hear(self) -> bool:
        """Bring the newest good command into the command states; True where one came."""
        heard = False
        for datagram, sender in self._udp.datagrams():
            if not self._good(datagram):
                self.refused += 1
                continue
            self.good += 1
            self._owed[sender] = None
            heard = True
            self._obey()
        return heard and self.obeys

    def _good(self, datagram: bytes) -> bool:
        frame, link = self._in, self._link
        if len(datagram) != len(frame.buffer) or not datagram.startswith(link.layout.head):
            return False
        frame.fill(datagram)
        if not frame.sound(self._encrypted) or frame["level"] != link.level_flag:
            return False
        if self._encrypted and frame.sound():
            return False
        motors, modes = self._commanded, (link.servo, link.damping)
        finite = np.isfinite(motors["q"]).all() and np.isfinite(motors["dq"]).all()
        return bool(finite and np.isin(motors["mode"], modes).all())

    def _obey(self) -> None:
        link, states, motors = self._link, self._states, self._commanded
        if not self.obeys:
            self.modes.reported[...] = link.damping
            return
        brakes = motors["mode"] == link.damping
        held = motors["q"] != np.float32(link.pos_stop)
        moves = motors["dq"] != np.float32(link.vel_stop)
        pos, vel = states["joint_pos_target"], states["joint_vel_target"]
        stiffness, damping = states["joint_stiffness"], states["joint_damping"]
        pos[...] = np.where(held, motors["q"], states["joint_pos"])
        vel[...] = np.where(moves & ~brakes, motors["dq"], 0.0)
        states["joint_effort_ff"][...] = np.where(brakes, 0.0, motors["tau"] / TORQUE)
        stiffness[...] = np.where(held & ~brakes, motors["kp"] / STIFFNESS, 0.0)
        damping[...] = np.where(moves, motors["kd"] / DAMPING, 0.0)
        damping[brakes] = BRAKE
        self.modes.command(motors["mode"], states)

    def tell(self) -> None:
        """Answer everybody of whom a command has come."""
        count = self.clock(self.now)
        if not self._owed:
            return
        states, frame, motors = self._states, self._out, self._motors
        motors["q"] = motors["q_raw"] = states["joint_pos"]
        motors["dq"] = motors["dq_raw"] = states["joint_vel"]
        effort = np.nan_to_num(states["joint_effort"])
        motors["tau"] = np.clip(effort * TORQUE, -32768, 32767)
        for field, state in zip(("quat", "gyro", "acc"), IMU_STATES):
            frame[field][...] = states[state]
        motors["temperature"] = np.clip(states["motor_temperature"], -128, 127)
        if "bms" in frame:
            bms = frame["bms"]
            bms["soc"] = round(100 * float(states["battery_charge"]))
            each = float(states["battery_voltage"]) / CELLS / CELL_VOLT
            bms["cells"][:CELLS] = np.clip(round(each), 0, 255)
        frame["remote"][...] = np.frombuffer(self.remote, np.uint8)
        frame["tick"][...] = count
        frame.seal(self._encrypted)
        for sender in self._owed:
            self._udp.peer = sender
            self._udp.send(frame.buffer)
        self._owed.clear()

    def close(self) -> None:
        """Close the socket."""
        self._udp.close()


face = LeggedEndpoint
