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

    skills:
      stand: {do: {zip: [{velocity_command: {constant: [0, 0, 0]}}, {policy: walk}]}}
      walk: {policy: walk, enter: "projected_gravity[2] < -0.9"}
      dance: {policy: dance, from: [walk], blend: 0.5, next: walk}
    flow: skills                       # begins with the first; or {skills: {on: STATE}}

Skills become the switch that one would write by hand: `blend_in` behind each skill, and a selector
of `unicon_core/blocks/controls/modes.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, WorkflowError
from unicon_base.located_yaml import Where
from unicon_base.schema.marks import Key, NotEmpty, Within, Write
from unicon_core.blocks.controls.modes import SKILL, Ended, Skills, check_buttons, way_of
from unicon_core.flow import Block, Chain, Deferred, Every, Loop, Node, Switch, When, Zip, as_node
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import control_states
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.file import FlowType
from unicon_core.workflow.program_data import ProgramData
from unicon_core.workflow.registry import known
from unicon_core.workflow.uses import EXPRESSION, EntryCondition, Use, of, on

BLEND = 0.5
"""Time in which a skill comes in, unless it says another, in [s]."""


@dataclass(frozen=True)
class SkillsForm:
    """What `skills:` of a flow says.

    Attributes:
        on: state that asks for a skill by its number.
    """

    on: Annotated[str | None, Write("STATE")] = None


Reader = Callable[[Any, Where], Node]


def skills_switch(document: WorkflowDocument, options: Any, path: Where, read: Reader) -> Node:
    """Return the switch between the skills of a workflow.

    Args:
        document: which has `skills:`.
        options: of the flow's word: `on`, a state that asks for skills, or nothing.
        path: of the word.
        read: makes a node of a YAML value at its path.

    Raises:
        WorkflowError: a skill is of no known form; with file and line.
    """
    listed = document.get("skills", {})
    if not listed:
        raise document.error("skills: the workflow has none; list them under skills:", *path)
    on = read_part(document, SkillsForm, options or {}, *path).on
    said = {name: {"policy": e} if isinstance(e, str) else e for name, e in listed.items()}
    where, made = document.where(*path), list[Skills]()

    def ended() -> Ended:
        return Ended(lambda: made[-1])

    ended.pure = False  # type: ignore[attr-defined]
    cases = {}
    for name, skill in said.items():
        place = ("skills", name)
        body = skill.get("do", {"policy": skill.get("policy")})
        node = read(body, (*place, "do") if "do" in skill else place)
        blend = float(skill.get("blend", BLEND))
        if blend:
            node = Zip(node, Use("blend_in", first=blend, where=where), where=where)
        if "next" in skill:
            node = Chain(node, Use("ended", factory=ended, label=f"end of {name}", where=where))
        cases[name] = node
    return Switch(_selector(document, said, on, made, where), cases, where=where)


def _selector(
    document: WorkflowDocument,
    said: Mapping[str, AnyMapping],
    on: str | None,
    made: list[Skills],
    where: str,
) -> Block:
    held = any("button" in skill or skill.get("calm") for skill in said.values())
    leans = any("tilt" in skill for skill in said.values())

    def skills(context: BuildContext) -> Skills:
        states, names, reads, ways = context.states, list(said), list[str](), []
        for name, skill in said.items():
            way = way_of(name, skill, names, context.period, "skills.")
            if "enter" in skill:
                place = document.where("skills", name, "enter")
                condition = EntryCondition(skill["enter"], states, place)
                reads += condition.reads
                way = replace(way, enter=condition)
            ways.append(way)
        check_buttons(ways)
        reads += ["sticks", "buttons"] if held else []
        reads += ["projected_gravity"] if leans else []
        if on is not None:
            if on not in states or states[on].size != 1 or states[on].dtype.kind not in "iu":
                raise WorkflowError(
                    f"skills: on: {on!r} is not a state with one whole number; declare it: "
                    f"states: {{{on}: {{dtype: int32, initial: -1}}}}",
                    where,
                )
            reads.append(on)
        seen = (
            states["sticks"] if held else np.zeros(0, np.float32),
            states["buttons"] if held else np.zeros(0, np.int32),
            states["projected_gravity"],
        )
        following = {name: skill["next"] for name, skill in said.items() if "next" in skill}
        wish = None if on is None else states[on]
        found = Skills(
            seen, states[SKILL], ways, following, wish, context, tuple(dict.fromkeys(reads))
        )
        made.append(found)
        return found

    def declares(robot: Robot) -> Mapping[str, StateSpec]:
        number = StateSpec((), "int32", description="number of the present skill")
        return {SKILL: number, **(control_states() if held else {})}

    skills.declares = declares  # type: ignore[attr-defined]
    skills.pure = False  # type: ignore[attr-defined]
    return Use("skills", factory=skills, where=where)


def skills_of(program: ProgramData) -> Skills | None:
    """Return what chooses between the skills of a program, None where it has none."""
    return next((b.tick for b in program.blocks if isinstance(b.tick, Skills)), None)


MAX_NODES = 1000
"""Blocks and flow words of one workflow: each takes time to build, and aliases can repeat it."""


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


_CONTROLS: AnyDict = {
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
        where = self._document.where
        if value == "skills":
            value = {"skills": None}
        if isinstance(value, str):
            return Use(value, where=where(*path))
        if callable(value) or isinstance(value, Node):
            return as_node(value, where=where(*path))
        if isinstance(value, dict) and len(value) > 1:
            for word, what, give in (("on", "part", on), ("of", "member", of)):
                if word not in value:
                    continue
                name = value[word]
                if not isinstance(name, str):
                    text = f"{word}: {name!r} is not a {what}; write {word}: NAME"
                    raise self._error((*path, word), text)
                # All blocks of the node beside it belong there.
                return give(name, self.node({k: v for k, v in value.items() if k != word}, path))
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
            return several(*children, where=where(*path))
        if word == "deferred":
            return Deferred(self.node(body, path), where=where(*path))
        if word == "skills":
            return skills_switch(self._document, body, path, self.node)
        if word in _CONTROLS:
            return self._control(word, body, path)
        return self._use(str(word), body, path)

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
        if isinstance(value, int | float):
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
