"""Block `recorded`: recorded commands drive a simulator or a robot, joints by name.

flow:
  recorded: {bag: walk.mcap, take: [joint_pos_target], approach: 2.0}
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unicon_base.errors import WorkflowError
from unicon_core.blocks.joint_command import robot_gains
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.autowire import BuildContext
from unicon_lab.replay.series import Series, opened

TARGET = "joint_pos_target"
GAINS = ("joint_stiffness", "joint_damping")


class Recorded:
    """Writes recorded commands tick by tick; done with the last one.

    A robot's approach ends where they begin, as before any flow. In a simulator, which begins where
    its scene says, `approach` goes there.

    Args:
        context: states, robot and period.
        series: of the commands.
        approach: how long the joints go from where they are to the first target, in [s].
    """

    memory = ("_from", "_tick")

    name = "recorded"
    reads = ("joint_pos",)

    def __init__(self, context: BuildContext, series: Series, approach: float) -> None:
        states = context.states
        self._series, self._ticks = series, round(approach / context.period)
        self._target, self._measured = states[TARGET], states["joint_pos"]
        self._from = np.zeros_like(self._target)
        self._first = np.array(series.values(TARGET)[0])
        lacking = [name for name in GAINS if name not in series.names]
        gains = robot_gains(context.robot, "recorded") if lacking else ()
        self._gains = [(states[n], g) for n, g in zip(GAINS, gains) if n in lacking]
        self.writes = (*series.names, *lacking)
        self._tick = 0

    def __call__(self) -> bool:
        tick = self._tick
        self._tick += 1
        if tick == 0:
            self._from[...] = self._measured
        for view, values in self._gains:
            view[...] = values
        behind = tick - self._ticks
        self._series.put(max(behind, 0))
        if behind < 0:
            share = np.float32((tick + 1) / (self._ticks + 1))
            np.subtract(self._first, self._from, out=self._target)
            self._target *= share
            self._target += self._from
        return behind >= len(self._series) - 1

    def reset(self) -> None:
        """Begin anew."""
        self._tick = 0


def recorded(
    context: BuildContext,
    *,
    bag: str,
    take: Sequence[str] = COMMAND_STATES,
    start: float = 0.0,
    approach: float = 0.0,
) -> Recorded:
    """Give recorded commands.

    Args:
        context: states, robot and period.
        bag: recording or fault record: a file or a folder, beside the workflow or from here.
        take: command states; gains that are not among them, or not in it, are
            the robot file's.
        start: how much is left out at the beginning, in [s].
        approach: how long the joints first go from where they are to the first target, in [s].

    Raises:
        WorkflowError: it does not fit the robot, or holds a command that is not finite.
        UniconError: it cannot be read.
    """
    if not 0.0 <= approach <= 60.0:
        raise WorkflowError(f"recorded: approach is {approach!r} s; give 0 to 60")
    for name in take:
        if name not in COMMAND_STATES:
            raise WorkflowError(
                f"recorded: {name!r} is not a command state; known: {', '.join(COMMAND_STATES)}"
            )
    record = opened(bag, context.relative_to)
    there = record.told("imported_states", list)  # all else in it was never commanded
    wanted = [name for name in COMMAND_STATES if name in take and (not there or name in there)]
    series = Series(record, wanted, "sent", context.states, context.period, start)
    if TARGET not in series.names:
        raise WorkflowError(
            f"recorded: {bag} gives no {TARGET} for the joints of robot {context.robot.name}; it "
            f"is of robot {record.facts.get('robot', '?')}, and take is {', '.join(take)}"
        )
    for name in series.names:
        bad = np.argwhere(~np.isfinite(series.values(name).astype(float)))
        if len(bad):
            tick, place = int(bad[0][0]), int(bad[0][-1])
            joint = context.robot.joint_names[place]
            raise WorkflowError(
                f"recorded: {bag} holds a {name} that is not finite ({joint}, row "
                f"{int(series.rows[tick])}); record anew, or begin behind it with start"
            )
    return Recorded(context, series, approach)
