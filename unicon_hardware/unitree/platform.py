"""Platform `unitree`: Go2, H1, G1 and H1-2 over CycloneDDS, for workflows.

    platform: unitree
    platforms:
      unitree: {address: eth0}        # of this machine, towards the robot

Topics, modes and motor slots stand in the robot file. It needs the extra `hw-unitree`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from unicon_base import AnyMapping, Fault, PlatformError
from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.device import unitree as held
from unicon_core.platforms.kit.base import IMU_STATES, Mounting
from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import CONTROL_STATES, HARDWARE_STATES, JOINT_STATES
from unicon_core.states.states import spans
from unicon_hardware.dds.end import DdsWire
from unicon_hardware.dds.maps import arrays_of, offset_of
from unicon_hardware.modes import SETTLES
from unicon_hardware.robot_clock import Repeats
from unicon_hardware.unitree.facts import PROTOCOLS, Release, UnitreeFacts
from unicon_hardware.wire import newer, turned
from unicon_hardware.wired_robot import SILENCE, WiredRobot, opened
from unicon_msgs_map import Decoder

TOLD, FOOT_FORCE = (*JOINT_STATES, *IMU_STATES, *HARDWARE_STATES), "foot_force"
"""States that LowState tells, those that are there."""


class UnitreeWire(DdsWire):
    """The connection to a robot, or to what looks like one.

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        domain: of DDS; None for the robot file's.
        address: of this machine's network interface, or its name.
        real: LowState must have a right checksum and a new number, and its own controller is asked
            to let go.
        silent: nothing is sent.

    Attributes:
        remote: the wireless remote's bytes, as they came last.
        variant: what the robot reports of itself, {} before its first frame.

    Raises:
        UniconError: it cannot be opened.
    """

    label, table, settles = "platform 'unitree'", UnitreeFacts, SETTLES

    def __init__(self, *given: Any, real: bool = True, **options: Any) -> None:
        self._checked = real
        super().__init__(*given, **options)

    def _built(self) -> None:
        states, own, facts = self._states, self._own, self._facts
        self.variant: AnyMapping = {}
        self._last = -1
        self.remote, self._held = memoryview(own["remote"].data), b""
        self._tick, self._mode = own["tick"], own["mode_machine"]
        told = {name for name in (*TOLD, FOOT_FORCE) if name in states}
        told -= set() if self._checked else set(HARDWARE_STATES)
        staged = States(states.layout)  # what is read waits here for the tick
        self._read = {name: array for name, array in arrays_of(staged).items() if name in told}
        into, out_of = (memoryview(each.buffer.data) for each in (states, staged))
        remote = CONTROL_STATES if "sticks" in states else ()
        self._controls = Controls(staged) if remote else None
        self._tell = [(into[span], out_of[span]) for span in spans(states.layout, {*told, *remote})]
        if "wireless_remote" in states:
            self._tell.append((memoryview(states["wireless_remote"].data), self.remote))
        self._mounting = Mounting.of(self._robot)
        self._pairs = own["temperatures"][0::2], own["temperatures"][1::2]
        # Number and variant are the head's.
        head, arrays = {"tick", "mode_machine"}, self._read | own
        self._head = Decoder.build(facts.state.subscribe(head), arrays)
        ends = ("head", "tick") if facts.go else ("imu_state", "wireless_remote")
        measured = slice(*(offset_of(facts.state.struct, name) for name in ends))
        self._repeats = Repeats(self.label, measured)
        self._message = replace(facts.state, checked=self._checked)
        self._into = {name: array for name, array in arrays.items() if name not in head}

    def _listen(self) -> None:
        self._frames = self._message.frames(self._into, self.counts)
        self.listen(self._facts.state, self, forget=self._forget)

    def _open(self) -> None:
        super()._open()
        if self._checked and not self._silent:
            before, wait = self._facts.release
            self._takeover = Release(self.participant, before, wait, self.label)

    def warm_up(self) -> None:
        """Read ahead, and do what `put` does, but send nothing to the robot."""
        for inlet in self._inlets:
            inlet.read_ahead()
        super().warm_up()

    def _measured(self) -> None:
        for view, value in self._tell:
            view[:] = value

    def _forget(self) -> None:
        self._last = -1

    @property
    def clock_ms(self) -> int | None:
        """The robot's tick; unitree_mujoco's is the time of its physics."""
        return self._last if self._checked and self._last >= 0 else None

    def good(self, raw: bytes) -> bool:
        """Tell whether a frame may be read, by its form, number and variant.

        Raises:
            Fault: the robot's variant is another one than it was, or its measurements repeat.
        """
        if not (self._frames.good(raw) and self._new(raw)):
            return False
        if self._checked:
            self._repeats(raw)
        return True

    def _new(self, raw: bytes) -> bool:
        if not self._head.decode(raw):
            self.counts.refuse("impossible values", self._head.last_error)
            return False
        if self._checked:
            number = int(self._tick)
            if self._last >= 0 and not newer(number, self._last):
                self.counts.refuse("old tick", f"{number} behind {self._last}")
                return False
            self._last = number
        told = {"protocol": self._facts.protocol}
        if self._checked and not self._facts.go:
            told["mode_machine"] = int(self._mode)
        if self.variant and told != self.variant:
            raise Fault(
                f"{self.label}: the robot's mode_machine is {told['mode_machine']}, and was "
                f"{self.variant['mode_machine']}: it is another robot, or was configured anew; "
                "choose its robot file"
            )
        self.variant = told
        return True

    def read(self, raw: bytes) -> bool:
        """Read a good frame, and bring what it tells in another form into that of the states."""
        if not self._frames.read(raw):
            return False
        values, waist = self._read, self._facts.waist
        if self._mounting.turned:
            self._mounting.turn(values, values)
        if waist is not None:
            turned(values, values, values, waist)
        if not self._facts.go and "motor_temperature" in values:
            np.maximum(*self._pairs, out=values["motor_temperature"])
        if self._controls is not None and self.remote != self._held:
            held(self.remote, self._controls)
            self._held = bytes(self.remote)
        return True


SIMULATOR = "unitree_mujoco"
DECLARED = ("wireless_remote", FOOT_FORCE)
"""States that it writes where a workflow declares them: 40 bytes; four forces, without a unit."""


def _facts(robot: Robot, states: States, peer: str) -> Facts:
    """Return what it writes of a robot."""
    facts = UnitreeFacts.of(robot)
    lacking = {"motor_error"} if facts.go else {FOOT_FORCE}
    if not facts.battery:
        lacking |= {"battery_charge", "battery_voltage"}
    if peer == SIMULATOR:  # it sends zeros, of a battery too
        lacking |= set(HARDWARE_STATES)
    every = (*Unitree.facts.writes, *DECLARED)
    writes = tuple(name for name in every if name in states and name not in lacking)
    return replace(Unitree.facts, writes=writes)


def _examined(states: States, robot: Robot, period: float, **options: Any) -> Binding:
    return Binding(_facts(robot, states, options.get("peer", "robot")))


class Unitree(WiredRobot):
    """A robot behind Unitree's DDS; build it with `make`."""

    facts = Facts(
        "unitree",
        writes=(*TOLD, "projected_gravity", "stamp_ns", *CONTROL_STATES),
        protocols=PROTOCOLS,
        examine=_examined,
    )
    _wire: UnitreeWire

    def variant(self) -> AnyMapping:
        """Return what the robot tells of itself: its protocol, and G1 and H1-2 `mode_machine`.

        unitree_mujoco leaves the latter at 0, whatever it simulates.
        """
        return self._wire.variant


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str | None = None,
    domain: int | None = None,
    peer: Literal["robot", "unitree_mujoco"] = "robot",
    connect: float = 5.0,
    silence: float = SILENCE,
    silent: bool = False,
) -> Unitree:
    """Build the platform and wait for the robot.

    Args:
        period: of a tick in [s].
        address: of this machine's network interface to the robot, or that interface's name;
            without it CYCLONEDDS_URI, or CycloneDDS itself, decides.
        domain: of DDS, instead of the robot file's.
        peer: `unitree_mujoco` sends no checksums, frame numbers, temperatures and battery, and has
            no controller of its own that must let go.
        connect: how long to wait for the first frame in [s].
        silence: of the robot that is a fault, in [s].
        silent: receive only: nothing is sent, at the end either.

    Raises:
        MissingDependencyError: cyclonedds is not installed.
        RobotError: the robot file lacks a fact.
        PlatformError: the network cannot be used, or no frame came in time.
    """
    if peer not in ("robot", SIMULATOR):
        raise PlatformError(f"platform 'unitree': no peer {peer!r}; known: robot, {SIMULATOR}")
    wire = UnitreeWire(states, robot, domain, address, real=peer == "robot", silent=silent)
    told = _facts(robot, states, peer)
    built = Unitree(states, robot, period, wire, silence=silence, silent=silent, facts=told)
    return opened(built, connect)
