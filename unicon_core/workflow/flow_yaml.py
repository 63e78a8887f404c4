"""Flow in YAML: reads the `flow:` tree of a workflow file into nodes, block by block.

    flow:
      chain:
        - pose: {to: stand, duration: 2.0}
        - loop: {do: {policy: walk}, until: {elapsed: 10.0}}
        - zip: [sway, {call: my_package.blocks:wave}]

A word is a block without options; a mapping with one key is a block with its options, or one of
zip, chain, loop, every, when, switch, deferred, skills. A value that is not a mapping is the first
option. `on: NAME` beside it gives a block to a part of a divided workflow, `of: MEMBER` to a member
of the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import Key, NotEmpty, Within, Write
from unicon_core.flow import Block, Chain, Deferred, Every, Loop, Node, Switch, When, Zip, as_node
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.file import FlowType
from unicon_core.workflow.registry import known
from unicon_core.workflow.skills import skills_switch
from unicon_core.workflow.uses import EXPRESSION, Use, of, on

MAX_NODES = 1000
"""Blocks and flow words of one workflow: each takes time to build, and aliases can repeat it."""

Where: TypeAlias = tuple[str | int, ...]


@dataclass(frozen=True)
class LoopForm:
    """What `loop:` says.

    Attributes:
        do: what is stepped.
        until: predicate that ends it.
    """

    do: FlowType
    until: Any = None


@dataclass(frozen=True)
class EveryForm:
    """What `every:` says.

    Attributes:
        n: ticks, of which it is stepped in the first.
        do: what is stepped.
    """

    n: Annotated[int, Within(1)]
    do: FlowType


@dataclass(frozen=True)
class WhenForm:
    """What `when:` says.

    Attributes:
        condition: predicate that has to hold.
        do: what is stepped.
    """

    condition: Annotated[Any, Key("if")]
    do: FlowType


@dataclass(frozen=True)
class SwitchForm:
    """What `switch:` says.

    Attributes:
        on: selector of a case.
        cases: name to what is stepped.
        blend: time over which a change of case is blended, in [s].
    """

    on: Any
    cases: Annotated[Mapping[Any, Any], NotEmpty, Write("{NAME: BLOCK}")]
    blend: Annotated[float, Within(0.0, unit="s")] = 0.0


_CONTROLS: dict[str, Any] = {
    "loop": LoopForm,
    "every": EveryForm,
    "when": WhenForm,
    "switch": SwitchForm,
}
FLOW_WORDS = ("zip", "chain", *_CONTROLS, "deferred", "skills")


class FlowReader:
    """Reads a tree of YAML values into nodes whose blocks are yet to be built.

    Args:
        document: the file, for `file:line`. Of a program in Python its values are nodes already.
    """

    def __init__(self, document: WorkflowDocument) -> None:
        self._document = document
        self._count = 0

    def node(self, value: Any, path: Where) -> Node:
        """Return the node of a YAML value.

        Raises:
            WorkflowError: the value is of no known form; with file and line.
        """
        self._count += 1
        if self._count > MAX_NODES:
            raise self._error(path, f"more than {MAX_NODES} blocks; make the workflow smaller")
        if isinstance(value, list):
            raise self._error(path, "a list stands alone; write chain: [...] or zip: [...]")
        if value == "skills":
            value = {"skills": None}
        if isinstance(value, str):
            return Use(value, where=self._document.where(*path))
        if callable(value) or isinstance(value, Node):
            return as_node(value, where=self._document.where(*path))
        if isinstance(value, dict) and len(value) > 1:
            for word, what, give in (("on", "part", on), ("of", "member", of)):
                if word in value:
                    return self._given(word, what, give, value, path)
        if not isinstance(value, dict) or len(value) != 1:
            keys = ", ".join(map(str, value)) if isinstance(value, dict) else repr(value)
            raise self._error(
                path, f"a block is a word or a mapping with one key, here: {keys or 'nothing'}"
            )
        ((word, body),) = value.items()
        path = (*path, word)
        if word in ("zip", "chain"):
            if not isinstance(body, list) or not body:
                raise self._error(path, f"{word}: needs a list of blocks")
            children = [self.node(item, (*path, i)) for i, item in enumerate(body)]
            several = Zip if word == "zip" else Chain
            return several(*children, where=self._document.where(*path))
        if word == "deferred":
            return Deferred(self.node(body, path), where=self._document.where(*path))
        if word == "skills":
            return skills_switch(self._document, body, path, self.node)
        if word in _CONTROLS:
            return self._control(word, body, path)
        return self._use(str(word), body, path)

    def _given(
        self,
        word: str,
        what: str,
        give: Callable[[str, Node], Node],
        value: dict[str, Any],
        path: Where,
    ) -> Node:
        """Return the node beside `on: NAME` or `of: NAME`, all of whose blocks belong there."""
        name = value[word]
        if not isinstance(name, str):
            raise self._error(
                (*path, word), f"{word}: {name!r} is not a {what}; write {word}: NAME"
            )
        return give(name, self.node({k: v for k, v in value.items() if k != word}, path))

    def _use(self, name: str, body: Any, path: Where) -> Use:
        where = self._document.where(*path)
        if body is None:
            return Use(name, where=where)
        if not isinstance(body, dict):
            return Use(name, first=body, where=where)
        options = dict(body)
        rename = options.pop("states", None) or {}
        label = options.pop("name", "")
        if not isinstance(rename, dict) or not all(isinstance(v, str) for v in rename.values()):
            raise self._error(
                path, f"block {name!r}: states: needs a mapping of parameter to state"
            )
        return Use(name, options=options, label=str(label), rename=rename, where=where)

    def _predicate(self, value: Any, path: Where) -> Block:
        """Return the block of a predicate: an expression, a block's name, or a block."""
        if isinstance(value, bool) or value is None:
            raise self._error(path, f"{path[-1]}: needs a block or an expression over states")
        if isinstance(value, (int, float)):
            return self._expression(str(value), path)
        if isinstance(value, str) and value not in known("blocks") and ":" not in value:
            return self._expression(value, path)
        node = self.node(value, path)
        if not isinstance(node, Block):
            raise self._error(path, f"{path[-1]}: needs a block or an expression, not a flow")
        return node

    def _expression(self, text: str, path: Where) -> Use:
        return Use(EXPRESSION, first=text, label=text, where=self._document.where(*path))

    def _control(self, word: str, body: Any, path: Where) -> Node:
        said = read_part(self._document, _CONTROLS[word], body, *path)
        where = self._document.where(*path)
        if isinstance(said, SwitchForm):
            cases = {str(n): self.node(case, (*path, "cases", n)) for n, case in said.cases.items()}
            selector = self._predicate(said.on, (*path, "on"))
            return Switch(selector, cases, blend=said.blend, where=where)
        child = self.node(said.do, (*path, "do"))
        if isinstance(said, EveryForm):
            return Every(said.n, child, where=where)
        if isinstance(said, WhenForm):
            return When(self._predicate(said.condition, (*path, "if")), child, where=where)
        stop = None if said.until is None else self._predicate(said.until, (*path, "until"))
        return Loop(child, stop, where=where)

    def _error(self, path: Where, message: str) -> WorkflowError:
        return self._document.error(message, *path)
