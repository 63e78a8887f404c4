"""Workflow: a workflow file built into states, platform and a compiled graph, for the runner."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from unicon_core.blocks.stops import Finite
from unicon_core.errors import RobotError, UniconError, WorkflowError, alternatives
from unicon_core.flow import (
    Blender,
    Block,
    Deferred,
    Every,
    Node,
    Switch,
    Zip,
    as_block,
    blocks_of,
)
from unicon_core.flow.checks import check_graph, raise_first
from unicon_core.flow.critical_path import critical_path
from unicon_core.flow.fuse import fuse
from unicon_core.platforms.platform import Platform
from unicon_core.policies.action_map import lacking_joints
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import Robot, load_robot, robot_names
from unicon_core.signals import SIGNALS
from unicon_core.states import Layout, States, StateSpec, standard_states
from unicon_core.states.spec import check_name
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.autowire import BuildContext, autowire, option_names
from unicon_core.workflow.command_bounds import (
    COMMAND,
    CommandBound,
    CommandBounds,
    bounded_flow,
    command_bounds,
    reads_command,
)
from unicon_core.workflow.document import WorkflowDocument, load_document
from unicon_core.workflow.expression import expression
from unicon_core.workflow.flow_yaml import BlockUse, FlowReader
from unicon_core.workflow.gate import Gate
from unicon_core.workflow.platforms import build_platform
from unicon_core.workflow.policies import (
    controllers_reading,
    declared_states,
    load_policies,
    policy_factory,
)
from unicon_core.workflow.registry import Factory, find_factory
from unicon_core.workflow.settings import safety_of
from unicon_core.workflow.warm_ups import WarmUps

__all__ = ["Hook", "Workflow", "build_workflow", "load_workflow"]

Hook = Callable[["Workflow"], Sequence[Block]]
"""Builds blocks once states and platform exist: a bridge, a recorder, a viewer.

Blocks of an `inputs` hook run before the flow, but those of role `tune` between flow and safety,
and those of role `safety` behind the workflow's own safety, as the last before `send`.
"""

GIVEN = ("tick", "velocity_command", "joint_vel_target", "joint_effort_ff")
"""States that may be read though no block writes them: the runner does, or zero is meant."""


@dataclass
class Workflow:
    """A built workflow.

    Attributes:
        document: the file it was built from.
        robot: the robot file.
        platform: the built platform.
        states: all states.
        period: tick period in [s].
        policies: name to policy contract.
        root: the whole tree: recv, commands, inputs, flow, tuning, safety, send, deferred; what
            the command does not depend on is put off, and neighbouring copies are fused.
        critical: the blocks that the command depends on.
        blocks: all blocks in order of building, for closing.
        gate: what every command passes last.
        command_bounds: what the velocity command is held to; empty where nobody reads it.
        warn: takes what blocks tell while they tick, one line each; the runner sets its own.
        safety: labels of the blocks between the flow and `send`; none with `safety: none`.
        safety_nodes: these blocks as the file has them, with the conditions that they stand under.
        forced: codes of the check's errors that somebody decided to run with.
    """

    document: WorkflowDocument
    robot: Robot
    platform: Platform
    states: States
    period: float
    policies: Mapping[str, Any]
    context: BuildContext
    root: Node = field(init=False)
    critical: frozenset[Block] = frozenset()
    blocks: list[Block] = field(default_factory=list)
    gate: Gate = field(default_factory=Gate)
    _closed: bool = field(default=False, init=False)
    command_bounds: tuple[CommandBound, ...] = ()
    warn: Callable[[str], None] = print
    safety: tuple[str, ...] = ()
    safety_nodes: tuple[Node, ...] = ()
    forced: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the workflow."""
        return self.document.name

    def tell(self, message: str) -> None:
        """Hand on what a block tells, to whoever listens by then."""
        self.warn(message)

    def close(self) -> None:
        """Close the platform first (it damps), then the blocks in reverse order of building, once.

        Nothing is sent from then on. Everything is closed before the first error is raised.
        """
        if self._closed:
            return
        self._closed = True
        self.gate.close()
        errors: list[Exception] = []
        closers: list[Callable[[], object]] = [self.platform.close]
        closers += [block.close for block in reversed(self.blocks) if block.close is not None]
        for close in closers:
            try:
                close()
            except Exception as error:
                errors.append(error)
        if errors:
            raise errors[0]

    def damp_now(self) -> bool:
        """Close in the middle of whatever runs, for a second signal; False where it closes already.

        The platform damps. What its closing finds wrong is not told: a signal handler has no ear.
        """
        if self._closed:
            return False
        with suppress(Exception):
            self.close()
        return True


def load_workflow(
    name_or_path: str | Path,
    overrides: Iterable[str] | Mapping[str, Any] = (),
    *,
    inputs: Sequence[Hook] = (),
    observers: Sequence[Hook] = (),
) -> Workflow:
    """Read and build a workflow.

    Args:
        name_or_path: a name in `config/workflows/`, or a path.
        overrides: `path=value` texts as of `--set`, or a mapping.
        inputs: hooks whose blocks run after `commands:` and before `flow:`, or where `Hook` says.
        observers: hooks whose blocks run after `send`.

    Raises:
        UniconError: anything that the user can mend; one line with culprit and remedy.
    """
    return build_workflow(
        load_document(name_or_path, overrides), inputs=inputs, observers=observers
    )


def build_workflow(
    document: WorkflowDocument,
    *,
    inputs: Sequence[Hook] = (),
    observers: Sequence[Hook] = (),
    dry: bool = False,
) -> Workflow:
    """Build a workflow; see `load_workflow`.

    Args:
        document: the workflow file.
        inputs: as of `load_workflow`.
        observers: as of `load_workflow`.
        dry: open no hardware: its options are checked, and `fake` stands in its place.
    """
    robot = load_robot_of(document)
    policies = load_policies(document, robot)
    period = _period(document, policies)
    specs = _specs(document, robot, policies)
    num_robots = document.get("num_robots", int)
    states = States(Layout(specs, num_robots))
    context = BuildContext(states, robot, period, policies, document.path.parent)
    platform = build_platform(document, context, dry=dry)
    workflow = Workflow(document, robot, platform, states, period, policies, context)
    try:
        with SIGNALS.guard(damp=workflow.damp_now):
            _assemble(workflow, inputs, observers)
            SIGNALS.check()
    except BaseException:
        workflow.close()
        raise
    return workflow


def _assemble(workflow: Workflow, inputs: Sequence[Hook], observers: Sequence[Hook]) -> None:
    document = workflow.document
    warm_ups = WarmUps(workflow.context)
    reader = _reader(workflow, warm_ups)

    def section(key: str, given: Sequence[Any] | None = None) -> list[Node]:
        items = document.get(key, list, []) if given is None else given
        return [reader.node(item, (key, i)) for i, item in enumerate(items)]

    commands = section("commands")
    flow = reader.node(document.values["flow"], ("flow",))
    safety = section("safety", safety_of(document))
    for node in safety:
        if isinstance(node, Block):
            node.role = "safety"
    _finite_first(document, safety)
    workflow.safety_nodes = tuple(safety)
    workflow.safety = tuple(block.name for node in safety for block in blocks_of(node))
    after = [Deferred(node) for node in section("deferred")]

    def hooked(hooks: Sequence[Hook]) -> list[Block]:
        first = len(workflow.blocks)
        for hook in hooks:  # one by one: what a hook has opened is closed when the next one fails
            workflow.blocks += hook(workflow)
        return workflow.blocks[first:]

    asked = hooked(inputs)
    tuning = [block for block in asked if block.role == "tune"]
    last = [block for block in asked if block.role == "safety"]
    before = [block for block in asked if block not in tuning and block not in last]
    early = reads_command(commands)
    if early or reads_command([flow, *safety]):
        states, readers = (
            workflow.states,
            controllers_reading(COMMAND, workflow.blocks, workflow.policies),
        )
        workflow.command_bounds = command_bounds(readers, workflow.robot)

        def bounds() -> Block:
            found, period = workflow.command_bounds, workflow.period
            return as_block(
                CommandBounds(states[COMMAND], found, states["tick"], period, workflow.tell)
            )

        before.append(bounds())
        flow = bounded_flow(flow, bounds)
        if early:
            commands = [bounded_flow(node, bounds) for node in commands]
    observed = [Deferred(block) for block in hooked(observers)]
    platform = workflow.platform
    recv = Block("recv", platform.recv, writes=tuple(platform.writes), role="recv")
    recv.warm_up = warm_ups.refresh(getattr(platform, "warm_up", None))
    send = Block(
        "send", workflow.gate.before(platform.send), reads=tuple(platform.reads), role="send"
    )
    acting = (recv, *commands, *before, flow, *tuning, *safety, *last, send, *after)
    # Observers only look: what they would find missing is no reason not to run.
    raise_first(check_graph(Zip(*acting), workflow.states, given=GIVEN))
    path = critical_path(Zip(*acting, *observed))
    workflow.critical = path.critical
    workflow.root = fuse(path.root, workflow.states)
    require = getattr(platform, "require", None)
    if require is not None:
        blocks = sorted(path.critical, key=lambda block: block.name)
        require({state: b.name for b in blocks for state in (*b.reads, *b.amends)})


def _finite_first(document: WorkflowDocument, safety: Sequence[Node]) -> None:
    """Refuse limits before `finite`: they turn an infinite command into a limit, unseen."""
    clamp = ""
    for i, node in enumerate(safety):
        for block in blocks_of(node):
            if isinstance(block.tick, Finite) and clamp:
                raise document.error(
                    f"safety: {block.name!r} stands behind {clamp!r}, which hides infinite "
                    f"commands from it; move {block.name!r} before {clamp!r}",
                    "safety",
                    i,
                )
            if not clamp and getattr(block.tick, "clamps", False):
                clamp = block.name


def load_robot_of(document: WorkflowDocument) -> Robot:
    """Load the robot that a workflow names, by name or by a path beside the workflow file.

    Raises:
        RobotError: no such robot, or its file is wrong.
    """
    text: str = document.get("robot", str)
    beside = document.path.parent / text
    if "/" in text and os.path.isfile(beside):
        return load_robot(beside)
    if text not in robot_names() and "/" not in text and not text.endswith(".yaml"):
        known = alternatives(text, robot_names())
        where = document.where("robot")
        raise RobotError(
            f"{where}: unknown robot {text!r}; {known}; or give a path to a .yaml file"
        )
    return load_robot(text)


def _period(document: WorkflowDocument, policies: Mapping[str, Any]) -> float:
    rate = document.get("rate", (int, float))
    if rate is not None:
        if not 0.0 < rate <= 10_000.0:
            raise document.error(f"rate: {rate!r} is not between 0 and 10000 Hz", "rate")
        return 1.0 / float(rate)
    periods = {contract.period for contract in policies.values()}
    if len(periods) != 1:
        said = f"the policies say {sorted(periods)} s" if periods else "no policy says a period"
        raise document.error(f"the key 'rate' is missing and {said}; give rate: HZ")
    return float(periods.pop())


def _specs(
    document: WorkflowDocument, robot: Robot, policies: Mapping[str, Any]
) -> dict[str, StateSpec]:
    specs = standard_states(robot.joint_names)
    given = document.get("states", dict, {})
    for name, values in given.items():
        try:
            spec = StateSpec.from_dict(values or {})
            check_name(name)
        except UniconError as error:
            raise document.error(f"state {name!r}: {error}", "states", name) from error
        standard = specs.get(name)
        if standard is not None and (spec.shape, spec.dtype) != (standard.shape, standard.dtype):
            raise document.error(
                f"state {name!r} is a standard one of shape {list(standard.shape)} and "
                f"{standard.dtype}; give yours another name",
                "states",
                name,
            )
        specs[name] = spec
    extra = {name: specs[name] for name in given}
    for use in _uses(document):
        if use.name == "policy":
            specs |= declared_states(use, policies, robot, extra)
            continue
        factory = _factory(use)
        declares = getattr(factory, "declares", None)
        if declares is not None:
            for name, spec in declares(robot=robot, **_options(factory, use)).items():
                specs.setdefault(use.rename.get(name, name), spec)
    return specs


def _uses(document: WorkflowDocument) -> list[BlockUse]:
    """Return all mentions of blocks, read with a builder that only writes them down."""
    found: list[BlockUse] = []

    def note(use: BlockUse) -> Block:
        found.append(use)
        return Block(use.name, bool)

    def predicate(text: str, where: str) -> Block:
        return Block(text, bool, where=where)

    def switch(selector: Block, cases: dict[str, Node], blend: float, where: str) -> Switch:
        return Switch(selector, cases, where=where)

    reader = FlowReader(document, note, predicate, switch)
    reader.node(document.values["flow"], ("flow",))
    given = {key: document.get(key, list, []) for key in ("commands", "deferred")}
    for key, items in (given | {"safety": safety_of(document)}).items():
        for i, item in enumerate(items):
            reader.node(item, (key, i))
    return found


def _factory(use: BlockUse) -> Factory:
    name = use.options.get("function", use.first) if use.name == "call" else use.name
    try:
        return find_factory("blocks", str(name), WorkflowError)
    except WorkflowError as error:
        raise WorkflowError(str(error), use.where) from error


def _options(factory: Factory, use: BlockUse) -> dict[str, Any]:
    options = dict(use.options)
    if use.name == "call":
        options.pop("function", None)
        return options
    if use.first is not None:
        free = option_names(factory)
        names = [name for name in inspect.signature(factory).parameters if name in free]
        if not names:
            raise WorkflowError(
                f"block {use.name!r} has no options, here: {use.first!r}", use.where
            )
        options[names[0]] = use.first
    return options


def _reader(workflow: Workflow, warm_ups: WarmUps) -> FlowReader:
    context, document = workflow.context, workflow.document

    def make_block(use: BlockUse) -> Node:
        SIGNALS.check()
        is_policy = use.name == "policy"
        factory = policy_factory(use, context.policies) if is_policy else _factory(use)
        options = _options(factory, use)

        def build(context: BuildContext) -> Block:
            return autowire(factory, use.label or use.name, context, options, use.rename, use.where)

        block = build(context)
        warm_ups.add(block, factory, build)
        workflow.blocks.append(block)
        return _at_its_period(block, workflow)

    def make_expression(text: str, where: str) -> Block:
        return expression(text, workflow.states, where)

    def make_switch(selector: Block, cases: dict[str, Node], blend: float, where: str) -> Switch:
        blender = Blender({name: workflow.states[name] for name in COMMAND_STATES})
        ticks = round(blend / workflow.period)
        return Switch(selector, cases, blend=ticks, blender=blender, where=where)

    return FlowReader(document, make_block, make_expression, make_switch)


def _at_its_period(block: Block, workflow: Workflow) -> Node:
    """Run a controller every n-th tick where the workflow ticks faster than it is made for."""
    contract = controller_contract(block)
    if contract is None:
        return block
    if lacking := lacking_joints(contract, workflow.robot):
        raise WorkflowError(f"block {block.name!r}: {lacking}", block.where)
    ticks = contract.period / workflow.period
    n = round(ticks)
    if n < 1 or abs(ticks - n) > 1e-6 * n:
        rate, wanted = 1.0 / workflow.period, 1.0 / contract.period
        raise WorkflowError(
            f"block {block.name!r}: {contract.name} is made for {wanted:g} Hz, which does not "
            f"divide the workflow's rate of {rate:g} Hz; set rate: {wanted:g} or a multiple",
            block.where,
        )
    return Every(n, block, where=block.where) if n > 1 else block
