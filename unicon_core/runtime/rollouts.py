"""Rollouts: a simulated program run again and again, each time as one that was built anew.

rollouts = Rollouts(program, look)
for document in documents:                      # of the same workflow, with other scenes
    rollouts.begin(document)
    rollout = rollouts.run(500)

Rollouts of several programs may run in one thread, each tick by tick: first all robots read, think
and command, then the physics of all are simulated. No program knows of another, so that each does
bit-exactly what it would do alone; but code and network are still in the cache when the next robot
needs them, where the physics of a whole tick would have driven them out.
"""

from __future__ import annotations

import re
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.errors import UniconError
from unicon_core.flow import Stage, compile_graph
from unicon_core.flow.compiled import LABEL, CompiledGraph
from unicon_core.memory import Library
from unicon_core.memory import Snapshot as Remembered
from unicon_core.platforms.platform import Changeable, DefersPhysics
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.report import reason_of
from unicon_core.states import States
from unicon_core.states.states import Snapshot
from unicon_core.workflow import Program, WorkflowDocument
from unicon_core.workflow.hardware import read_scene
from unicon_core.workflow.policies import GROUND
from unicon_core.workflow.tick_tree import memory_of

if TYPE_CHECKING:
    from unicon_core.runtime.runner import Runner

_CALLED = re.compile(r"\b(\w+)\(\)")

Look = Callable[[], bool]
"""Looks at the states behind each whole tick; True ends the rollout there."""


@dataclass(frozen=True)
class Rollout:
    """What became of one.

    Attributes:
        ended: `done`, `duration`, `looked` (its look ended it) or `fault`.
        ticks: whole ones.
        fault: what went wrong, "" for nothing.
        block: that raised it.
        sha256_commands: as a run's report has it.
        states: float32 states behind each tick as they lie in the buffer, shape (ticks, elements);
            a view that the next rollout overwrites. Columns are those of `States.offset`.
    """

    ended: str
    ticks: int
    fault: str
    block: str
    sha256_commands: str
    states: Float32


class Rollouts:
    """Runs one program again and again, at full speed and without its wind-down.

    Args:
        program: on a simulator, not run before; its first rollout needs no `begin`.
        look: makes what looks at a rollout, anew for each; or None.
        beside: others run beside it, so that its physics wait where they can; see `Lockstep`.

    Attributes:
        why_not: why it cannot begin anew, "" where it can.

    Raises:
        UniconError: it is not a simulator's.
    """

    def __init__(
        self,
        program: Program,
        look: Callable[[States], Look] | None = None,
        *,
        beside: bool = False,
    ) -> None:
        if not program.platform.facts.simulated:
            raise UniconError(
                f"platform {program.platform.facts.name!r} is a robot; rollouts are simulated"
            )
        self.program = program
        self._graph = compile_graph(program.root)
        self._look = look
        self._float = program.states.buffer_of(np.float32)
        self._rows = np.zeros((256, self._float.size), np.float32)
        self._memory = memory_of(program, self.graphs())
        self._built = self._memory.take()
        self.why_not = self._obstacle()
        self._act: Callable[[], None] | None = None
        if beside and not self.why_not and isinstance(program.platform, DefersPhysics):
            self._act = program.platform.postpone()

    def graphs(self) -> dict[str, CompiledGraph]:
        """Return the compiled tick."""
        return {Phase.RUN.value: self._graph}

    def _obstacle(self) -> str:
        program = self.program
        if not isinstance(program.platform, Changeable):
            return f"platform {program.platform.facts.name!r} cannot begin in another scene"
        for name, reason in self._memory.unproven.items():
            return f"block {name!r}: {reason}"
        if len(program.stages[Stage.RECV]) > 1 or program.store is not None:
            return "something comes from outside, or leaves"
        return ""

    def begin(self, document: WorkflowDocument) -> None:
        """Be as a program that was built of a document which differs in its scene alone.

        Not in `model` and `mounts` of the scene either, nor in whether anything disturbs it.

        Raises:
            UniconError: the scene is wrong, or it cannot begin anew; then it has to be built.
        """
        if self.why_not:
            raise UniconError(self.why_not)
        program, platform = self.program, self.program.platform
        assert isinstance(platform, Changeable)
        self.why_not = "a beginning failed"  # half changed, it must not go on
        program.states.reset()
        scene = read_scene(document, program.context, platform.facts)
        platform.change(scene)
        if (ground := program.context.models.get(GROUND)) is not None:
            ground.lay(scene.uneven)
        self._graph.reset()
        self._memory.put_back(self._built)
        program.gate.sent.forget()
        program.monitor.begin()
        self.why_not = ""

    def run(self, limit: int) -> Rollout:
        """Tick until the flow is done, or a look, a fault or the limit ends it.

        Args:
            limit: most ticks.
        """
        halves = self.halves(limit)
        while True:
            try:
                next(halves)
            except StopIteration as end:
                rollout: Rollout = end.value
                return rollout

    def halves(self, limit: int) -> Generator[None, None, Rollout]:
        """Do the same, and yield in front of the physics of each tick and behind them.

        Only where they wait for it; else it yields nothing.

        Args:
            limit: most ticks.
        """
        program, graph, act = self.program, self._graph, self._act
        look = None if self._look is None else self._look(program.states)
        step, deferred, tick = graph.step, graph.deferred, program.states["tick"]
        rows, values = self._rows, self._float
        ended, fault, block, count = "duration", "", "", 0
        try:
            while count < limit:
                done = step()
                if act is not None:
                    yield
                    block = "send"  # should it fail
                    act()
                    block = ""
                    yield
                try:
                    done = deferred() or done
                finally:
                    tick += 1
                if count == len(rows):
                    rows = self._rows = np.concatenate([rows, np.zeros_like(rows)])
                rows[count] = values
                count += 1
                if done:
                    ended = "done"
                    break
                if look is not None and look():
                    ended = "looked"
                    break
        except Exception as error:
            ended, fault, block = "fault", reason_of(error), block or self._where(error)
        return Rollout(ended, count, fault, block, program.monitor.sha256, rows[:count])

    def _where(self, error: Exception) -> str:
        """Return the block that an error came out of: what the generated function called there."""
        lines, found = self._graph.source.splitlines(), ""
        for frame, number in traceback.walk_tb(error.__traceback__):
            if frame.f_code.co_filename != LABEL:
                continue
            for name in _CALLED.findall(lines[number - 1]):
                tick = frame.f_locals.get(name)
                found = next((b.name for b in self._graph.blocks if b.tick == tick), found)
        return found


T = TypeVar("T")


class Lockstep(Generic[T]):
    """Rollouts that run side by side.

    They need not begin together, nor be of one workflow.
    """

    def __init__(self) -> None:
        self._running: list[tuple[T, Generator[None, None, Rollout]]] = []

    def __len__(self) -> int:
        return len(self._running)

    def add(self, mark: T, rollouts: Rollouts, limit: int) -> None:
        """Have a rollout run from the next tick on.

        Args:
            mark: that `tick` tells it by.
            rollouts: at their beginning, made with `beside=True`; without it, or where the platform
                cannot wait, the next tick runs all of it.
            limit: most ticks.
        """
        self._running.append((mark, rollouts.halves(limit)))

    def tick(self) -> list[tuple[T, Rollout]]:
        """Run a tick of each rollout; return those that have ended with their marks."""
        ended: list[tuple[T, Rollout]] = []
        for _ in ("commands", "physics"):
            running, self._running = self._running, []
            for one in running:
                try:
                    next(one[1])
                except StopIteration as end:
                    ended.append((one[0], end.value))
                else:
                    self._running.append(one)
        return ended


BACK_S, EVERY_S = 60.0, 0.5
"""How far back a `Rewind` goes, and between two of its moments, in [s] of ticks."""


Moment = tuple[int, Snapshot, Remembered]
"""A run between two ticks: number of the tick that follows, all states, the declared memory."""


class Rewind:
    """Keeps moments of a run on a simulator, and sets the run back to one of them.

    A moment is kept in the slack before a tick, where that is half a period or twice what the last
    one took: 0.3 ms and 8 kB with Go2 or G1, 1 MB in all. Whatever comes from outside (commands of
    pages and topics, devices) is not repeated.

    Args:
        runner: of the run, before its first tick.
        others: what else remembers and is set back, by label; each declares its memory.

    Attributes:
        why_not: why the run cannot be set back, "" where it can.
    """

    def __init__(self, runner: Runner, **others: Any) -> None:
        self._runner, self._program, self._next = runner, runner.program, 0
        self._every = max(1, round(EVERY_S / runner.program.period))
        self._slack_ns = runner.period_ns // 2
        self._kept = deque[Moment](maxlen=round(BACK_S / EVERY_S))
        self.why_not = self._obstacle()
        if not self.why_not:
            others["platform"] = runner.program.platform
            self._memory = memory_of(runner.program, runner.graphs(), **others)

    def _obstacle(self) -> str:
        program = self._program
        platform, name = program.platform, repr(program.platform.facts.name)
        if not platform.facts.simulated:
            return f"platform {name} is a real robot, which cannot go back; use a simulator"
        if not isinstance(platform, Library):
            return f"platform {name} cannot save its state; use mujoco or fake"
        if program.part:
            return f"part {program.part!r} cannot go back without the others; leave out --part"
        if not self._runner.options.returns:
            return "collected ticks may not repeat; leave out --collect"
        if self._runner.options.native:
            return "a native run cannot go back; leave out --native"
        if program.states.num_robots is not None:
            return "several robots cannot go back; leave out num_robots"
        for name, contract in program.policies.items():
            if contract.child is not None:
                return f"policy {name!r} computes elsewhere; leave out its {contract.child.key}"
        return ""

    def __call__(self) -> None:
        """Have a moment kept before the next tick, where one is due and there is time for it."""
        runner = self._runner
        count, due = runner.statistics.count, runner.next_due_ns
        if count < self._next or self.why_not or runner.phase is not Phase.RUN:
            return
        if not due or due - time.perf_counter_ns() > self._slack_ns:
            self._next = count + self._every
            runner.call_soon(self._keep)

    def _keep(self) -> None:
        began, states, memory = time.perf_counter_ns(), self._program.states, self._memory
        self._kept.append((int(states["tick"]), states.snapshot(), memory.take()))
        for name, reason in memory.unproven.items():
            self.why_not = f"block {name!r}: {reason}; unicon check says more"
        took_ns = time.perf_counter_ns() - began  # on a busy machine that may be anything
        self._slack_ns = min(2 * took_ns, self._runner.period_ns // 2)

    def moment(self, tick: float) -> Moment:
        """Return the newest moment up to a tick.

        Raises:
            UniconError: the run cannot be set back, or no moment is kept up to there.
        """
        phase, first = self._runner.phase, "later"
        if self._runner.stopping:
            raise UniconError("the run is about to end")
        if self.why_not or phase is not Phase.RUN:
            raise UniconError(self.why_not or f"the run is in phase {phase.value}, not in its flow")
        for moment in reversed(self._kept):
            if moment[0] <= tick:
                return moment
            first = f"{moment[0] * self._program.period:.2f} s"
        raise UniconError(f"that time is not kept; choose one from {first} on")

    def back(self, moment: Moment) -> None:
        """Set the run back to a moment, between two ticks, and forget those behind it.

        The flow is made fresh first, which records notice.
        """
        tick, states, memory = moment
        while self._kept and self._kept[-1][0] > tick:
            self._kept.pop()
        self._runner.graph.reset()
        self._memory.put_back(memory)
        self._program.states.restore(states)
        self._next = self._runner.statistics.count + self._every
