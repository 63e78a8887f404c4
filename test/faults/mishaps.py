"""Mishaps of a program while it runs, as blocks that are hooked in: for the fault cases in MuJoCo.

    program = Program(…, hooks=[raises("ValueError")])

The platform, a `FaultySimulator`, tells when the tick has come.
"""

from __future__ import annotations

import builtins
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from faults.simulated_platform import FaultySimulator
from unicon_base.errors import Fault
from unicon_core.flow import Block, Stage, blocks_of
from unicon_core.policies import Policy
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import HookBlocks, Program
from unicon_ros.bridge.estop import EmergencyStop
from unicon_ros.parameters import Tuning

Blocks: TypeAlias = Mapping[Stage, Sequence[Block]]
Mishap: TypeAlias = Callable[[Program], Blocks]


def _platform(program: Program) -> FaultySimulator:
    platform = program.platform
    assert isinstance(platform, FaultySimulator)
    return platform


def _of(program: Program, values: Mapping[str, int]) -> int:
    return next(v for name, v in values.items() if program.robot.name.startswith(name))


def acts(act: Callable[[Program, bool], object], *amends: str, stage: Stage = Stage.FLOW) -> Mishap:
    """Return a mishap that calls `act` in every tick from its own on, with whether it is the first.

    Args:
        amends: states that it changes.
        stage: where it stands, behind what the workflow has there.
    """

    def mishap(program: Program) -> Blocks:
        platform = _platform(program)

        def step() -> None:
            if platform.due:
                act(program, platform.begin())

        return {stage: [Block("mishap", step, amends=amends)]}

    return mishap


def commands(state: str, value: float, joint: int | Mapping[str, int] | None = None) -> Mishap:
    """A block behind the flow writes a value into a command state, of one joint or of all."""

    def mishap(program: Program) -> Blocks:
        place = _of(program, joint) if isinstance(joint, Mapping) else joint
        where: Any = ... if place is None else place

        def act(program: Program, first: bool) -> None:
            program.states[state][where] = value

        return acts(act, *COMMAND_STATES)(program)

    return mishap


def jumps(step: float) -> Mishap:
    """All targets jump to and fro, with another sign in each tick."""

    def act(program: Program, first: bool) -> None:
        program.states["joint_pos_target"] += step if int(program.states["tick"]) % 2 else -step

    return acts(act, *COMMAND_STATES)


def raises(error: str, stage: Stage = Stage.FLOW) -> Mishap:
    """A block that raises `Fault` or a built-in exception."""

    def act(program: Program, first: bool) -> None:
        raise getattr(builtins, error, Fault)("made by the bench")

    return acts(act, stage=stage)


def recurses() -> Mishap:
    """A block that calls itself for ever."""

    def act(program: Program, first: bool) -> None:
        act(program, first)

    return acts(act)


def ends(at: int | None = None) -> Mishap:
    """The run is asked to end: in its tick, or in the tick of the run that is given."""

    def end(program: Program) -> None:
        runner = _platform(program).runner
        assert runner is not None
        runner.stop()

    if at is None:
        return acts(lambda program, first: end(program))
    return _in_run(at, end)


def breaks(at: int) -> Mishap:
    """A block raises in a tick of the run, besides the fault of the case."""

    def act(program: Program) -> None:
        raise Fault("made by the bench")

    return _in_run(at, act)


def _in_run(at: int, act: Callable[[Program], None]) -> Mishap:
    def mishap(program: Program) -> Blocks:
        def step() -> None:
            if int(program.states["tick"]) == at and _platform(program).phase() == "run":
                act(program)

        return {Stage.FLOW: [Block("what comes before", step)]}

    return mishap


def both(one: Mishap, other: Mishap) -> Mishap:
    """Two mishaps, the one behind the other."""

    def mishap(program: Program) -> Blocks:
        first, second = one(program), other(program)
        return {
            stage: [*first.get(stage, ()), *second.get(stage, ())] for stage in {**first, **second}
        }

    return mishap


def hangs(seconds: float) -> Mishap:
    """A block that does not return for a time, once."""
    return acts(lambda program, first: time.sleep(seconds) if first else None)


def slows(share: float) -> Mishap:
    """A block that takes a share of the period in every tick."""
    return acts(lambda program, first: time.sleep(share * program.period))


def jumps_clock(seconds: float) -> Mishap:
    """The machine's clock of the day jumps; the caller restores `time`."""

    def act(program: Program, first: bool) -> None:
        if first:
            now, now_ns = time.time, time.time_ns
            time.time = lambda: now() + seconds
            time.time_ns = lambda: now_ns() + round(seconds * 1e9)

    return acts(act)


def velocity(value: float) -> Mishap:
    """Somebody commands a velocity that nobody can walk, in all three directions."""

    def act(program: Program, first: bool) -> None:
        program.states["velocity_command"][...] = value

    return acts(act, "velocity_command", stage=Stage.INPUT)


def policy_gives(value: float | str) -> Mishap:
    """The network gives a value in every entry, or `shape`: an array of another length."""

    def mishap(program: Program) -> Blocks:
        platform = _platform(program)
        nodes = program.stages[Stage.FLOW]
        ticks = [block.tick for node in nodes for block in blocks_of(node)]
        for policy in (tick for tick in ticks if isinstance(tick, Policy)):
            lane, infer = policy.lane, policy.lane.infer

            def broken(lane: Any = lane, infer: Any = infer) -> None:
                infer()
                if platform.due:
                    platform.begin()
                    lane.action[...] = np.zeros(7) if value == "shape" else value

            lane.infer = broken
        return {}

    return mishap


def tunes(stiffness: float, damping: float = 1.0) -> Mishap:
    """Somebody sets the parameters that scale the gains."""

    def mishap(program: Program) -> Blocks:
        tuning = Tuning()

        def act(program: Program, first: bool) -> None:
            tuning.scales[0], tuning.scales[1] = stiffness, damping

        blocks: HookBlocks = {k: list(v) for k, v in tuning.hook(program).items()}
        for stage, own in acts(act, stage=Stage.INPUT)(program).items():
            blocks[stage] = [*own, *blocks.get(stage, ())]
        return blocks

    return mishap


class _Pressed(EmergencyStop):
    """The emergency stop of a node, without the node: somebody presses it from a tick on."""

    def __init__(self, platform: FaultySimulator) -> None:
        self._platform = platform
        self._take = lambda: None

    @property
    def latched(self) -> bool:  # type: ignore[override]
        """Whether it is pressed."""
        return self._platform.due and (self._platform.begin() or True)

    def hear(self) -> None:
        """Hear nobody: there is no service."""


def estop() -> Mishap:
    """~/estop is pressed: the looks are those of a session, before and behind `send`."""

    def mishap(program: Program) -> Blocks:
        pressed = _Pressed(_platform(program))
        before = pressed.before_send()
        before.close = None
        return {Stage.SAFETY: [before], Stage.OBSERVE: [pressed.after_send()]}

    return mishap
