"""Uses: blocks that a workflow mentions and its program builds, for the YAML reader and for Python.

    Chain(pose("stand"), Loop(policy("walk"), until=elapsed(10)))

A use is a deferred factory: arrays and period do not exist while the flow is written. `block` makes
a use of any registered block, or of a factory of one's own.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

from unicon_base import AnyMapping, WorkflowError
from unicon_core.flow import Block, Node, Tick, as_node, blocks_of

EXPRESSION = "expression"
"""Word of a predicate over states that is given as a text."""


class Use(Block):
    """One mention of a block, which is built later.

    Attributes:
        word: registered name of the block, or that of the factory.
        factory: of one's own; None for a registered block.
        first: a single value in place of options; it goes to the factory's first option.
        options: of the factory, by name.
        label: name of the built block; the word if empty.
        rename: parameter of the factory to label of the state that it gets.
        of: member of the robot whose joints alone it is built for; "" for all of it.
    """

    def __init__(
        self,
        word: str,
        *,
        factory: Callable[..., Any] | None = None,
        first: Any = None,
        options: AnyMapping | None = None,
        label: str = "",
        rename: Mapping[str, str] | None = None,
        where: str = "",
    ) -> None:
        super().__init__(label or word, self._not_built, where=where)
        self.word, self.factory, self.first, self.label = word, factory, first, label
        self.options = dict(options or {})
        self.rename = dict(rename or {})
        self.of = ""

    def _not_built(self) -> object:
        raise self.error(" is not built yet; give the flow to a Program")

    def error(self, text: str, *_: str) -> WorkflowError:
        """Return the error of which `text` follows the block's name."""
        return WorkflowError(f"block {self.name!r}{text}", self.where)


def block(
    what: str | Callable[..., Any],
    first: Any = None,
    *,
    name: str = "",
    states: Mapping[str, str] | None = None,
    **options: Any,
) -> Use:
    """Mention a block.

    Args:
        what: name of a registered block, or a factory: a function whose parameters are annotated
            `Reads`, `Writes` or `Amends`.
        first: value of its first option.
        name: label of the block.
        states: parameter to the label of the state that it gets, where that is another.
        options: its options by name.
    """
    return _use(what, first, options, name, states)


def pose(to: Any, **options: Any) -> Use:
    """Mention the block that moves to a pose and is done there: `default`, `rest`, or joints."""
    return _use("pose", None, {"to": to, **options})


def policy(name: str | None = None) -> Use:
    """Mention a policy of the program by its name; without a name the only one."""
    return _use("policy", name, {})


def elapsed(seconds: float) -> Use:
    """Mention the predicate that holds after a time in [s]."""
    return _use("elapsed", seconds, {})


def on(part: str, node: Node | Tick) -> Node:
    """Give a tree to a part of a divided workflow, where it does not belong to one already."""
    made = as_node(node)
    for each in blocks_of(made):
        each.part = each.part or part
    return made


def of(member: str, node: Node | Tick) -> Node:
    """Give a tree to a member of the robot: its blocks see and move the joints of that one alone.

    Raises:
        WorkflowError: a block of it is built already.
    """
    made = as_node(node)
    for each in blocks_of(made):
        if not isinstance(each, Use):
            raise WorkflowError(
                f"block {each.name!r} is built already, with the states of the whole robot; "
                "mention its factory: block(FACTORY)",
                each.where,
            )
        if each.word != EXPRESSION:  # it looks at the whole robot
            each.of = each.of or member
    return made


def _use(
    what: str | Callable[..., Any],
    first: Any,
    options: AnyMapping,
    name: str = "",
    states: Mapping[str, str] | None = None,
) -> Use:
    caller = sys._getframe(2)
    return Use(
        what if isinstance(what, str) else getattr(what, "__name__", type(what).__name__),
        factory=None if isinstance(what, str) else what,
        first=first,
        options=options,
        label=name,
        rename=states,
        where=f"{caller.f_code.co_filename}:{caller.f_lineno}",
    )
