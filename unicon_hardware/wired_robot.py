"""WiredRobot: the platform around a wire, the same for all vendors.

    class Unitree(WiredRobot):
        facts = Facts("unitree", writes=(…), protocols=("unitree_go",))

    def make(states, robot, period, *, connect=5.0, silent=False) -> Unitree:
        wire = DdsWire(states, robot, silent)
        return opened(Unitree(states, robot, period, wire, silent=silent), connect)

It damps first in `close`, refuses what is not finite, knows silence, sees a motor that leaves the
commanded mode, and computes gravity where the wire tells an orientation.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from unicon_base import AnyMapping, Fault, PlatformError, Silence
from unicon_core.blocks.maps import projected_gravity
from unicon_core.platforms.kit.command import DAMPING_TIME, Damping, FiniteCheck, LastSent, repeated
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.signals import SIGNALS
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.robot_clock import RobotClock
from unicon_hardware.wire import Wire

SILENCE = 0.05
"""Without a good frame for so long, in [s], a robot at 500 Hz is silent: 25 frames are missing."""
LOOKING = 0.002
"""Between two looks at a wire that has not told anything yet, [s]."""


class WiredRobot:
    """A platform; the class of each vendor says its `facts`.

    Args:
        states: of the workflow.
        robot: its file.
        period: of a tick in [s].
        wire: open, and aligned with the robot's joints; it is closed where this fails.
        silence: of the robot that is a fault, in [s].
        silent: nothing is sent, in `close` either.
        facts: in place of the class's.
    """

    facts = Facts("wired")

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        wire: Wire,
        *,
        silence: float = SILENCE,
        silent: bool = False,
        facts: Facts | None = None,
    ) -> None:
        facts = facts or self.facts
        self.facts = replace(facts, writes=tuple(name for name in facts.writes if name in states))
        self._states, self._robot, self._period, self._wire = states, robot, period, wire
        self._silence, self._silent = silence, silent
        try:
            self._build(states, robot, wire)
        except BaseException:
            wire.close()
            raise

    def _build(self, states: States, robot: Robot, wire: Wire) -> None:
        if not 0.0 < self._silence <= 10.0:
            raise PlatformError(
                f"{self._label}: silence is {self._silence} s; give more than 0, at most 10 s"
            )
        self._gravity: Callable[[], None] | None = None
        self._scratch: Callable[[], object] = int  # does nothing
        if {"base_quat", "projected_gravity"} <= {*self.facts.writes}:
            self._gravity = projected_gravity(states["base_quat"], states["projected_gravity"])
            level = (1.0, 0.0, 0.0, 0.0)
            self._scratch = projected_gravity(np.array(level), np.zeros(3))
        commands = {name: states[name] for name in COMMAND_STATES}
        self._finite = FiniteCheck(commands, robot.joint_names)
        self._sent = LastSent(states)
        self._modes = wire.modes
        self._pushing = states["joint_stiffness"], states["joint_effort_ff"]
        self._stamp = states["stamp_ns"]
        self._clock = RobotClock(self._label)
        self._heard = self._looked = time.monotonic_ns()
        self._silent_for = 0.0
        # Of a longer pause of ours no more counts as silence: who only answers was not asked, as
        # between opening and the first tick.
        self._pause = 2.0 * self._period
        self._closed = False

    def connect(self, patience: float) -> None:
        """Wait for the first good frame, for so many seconds.

        Raises:
            PlatformError: none came, or the connection does not work.
        """
        if not 0.0 < patience < float("inf"):
            raise PlatformError(f"{self._label}: connect is {patience} s; give a time above 0")
        end = time.monotonic() + patience
        while not self._first():
            SIGNALS.check()
            if time.monotonic() > end:
                raise PlatformError(
                    f"{self._label}: no frame that it understands from {self._wire.where} within "
                    f"{patience:g} s{self._refused}; switch the robot on, and check cable, network "
                    f"interface, address and the robot file {self._robot.path.name}; an emulated "
                    "robot is reached by the command that it prints"
                )
            time.sleep(LOOKING)

    def _first(self) -> bool:
        try:
            return self._take()
        except Fault as fault:  # such as a network that is not there: nothing runs yet
            raise PlatformError(f"{self._label}: {fault}") from fault

    @property
    def _label(self) -> str:
        return f"platform {self.facts.name!r}"

    @property
    def _refused(self) -> str:
        counts = self._wire.counts
        return f" (refused: {counts}; the last one: {counts.last})" if counts.last else ""

    def _take(self) -> bool:
        if not self._wire.take():
            return False
        self._heard, self._silent_for = time.monotonic_ns(), 0.0
        count = self._wire.clock_ms
        self._stamp[...] = self._heard if count is None else self._clock(self._heard, count)
        if self._gravity is not None:
            self._gravity()
        return True

    def recv(self) -> bool | None:
        """Bring the newest frame into the states; `stamp_ns` is when it was measured.

        Where the robot tells no time it is when the frame was taken.

        Raises:
            Fault: the robot is silent, or says that it will not go on; its frames get older, or
                come again.
        """
        now, before = time.monotonic_ns(), self._looked
        self._looked = now
        if not self._take():
            self._silent_for += min((now - before) * 1e-9, self._pause)
            if self._silent_for > self._silence:
                silent = (now - self._heard) * 1e-9
                raise Silence(
                    f"{self._label}: nothing from {self._wire.where} for {silent:.3f} s"
                    f"{self._refused}; the robot is silent"
                )
        return None

    def warm_up(self) -> None:
        """Do what `recv` and `send` do, but change no state and send nothing, to warm up."""
        self._finite()
        self._scratch()
        self._wire.warm_up()

    def send(self) -> bool | None:
        """Send the command states.

        Raises:
            Fault: a command is not finite, or cannot be sent; or a motor is in another mode than
                the commanded one since it has had stiffness. A stiff command would let the joint
                jump when its motor comes back: from then on only limp ones leave.
        """
        self._finite()
        if not self._silent:
            left = "" if self._modes is None else self._modes(*self._pushing)
            if left:
                self._send_limp(Damping(self._states, self._robot, self._sent, self._period))
            else:
                self._wire.put()
            self._sent.note()
            if left:
                raise Fault(left)
        return None

    def close(self) -> None:
        """Send the damping command for a while, then let go."""
        if self._closed:
            return
        self._closed = True
        try:
            # A robot that got nothing of ours is somebody else's.
            if self._sent.any:
                damping = Damping(self._states, self._robot, self._sent, self._period)
                damped = self._sent.limp  # by the tick
                send = partial(self._send_limp, damping)
                repeated(send, self._period, 0.0 if damped else DAMPING_TIME)
        finally:
            self._wire.close()

    def _send_limp(self, damping: Damping) -> None:
        damping()
        if self._modes is not None:
            self._modes(*self._pushing)
        self._wire.put()

    def wait(self, timeout: float) -> bool:
        """Return True once a frame is there, False after `timeout` in [s]."""
        return self._wire.wait(timeout)

    def arrivals(self) -> int:
        """Return how many good frames have come so far."""
        return self._wire.counts.good

    def prepare(self) -> str:
        """Bring the robot to where it takes commands, step by step; see `Prepares`."""
        return "" if self._silent else self._wire.prepare()

    def commanders(self) -> Mapping[str, int]:
        """Return where the robot takes commands, with the number of others that send there."""
        return self._wire.commanders()

    def info(self) -> AnyMapping:
        """Return where the robot is, and what came from it."""
        counts, modes = self._wire.counts, self._modes
        told = {} if modes is None else {"unguarded_modes": modes.unguarded, "notes": [modes.note]}
        return {
            "where": self._wire.where,
            "frames": counts.good,
            "refused": dict(counts.refused),
            "clamped": counts.clamped,
            **told,
        }


R = TypeVar("R", bound=WiredRobot)


def opened(robot: R, connect: float) -> R:
    """Return a platform that has heard its robot; where that fails it is closed.

    Args:
        robot: the platform.
        connect: how long to wait for the first frame, [s].

    Raises:
        PlatformError: no good frame came.
    """
    try:
        robot.connect(connect)
    except BaseException:
        robot.close()
        raise
    return robot
