"""Skills: policies between which a workflow switches, from `skills:` to a switch of the flow.

    skills:
      stand: {do: {zip: [{velocity_command: {constant: [0, 0, 0]}}, {policy: walk}]}}
      walk: {policy: walk, enter: "projected_gravity[2] < -0.9"}
      dance: {policy: dance, from: [walk], blend: 0.5, next: walk}
    flow: skills                       # begins with the first; or {skills: {on: STATE}}

It is the switch that one would write by hand: `blend_in` behind each skill, and a selector that
`unicon_core/blocks/controls/modes.py` has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import Write
from unicon_core.blocks.controls.modes import SKILL, Ended, Skills, check_buttons, way_of
from unicon_core.flow import Block, Chain, Node, Switch, Zip
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import control_states
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.expression import EntryCondition
from unicon_core.workflow.program_data import ProgramData
from unicon_core.workflow.uses import Use

BLEND = 0.5
"""Time in which a skill comes in, unless it says another, in [s]."""


@dataclass(frozen=True)
class SkillsForm:
    """What `skills:` of a flow says.

    Attributes:
        on: state that asks for a skill by its number.
    """

    on: Annotated[str | None, Write("STATE")] = None


Reader = Callable[[Any, tuple[str | int, ...]], Node]


def skills_switch(
    document: WorkflowDocument, options: Any, path: tuple[str | int, ...], read: Reader
) -> Node:
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
        node: Node = read(body, (*place, "do") if "do" in skill else place)
        blend = float(skill.get("blend", BLEND))
        if blend:
            node = Zip(node, Use("blend_in", first=blend, where=where), where=where)
        if "next" in skill:
            node = Chain(node, Use("ended", factory=ended, label=f"end of {name}", where=where))
        cases[name] = node
    return Switch(_selector(document, said, on, made, where), cases, where=where)


def _selector(
    document: WorkflowDocument,
    said: Mapping[str, Mapping[str, Any]],
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
        number = StateSpec((), "int32", "", "", (), "number of the present skill")
        return {SKILL: number, **(control_states() if held else {})}

    skills.declares = declares  # type: ignore[attr-defined]
    skills.pure = False  # type: ignore[attr-defined]
    return Use("skills", factory=skills, where=where)


def skills_of(program: ProgramData) -> Skills | None:
    """Return what chooses between the skills of a program, None where it has none."""
    return next((b.tick for b in program.blocks if isinstance(b.tick, Skills)), None)
