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

from collections.abc import Callable
from typing import Any, TypeAlias

from unicon_core.errors import WorkflowError, alternatives
from unicon_core.flow import Block, Chain, Deferred, Every, Loop, Node, Switch, When, Zip, as_node
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.registry import known
from unicon_core.workflow.skills import skills_switch
from unicon_core.workflow.uses import EXPRESSION, Use, of, on

FLOW_WORDS = ("zip", "chain", "loop", "every", "when", "switch", "deferred", "skills")

MAX_NODES = 1000
"""Blocks and flow words of one workflow: each takes time to build, and aliases can repeat it."""

Where: TypeAlias = tuple[str | int, ...]


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
        if word in FLOW_WORDS:
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
        forms = {
            "loop": (("do",), ("until",)),
            "every": (("n", "do"), ()),
            "when": (("if", "do"), ()),
            "switch": (("on", "cases"), ("blend",)),
        }
        needed, optional = forms[word]
        shape = ", ".join([*(f"{key}: …" for key in needed), *(f"[{key}: …]" for key in optional)])
        if not isinstance(body, dict):
            raise self._error(path, f"{word}: needs {{{shape}}}")
        for key in body:
            if key not in needed and key not in optional:
                known_keys = (*needed, *optional)
                raise self._error(
                    (*path, key), f"{word}: no key {key!r}; {alternatives(str(key), known_keys)}"
                )
        for key in needed:
            if body.get(key) is None:
                raise self._error(path, f"{word}: the key {key!r} is missing; it needs {{{shape}}}")
        where = self._document.where(*path)
        if word == "switch":
            return self._switch(body, path, where)
        child = self.node(body["do"], (*path, "do"))
        if word == "every":
            return Every(body["n"], child, where=where)
        if word == "when":
            return When(self._predicate(body["if"], (*path, "if")), child, where=where)
        until = body.get("until")
        stop = None if until is None else self._predicate(until, (*path, "until"))
        return Loop(child, stop, where=where)

    def _switch(self, body: dict[str, Any], path: Where, where: str) -> Node:
        cases = body["cases"]
        if not isinstance(cases, dict) or not cases:
            raise self._error((*path, "cases"), "switch: cases: needs a mapping of name to block")
        blend = body.get("blend", 0.0)
        if isinstance(blend, bool) or not isinstance(blend, (int, float)) or blend < 0:
            raise self._error(
                (*path, "blend"), f"switch: blend: {blend!r} is not a time >= 0 in [s]"
            )
        nodes = {str(name): self.node(case, (*path, "cases", name)) for name, case in cases.items()}
        selector = self._predicate(body["on"], (*path, "on"))
        return Switch(selector, nodes, blend=float(blend), where=where)

    def _error(self, path: Where, message: str) -> WorkflowError:
        return self._document.error(message, *path)
