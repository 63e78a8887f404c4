"""Checks of a built graph, for the build (which stops at the first) and for `unicon check`.

Only what can be proven from declarations and from the tree is a finding: a block that declares
nothing is believed to touch nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from unicon_base.errors import WorkflowError, alternatives
from unicon_core.flow.block import Block, LinearMap
from unicon_core.flow.critical_path import Finding, behind_send, reads_before_writes
from unicon_core.flow.nodes import (
    Chain,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    blocks_of,
    children_of,
    never_done,
)
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES


def check_graph(root: Node, states: States, *, given: Iterable[str] = ()) -> list[Finding]:
    """Check a graph.

    Found are: unknown states; copies and maps between states of another type, unit or frame, and
    states that are not as a block expects them; a state read before anything writes it; two writers
    of a state in one tick; a command written, or a safety block, behind `send`; a loop that can
    never end and blocks that can never be reached.

    Args:
        root: the tree.
        states: all states.
        given: states that something outside the graph writes (the runner, ROS). A state with an
            initial value other than zero counts as given too, but not what is measured: a base
            that nobody looks at is upright for ever.

    Returns:
        The findings, first those without which the others cannot be judged.
    """
    specs = states.layout.specs
    unknown = list(_unknown(root, states))
    if unknown:
        return unknown
    initial = (
        name for name, spec in specs.items() if spec.initial != 0.0 and name not in BASE_STATES
    )
    return [
        *_mismatches(root, states),
        *reads_before_writes(root, frozenset([*given, *initial])),
        *_two_writers(root),
        *behind_send(root),
        *_never_reached(root),
    ]


def raise_first(findings: Iterable[Finding]) -> None:
    """Raise the first finding, if there is one.

    Raises:
        WorkflowError: its text, with `file:line` where known.
    """
    for finding in findings:
        raise WorkflowError(finding.text, finding.where)


def _unknown(root: Node, states: States) -> Iterator[Finding]:
    for block in blocks_of(root):
        for word in ("reads", "writes", "amends", "expects"):
            for name in getattr(block, word):
                if name not in states:
                    remedy = f"{alternatives(name, states)}; or declare it under 'states:'"
                    yield Finding.of(block, f"{word} {name!r}, which is not a state", remedy)


def _mismatches(root: Node, states: States) -> Iterator[Finding]:
    for block in blocks_of(root):
        for name, wanted in block.expects.items():
            spec = states.spec(name)
            for key, value in wanted.items():
                has = getattr(spec, key)
                if has != value:
                    yield Finding.of(
                        block,
                        f"expects {name!r} with {key} {_said(value)}, and it has {_said(has)}",
                        f"declare the state with {key}: {_said(value)}, or map another one to it",
                    )
        if block.linear is not None:
            yield from _copied(block, block.linear, states)


def _copied(block: Block, linear: LinearMap, states: States) -> Iterator[Finding]:
    names = linear.source_name, linear.target_name
    if names[0] not in states or names[1] not in states:
        return
    source, target = states.spec(names[0]), states.spec(names[1])
    for key, remedy in (
        ("dtype", "give both states one dtype"),
        ("unit", "give a scale that converts it, or both states one unit"),
        ("frame", "rotate it with a block of its own, or give both states one frame"),
    ):
        has, wants = getattr(source, key), getattr(target, key)
        if has == wants or not has or not wants or (key == "unit" and linear.scale is not None):
            continue
        copies = f"copies {names[0]!r} ({key} {has}) into {names[1]!r} ({key} {wants})"
        yield Finding.of(block, copies, remedy)


def _said(value: object) -> str:
    return repr(value) if value == "" else str(value)


class _Writer(NamedTuple):
    block: Block
    conditional: bool  # below a When: it may be meant to exclude another When


def _two_writers(root: Node) -> list[Finding]:
    """Find states with two writers in one tick.

    Children of a chain and cases of a switch exclude each other. Of two blocks below two `when`
    nobody can tell. A block that amends is not a writer, and a block is not a second writer to
    itself. Blocks of different members or groups of a robot write different joints.
    """
    found: dict[tuple[str, str, str], Finding] = {}

    def clash(one: dict[str, list[_Writer]], other: dict[str, list[_Writer]]) -> None:
        for name in one.keys() & other.keys():
            for first in one[name]:
                for second in other[name]:
                    if first.block is second.block or (first.conditional and second.conditional):
                        continue
                    if _apart(name, first.block, second.block):
                        continue
                    key = (name, first.block.name, second.block.name)
                    found[key] = Finding.of(
                        second.block,
                        f"writes {second.block.claim(name)!r} in the same tick as "
                        f"{first.block.name!r}",
                        _remedy(name, first.block, second.block),
                    )

    def walk(node: Node, conditional: bool) -> dict[str, list[_Writer]]:
        if isinstance(node, Block):
            return {name: [_Writer(node, conditional)] for name in node.writes}
        together: dict[str, list[_Writer]] = {}
        for child in children_of(node):
            below = isinstance(node, When) and child is node.child
            here = walk(child, conditional or below)
            if isinstance(node, Switch):
                clash(
                    {
                        name: [w for w in writers if w.block is node.selector]
                        for name, writers in together.items()
                    },
                    here,
                )
            elif not isinstance(node, Chain):
                clash(together, here)
            for name, writers in here.items():
                together.setdefault(name, []).extend(writers)
        return together

    walk(root, False)
    return [found[key] for key in sorted(found)]


def _apart(name: str, first: Block, second: Block) -> bool:
    """Whether they write different joints."""
    one, other = first.share, second.share
    if one is None or other is None or name not in one.states:
        return False
    return one.joints.isdisjoint(other.joints)


def _remedy(name: str, first: Block, second: Block) -> str:
    either = (second, first)
    whole = next((block for block in either if block.claim(name) == name), None)
    share = first.share or second.share
    if whole is not None and share is not None and name in share.states:
        free = [name for name, joints in share.parts.items() if joints.isdisjoint(share.joints)]
        others = f", of: {' or '.join(free)}" if free else ""
        return f"a joint has one writer: give {whole.name!r} other joints{others}"
    if share is not None and name in share.states:
        both = _both(first, second)
        return f"a joint has one writer, and both move {both}: take them from one of the two"
    return (
        "a state has one writer: remove one, declare the second as one that "
        "amends, or let a chain or switch choose"
    )


def _both(first: Block, second: Block) -> str:
    """Return the joints that two blocks move; the first few of many."""
    shares = [block.share.joints for block in (first, second) if block.share is not None]
    names = sorted(frozenset.intersection(*shares))
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _never_reached(root: Node) -> list[Finding]:
    """Find children of chains behind one that is never done, each chain's first."""
    return list(dict.fromkeys(_walk(root)))


def _walk(node: Node) -> Iterator[Finding]:
    if isinstance(node, Chain):
        for before, behind in zip(node.children, node.children[1:]):
            if not never_done(before):
                continue
            blocks = blocks_of(behind)
            loop = _loop(before)
            if loop is None:
                name = blocks_of(before)[0].name
                yield Finding(
                    f"block {blocks[0].name!r}",
                    f"can never be reached: {name!r} before it in the chain is never done",
                    f"run both in a zip, or give {name!r} an end: loop: {{do: …, until: …}}",
                    blocks[0].where or behind.where,
                )
            else:
                name = blocks_of(loop)[0].name
                yield Finding(
                    "loop",
                    f"of {name!r} can never end, and {blocks[0].name!r} stands behind it in the "
                    "chain",
                    "give it an until:, or put it last",
                    loop.where or blocks_of(loop)[0].where,
                )
            break
    for child in children_of(node):
        yield from _walk(child)


def _loop(node: Node) -> Loop | None:
    """Return the loop that a node is, through nodes with one child."""
    while not isinstance(node, Loop):
        if isinstance(node, (Every, When)):
            node = node.child
        elif isinstance(node, (Zip, Chain)) and len(node.children) == 1:
            node = node.children[0]
        else:
            return None
    return node
