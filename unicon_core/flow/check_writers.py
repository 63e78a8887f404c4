"""Two writers: a state that two blocks write in the same tick, where the last one wins unseen."""

from __future__ import annotations

from typing import NamedTuple

from unicon_core.flow.block import Block
from unicon_core.flow.finding import Finding
from unicon_core.flow.nodes import Chain, Node, Switch, When, children_of


class _Writer(NamedTuple):
    block: Block
    conditional: bool  # below a When: it may be meant to exclude another When


def two_writers(root: Node) -> list[Finding]:
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
                    {name: _of(node.selector, writers) for name, writers in together.items()}, here
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


def _of(block: Block, writers: list[_Writer]) -> list[_Writer]:
    return [writer for writer in writers if writer.block is block]
