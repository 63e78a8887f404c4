"""Replayed: a program that is built anew and ticks through a record; for verify.

What came from outside is put into the states at the moment at which it came: all of them behind
recv, what topics and parameters gave behind those. All else is computed again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from unicon_base import StateError, UniconError, one_line
from unicon_base.arrays import Float64
from unicon_core.flow import Block, Stage, blocks_of, compile_graph
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.memory import Snapshot
from unicon_core.policies.policy_states import TIMES
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.startup_sequence import approach_tree, waiting_tree
from unicon_core.signals import SIGNALS
from unicon_core.states.standard import COMMAND_STATES, GAIN_SCALE, GAIN_SCALE_SPEC
from unicon_core.workflow import Program, WorkflowDocument
from unicon_core.workflow.tick_tree import memory_of
from unicon_lab.recording import Record
from unicon_lab.recording.ticks import changes, from_json
from unicon_lab.replay.platform import StandIn, recorded_facts
from unicon_lab.replay.series import Columns

GIVEN = {"input": ("velocity_command",), "tuned": ("joint_stiffness", "joint_damping")}
"""What comes from outside where a record does not say it."""

_WRONG = (AttributeError, LookupError, TypeError, ValueError)


class Replayed:
    """A program and the record that it ticks through.

    Args:
        record: what was recorded.
        document: the workflow; its platform is not opened.
        native: it ticks natively, as `RunOptions.native`.

    Attributes:
        program: what ticks.
        columns: the record's states as the program's.
        graph: the compiled tick of the present phase.
        outside: states that came from outside, by the moment behind it.
        beyond: those of them that came behind the command: they are not computed in a tick.
        scaled: gains were scaled from outside, by these factors.
        skipped: what kind of ticks cannot be replayed, and how many.
        homeless: recorded blocks whose memory has no place here.
        fault: what the tick raised in which the recorded fault was; "" where it raised nothing,
            None where no such tick was run.

    Raises:
        UniconError: the program cannot be built, or the record is of another robot.
    """

    def __init__(self, record: Record, document: WorkflowDocument, native: bool = False) -> None:
        self.record = record
        facts, silent = recorded_facts(record)
        self._row, self._told_of = 0, -1
        self.scaled: dict[float, None] = {}
        self.skipped: dict[str, int] = {}
        self.homeless: set[str] = set()
        self.fault: str | None = None
        said = record.told("outside", dict) if "outside" in record.facts else GIVEN
        self.outside = {
            moment: tuple(map(str, names))
            for moment, names in said.items()
            if isinstance(names, list | tuple)
        }
        self.program = Program(
            document,
            hooks=[self._hook],
            part=record.facts.get("part", ""),
            dry=True,
            silent=silent,
            instead=partial(StandIn, facts),
        )
        try:
            period = self.program.period
            with suppress(UniconError):
                period = record.period
            if abs(period - self.program.period) > 1e-6 * period:
                raise StateError(
                    f"the record ticks at {1.0 / period:g} Hz and workflow {self.program.name} at "
                    f"{1.0 / self.program.period:g} Hz; give it rate: {1.0 / period:g}, or replay "
                    "without --verify, where a tick gets the newest values"
                )
            runner = Runner(self.program, RunOptions(warn=_quiet, native=native))
            self._graphs = runner.graphs()
            self._memory = memory_of(self.program, self._graphs)
            self._fresh = self._memory.take()
            self._memories = _memories(record)
        except BaseException:
            self.program.close()
            raise
        self.graph: CompiledGraph = runner.graph
        # What no command depends on is heard in the slack, behind the moment at which it is kept.
        own = self.program.critical.difference(self.program.outside)
        needed = {s for block in own for s in (*block.reads, *block.amends)}
        given = {*self.outside.get("input", ()), *self.outside.get("tuned", ())}
        self.beyond = {*self.outside.get("sent", ()), *(given - needed)}
        self.beyond |= {name for name in self.columns.names if name.endswith(tuple(TIMES))}

    def ended(self, row: int) -> None:
        """Take the end of a tick: its states are as the program has left them."""

    def failed(self, row: int, error: Exception) -> None:
        """Take a tick that raised where the recorded one went on."""

    def run(self) -> int:
        """Run all ticks that can be run, and return how many.

        Raises:
            StateError: what the blocks remembered cannot be given to these.
        """
        record, platform, ran = self.record, self.program.platform, 0
        assert isinstance(platform, StandIn)
        lost = False
        for row, phase in enumerate(record.phases):
            SIGNALS.check()
            if row in self._memories:
                self._restore(self._memories[row])
                lost = False
            elif row > 0 and record.phases[row - 1] == phase:
                lost |= record.ticks[row] != record.ticks[row - 1] + 1  # memory is not known then
            graph = None if lost else self._graph(row, phase)
            ended = record.ended[row]
            if graph is None:
                if ended:
                    why = "behind ticks that were not recorded" if lost else f"of phase {phase}"
                    self.skipped[why] = self.skipped.get(why, 0) + 1
                continue
            self._row, self.graph = row, graph
            if ended:
                # Where the flow itself was done this changes nothing: all begins anew either way.
                platform.done = bool(record.done[row])
                ran += 1
            else:  # nothing of the tick is compared
                self.fault = ""
            try:
                graph.step()
                graph.deferred()
            except Exception as error:
                if not ended:
                    self.fault = one_line(error)
                elif self._told_of == row and not all(record.ended[row + 1 : row + 2]):
                    self.fault = one_line(error)  # found behind send, as in the run
                    break
                else:
                    self.failed(row, error)
        return ran

    def _graph(self, row: int, phase: str) -> CompiledGraph | None:
        if phase not in (Phase.WAIT.value, Phase.APPROACH.value):
            return self._graphs.get(phase)
        if row == 0 or self.record.phases[row - 1] != phase:
            self._graphs.pop(phase, None)
            if phase == Phase.WAIT.value:
                self._graphs[phase] = compile_graph(waiting_tree(self.program), trace=True)
            elif row:  # an approach that began before is not known
                self._row = row - 1
                self._put("sent", self.columns.names)
                self._graphs[phase] = compile_graph(approach_tree(self.program), trace=True)
        return self._graphs.get(phase)

    # -- what came from outside -----------------------------------------------------------------

    def _hook(self, program: Program) -> Mapping[Stage, list[Block]]:
        self.columns = Columns(self.record, program.states)
        names = self.columns.names
        self.outside = {m: tuple(n for n in ns if n in names) for m, ns in self.outside.items()}
        made = _written(program, Stage.ESTIMATE, Stage.COMMAND)
        given = self.outside.get("input", ())
        wanted = [name for name in names if name in given or name not in made]
        self._at_input = self._kept("input", wanted)
        made |= {*given, *_written(program, Stage.INPUT, Stage.FLOW), *COMMAND_STATES}
        self._at_tuned = self._kept("tuned", [name for name in names if name not in made])
        gains = self._kept("tuned", self.outside.get("tuned", ()))
        self._gains = [name for name in gains if name != GAIN_SCALE]
        self._scales: Float64 | None = None
        if GAIN_SCALE in gains:
            scales = self.columns.column(GAIN_SCALE, "tuned")
            self._scales = scales.reshape(len(scales), -1)[:, :2]  # of a batch they are all alike
        written = {s for block in program.blocks for s in (*block.writes, *block.amends)}
        # Undeclared, so that they stay where they are. What they give is declared beside them, as
        # it was in the run: the graph puts off behind `send` what it put off there.
        stages = {
            Stage.RECV: [Block("received again", self._received, endless=True)],
            Stage.OBSERVE: [Block("compare", self._sent, endless=True)],
        }
        work = {Stage.INPUT: ("input", self._input), Stage.TUNE: ("tuned", self._tuned)}
        for stage, (moment, tick) in work.items():
            if moment not in self.record.moments:
                continue
            stages[stage] = [Block(f"{moment} again", tick, endless=True)]
            if theirs := self.outside.get(moment, ()):
                fresh = tuple(name for name in theirs if name not in written)
                amended = tuple(name for name in theirs if name in written)
                stages[stage].append(
                    Block("given", _quiet, writes=fresh, amends=amended, endless=True)
                )
        return stages

    def _kept(self, moment: str, names: Sequence[str]) -> list[str]:
        return self.columns.kept(moment, names) if moment in self.record.moments else []

    def _received(self) -> None:
        self.columns.begin(self._row)

    def _put(self, moment: str, names: Sequence[str]) -> None:
        for name in names:
            self.program.states[name][...] = self.columns.column(name, moment)[self._row]

    def _input(self) -> None:
        self._put("input", self._at_input)

    def _tuned(self) -> None:
        """Scale the gains as somebody wished; other gains are those of another workflow."""
        self._put("tuned", self._at_tuned)
        if self._scales is not None:
            for name, factor in zip(GAIN_SCALE_SPEC.names, self._scales[self._row].tolist()):
                if factor != 1.0:
                    own = self.program.states[name]
                    np.multiply(own, factor, out=own, casting="unsafe")
            return
        for name in self._gains:
            own, recorded = self.program.states[name], self.columns.column(name, "tuned")[self._row]
            if own.tobytes() == recorded.tobytes():
                continue
            factor = ratio(recorded, own, 1e-5)
            if factor is not None:
                self.scaled[round(factor, 5)] = None
                own[...] = recorded

    def _sent(self) -> None:
        self._told_of = self._row
        if self.fault is None:
            self.ended(self._row)

    # -- what was remembered --------------------------------------------------------------------

    def _restore(self, snapshot: Snapshot) -> None:
        own = self._fresh.keys()
        self.homeless |= snapshot.keys() - own
        try:
            self._memory.put_back(self._fresh)
            here = ((label, saved) for label, saved in snapshot.items() if label in own)
            self._memory.put_back(Snapshot(here))
        except StateError as error:
            raise StateError(
                f"workflow {self.program.name} cannot go on in the middle of the recorded run: "
                f"{error}"
            ) from error


def _written(program: Program, *stages: Stage) -> set[str]:
    blocks = [
        block for stage in stages for node in program.stages[stage] for block in blocks_of(node)
    ]
    return {state for block in blocks for state in (*block.writes, *block.amends)}


def _memories(record: Record) -> dict[int, Snapshot]:
    """Return what is to be given to freshly built blocks, by the row before which it is."""
    kept = {each["before"]: each for each in record.memories}
    if not kept:
        if len(record.ticks) and (record.ticks[0] > 0 or record.phases[0] == Phase.SOFT.value):
            raise UniconError(
                "the record begins in the middle of a run and holds no memory of its blocks, so "
                "that nothing after it can be foretold; record again with this version"
            )
        return {}
    if any("owners" in each for each in kept.values()):
        version = record.told("versions", dict).get("unicon_ros", "an older one")
        raise UniconError(
            f"the record holds the memory of its blocks as unicon_ros {version} wrote it, from "
            "before blocks declared it; its states are read, but --verify needs that version: "
            f"pip install unicon_ros=={version}"
        )
    told = record.files.get("memory.json")
    try:
        built = None if told is None else json.loads(told).get("built")
        given = {
            row: _snapshot(each["blocks"]) for row, each in kept.items() if row == 0 or each["anew"]
        }
        if built is not None:
            built = _snapshot(built)
        elif record.ticks[0] == 0:  # it holds the run from its first tick
            built = given.get(0)
        if built is None:
            return given
        return {row: changes(each, built) for row, each in given.items()}
    except _WRONG as error:
        raise StateError(f"the record's memory.json is damaged: {error!r}") from error


def _snapshot(value: Any) -> Snapshot:
    found = from_json(value)
    if not isinstance(found, Snapshot):
        raise TypeError(f"a {type(found).__name__} stands where a snapshot is to be")
    return found


def ratio(recorded: Any, own: Any, tolerance: float) -> float | None:
    """Return the one factor from one array to another, None where there is none."""
    moved = own != 0.0
    if not moved.any() or (recorded[~moved] != 0.0).any():
        return None
    ratios = recorded[moved].astype(float) / own[moved]
    near = np.abs(ratios - ratios[0]) <= tolerance * abs(ratios[0])
    return float(ratios[0]) if near.all() else None


def _quiet(*_: object) -> None:
    """Do nothing."""
