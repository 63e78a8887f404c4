"""Division: which blocks of a divided workflow belong to a part, and what it publishes where."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from unicon_base import WorkflowError, alternatives
from unicon_core.flow import Block, Node, Stage, Zip, as_block, blocks_of, children_of
from unicon_core.flow.nodes import with_children
from unicon_core.states import States
from unicon_core.states.groups import COMMAND, Groups
from unicon_core.states.links import Publisher, Store, open_writers
from unicon_core.workflow.build import Sections
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.parts import Parts


def of_part(
    part: str,
    parts: Parts | None,
    sections: Sections,
    ending: Node | None,
    document: WorkflowDocument,
) -> tuple[Sections, Node | None]:
    """Return what of each stage, and of the wind-down, belongs to a part.

    Raises:
        WorkflowError: there is no such part, or what does not share a tick is divided.
    """
    if parts is None:
        raise document.error(f"part {part!r}: the workflow has no parts; leave out --part", "parts")
    if part not in parts.parts:
        raise document.error(f"no part {part!r}; {alternatives(part, parts.parts)}", "parts")
    own: Sections = {}
    for stage, nodes in sections.items():
        found = [_divided(node, parts, part) for node in nodes]
        own[stage] = [node for node in found if node is not None]
    own[Stage.FLOW] = own[Stage.FLOW] or [Block("idle", bool)]
    if part != parts.first:
        own[Stage.SAFETY], ending = [], None
    return own, ending


def owner_of(block: Block, parts: Parts) -> str:
    """Return the part that a block belongs to."""
    return block.part or parts.first


def is_divided(blocks: Iterable[Block], parts: Parts | None) -> bool:
    """Return whether a block belongs to another part than the first; else parts are only named."""
    return parts is not None and any(owner_of(block, parts) != parts.first for block in blocks)


def check_places(
    sections: Mapping[Stage, list[Node]], ending: Node | None, parts: Parts | None
) -> None:
    """Refuse blocks of parts that are not there, and safety blocks away from the robot.

    Raises:
        WorkflowError: with the block's place.
    """
    for stage, nodes in (*sections.items(), (None, [ending] if ending else [])):
        for block in (block for node in nodes for block in blocks_of(node)):
            if not block.part:
                continue
            if parts is None:
                raise WorkflowError(
                    f"on: {block.part}: the workflow has no parts; declare them (parts:), or leave "
                    "out on:",
                    block.where,
                )
            if block.part not in parts.parts:
                raise WorkflowError(
                    f"on: no part {block.part!r}; {alternatives(block.part, parts.parts)}",
                    block.where,
                )
            if stage in (None, Stage.SAFETY) and block.part != parts.first:
                where = "safety" if stage else "wind_down"
                raise WorkflowError(
                    f"{where}: {block.name!r} is on {block.part!r}; {where} belongs to the part "
                    f"with the robot: leave out on:",
                    block.where,
                )


def refuse_parts(parts: Parts | None, document: WorkflowDocument) -> None:
    """Refuse a divided workflow, whose parts command each other.

    Raises:
        WorkflowError: it is one.
    """
    if parts is not None:
        raise document.error(
            "parts: a divided workflow cannot be run silently (--dry, preflight): what one part "
            "publishes moves another; run it undivided",
            "parts",
        )


def _divided(node: Node, parts: Parts, part: str) -> Node | None:
    """Return what of a tree belongs to a part, None for nothing.

    Raises:
        WorkflowError: what is in order (chain, loop, switch) is divided.
    """
    owners = _owners(node, parts)
    if owners == {part}:
        return node
    if part not in owners:
        return None
    if not isinstance(node, Zip):
        raise WorkflowError(
            f"{type(node).__name__.lower()}: its blocks are of the parts "
            f"{', '.join(sorted(owners))}, which do not share a tick; divide at a zip or a list",
            node.where,
        )
    kept = [child for child in children_of(node) if part in _owners(child, parts)]
    pruned = [_divided(child, parts, part) for child in kept]
    whole = Zip(*(child for child in pruned if child is not None), where=node.where)
    return with_children(whole, list(children_of(whole)))


def _owners(node: Node, parts: Parts) -> set[str]:
    return {owner_of(block, parts) for block in blocks_of(node)}


def publishers(
    store: Store, part: str, groups: Groups, states: States, stages: Mapping[Stage, list[Node]]
) -> list[Block]:
    """Put a publisher of each group behind what changes its states last; return them.

    Command states go out behind `send`: nobody outside ever sees one that safety has not seen.

    Args:
        store: how they travel.
        part: which publishes, "" for a workflow that is not divided.
        groups: its groups.
        states: of this process.
        stages: all blocks of the tick; is added to.

    Raises:
        StateError: another run publishes under that name.
    """
    writers = open_writers(store, part, groups, states)
    changed = {
        stage: {s for n in nodes for b in blocks_of(n) for s in (*b.writes, *b.amends)}
        for stage, nodes in stages.items()
        if stage is not Stage.OBSERVE
    }
    written = set().union(*changed.values())
    made = []
    for name, group in groups.items():
        last = Stage.SEND if name == COMMAND else Stage.RECV
        for stage, found in changed.items():
            if found & set(group.specs) and _rank(stage) > _rank(last):
                last = stage
        # A state that no block writes, such as one that a robot does not report, is published too.
        reads = [state for state in group.specs if part or state in written]
        block = as_block(Publisher(writers[name], reads, f"publish {name}"))
        block.stage = last
        stages[last].append(block)
        made.append(block)
    return made


def _rank(stage: Stage) -> int:
    return list(Stage).index(stage)
