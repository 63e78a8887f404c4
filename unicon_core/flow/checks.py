"""Checks of a built graph, for the build (which stops at the first) and for `unicon check`.

Only what can be proven from declarations and from the tree is a finding: a block that declares
nothing is believed to touch nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from unicon_core.errors import WorkflowError, alternatives
from unicon_core.flow import check_ends, check_order, check_writers
from unicon_core.flow.block import Block
from unicon_core.flow.finding import Finding
from unicon_core.flow.linear import LinearMap
from unicon_core.flow.nodes import Node, blocks_of
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES

__all__ = ["Finding", "check_graph", "raise_first"]


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
        *check_order.reads_before_writes(root, frozenset([*given, *initial])),
        *check_writers.two_writers(root),
        *check_order.behind_send(root),
        *check_ends.never_reached(root),
    ]


def raise_first(findings: Iterable[Finding]) -> None:
    """Raise the first finding, if there is one.

    Raises:
        WorkflowError: its text, with `file:line` where known.
    """
    for finding in findings:
        raise WorkflowError(finding.text, finding.where or None)


def _unknown(root: Node, states: States) -> Iterator[Finding]:
    for block in blocks_of(root):
        for word, names in (
            ("reads", block.reads),
            ("writes", block.writes),
            ("amends", block.amends),
            ("expects", tuple(block.expects)),
        ):
            for name in names:
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
