"""Building: the parts of a program made of what a workflow says; for `Program` alone."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

from unicon_base import AnyDict, AnyMapping, UniconError, WorkflowError, alternatives
from unicon_core.blocks.safety.stops import Finite
from unicon_core.flow import (
    Blender,
    Block,
    Every,
    Node,
    Stage,
    Switch,
    Tick,
    blocks_of,
    children_of,
)
from unicon_core.flow.nodes import chooser_of, with_children
from unicon_core.policies.action_map import lacking_joints
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import Robot
from unicon_core.signals import SIGNALS
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.states.layout import check_name
from unicon_core.states.standard import COMMAND_STATES, control_states, hardware_states
from unicon_core.states.states import spans
from unicon_core.workflow.autowire import BuildContext, autowire, option_names, read_options
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.flow_yaml import FlowReader
from unicon_core.workflow.live_twin import twin_states
from unicon_core.workflow.members import member_context, member_robot, of_whole, share_of, stamps_of
from unicon_core.workflow.platforms import facts_of_all, find_platforms
from unicon_core.workflow.policies import declared_states, policy_factory
from unicon_core.workflow.program_data import ProgramData
from unicon_core.workflow.registry import Factory, find_factory
from unicon_core.workflow.settings import safety_of
from unicon_core.workflow.uses import EXPRESSION, Use, expression

Sections = dict[Stage, list[Node]]
"""What a workflow says for each stage."""


def sections_of(document: WorkflowDocument) -> tuple[Sections, Node | None]:
    """Return what a workflow says for each stage, and the flow of its wind-down or None."""
    reader, safety = FlowReader(document), safety_of(document)
    listed = {Stage.ESTIMATE: "estimate", Stage.COMMAND: "commands", Stage.OBSERVE: "deferred"}

    def read(items: Sequence[Any], *path: str) -> list[Node]:
        return [reader.node(item, (*path, i)) for i, item in enumerate(items)]

    sections = {stage: read(document.get(key, []), key) for stage, key in listed.items()}
    sections[Stage.FLOW] = [reader.node(document.values["flow"], ("flow",))]
    sections[Stage.SAFETY] = read(safety.blocks, *safety.path)
    ending = document.values.get("wind_down")
    return sections, None if ending is None else reader.node(ending, ("wind_down",))


class Builder:
    """Makes blocks of uses.

    Args:
        program: whose states they get; takes the built blocks.

    Attributes:
        warm_ups: of the blocks.
    """

    def __init__(self, program: ProgramData) -> None:
        self._program, self._context = program, program.context
        self.warm_ups = WarmUps(program.context)

    def built(self, node: Node) -> Node:
        """Return a tree in which every use is a block.

        Raises:
            WorkflowError: a block cannot be built; with its place.
        """
        program = self._program
        if isinstance(node, Use):
            made = self._block(node)
            for each in blocks_of(made):
                each.part = node.part
            return made
        if isinstance(node, Block):
            if node not in program.blocks:
                program.blocks.append(node)
            return node
        children = [self.built(child) for child in children_of(node)]
        for child, new in zip(children_of(node), children):
            if child is chooser_of(node) and not isinstance(new, Block):
                raise WorkflowError(
                    f"{child.name!r} is a flow at this rate; it needs a block or an expression",
                    child.where,
                )
        made = with_children(copy(node), children)  # a node of its own for each place
        if isinstance(made, Switch) and isinstance(made.blend, float):
            made.blender = Blender({name: program.states[name] for name in COMMAND_STATES})
            made.blend = round(made.blend / program.period)
        return made

    def _block(self, use: Use) -> Node:
        SIGNALS.check()
        program, context = self._program, self._context
        if use.word == EXPRESSION:
            return expression(str(use.first), program.states, use.where)
        is_policy = use.word == "policy"
        factory = policy_factory(use, context.policies) if is_policy else factory_of(use)
        options, robots = _options(factory, use), program.states.num_robots
        if use.of and robots is not None:
            raise WorkflowError(
                f"block {use.name!r}: of: {use.of} gives it a part of the states of one robot, and "
                f"num_robots is {robots}; leave out num_robots, or of: {use.of}",
                use.where,
            )

        def build(context: BuildContext) -> Block:
            own = member_context(context, use.of) if use.of else context
            name = f"{use.name} of {use.of}" if use.of and not use.label else use.name
            made = autowire(factory, name, own, options, use.rename, use.where)
            moves = tuple(getattr(made.tick, "moves", ()))
            if use.of or moves:
                made.share = share_of(context, use.of, moves)
            return made

        block = build(context)
        self.warm_ups.add(block, factory, build)
        program.blocks.append(block)
        contract = controller_contract(block)
        if contract is None:
            return block
        # A controller runs every n-th tick where the program ticks faster than it is made for.
        if lacking := lacking_joints(contract, member_robot(context.robot, use.of)):
            raise WorkflowError(f"block {block.name!r}: {lacking}", block.where)
        ticks = contract.period / program.period
        n = round(ticks)
        if n < 1 or abs(ticks - n) > 1e-6 * n:
            wanted = 1.0 / contract.period
            raise WorkflowError(
                f"block {block.name!r}: {contract.name} is made for {wanted:g} Hz, which does not "
                f"divide the workflow's rate of {1.0 / program.period:g} Hz; set rate: "
                f"{wanted:.10g} or a multiple, or correct the period of {contract.name} "
                "(training: dt × decimation)",
                block.where,
            )
        if n == 1 or getattr(block.tick, "every_tick", False):
            return block
        return Every(n, block, where=block.where)


def finite_first(document: WorkflowDocument, safety: Sequence[Node]) -> None:
    """Refuse limits before `finite`: they turn an infinite command into a limit, unseen."""
    clamp = ""
    for i, block in ((i, block) for i, node in enumerate(safety) for block in blocks_of(node)):
        if isinstance(block.tick, Finite) and clamp:
            raise document.error(
                f"safety: {block.name!r} stands behind {clamp!r}, which hides infinite "
                f"commands from it; move {block.name!r} before {clamp!r}",
                "safety",
                i,
            )
        if not clamp and getattr(block.tick, "clamps", False):
            clamp = block.name


def period_of(document: WorkflowDocument, policies: AnyMapping) -> float:
    rate = document.get("rate")
    if rate is not None:
        return 1.0 / float(rate)
    periods = {contract.period for contract in policies.values()}
    if len(periods) != 1:
        said = f"the policies say {sorted(periods)} s" if periods else "no policy says a period"
        raise document.error(f"the key 'rate' is missing and {said}; give rate: HZ")
    return float(periods.pop())


def specs_of(
    document: WorkflowDocument, robot: Robot, policies: AnyMapping, uses: Iterable[Use]
) -> dict[str, StateSpec]:
    for use in uses:
        if use.of and use.of not in robot.members:
            known = f"; {alternatives(use.of, robot.members)}" if robot.members else ""
            raise WorkflowError(
                f"block {use.name!r}: the robot has no member {use.of!r}{known}; members are those "
                "of robot: {body: …, left_hand: …}",
                use.where,
            )
    specs = standard_states(robot.joint_names)
    hardware = hardware_states(robot.joint_names) | control_states()
    try:
        written = facts_of_all(find_platforms(document)).writes
    except UniconError:  # told when it is built; a part elsewhere may lack its package
        written = ()
    specs |= {name: spec for name, spec in hardware.items() if name in written}
    specs |= stamps_of(document)
    if document.values.get("twin") is not None:
        specs |= twin_states(robot)
    given = document.get("states", {})
    for name, values in given.items():
        standard = specs.get(name) or hardware.get(name)
        try:
            spec = StateSpec.from_dict(values or {}) if values or not standard else standard
            check_name(name)
        except UniconError as error:
            raise document.error(f"state {name!r}: {error}", "states", name) from error
        if standard is not None and (spec.shape, spec.dtype) != (standard.shape, standard.dtype):
            raise document.error(
                f"state {name!r} is a standard one of shape {list(standard.shape)} and "
                f"{standard.dtype}; give yours another name",
                "states",
                name,
            )
        specs[name] = spec
    extra = {name: specs[name] for name in given}
    for use in uses:
        own = member_robot(robot, use.of)
        if use.word == "policy":
            specs |= declared_states(use, policies, own, extra)
            continue
        factory = factory_of(use)
        declares = getattr(factory, "declares", None)
        if declares is not None:
            options = read_options(factory, _options(factory, use), use.error)
            for name, spec in declares(robot=own, **options).items():
                specs.setdefault(use.rename.get(name, name), of_whole(spec, own, robot))
    return specs


def factory_of(use: Use) -> Factory:
    """Return the factory behind a use.

    Raises:
        WorkflowError: no block of that name; with its place.
    """
    if use.factory is not None:
        return use.factory
    name = use.options.get("function", use.first) if use.word == "call" else use.word
    try:
        return find_factory("blocks", str(name), WorkflowError)
    except WorkflowError as error:
        raise WorkflowError(str(error), use.where) from error


def _options(factory: Factory, use: Use) -> AnyDict:
    options = dict(use.options)
    if use.word == "call":
        options.pop("function", None)
    elif use.first is not None:
        free = option_names(factory)
        names = [name for name in inspect.signature(factory).parameters if name in free]
        if not names:
            raise use.error(f" has no options, here: {use.first!r}")
        options[names[0]] = use.first
    return options


_OURS = ("unicon_core.blocks.", "unicon_manipulation.")  # all of them are pure

LARGEST = 65_536
"""Bytes of states beyond which a block is not warmed up: they alone would take 5 µs and more to
copy, and it spends its time on them and not on its code."""


class WarmUps:
    """The copy of the states and the second blocks on it.

    Args:
        context: what the blocks of the workflow are built with.
    """

    def __init__(self, context: BuildContext) -> None:
        self._states, self._context = context.states, context
        self._copy: States | None = None
        self._read: set[str] = set()

    def add(self, block: Block, factory: Factory, build: Callable[[BuildContext], Block]) -> None:
        """Give a block a warm-up, where its factory is pure and it has none.

        It is the tick of a second one, or its `again` where that ticks as if data were new.

        Args:
            block: the block.
            factory: what it was built with.
            build: builds it once more in another context.
        """
        pure = getattr(factory, "pure", getattr(factory, "__module__", "").startswith(_OURS))
        if not pure or block.warm_up is not None or block.stage is Stage.RECV:
            return  # a second device would take what the first is to hear
        slots = self._states.layout.slots
        used = {*block.reads, *block.amends, *block.writes}
        if sum(slots[name].nbytes for name in used & slots.keys()) > LARGEST:
            return
        self._read |= used
        if self._copy is None:
            self._copy = States(self._states.layout)
            # The block itself tells what there is to tell.
            self._context = replace(self._context, states=self._copy, tell=lambda _: None)
        tick = build(self._context).tick
        block.warm_up = _quiet(getattr(tick, "again", tick))

    def refresh(self, platform: Tick | None) -> Tick | None:
        """Return what brings the present values into the copy, or None where nothing is warmed up.

        Args:
            platform: what warms the platform's own way to the motors, called with it; or None.
        """
        warm_up = None if platform is None else _quiet(platform)
        if self._copy is None:
            return warm_up
        into, out_of = memoryview(self._copy.buffer.data), memoryview(self._states.buffer.data)
        parts = [(into[part], out_of[part]) for part in spans(self._states.layout, self._read)]

        def refresh() -> None:
            for there, here in parts:
                there[:] = here
            if warm_up is not None:
                warm_up()

        return refresh


def _quiet(tick: Tick) -> Tick:
    """Return its tick: a fault that it finds is told by the block itself, in its turn."""

    def warm_up() -> None:
        try:
            tick()
        except Exception:
            return

    return warm_up
