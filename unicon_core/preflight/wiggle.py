"""`wiggle`: one small slow move of each joint, which proves order and signs against the encoders.

Each joint goes by 0.05 rad and back within 1 s, away from its nearer limit, while all others are
held where they were; gains are low, and the workflow's safety blocks look at every command. A joint
to which the robot file gives no stiffness is not moved. As in a run the gates are asked, and then
the robot's own controller is asked to let go.

Of every joint j the measured way d_j is compared with the commanded way c of the joint that is
moved: share_j = Σ c·d_j / Σ c². Its own joint has a share near 1, all others near 0. A drift while
the robot sinks into its new hold, from the first to the last sample of a move, is taken out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from unicon_base import Fault
from unicon_core.blocks.postures import robot_gains
from unicon_core.bounds import within
from unicon_core.flow import Stage, Zip, as_block
from unicon_core.runtime.startup_sequence import Waiting, prepared, waiting_tree
from unicon_core.runtime.ticker import Ticker
from unicon_core.signals import SIGNALS
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.text_table import figure
from unicon_core.workflow import Program
from unicon_core.workflow.program_data import NEVER_NS

ANGLE = 0.05
"""Of a move in [rad]."""
SMALLEST, LARGEST = 0.01, 0.2
"""Of angles that may be asked for, [rad]: a smaller way is lost in noise, and proves nothing."""
SECONDS = 1.0
"""Of a move, there and back, in [s]."""
PAUSE = 0.5
"""After a move in [s]: a joint that comes back late would count as one that follows the next."""
SETTLE = 1.0
"""Time before the first move in which stiffness grows, in [s]."""
ESCAPED = 0.3
"""A joint that goes so far while it is to be held does not go where its encoder says, [rad]."""
STIFFNESS = 0.5
"""Share of the robot file's stiffness: what is wrong then pushes half as hard."""
FOLLOWED = 0.03
"""Least share of a move that counts as following: what noise of 0.1 mrad makes is 0.001, and a
simulated Go2 whose feet stick to the floor still shows 0.05."""
WEAKLY = 0.3
"""Less is told: low gains give way to friction, weight and the floor; on a gantry it is more."""


@dataclass(frozen=True)
class Moved:
    """What one move showed.

    Attributes:
        joint: that was commanded.
        follower: the joint whose encoder followed most; "" of one that was not moved, since the
            robot file gives it no stiffness.
        share: of the commanded way that it went; below 0 the other way.
    """

    joint: str
    follower: str
    share: float

    @property
    def wrong(self) -> str:
        """What is wrong, with the remedy; "" where the joint itself followed, or was not moved."""
        if not self.follower:
            return ""
        if not abs(self.share) >= FOLLOWED:  # true for NaN too
            return f"no joint followed {self.joint}; see whether its motor is on, and free to move"
        if self.follower != self.joint:
            return (
                f"{self.follower} moved instead of {self.joint}: they are swapped; correct the "
                "joint order of the robot file or of the map"
            )
        if self.share < 0.0:
            return f"{self.joint} moved the other way: inverted; correct its sign in the driver"
        return ""


class _Moves:
    """The block that moves one joint after the other; done after the last."""

    name = "wiggle"
    writes = COMMAND_STATES
    reads = ("joint_pos",)

    def __init__(self, program: Program, angle: float) -> None:
        states, robot, period = program.states, program.robot, program.period
        self._views = [states[name] for name in COMMAND_STATES]
        self._measured = states["joint_pos"]
        stiffness, self._damping = robot_gains(robot, "wiggle")
        self._stiffness = stiffness * np.float32(STIFFNESS)
        times = (SETTLE, SECONDS, PAUSE)
        self._settle, self._move, self._pause = (max(round(t / period), 2) for t in times)
        self._held = np.zeros_like(self._measured)
        self._ways = np.zeros(self._move)
        self._samples = np.zeros((self._move, self._held.size))
        self._lower, self._upper = robot.limits()
        self._names, self._angle, self._tick = robot.joint_names, angle, 0
        self._turns = np.flatnonzero(stiffness).tolist()
        self._period = period
        self._last = 0.0
        self.moved: list[Moved] = []

    def __call__(self) -> bool:
        target, velocity, effort, stiffness, damping = self._views
        if self._tick == 0:
            self._held[...] = np.clip(self._measured, self._lower, self._upper)
        self._watch()
        turn, k = divmod(self._tick - self._settle, self._move + self._pause)
        joint = self._turns[turn] if 0 <= turn < len(self._turns) else -1
        grown = min((self._tick + 1) / self._settle, 1.0)
        target[...] = self._held
        velocity[...] = effort[...] = 0.0
        if k == self._move and joint >= 0:
            self._judge(joint)
        if joint >= 0 and k < self._move:
            angle = 2.0 * math.pi / self._move
            way = self._angle * (0.5 - 0.5 * math.cos(angle * k))
            speed = self._angle * 0.5 * angle / self._period * math.sin(angle * k)
            target[joint] += self._side(joint) * way
            velocity[joint] = self._side(joint) * speed  # or damping would hold it back
            # What is measured now answers to the command of the tick before.
            self._ways[k], self._last = self._last if k else 0.0, way
            self._samples[k] = self._measured
        stiffness[...] = self._stiffness * np.float32(grown)
        damping[...] = self._damping
        self._tick += 1
        return len(self.moved) == len(self._turns)

    def left_out(self) -> list[Moved]:
        """Return those that are not moved."""
        return [Moved(n, "", 0.0) for k, n in enumerate(self._names) if k not in self._turns]

    def _watch(self) -> None:
        """End it where a joint goes away: of exchanged encoders each holds at the other's place."""
        away = np.abs(self._measured - self._held)
        if not away.max() <= ESCAPED:  # true for NaN too
            joints = [n for n, way in zip(self._names, away) if not way <= 0.5 * ESCAPED]
            raise Fault(
                f"{' and '.join(joints)} moved by up to {away.max():.2f} rad while all joints were "
                "to be held: swapped or inverted, or too heavy for half the stiffness; correct "
                "order and signs of the robot file, the map or the driver"
            )

    def _judge(self, joint: int) -> None:
        samples, ways = self._samples, self._ways
        drift = np.linspace(0.0, 1.0, len(samples))[:, None] * (samples[-1] - samples[0])
        shares = self._side(joint) * (ways @ (samples - samples[0] - drift)) / (ways @ ways)
        follower = int(np.argmax(np.abs(shares)))
        self.moved.append(Moved(self._names[joint], self._names[follower], float(shares[follower])))

    def _side(self, joint: int) -> float:
        """Away from the nearer limit."""
        room = self._upper[joint] - self._held[joint], self._held[joint] - self._lower[joint]
        return 1.0 if room[0] >= room[1] else -1.0


def wiggle(program: Program, angle: float = ANGLE) -> list[Moved]:
    """Move every joint a little, one after the other, and close the program, which damps.

    Args:
        program: built to send, of one robot that hangs or lies.
        angle: of a move in [rad].

    Returns:
        What each move showed, and behind them the joints that are not moved; less where a signal
        ended it.

    Raises:
        Fault: a safety block, the platform, or a gate or controller that does not let it begin.
        WorkflowError: the angle is not plausible.
    """
    angle = within(angle, "angle", "rad", LARGEST, SMALLEST, above=False)
    moves = _Moves(program, angle)
    stages = program.stages
    root = Zip(
        *stages[Stage.RECV],
        *stages[Stage.ESTIMATE],
        as_block(moves),
        *stages[Stage.SAFETY],
        *stages[Stage.SEND],
    )
    tickers = [Ticker(program, root, 1, None)]
    waiting = Waiting(program.gates, False, program.warn, prepared(program))
    if not program.platform.facts.simulated:
        tickers.insert(0, Ticker(program, waiting_tree(program, as_block(waiting)), 1, None))
        tickers[0].hang_ns = NEVER_NS

    def stop() -> None:
        for ticker in tickers:
            ticker.stop = True

    with SIGNALS, SIGNALS.guard(stop, program.damp_now):
        try:
            for ticker in tickers if not SIGNALS.asked else ():
                ticker.run(1 << 62)
                if ticker is not tickers[-1] and waiting.reason and not ticker.stop:
                    raise Fault(f"the platform has gone while it was waited for {waiting.reason}")
        finally:
            program.close()
    return [*moves.moved, *moves.left_out()] if tickers[-1].done else moves.moved


def verdicts(moved: list[Moved], angle: float) -> list[tuple[str, str, str, str, str]]:
    """Return the rows of a table: joint, joint that followed, way, share, verdict."""
    return [
        (
            each.joint,
            each.follower,
            f"{figure(1e3 * each.share * angle, '+.1f')} of {1e3 * angle:.0f} mrad",
            figure(each.share, "+.2f"),
            each.wrong or _right(each),
        )
        for each in moved
    ]


def _right(moved: Moved) -> str:
    if not moved.follower:
        return "not moved: the robot file gives it no stiffness"
    return "as commanded" if moved.share >= WEAKLY else "as commanded, weakly"
