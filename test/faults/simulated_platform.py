"""MuJoCo that goes wrong at a given tick, and keeps every command that it got: for fault cases.

    platform: faults.simulated_platform:simulator      # at full speed
    platform: faults.simulated_platform:robot          # gates, approach, real time

The second counts as a robot: WAIT and APPROACH are run, and its IMU has the noise of a real one.
Both tell of motors, battery and a remote that is off, so that the whole set of a robot's safety
blocks sees something.
"""

from __future__ import annotations

import builtins
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from unicon_base.errors import Fault
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco.platform import make
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.robots import Robot
from unicon_core.runtime import Runner
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, CONTROL_STATES, HARDWARE_STATES
from unicon_hardware.modes import ModeGuard

MODULE = __name__
LOGGED = (*COMMAND_STATES, "velocity_command")
HEALTHY = {"motor_temperature": 40.0, "motor_error": 0, "battery_charge": 0.8}


class FaultySimulator:
    """MuJoCo behind a log.

    Args:
        states: of the program.
        robot: the robot.
        period: of a tick in [s].
        scene: of the workflow.
        fault: what goes wrong, below; any of them together.
        at: tick of the phase before which it does not.
        during: the phase in which it begins.

    Faults:
        set: state to the value that recv leaves in it from then on: a number, or a text such as
            `nan`, for all elements; `joint` limits it to one, and `add` adds instead.
        freeze: states that keep their value, of that joint alone where one is given.
        swap: two joints, whose measured values are mixed up.
        mode: that the motor of `joint` reports instead of the commanded one, as drivers of robots
            see it.
        once: states are wrong for one tick.
        raise: `Fault` or a built-in exception, in `recv` or `in: send`.
        hang: time in [s] for which recv does not return, once.
        variant: what the robot says that it is, from the beginning.

    Attributes:
        log: a row for each command: phase, the command states, and the velocity command.
        phase: tells the run's phase; set by whoever runs it.
        runner: of the run, for a mishap that asks it to end.
        onset: commands that had left when the fault began, or None.
    """

    facts = Facts("faulty", simulated=True, writes=(*SIMULATED, *HARDWARE_STATES, *CONTROL_STATES))

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        scene: Scene,
        fault: Mapping[str, Any],
        at: int,
        during: str,
    ) -> None:
        self._inner = make(states, robot, period, scene=scene)
        self._states, self._fault, self._at, self._during = states, fault, at, during
        self._frozen = {name: np.array(states[name]) for name in fault.get("freeze", ())}
        self._modes = ModeGuard(f"platform {self.facts.name!r}", robot.joint_names, 1)
        self._modes.reported[...] = 1
        self._pushing = states["joint_stiffness"], states["joint_effort_ff"]
        self._ticks, self._period_ns = 0, round(period * 1e9)
        self.log: list[tuple[Any, ...]] = []
        self.phase: Callable[[], str] = str
        self.onset: int | None = None
        self.runner: Runner | None = None
        if "variant" in fault:  # the protocol looks for the method
            self.variant = lambda: fault["variant"]

    @property
    def due(self) -> bool:
        """Whether the fault has its tick; from then on it stays."""
        return self._ticks > self._at

    def begin(self) -> bool:
        """Note that the fault begins now; False where it had begun before."""
        first = self.onset is None
        if first:
            self.onset = len(self.log)
        return first

    def recv(self) -> None:
        """Bring the simulator's data, or what the fault makes of them."""
        states = self._states
        self._inner.recv()
        for name, usual in HEALTHY.items():
            states[name][...] = usual
        if self.phase() == self._during:
            self._ticks += 1
        if not self.due:
            for name, value in self._frozen.items():
                value[...] = states[name]
            return
        if not self._fault or self._fault.get("in") == "send":
            return
        first = self.begin()
        if first or not self._fault.get("once"):
            self._distort()
        if first and "hang" in self._fault:
            time.sleep(float(self._fault["hang"]))
        self._raise()

    def _distort(self) -> None:
        fault, states = self._fault, self._states
        joint = fault.get("joint")
        for name, frozen in self._frozen.items():
            where: Any = ... if joint is None else joint
            states[name][where] = frozen[where]
        for name, value in fault.get("set", {}).items():
            where = ... if joint is None else joint
            number = float(value) if isinstance(value, str) else value
            states[name][where] = states[name][where] + number if fault.get("add") else number
        for name, factor in fault.get("scale", {}).items():
            states[name] *= factor
        if "mode" in fault:
            self._modes.reported[joint] = fault["mode"]
        if "swap" in fault:
            one, two = fault["swap"]
            for name in ("joint_pos", "joint_vel"):
                states[name][[one, two]] = states[name][[two, one]]

    def send(self) -> None:
        """Keep the command, then simulate a tick of it."""
        if self.due and self._fault.get("in") == "send" and self.phase() == self._during:
            self.begin()
            self._raise()
        if left := self._modes(*self._pushing):
            raise Fault(left)
        self.log.append((self.phase(), *(np.array(self._states[name]) for name in LOGGED)))
        self._inner.send()

    def close(self) -> None:
        """Let go."""
        self._inner.close()

    def _raise(self) -> None:
        if name := self._fault.get("raise"):
            raise getattr(builtins, name, Fault)("made by the bench")


class FaultyRobot(FaultySimulator):
    """The same as a robot: its IMU has noise, and its clock goes on, from the machine's time."""

    facts = replace(FaultySimulator.facts, name="faulty_robot", simulated=False)

    _NOISE = 1e-3
    """Of gyroscope in [rad/s] and accelerometer in [m/s²]."""

    _rng = np.random.default_rng(0)
    _now = 0

    def recv(self) -> None:
        """Bring the data with noise."""
        super().recv()
        states, rng = self._states, self._rng
        if not self.log:  # its time has not begun: it hangs in the air, and does not fall
            states["base_lin_acc"][...] = -9.81 * states["projected_gravity"]
        for name in ("base_ang_vel", "base_lin_acc"):
            if name not in self._frozen or not self.due:
                states[name] += rng.normal(0.0, self._NOISE, 3).astype(np.float32)
        self._now = (self._now or time.monotonic_ns()) + self._period_ns
        states["stamp_ns"][...] = self._now


def simulator(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene | None = None,
    fault: dict[str, Any] | None = None,
    at: int = 1 << 30,
    during: str = "run",
) -> FaultySimulator:
    """Build the one that runs at full speed; see `FaultySimulator`."""
    return FaultySimulator(states, robot, period, scene or Scene(), fault or {}, at, during)


def robot(
    states: States,
    robot: Robot,
    period: float,
    *,
    scene: Scene | None = None,
    fault: dict[str, Any] | None = None,
    at: int = 1 << 30,
    during: str = "run",
) -> FaultyRobot:
    """Build the one that counts as a robot; see `FaultyRobot`."""
    return FaultyRobot(states, robot, period, scene or Scene(), fault or {}, at, during)
