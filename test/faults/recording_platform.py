"""A platform that logs every command that leaves, and does at a given tick what robots do at worst.

    platform: faults.recording_platform:RecordingPlatform
    platform: faults.recording_platform:RecordingSimulator

Behind the first stands the fake robot. It counts as hardware: what is refused on a robot is refused
here. Behind the second stands MuJoCo.
"""

from __future__ import annotations

import builtins
import math
import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from faults.command_log import CLOSE, FAULT, OPEN, RECV, SEND, CommandLog
from unicon_base.errors import Fault
from unicon_core.platforms.fake import FakeRobot, make_robot
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.platform import SIMULATED, Facts, Platform
from unicon_core.robots import Robot
from unicon_core.states import States


class RecordingPlatform:
    """The fake robot behind a command log.

    Args:
        period: of a tick in [s].
        log: file of the command log; it exists.
        fault: what goes wrong, see below; None for nothing.
        at: number of the tick from which it does.

    Faults, any of them together:
        set: state to the value that recv leaves in it from then on (in all elements).
        freeze: states that keep their value from then on.
        raise: `Fault` or a built-in exception, `in` one of recv (default), send and close.
        signals: names of signals that the process sends itself.
        hang: time in [s] for which recv does not return, once.
        slow: time in [s] that every recv takes from then on.
        shape: recv brings an array of another length.
        mark: nothing; a block misbehaves at that tick.
    """

    facts = replace(FakeRobot.facts, name="recording")

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        *,
        log: str,
        fault: dict[str, Any] | None = None,
        at: int = 25,
    ) -> None:
        self._open(make_robot(states, robot, period, time_constant=0.05), states, log, fault, at)

    def _open(
        self, behind: Platform, states: States, log: str, fault: dict[str, Any] | None, at: int
    ) -> None:
        self._behind = behind
        self._states, self._fault, self._at = states, fault or {}, at
        self._log = CommandLog(Path(log))
        self._where = self._fault.get("in", "recv")
        self._frozen = {name: np.array(states[name]) for name in self._fault.get("freeze", ())}
        self._tick = 0
        self._marked = self._closed = False
        self._log.add(OPEN)

    def recv(self) -> None:
        """Bring the fake robot's data, or what the fault makes of them."""
        self._log.add(RECV, self._tick)
        self._behind.recv()
        if self._tick >= self._at and self._fault:
            self._go_wrong(first=self._tick == self._at)
        for name, value in self._frozen.items():
            if self._tick < self._at:
                value[...] = self._states[name]
            else:
                self._states[name][...] = value

    def send(self) -> None:
        """Log the command, then let the joints follow where it can be followed."""
        tick = self._tick
        self._tick += 1
        if self._where == "send" and tick >= self._at:
            self._mark(tick)
            self._raise()
        states = self._states
        self._log.add(
            SEND,
            tick,
            target=states.joint_pos_target,
            speed=states.joint_vel_target,
            effort=states.joint_effort_ff,
            stiffness=states.joint_stiffness,
            damping=states.joint_damping,
            velocity=states.velocity_command,
        )
        if np.isfinite(states.joint_pos_target).all():
            self._behind.send()

    def close(self) -> None:
        """Log that motors would be damped now."""
        breaks = self._where == "close" and not self._closed
        self._closed = True
        if breaks:
            self._mark(self._tick)
        self._log.add(CLOSE, self._tick)
        if breaks:
            self._raise()

    def _go_wrong(self, first: bool) -> None:
        fault = self._fault
        if self._where == "recv" or "mark" in fault:
            self._mark(self._tick)
        for name, value in fault.get("set", {}).items():
            self._states[name][...] = math.nan if value == "nan" else value
        if "slow" in fault:
            time.sleep(float(fault["slow"]))
        if not first:
            return
        for name in fault.get("signals", ()):
            os.kill(os.getpid(), signal.Signals[name])
        if "hang" in fault:
            time.sleep(float(fault["hang"]))
        if fault.get("shape"):
            self._states.joint_pos[...] = np.zeros(7, np.float32)
        if self._where == "recv":
            self._raise()

    def _mark(self, tick: int) -> None:
        if not self._marked:
            self._marked = True
            self._log.add(FAULT, tick)

    def _raise(self) -> None:
        if name := self._fault.get("raise"):
            raise getattr(builtins, name, Fault)(f"made by the bench in {self._where}")


class RecordingSimulator(RecordingPlatform):
    """MuJoCo behind a command log; arguments and faults are those of the other."""

    facts = Facts("recording", simulated=True, writes=SIMULATED)

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        *,
        scene: Scene | None = None,
        log: str,
        fault: dict[str, Any] | None = None,
        at: int = 25,
    ) -> None:
        from unicon_core.platforms.mujoco.platform import make  # mujoco may be absent

        self._open(make(states, robot, period, scene=scene), states, log, fault, at)
