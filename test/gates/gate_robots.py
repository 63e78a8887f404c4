"""A fake robot with noise, of which one thing is wrong; it counts what it is sent."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from unicon_core.flow import Zip, compile_graph
from unicon_core.flow.block import Stage, Writes
from unicon_core.platforms.fake import FakeRobot
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.workflow import Program

SENT: list[str] = []
"""What left for the motors of the robots of this process: `command` or `damping`."""


class WrongRobot(FakeRobot):
    """See the module.

    Args:
        wrong: what is wrong, by name; "" for nothing.
        pose: of the joints, added to the default one in [rad]; one number or one for each.
        swapped: two joints whose encoders are exchanged.
        inverted: a joint whose encoder counts the other way.
        stuck: a joint that does not move.
    """

    facts = replace(FakeRobot.facts, name="wrong")

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        *,
        wrong: str = "",
        pose: Any = 0.0,
        swapped: tuple[str, ...] = (),
        inverted: str = "",
        stuck: str = "",
        silent: bool = False,
    ) -> None:
        super().__init__(states, robot, period, Scene(), 0.05)
        self._states, self.wrong, self._silent = states, wrong, silent
        self._pos += np.asarray(pose, np.float32)
        self._random = np.random.default_rng(0)
        names = robot.joint_names
        self._order = np.arange(len(names))
        if swapped:
            a, b = (names.index(joint) for joint in swapped)
            self._order[[a, b]] = b, a
        self._sign = np.where(np.array(names) == inverted, -1.0, 1.0).astype(np.float32)
        self._stuck = names.index(stuck) if stuck else None
        self._kept: dict[str, Any] = {}
        self.ticks = 0

    def recv(self) -> None:
        """Bring the data, with what is wrong in them."""
        self.ticks += 1
        states, wrong = self._states, self.wrong
        if wrong == "silent" or (wrong == "slow" and self.ticks % 3):
            return
        untold = wrong.removeprefix("never ") if wrong.startswith("never ") else ""
        before = np.array(states[untold]) if untold else None
        super().recv()
        for name in ("joint_pos", "joint_vel", "base_ang_vel", "base_lin_acc"):
            size = states[name].shape
            states[name] += self._random.normal(0, 1e-4, size).astype(np.float32)
        for name in ("joint_pos", "joint_vel"):
            states[name] = (states[name] * self._sign)[self._order]
        if before is not None:
            states[untold][-1:] = before[-1:]
        change = WRONG.get(wrong)
        if change is not None:
            change(self, states)

    def send(self) -> None:
        """Move, and count."""
        SENT.append("command")
        kept = None if self._stuck is None else self._pos[self._stuck]
        super().send()
        if self._stuck is not None:
            self._pos[self._stuck] = kept

    def close(self) -> None:
        """Count what damps."""
        if not self._silent:
            SENT.append("damping")

    def keep(self, name: str) -> None:
        """Let a state stay as it was first."""
        self._states[name][...] = self._kept.setdefault(name, np.array(self._states[name]))


class Shared(WrongRobot):
    """One whose own controller commands it in the first ticks."""

    def commanders(self) -> Mapping[str, int]:
        """Return how many others send."""
        return {"rt/other": 0, "rt/command": int(self.ticks < 40)}


class Prepared(Shared):
    """One that lets go behind the gates."""

    def prepare(self) -> str:
        """Take the robot over."""
        SENT.append("prepared")
        return ""


class Secretive(Prepared):
    """One that does not tell who sends."""

    def commanders(self) -> Mapping[str, int]:
        """Return nothing."""
        return {}


class Reporting(WrongRobot):
    """One that reports a variant."""

    def variant(self) -> Mapping[str, Any]:
        """Report it in the third tick."""
        if self.ticks < 3:
            return {}
        return {"mode_machine": 4 if self.wrong == "variant" else 5}


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    wrong: str = "",
    pose: float = 0.0,
    swapped: tuple[str, ...] = (),
    inverted: str = "",
    stuck: str = "",
    silent: bool = False,
) -> WrongRobot:
    """Build it."""
    kind = Reporting if "mode_machine" in robot.transport else WrongRobot
    return kind(
        states,
        robot,
        period,
        wrong=wrong,
        pose=pose,
        swapped=swapped,
        inverted=inverted,
        stuck=stuck,
        silent=silent,
    )


def shared(states: States, robot: Robot, period: float) -> Shared:
    """Build a robot that another one commands for a while."""
    return Shared(states, robot, period)


def prepared(states: States, robot: Robot, period: float, *, silent: bool = False) -> Prepared:
    """Build one that is taken over behind the gates."""
    return Prepared(states, robot, period, silent=silent)


def secretive(states: States, robot: Robot, period: float, *, silent: bool = False) -> Secretive:
    """Build one whose protocol does not tell who sends."""
    return Secretive(states, robot, period, silent=silent)


def _set(name: str, index: int, value: float) -> Callable[[WrongRobot, States], None]:
    def change(robot: WrongRobot, states: States) -> None:
        states[name][index] = value

    return change


def _times(name: str, factor: Any) -> Callable[[WrongRobot, States], None]:
    def change(robot: WrongRobot, states: States) -> None:
        states[name] *= np.float32(factor)

    return change


def _frozen(*names: str) -> Callable[[WrongRobot, States], None]:
    def change(robot: WrongRobot, states: States) -> None:
        for name in names:
            robot.keep(name)

    return change


def _leaning(robot: WrongRobot, states: States) -> None:
    angle = 1.2
    states.base_quat[...] = (np.cos(angle / 2), np.sin(angle / 2), 0, 0)
    states.projected_gravity[...] = (0, -np.sin(angle), -np.cos(angle))
    states.base_lin_acc[...] = -9.81 * states.projected_gravity + 0.001 * robot.ticks


WRONG: dict[str, Callable[[WrongRobot, States], None]] = {
    "nan joint": _set("joint_vel", 4, np.nan),
    "beyond its limit": _set("joint_pos", 2, 0.5),
    "in units of g": _times("base_lin_acc", 1 / 9.81),
    "without gravity": _times("base_lin_acc", 1e-3),
    "upside down": _times("base_lin_acc", -1.0),
    "quaternion of zeros": _times("base_quat", 0.0),
    "turning": _set("base_ang_vel", 2, 0.9),
    "gravity and quaternion": _set("projected_gravity", 2, 1.0),
    "frozen IMU": _frozen("base_quat", "projected_gravity", "base_ang_vel", "base_lin_acc"),
    "frozen joints": _frozen("joint_pos", "joint_vel", "joint_effort"),
    "leaning": _leaning,
}


def waiting(program: Program) -> Callable[[], bool]:
    """Return a tick of the wait: recv and estimate, as the runner has it."""
    nodes = (*program.stages[Stage.RECV], *program.stages[Stage.ESTIMATE])
    return compile_graph(Zip(*nodes)).step


def reasons(program: Program, ticks: int = 80) -> dict[str, str]:
    """Return what each gate says after some ticks of the wait."""
    tick = waiting(program)
    said: dict[str, str] = {}
    for _ in range(ticks):
        tick()
        said = {gate.name: gate() for gate in program.gates}
        time.sleep(0)
    return said


def broken(
    joint_pos_target: Writes,
    joint_vel_target: Writes,
    joint_effort_ff: Writes,
    joint_stiffness: Writes,
    joint_damping: Writes,
) -> Callable[[], None]:
    """Build a block that raises."""

    def tick() -> None:
        raise ValueError("broken")

    return tick
