"""Program: what runs, built from a workflow file or in Python; for runner, bridge and viewers.

program = Program(
    robot="go2", platform="mujoco", rate=50, policies={"walk": "go2_velocity"},
    flow=Chain(pose("stand"), Loop(policy("walk"), until=elapsed(10))),
)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from unicon_base import AnyMapping
from unicon_core.blocks.approach import Entry, Monitor
from unicon_core.flow import Block, Node, Stage, as_block, blocks_of
from unicon_core.gates.build import gates_of
from unicon_core.platforms.joined import PartPlatform
from unicon_core.platforms.kit.command import LastSent
from unicon_core.platforms.platform import Platform, RequiresStates, WarmsUp
from unicon_core.policies import PolicyContract
from unicon_core.signals import SIGNALS
from unicon_core.states import Layout, States
from unicon_core.states.groups import groups_of
from unicon_core.states.links import Incoming
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.build import (
    Builder,
    Sections,
    finite_first,
    period_of,
    sections_of,
    specs_of,
)
from unicon_core.workflow.division import (
    check_places,
    is_divided,
    of_part,
    publishers,
    refuse_parts,
)
from unicon_core.workflow.document import WorkflowDocument, document_of, load_document
from unicon_core.workflow.live_twin import build_twin, twin_of
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.parts import read_parts, read_store
from unicon_core.workflow.platforms import build_platform, latches_of
from unicon_core.workflow.policies import (
    image_terms,
    load_policies,
    shadow_blocks,
    shadow_of,
    with_weldable,
)
from unicon_core.workflow.program_data import Gate, ProgramData, withheld
from unicon_core.workflow.settings import pacing_of, safety_of, start_of
from unicon_core.workflow.tick_tree import bound_commands, completed, left_out, tick_tree, with_flow
from unicon_core.workflow.uses import EXPRESSION, Use

if TYPE_CHECKING:
    from typing import Unpack


Named = str | AnyMapping
Flow = Node | Callable[..., object] | str | AnyMapping
Blocks = Sequence[Flow]


class Described(TypedDict, total=False):
    """A workflow in Python; `Workflow` says what each key means and which values it takes."""

    robot: Named
    platform: Named
    flow: Flow
    name: str
    description: str
    store: Named
    parts: AnyMapping
    scene: AnyMapping
    platforms: AnyMapping
    rate: float
    duration: float
    num_robots: int
    map: str
    ros: bool
    states: AnyMapping
    policies: AnyMapping
    shadow: AnyMapping
    skills: AnyMapping
    estimate: Blocks
    commands: Blocks
    start: Named
    wind_down: Flow
    safety: str | Blocks | AnyMapping
    deferred: Blocks
    twin: Named
    pacing: AnyMapping
    check: AnyMapping


Hook = Callable[["Program"], Mapping[Stage, Sequence[Block]]]
"""Gives a program further blocks, each for its stage, once states and platform exist: a bridge, a
recorder, a viewer. They stand behind the program's own blocks of that stage."""
HookBlocks = dict[Stage, list[Block]]
"""What most hooks give."""


class Program(ProgramData):
    """Robot, platform, states and the graph of a tick.

    Args:
        document: the workflow; without it the keywords describe one, with the keys of a workflow
            file. Flows are then trees of nodes, uses and plain functions.
        hooks: give further blocks.
        part: of a divided workflow, which alone is built; "" for all of it.
        dry: open no hardware: its options are checked, and `fake` stands in its place.
        silent: open the robot and send it nothing, at the end either; a simulator is sent limp
            joints. The command states hold what would have been sent.
        instead: makes what stands in the place of the platform, which is not opened.
        contracts: policies by their name, in place of those of the document.

    Raises:
        UniconError: anything that the user can mend; one line with culprit and remedy.
    """

    def __init__(
        self,
        document: WorkflowDocument | None = None,
        /,
        *,
        hooks: Iterable[Hook] = (),
        part: str = "",
        dry: bool = False,
        silent: bool = False,
        instead: Callable[[States], Platform] | None = None,
        contracts: Mapping[str, PolicyContract] | None = None,
        **described: Unpack[Described],
    ) -> None:
        if document is None:
            caller = sys._getframe(1)
            document = document_of(described, Path(caller.f_code.co_filename), caller.f_lineno)
        self.document, self.name, self.dry, self.silent = document, document.name, dry, silent
        self.robot = load_robot_of(document)
        self.policies = load_policies(document, self.robot) | dict(contracts or {})
        self.robot = with_weldable(document, self.robot, self.policies)
        self.period = period_of(document, self.policies)
        self.duration = document.get("duration")
        self.pacing = pacing_of(document)
        self.start = start_of(document)
        sections, ending = sections_of(document)
        trees = [node for nodes in sections.values() for node in nodes]
        mentioned = [b for n in (*trees, *([ending] if ending else ())) for b in blocks_of(n)]
        uses = [b for b in mentioned if isinstance(b, Use) and b.word != EXPRESSION]
        specs = specs_of(document, self.robot, self.policies, uses)
        shadow = shadow_of(document, self.robot, self.policies, uses)
        if shadow is not None:
            specs |= shadow.states(self.robot, specs)
        self.states = States(Layout(specs, document.get("num_robots")))
        self.part, self.parts, self.store = part, read_parts(document), read_store(document)
        if self.parts is not None:
            self.parts.check(self.states.layout, document)
        check_places(sections, ending, self.parts)
        if silent and (part or is_divided(mentioned, self.parts)):
            refuse_parts(self.parts, document)
        if part:
            sections, ending = of_part(part, self.parts, sections, ending, document)
        self.paced = False
        self.gate = Gate(LastSent(self.states))
        self.context = BuildContext(
            self.states,
            self.robot,
            self.period,
            self.policies,
            document.path.parent,
            dry=dry,
            tell=self.tell,
            driving=lambda: self.gate.sent.any,
            sent=self.gate.sent,
            paced=lambda: self.paced,
            lag=0.0 if self.has_platform else self.period,
            scene=document.get("scene", {}),
            shadow=shadow,
        )
        self.monitor = Monitor(self.states, dry=silent, fixed=not self.robot.floats)
        self.warn = print
        self._arrivals: list[Incoming] = []
        if self.parts is not None and part:
            self._arrivals = self.parts.incoming(part, self.states, self.tell)
        self.blocks = self.context.blocks = []
        self.outside = []
        self.latches = []
        try:
            if instead is not None:
                self.platform = instead(self.states)
            elif self.parts is not None and not self.has_platform:
                self.platform = PartPlatform(part, self.parts.first, self._arrivals)
            else:
                if not (dry or silent):
                    self.latches = latches_of(document, self.robot, self.tell)
                self.platform = build_platform(document, self.context, dry=dry, silent=silent)
            self.context.platform = self.platform
            held = document.get("scene", {}).get("gantry") and self.platform.facts.simulated
            self.monitor.held = bool(held)
        except BaseException:  # nobody else has them yet
            for arrival in self._arrivals:
                arrival.close()
            raise
        self.stages = {stage: [] for stage in Stage}
        self.gates = []
        self.command_bounds = ()
        self.forced = ()
        self.safety_left_out = {}
        self._closed = False
        try:
            with SIGNALS.guard(damp=self.damp_now):
                self._assemble(sections, ending, hooks)
                SIGNALS.check()
        except BaseException:
            self.close()
            raise

    # -- building -------------------------------------------------------------------------------

    def _assemble(self, sections: Sections, ending: Node | None, hooks: Iterable[Hook]) -> None:
        stages, platform = self.stages, self.platform
        builder = Builder(self)
        for stage, nodes in sections.items():
            for node in nodes if stage is not Stage.SAFETY else ():
                built = builder.built(node)
                # What a device tells is received, wherever the block is listed.
                is_device = isinstance(built, Block) and built.stage is Stage.RECV
                stages[Stage.RECV if is_device else stage].append(built)
        stages[Stage.SAFETY] += self._safety(builder, sections[Stage.SAFETY])
        finite_first(self.document, stages[Stage.SAFETY])
        self.safety = tuple(b.name for node in stages[Stage.SAFETY] for b in blocks_of(node))
        last = None if ending is None else builder.built(ending)
        if self.has_platform:
            heard = [as_block(arrival) for arrival in self._arrivals]
            self.blocks += heard  # before the hooks: a bridge amends what comes from a part
            stages[Stage.RECV] += heard
        self._beside()
        for hook in hooks:  # one by one: what a hook has opened is closed when the next one fails
            for stage, blocks in hook(self).items():
                self.blocks += blocks
                self.outside += blocks
                stages[stage] += blocks
        self.command_bounds = bound_commands(self)
        recv = Block("recv", platform.recv, writes=platform.facts.writes)
        warm_up = platform.warm_up if isinstance(platform, WarmsUp) else None
        recv.warm_up = builder.warm_ups.refresh(warm_up)
        sending = self.sending = withheld(platform, self.states) if self.silent else platform.send
        send = Block("send", self.gate.before(sending), reads=platform.facts.reads)
        stages[Stage.RECV].insert(0, recv)
        stages[Stage.SEND].append(send)
        self.blocks += self._published()
        looking = list(stages[Stage.OBSERVE])
        stages[Stage.OBSERVE].append(as_block(self.monitor))
        for stage, nodes in stages.items():
            for block in (block for node in nodes for block in blocks_of(node)):
                block.stage = block.stage or stage
        self.hearing = [*stages[Stage.RECV], *stages[Stage.ESTIMATE], *stages[Stage.INPUT]]
        self.looking = looking
        self.root, self.critical = tick_tree(stages | self._entry(), self.states)
        self.wind_down = None if last is None else self.with_flow(last)
        if isinstance(platform, RequiresStates):
            needing = [block for block in self.critical if getattr(block.tick, "needs", True)]
            ordered = sorted(needing, key=lambda block: block.name)
            platform.require({state: b.name for b in ordered for state in (*b.reads, *b.amends)})
        self.gates += gates_of(self)

    def _beside(self) -> None:
        """Let what follows `send` see it; before the hooks: a recorder sees its states."""
        pictures = [(Stage.OBSERVE, as_block(term)) for term in image_terms(self.context)]
        for stage, block in [*pictures, *shadow_blocks(self.blocks)]:
            self.blocks.append(block)
            self.stages[stage].append(block)
        settings = twin_of(self.document)
        if settings is None or self.silent or not self.has_platform:
            return
        estimates = [b for node in self.stages[Stage.ESTIMATE] for b in blocks_of(node)]
        measured = {*self.platform.facts.writes, *(n for b in estimates for n in b.writes)}
        twin = build_twin(self.document, settings, self.context, measured)
        self.blocks.append(twin)
        self.stages[Stage.OBSERVE].append(twin)

    def _safety(self, builder: Builder, listed: Sequence[Node]) -> list[Node]:
        """Return the safety blocks: of a robot also those that the workflow does not list."""
        said = safety_of(self.document)
        robot = self.has_platform and not self.platform.facts.simulated
        if robot and not said.exact:
            nodes, self.safety_left_out = completed(self, builder, listed)
        else:
            nodes = [builder.built(node) for node in listed]
            if robot:
                self.safety_left_out = dict.fromkeys(
                    left_out(listed, self.platform, self.robot.members), said.words
                )
        if not self.silent:
            return nodes
        awaits = [n for n in nodes if isinstance(n, Block) and getattr(n.tick, "awaits", False)]
        for node in awaits:
            self.safety_left_out[node.name] = "a robot that is sent nothing does not follow"
        return [node for node in nodes if node not in awaits]

    def _published(self) -> list[Block]:
        """Put the publishers of this process into the stages, as its store and part say."""
        states = self.states
        if self.part and self.parts is not None and not self.dry:
            groups = self.parts.groups(self.part, states.layout)
            return publishers(self.parts.store, self.part, groups, states, self.stages)
        if self.store is None or self.dry or self.silent or self.parts is not None:
            return []
        return publishers(self.store, "", groups_of(states.layout), states, self.stages)

    def with_flow(self, flow: Node) -> Node:
        """Return the tree of a tick with another flow, which nobody commands or reports.

        Safety blocks that look at what the flow of the run writes, such as an observation, are left
        out: nobody writes it here.
        """
        stages = with_flow(self.stages, flow) | {Stage.OBSERVE: self.looking}
        return tick_tree(stages, self.states)[0]

    def _entry(self) -> dict[Stage, list[Node]]:
        """Let a robot's flow come in without a jump; in a simulator no command is changed."""
        ticks = round(self.start.fade_in / self.period)
        if self.platform.facts.simulated or not self.has_platform or not ticks:
            return {}
        entry = as_block(Entry(self.states, self.gate.sent, ticks))
        entry.stage = Stage.SAFETY
        return {Stage.SAFETY: [entry, *self.stages[Stage.SAFETY]]}


def load_workflow(
    name_or_path: str | Path,
    overrides: Iterable[str] | AnyMapping = (),
    *,
    hooks: Iterable[Hook] = (),
) -> Program:
    """Read a workflow file and build its program.

    Args:
        name_or_path: a name in `config/workflows/`, or a path.
        overrides: `path=value` texts as of `--set`, or a mapping.
        hooks: as of `Program`.

    Raises:
        UniconError: anything that the user can mend; one line with culprit and remedy.
    """
    return Program(load_document(name_or_path, overrides), hooks=hooks)
